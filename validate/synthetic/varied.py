"""Random variation between captures: the laboratory, and blocks within a survey's error."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from cboxlab.rendering.effects import names_in
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.scenes.scene import Scene
from cboxlab.scenes.shapes import moved_on_floor

__all__ = ["BlockOffset", "block_offsets", "varied_settings", "with_block_offsets"]

#: Standard deviations of blocks from their survey, mm, mm and degrees: half of what a diagnosis tolerates, or less.
_BLOCK_SCATTER = (0.05, 0.05, 0.01)


def varied_settings(seed: int) -> CaptureSettings:
    """Settings of a laboratory with random camera, sphere, exposure and survey.

    Parameters
    ----------
    seed
        Repeats the draw.

    Returns
    -------
    CaptureSettings
        Sensor, level, repeats, number of points and sphere drawn uniformly; the sphere's brightness by its logarithm.
    """
    draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))
    plain = CaptureSettings()
    return replace(
        plain,
        gain_e_per_dn=round(plain.gain_e_per_dn * draw.uniform(0.7, 1.4), 2),
        read_noise_e=round(draw.uniform(6.0, 16.0), 1),
        dark_current_e_s=round(draw.uniform(2.0, 12.0), 1),
        prnu=round(draw.uniform(0.005, 0.015), 4),
        vignetting=round(draw.uniform(0.03, 0.15), 3),
        level=round(draw.uniform(0.5, 0.85), 3),
        repeats=int(draw.integers(1, 4)),
        point_count=int(draw.integers(40, 61)),
        point_sigma_px=round(draw.uniform(0.1, 0.2), 3),
        sphere_brightness=round(float(10 ** draw.uniform(-0.5, 2.5)), 2),
    )


class BlockOffset(NamedTuple):
    """Offset of a block from its surveyed position, and rotation about +y (right-handed)."""

    #: Along x, mm.
    dx_mm: float
    #: Along z, mm.
    dz_mm: float
    #: Rotation, degrees.
    yaw_deg: float


def block_offsets(scene: Scene, seed: int) -> dict[str, BlockOffset]:
    """Random offset of each block of a scene from its surveyed position.

    Parameters
    ----------
    scene
        Scene as surveyed.
    seed
        Repeats the draw.

    Returns
    -------
    dict
        Offsets by block.
    """
    draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4,)))
    return {
        block: BlockOffset(*map(float, np.array(_BLOCK_SCATTER) * draw.standard_normal(3)))
        for block in names_in(scene)["block"]
    }


def with_block_offsets(scene: Scene, seed: int) -> Scene:
    """The scene with its blocks at random offsets from their surveyed positions.

    Parameters
    ----------
    scene
        Scene as surveyed.
    seed
        Repeats the draw.

    Returns
    -------
    Scene
        With moved blocks.
    """
    surfaces = {surface.name: surface for surface in scene.surfaces}
    for block, offset in block_offsets(scene, seed).items():
        surface = surfaces[f"{block}-block"]
        surfaces[surface.name] = replace(surface, vertices_mm=moved_on_floor(surface.vertices_mm, *offset))
    return replace(scene, surfaces=tuple(surfaces.values()))
