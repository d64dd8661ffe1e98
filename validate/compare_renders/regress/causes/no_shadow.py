"""Shadows of a surface left out in light that comes straight from the lamp."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from .cause import Cause, Pictures, Trial, fixed_values

__all__ = ["CAUSE"]


def _trials(pictures: Pictures) -> Iterator[Trial]:
    """Direct light of the scene without the surfaces, where the others are seen."""
    scene = pictures.scene
    if scene is None:
        return
    surfaces = scene.scene.surfaces
    blocks = [number for number, surface in enumerate(surfaces) if surface.name.endswith("-block")]
    groups = [blocks, *([n] for n in blocks)] if len(blocks) > 1 else [blocks] if blocks else []
    direct = scene.light.change(max_bounces=1).picture()
    for group in groups:
        others = tuple(surface for number, surface in enumerate(surfaces) if number not in group)
        bare = scene.rebuilt(replace(scene.scene, surfaces=others))
        visible = (scene.surface_index >= 0) & ~np.isin(scene.surface_index, group)
        more = np.where(visible, np.maximum(bare.light.change(max_bounces=1).picture() - direct, 0), 0)
        names = [surfaces[number].name for number in group]
        change = pictures.change(scene.picture + more)
        yield Trial(fixed_values({"of": names}), fixed=change, selected=1)
        yield Trial(partial(_part, names), (change,), selected=1)


def _part(names: list[str], amplitudes: NDArray[np.float64]) -> dict[str, object] | None:
    """Parameters of a part of the missing shadow."""
    return {"of": names, "part": float(amplitudes[0])} if amplitudes[0] > 0 else None


CAUSE = Cause(
    "no-shadow",
    "Shadow rays pass through surfaces: their shadows in direct light are missing.",
    _trials,
    needs_scene=True,
    costly=True,
    shape_error=0.03,
)
