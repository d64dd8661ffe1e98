"""The catalogue: one small file per effect. Users add their own through the entry point ``cboxlab.effects``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import iter_modules
from typing import Any

from cboxlab.scenes.errors import InputError
from cboxlab.scenes.faults import suggestion

from ._effect import AppliedEffect, BandCurves, Counts, Effect, Light, Parameter, Stage

__all__ = [
    "AppliedEffect", "BandCurves", "Counts", "Effect", "Light", "Parameter", "Stage", "apply_checked", "catalogue",
]  # fmt: skip


@lru_cache(maxsize=1)
def catalogue() -> dict[str, Effect]:
    """All effects by identifier, those of other packages included."""
    names = [module.name for module in iter_modules(__path__) if not module.name.startswith("_")]
    own = [import_module(f"{__name__}.{name}").EFFECT for name in names]
    others = [entry.load() for entry in entry_points(group="cboxlab.effects")]
    return {effect.id: effect for effect in sorted([*own, *others], key=lambda effect: effect.id)}


def apply_checked(identifier: str | None, values: Mapping[str, Any], where: str) -> AppliedEffect:
    """An effect with checked values; parameters left out take their default, or else their null value.

    Raises InputError (at ``where``) for an unknown effect or parameter, a wrong type, a value out of bounds.
    """
    known = catalogue()
    if identifier not in known:
        allowed = f"one of {', '.join(known)}"
        raise InputError(f"{where}.id", repr(identifier), allowed, suggestion(str(identifier), known))
    effect = known[identifier]
    names = [p.name for p in effect.parameters]
    for name in values:
        if name not in names:
            allowed = f"one of {', '.join(names)}"
            raise InputError(f"{where}.{name}", "an unknown parameter", allowed, suggestion(name, names))
    checked: dict[str, str | float] = {}
    for parameter in effect.parameters:
        key = f"{where}.{parameter.name}"
        if parameter.choices:
            value = values.get(parameter.name, parameter.choices[0])
            if value not in parameter.choices:
                raise InputError(key, repr(value), f"one of {', '.join(parameter.choices)}")
            checked[parameter.name] = str(value)
            continue
        fallback = parameter.default if parameter.default is not None else parameter.null
        number = values.get(parameter.name, fallback)
        proper = isinstance(number, int | float) and not isinstance(number, bool)
        if not proper or not parameter.low <= number <= parameter.high:
            allowed = f"a number from {parameter.low:g} to {parameter.high:g} {parameter.unit}"
            raise InputError(key, "nothing" if number is None else repr(number), allowed)
        checked[parameter.name] = float(number)
    return AppliedEffect(effect, checked)
