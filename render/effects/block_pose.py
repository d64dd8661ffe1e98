"""Block pose: a block stands at another place on the floor, or is turned.

The block is turned by yaw about +y, right-handed, through the mean of its footprint's corners. It is then shifted by
dx along x and dz along z. The cause is a block that was moved after the survey, or surveyed wrongly.

Parameters: block, short or tall; dx_mm and dz_mm, mm, null value 0; yaw_deg, degrees, null value 0.
Source: rigid motion; no formula from a publication.
"""

from __future__ import annotations

from dataclasses import replace

from cboxlab.scenes.scene import Scene
from cboxlab.scenes.shapes import moved_on_floor

from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]


def _apply(scene: Scene, block: str, dx_mm: float, dz_mm: float, yaw_deg: float) -> Scene:
    """Scene with the block moved, which may then meet a wall: that is not checked."""
    index = index_of(f"{block}-block", (s.name for s in scene.surfaces), "block-pose: block")
    surfaces = list(scene.surfaces)
    vertices = moved_on_floor(surfaces[index].vertices_mm, dx_mm, dz_mm, yaw_deg)
    surfaces[index] = replace(surfaces[index], vertices_mm=vertices)
    return replace(scene, surfaces=tuple(surfaces))


EFFECT = Effect(
    id="block-pose",
    stage="scene",
    title="a block is moved or turned",
    in_words="the {block} stands {dx_mm:+.2f} mm off in x and {dz_mm:+.2f} mm in z, turned by {yaw_deg:+.2f}°",
    summary="A block stands at another place on the floor, or is turned. It turns by yaw about +y (right-handed) "
    "through the mean of its footprint's corners, then moves by dx and dz.",
    parameters=(
        Parameter("block", choices=("short", "tall"), kind="block"),
        Parameter("dx_mm", "mm", null=0.0, low=-60.0, high=60.0, step=0.5, tolerance=0.1),
        Parameter("dz_mm", "mm", null=0.0, low=-60.0, high=60.0, step=0.5, tolerance=0.1),
        Parameter("yaw_deg", "deg", null=0.0, low=-30.0, high=30.0, step=0.25, tolerance=0.05),
    ),
    apply=_apply,
    confirm="Survey the block's corners again. In the photograph its outline and its shadow move while the "
    "room's edges stay.",
)
