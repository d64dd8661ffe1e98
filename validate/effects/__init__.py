"""The catalogue: one small file per effect. Users add their own through the entry point ``cboxlab.effects``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import iter_modules
from types import MappingProxyType
from typing import Any

from cboxlab.scenes.errors import InputError
from cboxlab.scenes.faults import suggestion
from cboxlab.scenes.scene import Scene

from ._effect import AppliedEffect, BandCurves, Counts, Effect, Light, Parameter, Stage

__all__ = [
    "AppliedEffect", "BandCurves", "Counts", "Effect", "Light", "Parameter", "Stage", "apply_checked", "catalogue",
    "names_in",
]  # fmt: skip


@lru_cache(maxsize=1)
def catalogue() -> dict[str, Effect]:
    """All effects by identifier, those of other packages included."""
    names = [module.name for module in iter_modules(__path__) if not module.name.startswith("_")]
    own = [import_module(f"{__name__}.{name}").EFFECT for name in names]
    others = [entry.load() for entry in entry_points(group="cboxlab.effects")]
    return {effect.id: effect for effect in sorted([*own, *others], key=lambda effect: effect.id)}


def names_in(scene: Scene) -> dict[str, tuple[str, ...]]:
    """What effects may name in a scene, by parameter. A block is a surface whose name ends in -block."""
    surfaces = tuple(surface.name for surface in scene.surfaces)
    blocks = tuple(name.removesuffix("-block") for name in surfaces if name.endswith("-block"))
    return {"material": tuple(scene.materials), "surface": surfaces, "block": blocks}


def apply_checked(
    identifier: str | None,
    values: Mapping[str, Any],
    where: str,
    names: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> AppliedEffect:
    """An effect with checked values; parameters left out take their default, or else their null value.

    names : by parameter, what open choices are taken from (see ``names_in``); where it says nothing, any name will do.

    Raises InputError (at ``where``) for an unknown effect or parameter, a wrong type, a value out of bounds.
    """
    known = catalogue()
    if identifier not in known:
        allowed = f"one of {', '.join(known)}"
        raise InputError(f"{where}.id", repr(identifier), allowed, suggestion(str(identifier), known))
    effect = known[identifier]
    parameters = [p.name for p in effect.parameters]
    for name in values:
        if name not in parameters:
            allowed = f"one of {', '.join(parameters)}"
            raise InputError(f"{where}.{name}", "an unknown parameter", allowed, suggestion(name, parameters))
    checked: dict[str, str | float] = {}
    for parameter in effect.parameters:
        key = f"{where}.{parameter.name}"
        if parameter.choices:
            possible = names.get(parameter.name, ()) if parameter.open else parameter.choices
            value = values.get(parameter.name, (possible or parameter.choices)[0])
            if not isinstance(value, str) or (possible and value not in possible):
                raise InputError(key, repr(value), f"one of {', '.join(possible or parameter.choices)}")
            checked[parameter.name] = value
            continue
        fallback = parameter.default if parameter.default is not None else parameter.null
        number = values.get(parameter.name, fallback)
        proper = isinstance(number, int | float) and not isinstance(number, bool)
        if not proper or not parameter.low <= number <= parameter.high:
            allowed = f"a number from {parameter.low:g} to {parameter.high:g} {parameter.unit}"
            raise InputError(key, "nothing" if number is None else repr(number), allowed)
        checked[parameter.name] = float(number)
    return AppliedEffect(effect, checked)
