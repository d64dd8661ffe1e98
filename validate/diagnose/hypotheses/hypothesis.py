"""Hypotheses: an effect of the catalogue with its choices made and its numbers free."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from cboxlab.rendering.chain import RenderSettings
from cboxlab.rendering.effects import AppliedEffect, Effect, Parameter, catalogue, names_in
from cboxlab.scenes.scene import Scene
from cboxlab.utils.frozen import FrozenMappings

__all__ = ["Hypothesis", "hypotheses"]


@dataclass(frozen=True, eq=False)
class Hypothesis(FrozenMappings):
    """One way for an effect to act: names and starting values chosen, the other numbers free."""

    #: Effect of the catalogue, its parameters' bounds adapted to the scene.
    effect: Effect
    #: Numbers with a null value, at which the effect changes nothing; a fit starts there.
    free: tuple[Parameter, ...]
    #: By parameter, the values of all others: names, and numbers without a null value at their start.
    fixed: Mapping[str, str | float]
    #: Names of fixed numbers that a full fit keeps as they are; it refines the other fixed numbers.
    unfitted: tuple[str, ...] = ()

    def at(self, numbers: Mapping[str, float]) -> AppliedEffect:
        """The effect with given numbers.

        Parameters
        ----------
        numbers
            By parameter, in its unit. Numbers left out are at their null value, or as in `fixed`.

        Returns
        -------
        AppliedEffect
            The effect with a value for each of its parameters.
        """
        null = {p.name: p.from_coordinate(p.null_coordinate) for p in self.free}
        return AppliedEffect(self.effect, {**self.fixed, **null, **numbers})


def hypotheses(
    bands: tuple[str, ...],
    scene: Scene,
    settings: RenderSettings,
    effects: Iterable[Effect] | None = None,
) -> list[Hypothesis]:
    """Hypotheses that are possible for a capture.

    Each effect yields the product of its choices (paints, surfaces, axes, bands present) and of the starting values of
    its numbers without a null value. An effect on the settings without a free number is left out where it does not
    change them: no interreflection can be missing from a model without a limit on reflections.

    Parameters
    ----------
    bands
        Identifiers of the capture's bands.
    scene
        Scene of the model, as surveyed.
    settings
        Render settings of the model, its own effects included.
    effects
        Effects to consider; None for the whole catalogue.

    Returns
    -------
    list of Hypothesis
        In the order of the effects.
    """
    present = names_in(scene, bands)
    possible = []
    for candidate_effect in catalogue().values() if effects is None else effects:
        effect = candidate_effect.within(scene)
        choices = [p for p in effect.parameters if p.choices]
        started = [p for p in effect.numbers if p.null is None]
        free = tuple(p for p in effect.numbers if p.null is not None)
        options: list[Sequence[str | float]] = [present[p.kind] if p.kind else p.choices for p in choices]
        options += [p.starting_values for p in started]
        for values in itertools.product(*options):
            fixed: dict[str, str | float] = dict(zip([p.name for p in (*choices, *started)], values, strict=True))
            hypothesis = Hypothesis(effect, free, fixed)
            changes_nothing = effect.stage == "settings" and not free and hypothesis.at({}).apply(settings) == settings
            if not changes_nothing:
                possible.append(hypothesis)
    return possible
