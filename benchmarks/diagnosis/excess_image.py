"""Causes between lens and sensor: displacements, blurs, copies, trails."""

from __future__ import annotations

import numpy as np
from excess_laboratory import (
    Draw,
    Laboratory,
    Made,
    Stack,
    Truth,
    binned,
    blend,
    finer_places,
    grid,
    moved_bands,
    per_rate,
    scaled_change,
)
from scipy.ndimage import convolve1d, gaussian_filter, map_coordinates, rotate, shift, uniform_filter


def wedged_filter(draw: Draw, lab: Laboratory) -> Made:
    """One filter is a wedge and moves its picture."""
    steps = np.zeros((len(lab.rate), 2))
    steps[int(draw.integers(len(lab.rate)))] = draw.normal(0, 0.12, 2)
    return Truth("displacement"), per_rate(lab, moved_bands(lab, steps)), {}


def sagging_tripod(draw: Draw, lab: Laboratory) -> Made:
    """The camera sinks while the bands are taken."""
    time = lab.data.minutes - lab.data.minutes.mean()
    steps = np.outer(time / np.abs(time).max(), draw.normal(0, 0.08, 2))
    return Truth("displacement"), per_rate(lab, moved_bands(lab, steps)), {}


def warped_sensor(draw: Draw, lab: Laboratory) -> Made:
    """A warped film or a poor lens: points lie off their places by a smooth field."""
    rows, columns = grid(lab)
    field = [gaussian_filter(draw.normal(0, 1, lab.shape), 0.18 * lab.shape[0], mode="reflect") for _ in range(2)]
    positions = [
        grid + draw.uniform(0.08, 0.2) * way / way.std() for grid, way in zip((rows, columns), field, strict=True)
    ]
    moved = np.array([map_coordinates(image, finer_places(positions), order=1, mode="nearest") for image in lab.fine])
    return Truth("displacement"), per_rate(lab, lab.rate + binned(moved) - binned(lab.fine)), {}


def smear(draw: Draw, lab: Laboratory) -> Made:
    """The camera swings while the shutter is open."""
    angle = draw.uniform(0, np.pi)
    way = np.array([np.sin(angle), np.cos(angle)]) * draw.uniform(0.4, 1.2)
    copies = [moved_bands(lab, np.tile(part * way, (len(lab.rate), 1))) for part in np.linspace(-1, 1, 7)]
    return Truth("blur"), blend(draw, lab, np.mean(copies, axis=0)), {}


def tilted_sensor(draw: Draw, lab: Laboratory) -> Made:
    """Sharp at one side only: discs of confusion that grow across the picture."""
    rows, columns = (grid / lab.shape[0] for grid in grid(lab))
    along = rows if draw.random() < 0.5 else columns
    wide = binned(uniform_filter(lab.fine, (0, 7, 7), mode="nearest") - lab.fine)
    return Truth("blur"), blend(draw, lab, lab.rate + along**2 * wide), {}


def wiped_lens(draw: Draw, lab: Laboratory) -> Made:
    """Grease drawn over the lens in one direction scatters light far along the other."""
    angle = draw.uniform(0, np.pi)
    wide = np.array([rotate(image, np.degrees(angle), reshape=False, order=1, mode="nearest") for image in lab.rate])
    away = np.arange(-int(0.35 * lab.shape[0]), int(0.35 * lab.shape[0]) + 1)
    profile = np.exp(-np.abs(away) / (0.1 * lab.shape[0]))
    wide = convolve1d(wide, profile / profile.sum(), axis=2, mode="nearest")
    plain = np.array([rotate(image, np.degrees(angle), reshape=False, order=1, mode="nearest") for image in lab.rate])
    scattered = np.array(
        [rotate(image, -np.degrees(angle), reshape=False, order=1, mode="nearest") for image in wide - plain]
    )
    return Truth("blur"), blend(draw, lab, lab.rate + scattered), {}


