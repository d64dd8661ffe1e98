"""Causes that no family covers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from excess_laboratory import (
    Draw,
    Laboratory,
    Made,
    Truth,
    as_counts,
    binned,
    finer_places,
    grid,
    of_other_scene,
    per_rate,
    scaled_change,
)
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation


def cosmic_rays(draw: Draw, lab: Laboratory) -> Made:
    """Charged particles hit single frames: pixels of one band each."""
    hits = (draw.random(lab.rate.shape) < draw.uniform(0.003, 0.02)) * draw.lognormal(0, 1, lab.rate.shape)
    return Truth("none"), scaled_change(draw, lab, as_counts(lab, hits)), {}


def compression(draw: Draw, lab: Laboratory) -> Made:
    """Frames went through a lossy compression in blocks of 8 x 8 pixels."""
    step = draw.uniform(4, 30)
    raw = lab.data.signal * lab.data.flat
    rows, columns = (n - n % 8 for n in lab.shape)
    blocks = raw[:, :rows, :columns].reshape(len(raw), rows // 8, 8, columns // 8, 8)
    noisy = blocks + draw.normal(0, 3, blocks.shape)
    weights = 1 + np.add.outer(np.arange(8), np.arange(8))
    coefficients = dctn(noisy, axes=(2, 4), norm="ortho") / (step * weights[:, None, :])
    squeezed = idctn(np.round(coefficients) * step * weights[:, None, :], axes=(2, 4), norm="ortho")
    change = np.zeros(raw.shape)
    change[:, :rows, :columns] = (squeezed - noisy).reshape(len(raw), rows, columns)
    return Truth("none"), as_counts(lab, change), {}


def heat_haze(draw: Draw, lab: Laboratory) -> Made:
    """Warm air before the lens: small places of each band's picture move by themselves."""
    rows, columns = grid(lab)
    moved = []
    for image in lab.fine:
        field = [gaussian_filter(draw.normal(0, 1, lab.shape), 2.0) for _ in range(2)]
        positions = [grid + 0.25 * way / way.std() for grid, way in zip((rows, columns), field, strict=True)]
        moved.append(map_coordinates(image, finer_places(positions), order=1, mode="nearest"))
    change = per_rate(lab, lab.rate + binned(np.array(moved)) - binned(lab.fine))
    return Truth("none"), scaled_change(draw, lab, change, 3.0), {}


def moved_block(draw: Draw, lab: Laboratory) -> Made:
    """A block was pushed, turned and tilted after the survey, by more than a survey errs."""
    name, surfaces = str(draw.choice(["short-block", "tall-block"])), []
    for surface in lab.scene.surfaces:
        if surface.name == name:
            vertices = surface.vertices_mm
            foot = np.array([vertices[:, 0].mean(), 0.0, vertices[:, 2].mean()])
            turn = Rotation.from_euler("xyz", draw.normal(0, [0.5, 1.0, 0.5]), degrees=True)
            surface = replace(surface, vertices_mm=turn.apply(vertices - foot) + foot + draw.normal(0, [2, 0, 2]))
        surfaces.append(surface)
    return Truth("none"), of_other_scene(lab, replace(lab.scene, surfaces=tuple(surfaces))), {}


def telegraph_noise(draw: Draw, lab: Laboratory) -> Made:
    """Pixels jump between two levels: each frame has another pattern."""
    states = draw.choice([-1, 1], lab.rate.shape) * (draw.random(lab.shape) < draw.uniform(0.05, 0.4))
    return Truth("none"), scaled_change(draw, lab, as_counts(lab, states * draw.lognormal(0, 0.5, lab.shape))), {}


def torn_frame(draw: Draw, lab: Laboratory) -> Made:
    """The transfer of one frame broke off: below a row it repeats the lines before, in one band."""
    band, row = int(draw.integers(len(lab.rate))), int(draw.uniform(0.3, 0.9) * lab.shape[0])
    slip = int(draw.integers(1, 4))
    changed = lab.rate.copy()
    changed[band, row:] = np.roll(changed[band], slip, axis=1)[row:]
    part = 1 / max(int(np.isfinite(lab.data.repeats[band]).sum()), 1)
    return Truth("none"), per_rate(lab, lab.rate + part * (changed - lab.rate)), {}


def sound(draw: Draw, lab: Laboratory) -> Made:
    """No cause but the flaws of the box."""
    return Truth("sound"), np.zeros(lab.rate.shape), {}
