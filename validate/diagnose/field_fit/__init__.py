"""Linear fields fitted to a residual, and the record of a family of explanations."""

from .family import ActsOn, Advice, Family, FitInput, MaskedPattern, advice_for
from .field import (
    FieldFit,
    NormalEquations,
    cross_validate,
    each_band,
    fit_result,
    fixed_spectrum,
    free_spectrum,
    next_to_common_field,
    normal_equations,
    pixel_fit,
    solve_coefficients,
)
from .fitted_explanation import Columns, FittedExplanation, change_dn, equations_in_all_bands, scaled
from .light_exchange import light_exchange
from .residual_data import LEAST_DIVISOR, ChargeExchange, ResidualData, Transport
from .spot_appearance import (
    CORE_WEIGHT,
    OTHER_SIGN,
    PENALTY_IMPOSSIBLE,
    PENALTY_ODD,
    PENALTY_UNLIKELY,
    SpotAppearance,
    darker_part,
)
from .spot_regions import bells_on, hot_spot, hot_spot_of_one_band
from .surface_maps import SmoothSurfaceMaps, lamp_dn
from .surface_spot import SurfaceSpot
from .waves import Wave, strongest_waves

__all__ = [
    "CORE_WEIGHT",
    "LEAST_DIVISOR",
    "OTHER_SIGN",
    "PENALTY_IMPOSSIBLE",
    "PENALTY_ODD",
    "PENALTY_UNLIKELY",
    "ActsOn",
    "Advice",
    "ChargeExchange",
    "Columns",
    "Family",
    "FieldFit",
    "FitInput",
    "FittedExplanation",
    "MaskedPattern",
    "NormalEquations",
    "ResidualData",
    "SmoothSurfaceMaps",
    "SpotAppearance",
    "SurfaceSpot",
    "Transport",
    "Wave",
    "advice_for",
    "bells_on",
    "change_dn",
    "cross_validate",
    "darker_part",
    "each_band",
    "equations_in_all_bands",
    "fit_result",
    "fixed_spectrum",
    "free_spectrum",
    "hot_spot",
    "hot_spot_of_one_band",
    "lamp_dn",
    "light_exchange",
    "next_to_common_field",
    "normal_equations",
    "pixel_fit",
    "scaled",
    "solve_coefficients",
    "strongest_waves",
]
