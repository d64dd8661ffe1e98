"""Causes in the sensor and in time: offsets, gains, pixels, dust, fringes, levels of frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from excess_laboratory import (
    Draw,
    Laboratory,
    Made,
    Stack,
    Truth,
    as_counts,
    grid,
    scaled_change,
)
from scipy.ndimage import gaussian_filter


def row_offsets(draw: Draw, lab: Laboratory) -> Made:
    """Rows are read with different offsets."""
    counts = draw.normal(0, 1, (1, lab.shape[0], 1)) * np.ones(lab.rate.shape)
    return Truth("sensor-offset"), scaled_change(draw, lab, as_counts(lab, counts)), {}


def column_offsets(draw: Draw, lab: Laboratory) -> Made:
    """A few columns have trapped charge, to their end."""
    counts = np.zeros(lab.shape)
    for column in draw.integers(0, lab.shape[1], int(draw.integers(2, 9))):
        counts[int(draw.integers(0, lab.shape[0] // 2)) :, column] += draw.normal(0, 1)
    return Truth("sensor-offset"), scaled_change(draw, lab, as_counts(lab, counts)), {}


def amplifier_glow(draw: Draw, lab: Laboratory) -> Made:
    """An amplifier shines on a corner of the sensor while the scene is taken."""
    rows, columns = grid(lab)
    corner = draw.integers(0, 2, 2) * (np.array(lab.shape) - 1)
    away = np.hypot(rows - corner[0], columns - corner[1])
    glow = 1 / (1 + (away / (draw.uniform(0.06, 0.14) * lab.shape[0])) ** 2)
    by_time = lab.data.exposure_s[:, None, None] if draw.random() < 0.5 else np.ones((len(lab.rate), 1, 1))
    truth = Truth("sensor-offset", (float(corner[1]), float(corner[0])))
    return truth, scaled_change(draw, lab, as_counts(lab, glow * by_time)), {}


def hum(draw: Draw, lab: Laboratory) -> Made:
    """The mains hum in the read-out: a wave over rows and columns."""
    rows, columns = grid(lab)
    frequency = draw.uniform(0.08, 0.45, 2)
    phase = 2 * np.pi * (frequency[0] * rows + frequency[1] * columns * draw.choice([-1, 1]))
    return Truth("sensor-offset"), scaled_change(draw, lab, as_counts(lab, np.sin(phase + draw.uniform(0, 6)))), {}


def light_leak(draw: Draw, lab: Laboratory) -> Made:
    """Light leaks into the camera past the filter wheel: more of it in long exposures."""
    rows, columns = (grid / lab.shape[0] for grid in grid(lab))
    angle = draw.uniform(0, 2 * np.pi)
    leak = np.exp(draw.uniform(0.5, 2.5) * (np.cos(angle) * rows + np.sin(angle) * columns))
    counts = leak * lab.data.exposure_s[:, None, None]
    return Truth("sensor-offset"), scaled_change(draw, lab, as_counts(lab, counts)), {}


def old_darks(draw: Draw, lab: Laboratory) -> Made:
    """The darks are of another day: every pixel has another bias, and more or less dark current."""
    counts = draw.normal(0, 1, lab.shape) * np.ones((len(lab.rate), 1, 1))
    if draw.random() < 0.5:
        current = lab.data.exposure_s[:, None, None] / lab.data.exposure_s.mean()
        counts = draw.lognormal(0, 0.7, lab.shape) * current
    return Truth("sensor-offset"), scaled_change(draw, lab, as_counts(lab, counts)), {}


def hot_pixels(draw: Draw, lab: Laboratory) -> Made:
    """Radiation made pixels hot after the darks were taken."""
    hot = (draw.random(lab.shape) < draw.uniform(0.004, 0.03)) * draw.lognormal(0, 0.6, lab.shape)
    counts = hot * lab.data.exposure_s[:, None, None]
    return Truth("sensor-offset"), scaled_change(draw, lab, as_counts(lab, counts)), {}


def wrong_bit(draw: Draw, lab: Laboratory) -> Made:
    """One bit of the converter weighs too much."""
    step = 2.0 ** int(draw.integers(7, 11))
    raw = lab.data.signal * lab.data.flat + lab.settings.bias_dn
    return Truth("sensor-offset"), scaled_change(draw, lab, as_counts(lab, np.floor(raw / step) % 2)), {}


def old_flats(draw: Draw, lab: Laboratory) -> Made:
    """The flats are old: every pixel's sensitivity has changed."""
    gain = draw.normal(0, 1, lab.shape)
    if draw.random() < 0.4:
        gain = gain * (draw.random(lab.shape) < draw.uniform(0.02, 0.3))
    return Truth("sensor-gain"), scaled_change(draw, lab, lab.data.signal * gain, 0.06), {}


