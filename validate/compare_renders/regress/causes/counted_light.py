"""Light after exactly n reflections scaled: dropped, counted twice, or weighted wrongly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .cause import Cause, Pictures, Trial

__all__ = ["CAUSE"]

#: Largest number of reflections: later light of a box is too weak.
_MOST_REFLECTIONS = 6
#: Distance of a factor from 0 or 2 at which it is named so.
_NEAR = 0.05


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """One trial for each number of reflections, and for that number and more."""
    scene = pictures.scene
    if scene is None:
        return
    until = [scene.light.change(max_bounces=n).picture() for n in range(_MOST_REFLECTIONS + 1)]
    for reflections in range(1, _MOST_REFLECTIONS + 1):
        for more in (False, True):
            light = (scene.picture if more else until[reflections]) - until[reflections - 1]
            template = pictures.change(scene.picture + np.maximum(light, 0))

            def parameters(a: np.ndarray, n: int = reflections, and_more: bool = more) -> dict[str, object] | None:
                factor = 1 + float(a[0])
                if factor < -_NEAR or (and_more and factor < _NEAR):  # the latter is a depth of paths
                    return None
                values: dict[str, object] = {"reflections": n, "factor": factor, "and_more": and_more}
                if abs(factor) < _NEAR:
                    values["meaning"] = "left out"
                elif abs(factor - 2) < _NEAR:
                    values["meaning"] = "counted twice"
                return values

            yield Trial(parameters, (template,), selected=1)


CAUSE = Cause(
    "counted-light",
    "Light after a number of reflections has a factor: a shadow ray left out or counted twice, a wrong weight.",
    _trials,
    needs_scene=True,
)
