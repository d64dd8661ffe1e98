"""Large pictures reduced to a window around the box and sums over square blocks of pixels.

A sum over n x n pixels is the count of a sensor with n times the pixel pitch and the same gain. Its read noise is n
times as large and its box filter n times as wide. The manifest of a reduced capture describes this sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_rows
from cboxlab.utils.numbers import number_of
from numpy.typing import NDArray

from .manifest import CropTable
from .whole_manifest import Manifest

__all__ = ["ReducedFrames", "Reduction", "reduced_manifest", "reduction_of"]

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

    @property
    def reduced_bits(self) -> int:
        """Bits of a sum over a block."""
        return self.bit_depth + int(np.ceil(2 * np.log2(self.side_px)))

    @property
    def note(self) -> str:
        """One sentence on the window and the blocks."""
        window = f"the window of {self.width * self.side_px} x {self.height * self.side_px} px from "
        window += f"({self.u0_px}, {self.v0_px})"
        sums = f"sums of {self.side_px} x {self.side_px} pixels" if self.side_px > 1 else "single pixels"
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
        n, height, width = self.side_px, self.height, self.width
        window = frame[self.v0_px : self.v0_px + n * height, self.u0_px : self.u0_px + n * width]
        rows = window.reshape(height, n, n * width)
        sums = rows.sum(axis=1, dtype=np.uint32).reshape(height, width, n).sum(axis=2, dtype=np.uint32)
        largest = rows.max(axis=1).reshape(height, width, n).max(axis=2)
        return np.where(largest >= self.saturated_dn, np.uint32(2**self.reduced_bits - 1), sums)

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


def reduction_of(folder: Path, manifest: Manifest) -> Reduction | None:
    """Reduction of a capture's frames.

    Without keys, frames above 4 megapixels are reduced to about 256 pixels across the surveyed points. Pixels behind a
    mosaic are not summed: each sees one channel.

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
    cell = np.ones(2, int)
    if manifest.mosaic is not None:
        # the window starts at a whole repeat, so that the pattern stays as stated
        rows = manifest.mosaic.pattern.split()
        cell, side = np.array([len(rows[0]), len(rows)] if len(rows) > 1 else [2, 2]), 1
    first = (np.floor(low / cell) * cell).astype(int)
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
    """Frames that were read and reduced, by name: a large file is read once."""

    def __init__(self) -> None:
        self._frames: dict[str, NDArray[np.uint32]] = {}

    def get(self, name: str, read: Callable[[], NDArray[np.uint32]]) -> NDArray[np.uint32]:
        """Frame of a name.

        Parameters
        ----------
        name
            Name of the frame.
        read
            Reads and reduces it, at the first call for its name.

        Returns
        -------
        NDArray
            (height, width) sums of counts, DN.
        """
        if name not in self._frames:
            self._frames[name] = read()
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
        "read_noise_e": scaled(camera.read_noise_e, n),
        "white_level_dn": None,
    }
    if isinstance(camera.black_level_dn, float):
        of_camera["black_level_dn"] = camera.black_level_dn * n**2
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
