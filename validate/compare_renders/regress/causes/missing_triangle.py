"""Missing triangles: geometry that was not loaded, or culled by its orientation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]

#: Relative change of a pixel that shows another surface.
_CLEAR_CHANGE = 0.3
#: Fewest such pixels of a surface whose triangles are tried.
_MIN_PIXELS = 4
#: Most triangles that are tried.
_MOST_TRIANGLES = 12


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Each triangle of the surfaces that changed most, and each of these surfaces."""
    scene = pictures.scene
    if scene is None:
        return
    before, after = (p.sum(axis=-1) for p in (pictures.baseline, pictures.candidate))
    changed = np.abs(after - before) > _CLEAR_CHANGE * np.maximum(before, 1e-3 * before.mean())
    triangles = 0
    for number, surface in enumerate(scene.scene.surfaces):
        if (changed & (scene.surface_index == number)).sum() < _MIN_PIXELS:
            continue
        count = len(surface.faces)
        for removed in ([n] for n in range(count)) if count > 1 else ():
            triangles += 1
            if triangles > _MOST_TRIANGLES:
                return
            faces = np.delete(surface.faces, removed, axis=0)
            rest = (*scene.scene.surfaces[:number], replace(surface, faces=faces), *scene.scene.surfaces[number + 1 :])
            picture = scene.rebuilt(replace(scene.scene, surfaces=rest)).picture
            parameters = {"surface": surface.name, "triangle": removed[0] + 1}
            yield Trial(fixed_values(parameters), fixed=pictures.change(picture), selected=1)
        rest = (*scene.scene.surfaces[:number], *scene.scene.surfaces[number + 1 :])
        picture = scene.rebuilt(replace(scene.scene, surfaces=rest)).picture
        yield Trial(fixed_values({"surface": surface.name}), fixed=pictures.change(picture), selected=1)


CAUSE = Cause(
    "missing-geometry",
    "A triangle or a surface is missing.",
    _trials,
    needs_scene=True,
    costly=True,
    shape_error=0.03,
    edge_error=0.15,
)
