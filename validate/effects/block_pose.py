"""Block pose: a block stands or turns elsewhere on the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.scenes.scene import Scene, Surface
from scipy.spatial.transform import Rotation

from ._effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]

#: Vertices this near to the lowest one stand on the floor, mm.
STANDING_MM = 1e-3


def _moved(block: Surface, dx_mm: float, dz_mm: float, yaw_deg: float) -> Surface:
    height = block.vertices_mm[:, 1]
    footprint = np.unique(block.vertices_mm[height < height.min() + STANDING_MM], axis=0)
    centre = footprint.mean(axis=0)
    turned = Rotation.from_euler("y", yaw_deg, degrees=True).apply(block.vertices_mm - centre)
    return replace(block, vertices_mm=turned + centre + np.array([dx_mm, 0.0, dz_mm]))


def _apply(scene: Scene, block: str, dx_mm: float, dz_mm: float, yaw_deg: float) -> Scene:
    """Raises InputError for a block that the scene lacks. Whether the block meets a wall is not checked."""
    own = index_of(f"{block}-block", (s.name for s in scene.surfaces), "block-pose: block")
    moved = (_moved(s, dx_mm, dz_mm, yaw_deg) if i == own else s for i, s in enumerate(scene.surfaces))
    return replace(scene, surfaces=tuple(moved))


EFFECT = Effect(
    id="block-pose",
    stage="scene",
    summary="A block stands or turns elsewhere on the floor: turned by yaw about +y (right-handed) through "
    "the mean of its footprint's corners, then shifted by dx and dz.",
    parameters=(
        Parameter("block", choices=("short", "tall"), open=True),
        Parameter("dx_mm", "mm", null=0.0, low=-60.0, high=60.0, step=0.5),
        Parameter("dz_mm", "mm", null=0.0, low=-60.0, high=60.0, step=0.5),
        Parameter("yaw_deg", "deg", null=0.0, low=-30.0, high=30.0, step=0.25),
    ),
    apply=_apply,
    confirm="Survey the block's corners again. In the picture its outline and its shadow move while the "
    "room's edges stay.",
)
