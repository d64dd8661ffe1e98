"""Every way in which one effect of the catalogue could act: choices made, numbers free."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from cboxlab.rendering.chain import RenderSettings
from cboxlab.rendering.effects import AppliedEffect, Effect, Parameter, catalogue, names_in
from cboxlab.scenes.scene import Scene
from cboxlab.utils.frozen import OwnMappings

__all__ = ["Hypothesis", "hypotheses"]


@dataclass(frozen=True, eq=False)
class Hypothesis(OwnMappings):
    """An effect with its choices made. free : the numbers whose null value does nothing. fixed : all other values.

    held : those of them that a fit does not move on from where they start.
    """

    effect: Effect
    free: tuple[Parameter, ...]
    fixed: Mapping[str, str | float]
    held: tuple[str, ...] = ()

    def at(self, numbers: Mapping[str, float]) -> AppliedEffect:
        """The effect with these numbers, the others at their start or null."""
        null = {p.name: p.from_coordinate(p.null_coordinate) for p in self.free}
        return AppliedEffect(self.effect, {**self.fixed, **null, **numbers})


def hypotheses(
    bands: tuple[str, ...],
    scene: Scene,
    settings: RenderSettings,
    effects: Iterable[Effect] | None = None,
) -> list[Hypothesis]:
    """All hypotheses that make sense for a capture of these bands, this scene and a model rendered so.

    effects : by default those of the catalogue. An effect of the settings that has no free number makes sense only
    where it changes them: light that bounces on cannot be missing where no bounce was left out.
    """
    present = names_in(scene, bands)
    found = []
    for known in catalogue().values() if effects is None else effects:
        effect = known.within(scene)
        named = [p for p in effect.parameters if p.choices]
        started = [p for p in effect.numbers if p.null is None]
        free = tuple(p for p in effect.numbers if p.null is not None)
        options: list[Sequence[str | float]] = [present[p.kind] if p.kind else p.choices for p in named]
        options += [p.starting_values for p in started]
        for values in itertools.product(*options):
            fixed: dict[str, str | float] = dict(zip([p.name for p in (*named, *started)], values, strict=True))
            one = Hypothesis(effect, free, fixed)
            idle = effect.stage == "settings" and not free and one.at({}).apply(settings) == settings
            if not idle:
                found.append(one)
    return found
