"""The catalogue: one small file per effect. Users add their own through the entry point ``cboxlab.effects``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules
from types import MappingProxyType
from typing import Any

from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion

from .effect import AppliedEffect, Effect, Kind, Parameter

__all__ = ["AppliedEffect", "Effect", "Kind", "Parameter", "apply_checked", "catalogue", "names_in"]

#: Entry points of this group are effects of other packages.
_GROUP = "cboxlab.effects"

#: Modules of this package that hold no effect: the classes, and the blur that two effects share.
_NO_EFFECTS = frozenset({"effect", "blur"})


@lru_cache(maxsize=1)
def catalogue() -> dict[str, Effect]:
    """All effects by identifier, those of other packages included.

    Raises InputError for an entry point that cannot be loaded, is no Effect, or has the identifier of another.
    """
    names = [module.name for module in iter_modules(__path__) if module.name not in _NO_EFFECTS]
    own = [import_module(f"{__name__}.{name}").EFFECT for name in names]
    known: dict[str, Effect] = {effect.id: effect for effect in own}
    for entry in entry_points(group=_GROUP):
        effect = _loaded(entry)
        if effect.id in known:
            raise InputError(_where(entry), f"'{effect.id}', which is there already", "an identifier of its own")
        known[effect.id] = effect
    return dict(sorted(known.items()))


def _where(entry: EntryPoint) -> str:
    return f"entry point {_GROUP}: {entry.name} = {entry.value}"


def _loaded(entry: EntryPoint) -> Effect:
    try:
        found = entry.load()
    except Exception as error:  # whatever the other package's import raises
        hint = "Mend or uninstall the package that has this entry point"
        raise InputError(_where(entry), f"{type(error).__name__}: {error}", "an Effect", hint) from error
    if not isinstance(found, Effect):
        raise InputError(_where(entry), f"a {type(found).__name__}", "an Effect")
    return found


def names_in(scene: Scene, bands: tuple[str, ...] = ()) -> dict[Kind, tuple[str, ...]]:
    """What effects may name in a scene and in a capture of these bands. A block is a surface whose name ends in
    -block. Without bands any name of a band will do."""
    surfaces = tuple(surface.name for surface in scene.surfaces)
    blocks = tuple(name.removesuffix("-block") for name in surfaces if name.endswith("-block"))
    names: dict[Kind, tuple[str, ...]] = {
        "material": tuple(scene.materials),
        "surface": surfaces,
        "block": blocks,
    }
    return {**names, "band": bands} if bands else names


def _in_catalogue(identifier: object, where: str) -> Effect:
    known = catalogue()
    if not isinstance(identifier, str) or identifier not in known:
        allowed = f"one of {', '.join(known)}"
        raise InputError(f"{where}.id", repr(identifier), allowed, suggestion(str(identifier), known))
    return known[identifier]


def apply_checked(
    identifier: str | Effect | None,
    values: Mapping[str, Any],
    where: str,
    names: Mapping[Kind, Sequence[str]] = MappingProxyType({}),
) -> AppliedEffect:
    """An effect with checked values; parameters left out take their default, or else their null value.

    identifier : of the catalogue, or an effect that a file holds.
    names : what a parameter of a kind may name (see ``names_in``); where it says nothing, any name will do.

    Raises InputError (at ``where``) for an unknown effect or parameter, a wrong type, a value out of bounds.
    """
    effect = identifier if isinstance(identifier, Effect) else _in_catalogue(identifier, where)
    parameters = [p.name for p in effect.parameters]
    for name in values:
        if name not in parameters:
            allowed = f"one of {', '.join(parameters)}"
            raise InputError(f"{where}.{name}", "an unknown parameter", allowed, suggestion(name, parameters))
    checked: dict[str, str | float] = {}
    for parameter in effect.parameters:
        key = f"{where}.{parameter.name}"
        if parameter.choices:
            possible = names.get(parameter.kind, ()) if parameter.kind else parameter.choices
            value = values.get(parameter.name, (possible or parameter.choices)[0])
            if not isinstance(value, str) or (possible and value not in possible):
                raise InputError(key, repr(value), f"one of {', '.join(possible or parameter.choices)}")
            checked[parameter.name] = value
            continue
        fallback = parameter.default if parameter.default is not None else parameter.null
        number = values.get(parameter.name, fallback)
        proper = isinstance(number, int | float) and not isinstance(number, bool)
        if not proper or not parameter.low <= number <= parameter.high:
            unit = "" if parameter.unit == "1" else f" {parameter.unit}"
            allowed = f"a number from {parameter.low:g} to {parameter.high:g}{unit}"
            raise InputError(key, "nothing" if number is None else repr(number), allowed)
        checked[parameter.name] = float(number)
    return AppliedEffect(effect, checked)
