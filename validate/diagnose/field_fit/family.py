"""Record of a family of explanations, and what its generator is given."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray

from .fitted_explanation import FittedExplanation
from .residual_data import ResidualData
from .spot_appearance import SpotAppearance
from .spot_regions import bells_on, hot_spot, hot_spot_of_one_band
from .surface_maps import SmoothSurfaceMaps, smooth_surface_maps
from .surface_spot import SurfaceSpot, surface_spot

__all__ = ["ActsOn", "Advice", "Family", "FitInput", "MaskedPattern", "advice_for"]

#: Part of the chain on which a family acts: pixels of the sensor, the image on it, levels of frames, lamp, or scene.
ActsOn = Literal["sensor", "image", "frames", "lamp", "scene"]


@dataclass(frozen=True, eq=False)
class FitInput:
    """Residual and what several families derive from it; derived once."""

    #: Residual to be explained.
    data: ResidualData
    #: (y, x) region where the residual of all bands together is largest; None where none exceeds noise.
    spot: NDArray[np.bool_] | None
    #: (y, x) the same of the band that differs most from the mean of the others.
    spot_of_one_band: NDArray[np.bool_] | None

    @classmethod
    def of(cls, data: ResidualData) -> FitInput:
        """Input for a residual.

        Parameters
        ----------
        data
            Residual to be explained.

        Returns
        -------
        FitInput
            The residual with its regions of largest excess.
        """
        return cls(data, hot_spot(data), hot_spot_of_one_band(data))

    @cached_property
    def surface_maps(self) -> SmoothSurfaceMaps:
        """Smooth maps on all visible surfaces, with interreflection."""
        return smooth_surface_maps(self.data)

    @cached_property
    def bells(self) -> ImageMaps | None:
        """Bell-shaped maps that cover ``spot``; None without a spot."""
        return None if self.spot is None else bells_on(self.spot, self.data.cell)

    @cached_property
    def surface_spot(self) -> SurfaceSpot | None:
        """The part of ``spot`` on its main surface; None without a spot or a surface in it."""
        return None if self.spot is None else surface_spot(self.data, self.spot)


@dataclass(frozen=True)
class MaskedPattern:
    """Forms of a family that are fitted separately, as larger rendering errors would mask them."""

    #: Position in the sequence of all masked patterns, in which the first significant one is reported.
    rank: int
    #: Generator of the forms.
    generate: Callable[[ResidualData], Iterator[FittedExplanation]]


@dataclass(frozen=True)
class Advice:
    """Words for the laboratory about a cause."""

    #: Part of a form's words to which it applies; empty for every form.
    form: str
    #: Place where such a cause is fixed, after "is fixed", as "on the sensor".
    fixed: str
    #: Two or three everyday causes, noun phrases.
    causes: tuple[str, ...]
    #: The one experiment that settles it, a sentence or two.
    experiment: str


def _no_prior(spot: SpotAppearance) -> float:
    """Equal prior odds for every appearance."""
    return 0.0


@dataclass(frozen=True)
class Family:
    """Causes of a residual that act in the same way; one file with a constant ``FAMILY``."""

    #: Identifier in diagnosis.json: small letters and hyphens.
    id: str
    #: Noun phrase that completes "What remains looks like ..." in the report.
    title: str
    #: Part of the chain on which it acts. Patterns on the sensor must also hold away from edges of the image.
    acts_on: ActsOn
    #: Generator of its fitted forms.
    generate: Callable[[FitInput], Iterator[FittedExplanation]]
    _: KW_ONLY
    #: Position among the families; of equal scores the first wins. The identifier decides between equal positions.
    order: int = 1000
    #: Whether the report says where in the image it acts.
    localised: bool = True
    #: Whether it is one number for each band, constant over the image.
    levels: bool = False
    #: Whether it multiplies spectra: bands with a small relative change are then not reported.
    spectral: bool = False
    #: Whether it only adds light or charge: it brightens a place by any factor, without an outline, and darkens none.
    additive: bool = False
    #: Whether it hides what is behind: then it may change a place by any factor.
    opaque: bool = False
    #: Generator of its forms that compete with every selected effect, computed exactly and of few numbers; None for
    #: a family without such forms.
    rivals: Callable[[FitInput], Iterator[FittedExplanation]] | None = None
    #: 2 ln of its prior odds for the appearance of a spot, beyond those that all families have in common.
    spot_log_odds: Callable[[SpotAppearance], float] = _no_prior
    #: Patterns that are also fitted separately.
    masked: tuple[MaskedPattern, ...] = ()
    #: Words for the laboratory; the first entry whose form is part of the fitted form applies.
    advice: tuple[Advice, ...] = ()


def advice_for(family: Family, form: str) -> Advice | None:
    """Words for the laboratory about a form of a family.

    Parameters
    ----------
    family
        The family.
    form
        The form in words.

    Returns
    -------
    Advice or None
        The first entry that applies; None for a family without words.
    """
    return next((entry for entry in family.advice if entry.form in form), None)
