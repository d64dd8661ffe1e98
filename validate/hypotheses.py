"""Every way in which one effect of the catalogue could act: choices made, numbers free."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.scene import Scene

from .effects import AppliedEffect, Effect, Parameter, catalogue, names_in

__all__ = ["Hypothesis", "hypotheses"]

#: Starting values of numbers that have no null value: the screening tries them all, the fit moves them on.
_STARTS: Mapping[str, tuple[float, ...]] = {
    "peak_nm": (460.0, 500.0, 540.0, 580.0, 620.0, 660.0),
    "roughness": (0.08, 0.2, 0.45),
}


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An effect with its choices made. free : the numbers whose null value does nothing. fixed : all other values.

    held : those of them that a fit does not move on from where they start.
    """

    effect: Effect
    free: tuple[Parameter, ...]
    fixed: Mapping[str, str | float]
    held: tuple[str, ...] = ()

    def at(self, numbers: Mapping[str, float]) -> AppliedEffect:
        """The effect with these numbers, the others at their start or null."""
        null = {p.name: _null(p) for p in self.free}
        return AppliedEffect(self.effect, {**self.fixed, **null, **numbers})

    @property
    def label(self) -> str:
        """The identifier with its choices."""
        names = [str(v) for v in self.fixed.values() if isinstance(v, str)]
        return f"{self.effect.id}({', '.join(names)})" if names else self.effect.id


def _null(parameter: Parameter) -> float:
    assert parameter.null is not None
    return parameter.null


def hypotheses(bands: tuple[str, ...], scene: Scene, truncated: bool) -> list[Hypothesis]:
    """All hypotheses that make sense for a capture of these bands and this scene.

    truncated : whether the model stops light after some bounces; only then can more of them be missing.
    """
    present = {"band": bands, **names_in(scene)}
    found = []
    for effect in catalogue().values():
        if effect.id == "interreflection":
            if truncated:
                found.append(Hypothesis(effect, (), {"max_bounces": np.inf}))
            continue
        named = [p for p in effect.parameters if p.choices]
        started = [p for p in effect.numbers if p.null is None]
        options: list[Sequence[str | float]] = []
        for p in named:
            options.append(present[p.name] if p.open else p.choices)
        for p in started:
            options.append(_STARTS.get(p.name, (p.default or 0.5 * (p.low + p.high),)))
        for values in itertools.product(*options):
            fixed: dict[str, str | float] = dict(
                zip([p.name for p in (*named, *started)], values, strict=True)
            )
            found.append(Hypothesis(effect, tuple(p for p in effect.numbers if p.null is not None), fixed))
    return found