def fogged_lens(draw: Draw, lab: Laboratory) -> Made:
    """Droplets on the lens: light spreads into a wide halo."""
    width = draw.uniform(0.04, 0.15) * lab.shape[0]
    spectrum = (lab.data.nm[:, None, None] / 550) ** draw.choice([0.0, -2.0])
    halo = gaussian_filter(lab.rate, (0, width, width), mode="nearest")
    return Truth("blur"), blend(draw, lab, lab.rate + 0.2 * spectrum * (halo - lab.rate)), {}


def soft_band(draw: Draw, lab: Laboratory) -> Made:
    """One filter is thicker, and its picture out of focus."""
    band = np.eye(len(lab.rate))[int(draw.integers(len(lab.rate)))][:, None, None]
    soft = binned(gaussian_filter(lab.fine, (0, 2.0, 2.0), mode="nearest") - lab.fine)
    return Truth("blur"), blend(draw, lab, lab.rate + band * soft), {}


def _with_copy(draw: Draw, lab: Laboratory, copy: Stack) -> Stack:
    """A faint copy of the picture is added; the lamp keeps its brightness in it."""
    return scaled_change(draw, lab, per_rate(lab, lab.rate + 0.05 * copy), 2.0)


def pane(draw: Draw, lab: Laboratory) -> Made:
    """A tilted pane before the lens: reflected twice in it, the picture appears again next to itself."""
    angle, far = draw.uniform(0, 2 * np.pi), draw.uniform(2.0, 0.2 * lab.shape[0])
    copy = moved_bands(lab, np.tile([far * np.sin(angle), far * np.cos(angle)], (len(lab.rate), 1)))
    return Truth("blur"), _with_copy(draw, lab, copy), {}


def lens_ghost(draw: Draw, lab: Laboratory) -> Made:
    """Sensor and lens mirror each other: the picture appears turned upside down, somewhat out of focus."""
    copy = gaussian_filter(lab.rate[:, ::-1, ::-1], (0, *[draw.uniform(0.3, 1.5)] * 2))
    copy = np.array([shift(image, draw.uniform(-2, 2, 2), order=1, mode="constant") for image in copy])
    return Truth("blur"), _with_copy(draw, lab, copy), {}


def mirror_ghost(draw: Draw, lab: Laboratory) -> Made:
    """A shiny part next to the lens mirrors the picture from left to right."""
    copy = lab.rate[:, :, ::-1] if draw.random() < 0.7 else lab.rate[:, ::-1]
    copy = np.roll(copy, int(draw.integers(-6, 7)), axis=2)
    return Truth("blur"), _with_copy(draw, lab, copy), {}


def double_exposure(draw: Draw, lab: Laboratory) -> Made:
    """A part of an earlier picture of the box is in the frame, taken with the camera turned or elsewhere."""
    turns, step = int(draw.integers(1, 4)), draw.uniform(-5, 5, 2)
    copy = np.array([shift(image, step, order=1) for image in np.rot90(lab.rate, turns, axes=(1, 2))])
    return Truth("blur"), _with_copy(draw, lab, copy), {}


def trailing_charge(draw: Draw, lab: Laboratory) -> Made:
    """Charge stays behind in the register and comes out behind its pixel: tails along rows or columns."""
    away = np.arange(int(0.5 * lab.shape[0]))
    length = draw.uniform(1.0, 6.0)
    release = np.exp(-away / length) * (away > 0)
    axis, way = int(draw.integers(1, 3)), int(draw.choice([-1, 1]))
    counts = lab.rate * lab.data.flat
    if way < 0:
        counts = np.flip(counts, axis)
    trail = np.apply_along_axis(lambda line: np.convolve(line, release / release.sum())[: len(line)], axis, counts)
    change = trail - counts
    if way < 0:
        change = np.flip(change, axis)
    return Truth("blur"), blend(draw, lab, lab.rate + 0.3 * change / np.maximum(lab.data.flat, 0.05)), {}
