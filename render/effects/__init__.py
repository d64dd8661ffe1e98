"""Catalogue of effects: one file each, and those of other packages.

Other packages add effects through the entry point group ``cboxlab.effects``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from cboxlab.scenes.scene import Scene
from cboxlab.utils.arguments import described
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.other_packages import loaders_of, records_in, with_others

from .blur import blurred
from .checked import checked_effect
from .effect import AppliedEffect, Effect, Kind, Parameter

__all__ = ["AppliedEffect", "Effect", "Kind", "Parameter", "apply_checked", "blurred", "catalogue", "names_in"]

#: Entry points of this group are effects of other packages.
_GROUP = "cboxlab.effects"

#: Modules of this package that hold no effect: the classes, checks of others' effects, the blur that two effects share.
_NO_EFFECTS = frozenset({"checked", "effect", "blur"})


@lru_cache(maxsize=1)
def catalogue() -> dict[str, Effect]:
    """All effects by identifier, including those of other packages.

    Returns
    -------
    dict[str, Effect]
        Effects in the alphabetical order of their identifiers. The result is cached.

    Raises
    ------
    InputError
        If an entry point cannot be loaded, is no sound Effect, or has the identifier of another effect.

    Examples
    --------
    >>> from cboxlab.rendering.effects import catalogue
    >>> catalogue()["veiling-glare"].short_title
    'a part of all light spreads over the image'
    """
    ours = records_in(__name__, "EFFECT", _NO_EFFECTS)
    return dict(sorted(with_others(ours, loaders_of(_GROUP, Effect), checked_effect).items()))


def names_in(scene: Scene, bands: tuple[str, ...] = ()) -> dict[Kind, tuple[str, ...]]:
    """Names that effects may give in a scene, and in a capture of some bands.

    Parameters
    ----------
    scene
        The scene. A block is a surface whose name ends in "-block".
    bands
        Names of the capture's bands; empty to allow any name of a band.

    Returns
    -------
    dict[Kind, tuple[str, ...]]
        Names by kind; without "band" if there are no bands.
    """
    surfaces = tuple(surface.name for surface in scene.surfaces)
    blocks = tuple(name.removesuffix("-block") for name in surfaces if name.endswith("-block"))
    names: dict[Kind, tuple[str, ...]] = {
        "material": tuple(scene.materials),
        "surface": surfaces,
        "block": blocks,
    }
    return {**names, "band": bands} if bands else names


def _in_catalogue(identifier: object, where: str) -> Effect:
    """Effect of an identifier."""
    effects = catalogue()
    if not isinstance(identifier, str) or identifier not in effects:
        allowed = f"one of {', '.join(effects)}"
        hint = suggestion(identifier, effects) if isinstance(identifier, str) else ""
        raise InputError(f"{where}.id", described(identifier), allowed, hint)
    return effects[identifier]


def apply_checked(
    identifier: str | Effect | None,
    values: Mapping[str, Any],
    where: str,
    names: Mapping[Kind, Sequence[str]] = MappingProxyType({}),
) -> AppliedEffect:
    """Effect with checked values.

    Parameters
    ----------
    identifier
        Identifier in the catalogue, or an effect that a file holds.
    values
        Values by parameter. A missing number is its default, or else its null value; a missing name is the first one.
    where
        File and key, or function, at which errors are reported.
    names
        Names that a parameter of a kind may give, see ``names_in``; a kind without an entry allows any name.

    Returns
    -------
    AppliedEffect
        The effect with a value for every parameter.

    Raises
    ------
    InputError
        If the effect or a parameter is unknown, a value has the wrong type or is out of bounds, or a number without
        default and null value is missing.
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
                raise InputError(key, described(value), f"one of {', '.join(possible or parameter.choices)}")
            checked[parameter.name] = value
            continue
        fallback = parameter.default if parameter.default is not None else parameter.null
        number = values.get(parameter.name, fallback)
        proper = isinstance(number, int | float) and not isinstance(number, bool)
        if not proper or not parameter.low <= number <= parameter.high:
            unit = "" if parameter.unit == "1" else f" {parameter.unit}"
            allowed = f"a number from {parameter.low:g} to {parameter.high:g}{unit}"
            raise InputError(key, "nothing" if number is None else described(number), allowed)
        checked[parameter.name] = float(number)
    return AppliedEffect(effect, checked)
