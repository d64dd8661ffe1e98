"""Large pictures reduced to a window around the box and sums over square blocks of pixels.

A sum over n x n pixels is the count of a sensor with n times the pixel pitch and the same gain. Its read noise is n
times as large and its box filter n times as wide. The manifest of a reduced capture describes this sensor.

Behind a mosaic of c x c pixels a block is n = 2 k c + 1 pixels wide, and its sum is over (2 k + 1)^2 of them: those c
pixels apart, from the block's border to its border. They have the position in the mosaic that the block has in the
mosaic of blocks, so that the pattern stays, and they lie evenly about the block's middle. Light between them is not
collected: the sensor of the blocks has a smaller sensitive area (``Reduction.fill``). Across an edge their mean differs
from that of the whole block; ``Reduction.spread`` and ``sampling_variance`` say how much.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.distributions import chi2_quantile
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_rows
from cboxlab.utils.numbers import number_of
from numpy.typing import NDArray

from .manifest import CropTable, pattern_rows
from .whole_manifest import Manifest

__all__ = ["ReducedFrames", "Reduction", "mosaic_side", "reduced_manifest", "reduction_of"]

#: Pixels of a frame above which a capture is reduced where its manifest says nothing: 4 megapixels.
_LARGEST_FRAME = 4_000_000

#: Pixels in use across the surveyed points, or across the frame without points: as in the captures of the manual.
_ACROSS = 256

#: Margin of the window around the surveyed points, over their extent: the room's front edges lie outside the points.
_MARGIN = 0.5

#: Straight edges at random places and angles that give the error of a sum across an edge: to 6 % of its variance.
_EDGES = 1000

#: Parts of a pixel across, for its coverage by an edge.
_PARTS = 4

#: Share of the blocks whose pixels scatter by noise as if they saw an edge: it raises the mean variance by 1 %.
_FALSE_EDGES = 0.02


@dataclass(frozen=True)
class Reduction:
    """Window of a frame and side of the blocks that are summed."""

    #: Columns of the stored frames, px.
    full_width_px: int
    #: Rows of the stored frames, px.
    full_height_px: int
    #: Bits of a stored count.
    bit_depth: int
    #: First column of the window, px.
    u0_px: int
    #: First row of the window, px.
    v0_px: int
    #: Columns in use, blocks.
    width: int
    #: Rows in use, blocks.
    height: int
    #: Side of a block, px.
    side_px: int
    #: Stored count from which a pixel is saturated, DN.
    saturated_dn: float
    #: Distance of the pixels that are summed, px: that of the mosaic's repeats; 1 without a mosaic.
    step_px: int = 1

    @property
    def summed(self) -> int:
        """Pixels of a row of a block that are summed."""
        return len(range(0, self.side_px, self.step_px))

    @property
    def fill(self) -> float:
        """Share of a block's area whose light is counted."""
        return (self.summed / self.side_px) ** 2

    @property
    def reduced_bits(self) -> int:
        """Bits of a sum over a block."""
        return self.bit_depth + int(np.ceil(2 * np.log2(self.summed)))

    @property
    def note(self) -> str:
        """One sentence on the window and the blocks."""
        window = f"the window of {self.width * self.side_px} x {self.height * self.side_px} px from "
        window += f"({self.u0_px}, {self.v0_px})"
        sums = f"sums of {self.summed} x {self.summed} pixels" if self.side_px > 1 else "single pixels"
        if self.step_px > 1 and self.side_px > 1:
            sums += f" of one channel in blocks of {self.side_px} x {self.side_px}"
        return (
            f"frames of {self.full_width_px} x {self.full_height_px} px: {window} is in use, as {sums}; pixels in all "
            "results are these; binning = 1 and window_px in [camera] set both"
        )

    def counts(self, frame: NDArray[np.uint16]) -> NDArray[np.uint32]:
        """Sums of a frame's blocks in the window.

        Parameters
        ----------
        frame
            (y, x) stored counts, DN.

        Returns
        -------
        NDArray
            (height, width) sums, DN. A block with a saturated pixel has the largest count of ``reduced_bits``.
        """
        pixels = self._pixels(frame)
        rows = pixels.sum(axis=3, dtype=np.uint32)
        sums, largest = rows.sum(axis=1, dtype=np.uint32), pixels.max(axis=(1, 3))
        return np.where(largest >= self.saturated_dn, np.uint32(2**self.reduced_bits - 1), sums)

    def _pixels(self, frame: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """(height, summed, width, summed) counts that are summed, DN."""
        n, height, width = self.side_px, self.height, self.width
        window = frame[self.v0_px : self.v0_px + n * height, self.u0_px : self.u0_px + n * width]
        return window.reshape(height, n, width, n)[:, :: self.step_px, :, :: self.step_px]

    def spread(self, frame: NDArray[np.uint16]) -> NDArray[np.float64]:
        """Scatter of the pixels that are summed about the light's gradient.

        A gradient does no harm to their mean. It is that of the neighbouring blocks of the same channel. A plane
        through three by three pixels would take up much of a corner between two walls.

        Parameters
        ----------
        frame
            (y, x) stored counts, DN.

        Returns
        -------
        NDArray
            (height, width) variance of a block's counts, DN^2; 0 where it sums a single one.
        """
        return _about_neighbours(self._pixels(frame), self.side_px, self.step_px)

    def sampling_variance(
        self, spread: NDArray[np.float64], noise: NDArray[np.float64], repeats: int
    ) -> NDArray[np.float64]:
        """Variance of sums by edges between the pixels that are summed.

        Parameters
        ----------
        spread
            (height, width) scatter of a block's pixels, DN^2, see ``spread``; the mean over repeats.
        noise
            (height, width) scatter that noise and the pixels' sensitivities give, DN^2.
        repeats
            Number of repeats.

        Returns
        -------
        NDArray
            (height, width) variance, DN^2; 0 where the pixels scatter as noise makes them.
        """
        degrees = repeats * (self.summed**2 - 1)
        largest = float(chi2_quantile(_FALSE_EDGES, degrees)) / degrees
        by_edges = np.where(spread > largest * noise, spread - noise, 0.0)
        return _edge_error(self.side_px, self.step_px) * self.summed**4 * by_edges

    def labels(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Labels of the blocks.

        Parameters
        ----------
        image
            (y, x) label of each stored pixel.

        Returns
        -------
        NDArray
            (height, width) label that all pixels of a block have, else 0.
        """
        n, height, width = self.side_px, self.height, self.width
        window = image[self.v0_px : self.v0_px + n * height, self.u0_px : self.u0_px + n * width]
        blocks = window.reshape(height, n, width, n)
        low, high = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
        return np.where(low == high, low, 0).astype(np.uint8)

    def positions(self, stored_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions in the reduced frame.

        Parameters
        ----------
        stored_px
            (n, 2) positions (u, v) in the stored frame, px.

        Returns
        -------
        NDArray
            (n, 2) positions, blocks; (0, 0) is the centre of the first block.
        """
        return (stored_px - [self.u0_px, self.v0_px] + 0.5) / self.side_px - 0.5


def _about_neighbours(pixels: NDArray, side: int, step: int) -> NDArray[np.float64]:
    """Variances of blocks about the gradients of their neighbours, or about none.

    The smaller counts: next to an edge the neighbours lie beyond it.
    pixels : (height, n, width, n), ``step`` px apart in blocks of ``side`` px. Returns (height, width), 0 for n = 1.
    """
    n = pixels.shape[1]
    if n == 1:
        return np.zeros((pixels.shape[0], pixels.shape[2]))
    values = pixels.astype(float)
    means = values.mean(axis=(1, 3))
    offsets = step * (np.arange(n) - (n - 1) / 2)
    down, across = (_slope_of_neighbours(means, axis, step, side) for axis in (0, 1))
    plane = means[:, None, :, None] + down[:, None, :, None] * offsets[:, None, None]
    plane = plane + across[:, None, :, None] * offsets
    squares = [((values - each) ** 2).sum(axis=(1, 3)) for each in (plane, means[:, None, :, None])]
    return np.asarray(np.minimum(*squares) / (n**2 - 1), np.float64)


def _slope_of_neighbours(means: NDArray[np.float64], axis: int, step: int, side: int) -> NDArray[np.float64]:
    """(height, width) slope per pixel through the blocks before and after each; 0 at the border."""
    slope = np.zeros_like(means)
    size = means.shape[axis]
    if size > 2 * step:
        blocks = [np.take(means, range(start, start + size - 2 * step), axis) for start in (0, 2 * step)]
        inside = [slice(None), slice(None)]
        inside[axis] = slice(step, size - step)
        slope[tuple(inside)] = (blocks[1] - blocks[0]) / (2 * step * side)
    return slope


@lru_cache
def _edge_error(side_px: int, step_px: int) -> float:
    """Square of the error of the summed pixels' mean over their variance about the gradient.

    The mean over straight edges.
    """
    generator = np.random.default_rng(0)
    position = (np.arange(side_px * _PARTS) + 0.5) / _PARTS - side_px / 2
    offsets = position.reshape(side_px, _PARTS).mean(axis=1)[::step_px]
    distance = step_px * side_px
    angle, offset = generator.uniform(0, np.pi, _EDGES), generator.uniform(-side_px, side_px, _EDGES) / np.sqrt(2)
    errors, variances = 0.0, 0.0
    for turn, shift in zip(angle, offset, strict=True):
        bright = np.add.outer(np.sin(turn) * position, np.cos(turn) * position) > shift
        pixels = bright.reshape(side_px, _PARTS, side_px, _PARTS).mean(axis=(1, 3))
        summed = pixels[::step_px, ::step_px]
        errors += (summed.mean() - pixels.mean()) ** 2
        down, across = (
            (float(part * distance > shift) - float(-part * distance > shift)) / (2 * distance)
            for part in (np.sin(turn), np.cos(turn))
        )
        plane = summed.mean() + np.add.outer(down * offsets, across * offsets)
        squares = [float(((summed - each) ** 2).sum()) for each in (plane, summed.mean())]
        variances += min(squares) / (summed.size - 1)
    return float(errors / variances)


def mosaic_side(pattern: str, largest: int) -> int:
    """Side of the blocks whose sums keep a mosaic's pattern.

    Parameters
    ----------
    pattern
        Letters of one repeat.
    largest
        Largest side, px.

    Returns
    -------
    int
        Largest number 2 k c + 1 up to ``largest``, with c the repeat's rows and columns, px; 1 where there is none.
    """
    double = 2 * _repeat(pattern)
    return max(1, (largest - 1) // double * double + 1)


def _repeat(pattern: str) -> int:
    """Rows and columns after which a mosaic repeats, px."""
    rows: Sequence[str] = pattern_rows(pattern)
    return int(np.lcm(len(rows), len(rows[0])))


def reduction_of(folder: Path, manifest: Manifest) -> Reduction | None:
    """Reduction of a capture's frames.

    Without keys, frames above 4 megapixels are reduced to about 256 pixels across the surveyed points. Behind a mosaic
    pixels of one channel are summed.

    Parameters
    ----------
    folder
        Folder of the capture.
    manifest
        Content of its capture.toml.

    Returns
    -------
    Reduction | None
        None where the stored pixels are in use.
    """
    camera = manifest.camera
    full = np.array([camera.width_px, camera.height_px])
    automatic = full.prod() > _LARGEST_FRAME and manifest.noise is None
    if camera.binning is None and camera.window_px is None and not automatic:
        return None
    low, high = np.zeros(2), full.astype(float)
    box = _extent(folder, manifest)
    across = float(full.max()) if box is None else float(np.ptp(box, axis=0).max())
    if camera.window_px is not None:
        low = np.array(camera.window_px[:2], float)
        high = low + camera.window_px[2:]
    elif box is not None and automatic:
        margin = _MARGIN * np.ptp(box, axis=0)
        low, high = np.maximum(box.min(axis=0) - margin, 0), np.minimum(box.max(axis=0) + margin, full)
    side = max(1, int(across / _ACROSS)) if camera.binning is None and automatic else camera.binning or 1
    step = 1
    if manifest.mosaic is not None:
        # the window starts at a whole repeat, so that the pattern stays as stated
        step, side = _repeat(manifest.mosaic.pattern), mosaic_side(manifest.mosaic.pattern, side)
    first = (np.floor(low / step) * step).astype(int)
    blocks = ((np.ceil(high) - first) // side).astype(int)
    if side == 1 and tuple(blocks) == tuple(full):
        return None
    return Reduction(
        full_width_px=camera.width_px,
        full_height_px=camera.height_px,
        bit_depth=camera.bit_depth,
        u0_px=int(first[0]),
        v0_px=int(first[1]),
        width=int(blocks[0]),
        height=int(blocks[1]),
        side_px=side,
        saturated_dn=2**camera.bit_depth - 1 if camera.white_level_dn is None else camera.white_level_dn,
        step_px=step,
    )


def _extent(folder: Path, manifest: Manifest) -> NDArray[np.float64] | None:
    """(n, 2) positions of the surveyed points, px; None without readable ones."""
    if manifest.geometry is None:
        return None
    try:
        lines = read_rows(folder / manifest.geometry.points, "a CSV file of surveyed points")
        header = [name.strip() for name in lines[0][1]]
        columns = [header.index("u_px"), header.index("v_px")]
        points = np.array([[number_of(cells[column]) for column in columns] for _, cells in lines[1:]])
    except (InputError, ValueError, IndexError):  # calibration states what is wrong
        return None
    inside = (points >= 0).all(axis=1) & (points < [manifest.camera.width_px, manifest.camera.height_px]).all(axis=1)
    return points[inside] if np.count_nonzero(inside) > 1 else None


class ReducedFrames:
    """Frames that were read and reduced, with their spreads, by name: a large file is read once."""

    def __init__(self) -> None:
        self._frames: dict[str, tuple[NDArray[np.uint32], NDArray[np.float64]]] = {}

    def get(
        self, name: str, reduction: Reduction, read: Callable[[], NDArray[np.uint16]]
    ) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
        """Reduced frame of a name.

        Parameters
        ----------
        name
            Name of the frame.
        reduction
            Window and blocks.
        read
            Reads the stored frame, at the first call for its name.

        Returns
        -------
        NDArray
            (height, width) sums of counts, DN.
        NDArray
            (height, width) scatter of the pixels of a block, DN^2; 0 where all of them are summed.
        """
        if name not in self._frames:
            stored = read()
            sums = reduction.counts(stored)
            self._frames[name] = sums, reduction.spread(stored) if reduction.step_px > 1 else np.zeros(sums.shape)
        return self._frames[name]


def reduced_manifest(manifest: Manifest, reduction: Reduction) -> Manifest:
    """The manifest of the sensor whose pixels are the blocks.

    Parameters
    ----------
    manifest
        Content of capture.toml.
    reduction
        Window and blocks.

    Returns
    -------
    Manifest
        The same capture with the size, pitch, bits and read noise of the blocks, and lengths in blocks.
    """
    n, camera, lens, geometry = reduction.side_px, manifest.camera, manifest.lens, manifest.geometry

    def scaled(value: float | None, factor: float) -> float | None:
        return None if value is None else value * factor

    of_camera: dict[str, Any] = {
        "width_px": reduction.width,
        "height_px": reduction.height,
        "pixel_pitch_um": scaled(camera.pixel_pitch_um, n),
        "bit_depth": reduction.reduced_bits if n > 1 else camera.bit_depth,
        "read_noise_e": scaled(camera.read_noise_e, reduction.summed),
        "white_level_dn": None,
    }
    if isinstance(camera.black_level_dn, dict):
        of_camera["black_level_dn"] = {c: level * reduction.summed**2 for c, level in camera.black_level_dn.items()}
    elif camera.black_level_dn is not None:
        of_camera["black_level_dn"] = camera.black_level_dn * reduction.summed**2
    crop = manifest.crop
    u0, v0 = (0, 0) if crop is None else (crop.u0_px, crop.v0_px)
    width, height = (camera.width_px, camera.height_px) if crop is None else (crop.full_width_px, crop.full_height_px)
    changes: dict[str, Any] = {
        "camera": camera.model_copy(update=of_camera),
        "lens": lens.model_copy(update={"fx_px": scaled(lens.fx_px, 1 / n), "fy_px": scaled(lens.fy_px, 1 / n)}),
        "crop": CropTable(
            u0_px=(u0 + reduction.u0_px) // n,
            v0_px=(v0 + reduction.v0_px) // n,
            full_width_px=width // n,
            full_height_px=height // n,
        ),
    }
    if geometry is not None:
        changes["geometry"] = geometry.model_copy(update={"point_sigma_px": scaled(geometry.point_sigma_px, 1 / n)})
    return manifest.model_copy(update=changes)
