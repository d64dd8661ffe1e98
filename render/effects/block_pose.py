"""Block pose: a block stands or turns elsewhere on the floor."""

from __future__ import annotations

from dataclasses import replace

from cboxlab.scenes.scene import Scene
from cboxlab.scenes.shapes import moved_on_floor

from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]


def _apply(scene: Scene, block: str, dx_mm: float, dz_mm: float, yaw_deg: float) -> Scene:
    """Raises InputError for a block that the scene lacks. Whether the block meets a wall is not checked."""
    own = index_of(f"{block}-block", (s.name for s in scene.surfaces), "block-pose: block")
    surfaces = list(scene.surfaces)
    vertices = moved_on_floor(surfaces[own].vertices_mm, dx_mm, dz_mm, yaw_deg)
    surfaces[own] = replace(surfaces[own], vertices_mm=vertices)
    return replace(scene, surfaces=tuple(surfaces))


EFFECT = Effect(
    id="block-pose",
    stage="scene",
    title="a block stands or turns elsewhere",
    summary="A block stands or turns elsewhere on the floor: turned by yaw about +y (right-handed) through "
    "the mean of its footprint's corners, then shifted by dx and dz.",
    parameters=(
        Parameter("block", choices=("short", "tall"), kind="block"),
        Parameter("dx_mm", "mm", null=0.0, low=-60.0, high=60.0, step=0.5, tolerance=0.05),
        Parameter("dz_mm", "mm", null=0.0, low=-60.0, high=60.0, step=0.5, tolerance=0.05),
        Parameter("yaw_deg", "deg", null=0.0, low=-30.0, high=30.0, step=0.25, tolerance=0.01),
    ),
    apply=_apply,
    confirm="Survey the block's corners again. In the picture its outline and its shadow move while the "
    "room's edges stay.",
)
