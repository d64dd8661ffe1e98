"""Large pictures reduced to a window around the box and sums over square blocks of pixels.

A sum over n x n pixels is the count of a sensor with n times the pixel pitch and the same gain. Its read noise is n
times as large and its box filter n times as wide. The manifest of a reduced capture describes this sensor.

Behind a mosaic of c x c pixels a block is n = 2 k c + 1 pixels wide, and its sum is over (2 k + 1)^2 of them: those c
pixels apart, from the block's border to its border. They have the position in the mosaic that the block has in the
mosaic of blocks, so that the pattern stays, and they lie evenly about the block's middle. Light between them is not
collected: the sensor of the blocks has a smaller sensitive area (``Reduction.fill``). Across an edge their mean differs
from that of the whole block; ``Reduction.spread`` shows it, and
``correction.block_sampling`` says how much.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_rows
from cboxlab.utils.numbers import number_of
from numpy.typing import NDArray

from .manifest import CropTable, pattern_rows
from .whole_manifest import Manifest

__all__ = [
    "ReducedFrames",
    "Reduction",
    "degrees_of_freedom",
    "mosaic_side",
    "reduced_manifest",
    "reduction_of",
    "scatters",
]

#: Pixels of a frame above which a capture is reduced where its manifest says nothing: 4 megapixels.
_LARGEST_FRAME = 4_000_000

#: Pixels in use across the surveyed points, or across the frame without points: as in the captures of the manual.
_ACROSS = 256

#: Margin of the window around the surveyed points, over their extent: the room's front edges lie outside the points.
_MARGIN = 0.5


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
        """Scatters of the pixels that are summed about a plane through them.

        A gradient of the light does no harm to their mean.

        Parameters
        ----------
        frame
            (y, x) stored counts, DN.

        Returns
        -------
        NDArray
            (2, height, width) variances of a block's counts, DN^2, see ``scatters``.
        """
        return scatters(self._pixels(frame))

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
        blocks = self._blocks(image)
        low, high = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
        return np.where(low == high, low, 0).astype(np.uint8)

    def any_of(self, pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Blocks with at least one of some pixels.

        Parameters
        ----------
        pixels
            (y, x) True for these stored pixels.

        Returns
        -------
        NDArray
            (height, width) True for these blocks.
        """
        return np.asarray(self._blocks(pixels).any(axis=(1, 3)))

    def _blocks(self, image: NDArray) -> NDArray:
        """(height, n, width, n) pixels of the blocks."""
        n, height, width = self.side_px, self.height, self.width
        window = image[self.v0_px : self.v0_px + n * height, self.u0_px : self.u0_px + n * width]
        return window.reshape(height, n, width, n)

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


def degrees_of_freedom(summed: int) -> tuple[int, int]:
    """Degrees of freedom of the two scatters.

    Parameters
    ----------
    summed
        Pixels of a row of a block that are summed, at least 3.

    Returns
    -------
    tuple[int, int]
        Those of rows and columns, and the others.
    """
    return 2 * (summed - 2), (summed - 1) ** 2


def scatters(pixels: NDArray) -> NDArray[np.float64]:
    """Scatters of the pixels in blocks, in two parts.

    The first is of the means of rows and of columns about a plane, the second of the pixels beyond these means. Both
    have the variance of a pixel's noise as their expectation where the light is even or has a gradient.

    Parameters
    ----------
    pixels
        (height, n, width, n) counts of the n x n summed pixels of each block.

    Returns
    -------
    NDArray
        (2, height, width) variances; 0 for n = 1.
    """
    n = pixels.shape[1]
    if n == 1:
        return np.zeros((2, pixels.shape[0], pixels.shape[2]))
    offsets = np.arange(n) - (n - 1) / 2
    values = pixels - pixels.mean(axis=(1, 3), keepdims=True)
    of_means, beyond_planes = np.zeros((2, pixels.shape[0], pixels.shape[2]))
    for means in (values.mean(axis=3), values.mean(axis=1).swapaxes(1, 2)):
        squares = n * (means**2).sum(axis=1)
        of_means += squares
        beyond_planes += squares - n * np.tensordot(means, offsets, (1, 0)) ** 2 / float(offsets @ offsets)
    first, second = degrees_of_freedom(n)
    return np.stack([beyond_planes / first, ((values**2).sum(axis=(1, 3)) - of_means) / second])


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
            (2, height, width) scatters of the pixels of a block, DN^2; 0 where all of them are summed.
        """
        if name not in self._frames:
            stored = read()
            sums = reduction.counts(stored)
            spread = reduction.spread(stored) if reduction.step_px > 1 else np.zeros((2, *sums.shape))
            self._frames[name] = sums, spread
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
