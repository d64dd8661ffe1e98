"""Laboratories and boxes that differ from capture to capture, within what a survey would not see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cboxlab.render.laboratory import CaptureSettings
from cboxlab.scenes.scene import Scene

from .effects import catalogue

__all__ = ["block_offsets", "settled", "varied_settings"]

#: Standard deviations of where the blocks really stand: what a diagnosis cannot see.
_BLOCK_MM, _BLOCK_DEG = 0.05, 0.01


def varied_settings(seed: int) -> CaptureSettings:
    """A laboratory with another camera, exposure and survey, by ``seed``."""
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
    )


def block_offsets(seed: int) -> dict[str, dict[str, float]]:
    """By how much each block stands beside where the survey has it, as numbers of ``block-pose``, by ``seed``."""
    draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4,)))
    scatter = np.array([_BLOCK_MM, _BLOCK_MM, _BLOCK_DEG])
    return {
        block: dict(
            zip(("dx_mm", "dz_mm", "yaw_deg"), map(float, scatter * draw.standard_normal(3)), strict=True)
        )
        for block in ("short", "tall")
    }


def settled(scene: Scene, seed: int) -> Scene:
    """The scene with its blocks a little beside where the survey has them, by ``seed``."""
    names = {surface.name for surface in scene.surfaces}
    for block, offset in block_offsets(seed).items():
        if f"{block}-block" in names:
            scene = catalogue()["block-pose"].apply(scene, block=block, **offset)
    return scene