def frost(draw: Draw, lab: Laboratory) -> Made:
    """Crystals of ice on the cooled sensor: many grains of a pixel or two that scatter light away."""
    grains = (draw.random(lab.shape) < draw.uniform(0.02, 0.12)) * draw.uniform(0.3, 1, lab.shape)
    shade = gaussian_filter(grains, draw.uniform(0.25, 0.6))
    return Truth("sensor-gain"), scaled_change(draw, lab, -lab.data.signal * shade, 0.3), {}


def dust(draw: Draw, lab: Laboratory) -> Made:
    """A grain on the sensor's window, out of focus: a ring or a disc of shade."""
    rows, columns = grid(lab)
    y, x = draw.uniform(0.15, 0.85, 2) * lab.shape[0]
    away, radius = np.hypot(rows - y, columns - x), draw.uniform(0.03, 0.09) * lab.shape[0]
    shade = np.clip(radius + 0.5 - away, 0, 1)
    if draw.random() < 0.4:
        shade = shade - 0.7 * np.clip(radius / 2.2 + 0.5 - away, 0, 1)
    return Truth("sensor-gain", (float(x), float(y))), scaled_change(draw, lab, -lab.data.signal * shade, 0.2), {}


def dust_everywhere(draw: Draw, lab: Laboratory) -> Made:
    """Several grains fell on the sensor's window after the flats."""
    rows, columns = grid(lab)
    shade = np.zeros(lab.shape)
    for _ in range(int(draw.integers(3, 9))):
        y, x = draw.uniform(0, 1, 2) * lab.shape[0]
        away = np.hypot(rows - y, columns - x)
        shade += draw.uniform(0.3, 1) * np.clip(draw.uniform(0.02, 0.07) * lab.shape[0] + 0.5 - away, 0, 1)
    return Truth("sensor-gain"), scaled_change(draw, lab, -lab.data.signal * shade, 0.15), {}


def fibre(draw: Draw, lab: Laboratory) -> Made:
    """A bent fibre on the sensor's window."""
    t = np.linspace(0, 1, 200)
    start, way = draw.uniform(0.25, 0.75, 2), draw.normal(0, 0.18, 2)
    bend = draw.normal(0, 0.16, 2)
    path = (start[:, None] + way[:, None] * t + bend[:, None] * t**2) * lab.shape[0]
    rows, columns = grid(lab)
    away = np.min(np.hypot(rows[..., None] - path[0], columns[..., None] - path[1]), axis=-1)
    shade = np.clip(1.4 - away, 0, 1)
    centre = (float(path[1].mean()), float(path[0].mean()))
    return Truth("sensor-gain", centre), scaled_change(draw, lab, -lab.data.signal * shade, 0.2), {}


def column_gains(draw: Draw, lab: Laboratory) -> Made:
    """Columns have amplifiers that drifted since the flats."""
    gain = draw.normal(0, 1, (1, lab.shape[1])) * np.ones(lab.shape)
    if draw.random() < 0.4:
        gain = gain.T
    return Truth("sensor-gain"), scaled_change(draw, lab, lab.data.signal * gain), {}


def smooth_gain(draw: Draw, lab: Laboratory) -> Made:
    """A film of water dries on the window: smooth shades that the flats do not have."""
    shade = gaussian_filter(draw.normal(0, 1, lab.shape), draw.uniform(0.08, 0.2) * lab.shape[0], mode="reflect")
    return Truth("sensor-gain"), scaled_change(draw, lab, lab.data.signal * shade / shade.std(), 0.1), {}


