"""Families of other packages: their record, and what their functions give."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from cboxlab.utils.other_packages import (
    checked_function,
    checked_generator,
    is_identifier,
    is_tuple_of,
    require,
    require_fields,
)

from ..field_fit import ActsOn, Advice, Family, FitInput, FittedExplanation, MaskedPattern, ResidualData, change_dn

__all__ = ["checked_family"]

#: Requirement of a generator, in messages.
_FORMS = "fitted explanations from its generator"


def checked_family(family: Family, where: str) -> Family:
    """Family of another package whose functions' faults are InputErrors.

    Parameters
    ----------
    family
        The family as the package has it.
    where
        The entry point, for messages.

    Returns
    -------
    Family
        A copy. Its functions raise InputError where those of the package raise any exception, or give a value of
        another type, of another shape, or with numbers that are not finite.

    Raises
    ------
    InputError
        For fields of another type than those of ``Family``.
    """
    sound = {
        "id": is_identifier(family.id),
        "title": isinstance(family.title, str),
        "acts_on": family.acts_on in get_args(ActsOn),
        "generate": callable(family.generate),
        "order": isinstance(family.order, int),
        "spot_log_odds": callable(family.spot_log_odds),
        "masked": is_tuple_of(MaskedPattern, family.masked),
        "advice": is_tuple_of(Advice, family.advice),
    }
    require_fields(where, family, sound)

    def form(value: Any, argument: FitInput | ResidualData) -> FittedExplanation:
        _require_form(value, argument if isinstance(argument, ResidualData) else argument.data, where)
        return replace(value, family=checked)

    def odds(value: Any, *arguments: Any) -> float:
        require(bool(np.isfinite(float(value))), where, f"prior odds of {value}", "a finite number")
        return float(value)

    masked = tuple(replace(p, generate=checked_generator(p.generate, where, _FORMS, form)) for p in family.masked)
    checked = replace(
        family,
        generate=checked_generator(family.generate, where, _FORMS, form),
        spot_log_odds=checked_function(family.spot_log_odds, where, "a finite number", odds),
        masked=masked,
    )
    return checked


def _require_form(form: Any, data: ResidualData, where: str) -> None:
    """Check a fitted form and the change that it makes. Raises InputError for a faulty one."""
    require(isinstance(form, FittedExplanation), where, f"a {type(form).__name__}", _FORMS)
    require(isinstance(form.form, str), where, f"a form named {form.form!r}", "a form in words")
    maps = isinstance(form.maps, ImageMaps | tuple)
    require(maps, where, f"maps of type {type(form.maps).__name__}", "maps over the image or on surfaces")
    fit = form.fit
    numbers = [fit.coefficients, fit.gain, fit.evidence, fit.freedom, fit.size]
    if not all(np.isfinite(np.asarray(number, float)).all() for number in numbers):
        require(False, where, f"a fit with numbers that are not finite ({form.form[:60]})", "finite numbers")
    change = change_dn(data, form)
    shape = data.used.shape
    require(change.shape == shape, where, f"a change of shape {change.shape}", f"shape {shape}, as the residual")
    require(bool(np.isfinite(change).all()), where, "a change that is not finite", "finite numbers")
