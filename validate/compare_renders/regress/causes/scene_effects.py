"""Effects of the catalogue of ``cbox effects`` that act on scene and transport."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from cboxlab.rendering.effects import Effect, apply_checked, catalogue, names_in
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]

#: Effects that other causes name already, or that change no picture of a renderer.
_NAMED_ELSEWHERE = frozenset({"gloss", "wall-reflectance", "lamp-power", "lamp-spectrum", "ambient-light", "haze"})
#: Steps of the effects' own steps by which pictures differ: large enough for the noise of rendering.
_STEPS = 4.0
#: Effects that are computed at their values: those that explain most to first order.
_REFINED = 3
#: Steps of Gauss and Newton.
_ITERATIONS = 3


@dataclass(frozen=True, eq=False)
class _Linear(FrozenMappings):
    """Effect to first order."""

    #: Chi-square that it leaves.
    chi2: float
    #: The effect, with the null values of the scene.
    effect: Effect
    #: Its names.
    names: Mapping[str, str]
    #: Changes of the picture by one unit of each number.
    slopes: tuple[NDArray[np.float64], ...]


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Trials of the effects that explain most to first order, computed at their values."""
    if pictures.scene is None:
        return
    linear_effects: list[_Linear] = []
    for effect in catalogue().values():
        usable = effect.stage in ("scene", "transport") and effect.id not in _NAMED_ELSEWHERE
        if usable and effect.numbers:
            linear_effects += _linear(pictures, effect.within(pictures.scene.scene))
    for linear in sorted(linear_effects, key=lambda linear: linear.chi2)[:_REFINED]:
        try:
            values, change = _refined(pictures, linear)
        except InputError:
            continue
        numbers = {n.name: float(v) for n, v in zip(linear.effect.numbers, values, strict=True)}
        parameters: dict[str, Any] = {"effect": linear.effect.id, **linear.names, **numbers}
        yield Trial(fixed_values(parameters), fixed=change, selected=len(numbers) + (len(linear.names) > 0))


def _linear(pictures: Pictures, effect: Effect) -> Iterator[_Linear]:
    """An effect to first order, for each choice of its names."""
    scene = pictures.scene
    if scene is None or any(n.null is None for n in effect.numbers):
        return
    names_by_kind = names_in(scene.scene)
    choices = [p for p in effect.parameters if p.choices]
    for combination in product(*(names_by_kind.get(p.kind, ()) if p.kind else p.choices for p in choices)):
        names = dict(zip((p.name for p in choices), combination, strict=True))
        null = _nulls(effect)
        step = np.array([_STEPS * n.step for n in effect.numbers])
        # a null value at a bound leaves one direction
        step = np.where(null + step > [n.high for n in effect.numbers], -step, step)
        try:
            slopes = tuple(_change(pictures, effect, names, null + s) / s.sum() for s in np.diag(step))
        except InputError:
            continue
        yield _Linear(pictures.chi2(slopes, None), effect, names, slopes)


def _refined(pictures: Pictures, linear: _Linear) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values of an effect's numbers, and the change of the picture there."""
    effect = linear.effect
    low, high = (np.array([getattr(n, key) for n in effect.numbers], float) for key in ("low", "high"))
    values, now = _nulls(effect), np.zeros_like(pictures.baseline)
    for _ in range(_ITERATIONS):
        moved = np.clip(values + pictures.fit(linear.slopes, now), low, high)
        if np.all(np.abs(moved - values) < 0.1 * np.array([n.step for n in effect.numbers])):
            break
        values = moved
        now = _change(pictures, effect, linear.names, values)
    return values, now


def _nulls(effect: Effect) -> NDArray[np.float64]:
    """Null values of an effect's numbers."""
    return np.array([n.null for n in effect.numbers], float)


def _change(
    pictures: Pictures, effect: Effect, names: Mapping[str, str], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(y, x, w) change of the baseline by an effect."""
    return pictures.change(_picture(pictures, effect, names, values))


def _picture(pictures: Pictures, effect: Effect, names: Mapping[str, str], values: NDArray) -> NDArray[np.float64]:
    """(c, y, x) rendering of the scene with an effect."""
    scene = pictures.scene
    if scene is None:
        raise ValueError("the scene is unknown")
    numbers = {n.name: float(v) for n, v in zip(effect.numbers, values, strict=True)}
    applied = apply_checked(effect, {**names, **numbers}, effect.id, names_in(scene.scene))
    if effect.stage == "scene":
        return scene.rebuilt(applied.apply(scene.scene)).picture
    return np.asarray(applied.apply(scene.light).picture())


CAUSE = Cause(
    "scene-effect",
    "An effect of the catalogue: a block or the lamp elsewhere, another lamp reflectance, rough paint.",
    _trials,
    needs_scene=True,
    costly=True,
    shape_error=0.03,
    edge_error=0.15,
)