def rings(draw: Draw, lab: Laboratory) -> Made:
    """Interference in one filter: rings about a point next to the picture."""
    rows, columns = (grid / lab.shape[0] for grid in grid(lab))
    y, x = draw.uniform(-0.6, 0.4, 2)
    phase = 2 * np.pi * draw.uniform(3, 7) * ((rows - y) ** 2 + (columns - x) ** 2)
    band = np.eye(len(lab.rate))[int(draw.integers(len(lab.rate)))][:, None, None]
    return Truth("sensor-gain"), scaled_change(draw, lab, lab.data.signal * band * np.cos(phase)), {}


def wedge_fringes(draw: Draw, lab: Laboratory) -> Made:
    """A thin air wedge before the sensor: straight fringes in one band, or in all by their wavelength."""
    rows, columns = (grid / lab.shape[0] for grid in grid(lab))
    angle, waves = draw.uniform(0, np.pi), draw.uniform(4, 10)
    path = np.cos(angle) * rows + np.sin(angle) * columns
    scale = 550 / lab.data.nm[:, None, None]
    strength = (
        np.ones(len(lab.rate)) if draw.random() < 0.4 else np.eye(len(lab.rate))[int(draw.integers(len(lab.rate)))]
    )
    fringe = np.cos(2 * np.pi * waves * path * scale + draw.uniform(0, 6))
    return Truth("sensor-gain"), scaled_change(draw, lab, lab.data.signal * strength[:, None, None] * fringe), {}


def _timed(lab: Laboratory, levels: Stack, repeats: Stack | None = None) -> tuple[Stack, Mapping[str, Any]]:
    """Change by a level of the lamp in each band; ``repeats`` (band, repeat) are levels of its frames."""
    change = lab.data.signal * levels[:, None, None]
    return change, {} if repeats is None else {"repeats": lab.data.repeats + repeats}


def lamp_step(draw: Draw, lab: Laboratory) -> Made:
    """The lamp falls to a lower level, for the rest or for a while."""
    rank = np.argsort(np.argsort(lab.data.minutes))
    first, last = sorted(draw.choice(len(rank) + 1, 2, replace=False))
    inside = ((rank >= first) & (rank < last)).astype(float)
    change, more = _timed(lab, draw.choice([-1, 1]) * inside)
    return Truth("time-order"), scaled_change(draw, lab, change, 0.1), more


def lamp_drift(draw: Draw, lab: Laboratory) -> Made:
    """The lamp warms up, or ages, while the bands are taken."""
    time = lab.data.minutes - lab.data.minutes.min()
    levels = 1 - np.exp(-time / (draw.uniform(0.15, 0.8) * time.max()))
    change, more = _timed(lab, draw.choice([-1, 1]) * levels)
    return Truth("time-order"), scaled_change(draw, lab, change, 0.1), more


def flicker(draw: Draw, lab: Laboratory) -> Made:
    """The lamp's level is another in every frame."""
    frames = np.where(np.isfinite(lab.data.repeats), draw.normal(0, 0.012, lab.data.repeats.shape), np.nan)
    mean = np.nanmean(frames, axis=1)
    change, more = _timed(lab, mean, frames - mean[:, None])
    return Truth("time-order"), change, more


def persistence(draw: Draw, lab: Laboratory) -> Made:
    """A part of each frame's charge stays in the sensor and is read with the next frame."""
    part, counts = draw.uniform(0.002, 0.01), lab.data.signal * lab.data.flat
    frames = np.maximum(np.isfinite(lab.data.repeats).sum(axis=1), 1)
    order, change = np.argsort(lab.data.minutes, kind="stable"), np.zeros(counts.shape)
    for position, band in enumerate(order):
        earlier = counts[order[position - 1]] if position else 0.0 * counts[band]
        change[band] = part * ((frames[band] - 1) * counts[band] + earlier) / frames[band]
    return Truth("time-order"), as_counts(lab, change), {}
