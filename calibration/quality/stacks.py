"""All frames of a capture, read once, with their tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..capture import BandTable, BracketTable, Capture, DarkTable

__all__ = ["Stack", "read_stacks"]


@dataclass(frozen=True, eq=False)
class Stack:
    """The frames of one table."""

    #: "band", "dark", "flat", "reference" or "bracket".
    kind: str

    #: The table in capture.toml with its band or exposure, as in "flat[0] (f450)".
    key: str

    #: Id of its band; None for darks.
    band: str | None

    #: Exposure, s.
    exposure_s: float

    #: Start, s after the first frame; None if it is not stated.
    start_s: float | None

    #: Files of the frames, as in the manifest.
    paths: tuple[str, ...]

    #: (repeat, y, x) DN, all pixels.
    frames: NDArray[np.uint16]

    #: (row, column) in the 2 x 2 cell of the pixels that ``counts`` holds; None without a mosaic.
    cell_pixel: tuple[int, int] | None

    @property
    def counts(self) -> NDArray[np.uint16]:
        """(repeat, y, x) DN; with a mosaic only the pixels at ``cell_pixel``."""
        return self.thinned(self.frames)

    def thinned(self, image: NDArray) -> NDArray:
        """Select the pixels of an image that ``counts`` holds.

        Parameters
        ----------
        image
            (..., y, x) all pixels.

        Returns
        -------
        NDArray
            (..., y, x); with a mosaic every second row and column.
        """
        return image if self.cell_pixel is None else image[..., self.cell_pixel[0] :: 2, self.cell_pixel[1] :: 2]

    @cached_property
    def mean(self) -> NDArray[np.float64]:
        """(y, x) DN, mean over the repeats of ``counts``."""
        return np.asarray(self.counts.mean(axis=0), np.float64)


def read_stacks(capture: Capture, channels: dict[str, str] | None = None) -> tuple[Stack, ...]:
    """Read all tables with frames, except those of flat targets.

    Parameters
    ----------
    capture
        A capture.
    channels
        Channel of each band of a sensor with a mosaic; None without one.

    Returns
    -------
    tuple of Stack
        Bands, brackets, darks, flats, references; each in the manifest's order.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    manifest = capture.manifest
    stacks = []
    kinds: tuple[tuple[str, Sequence[BandTable | BracketTable | DarkTable]], ...] = (
        ("band", manifest.band),
        ("bracket", manifest.bracket),
        ("dark", manifest.darks),
        ("flat", manifest.flats),
        ("reference", manifest.reference),
    )
    for kind, tables in kinds:
        for index, table in enumerate(tables):
            band = None if kind == "dark" else str(getattr(table, "id" if kind == "band" else "band"))
            name = f"{table.exposure_s:g} s" if band is None else band
            stacks.append(
                Stack(
                    kind,
                    f"{kind}[{index}] ({name})",
                    band,
                    table.exposure_s,
                    table.start_s,
                    table.frames,
                    capture.frames(table),
                    _cell_pixel(capture, channels, band),
                )
            )
    return tuple(stacks)


def _cell_pixel(capture: Capture, channels: dict[str, str] | None, band: str | None) -> tuple[int, int] | None:
    """(row, column) of a band in the mosaic's cell, (0, 0) for darks; None without a mosaic."""
    mosaic = capture.manifest.mosaic
    if mosaic is None:
        return None
    if channels is None or band is None:
        return 0, 0
    index = mosaic.pattern.index(channels[band])
    return index // 2, index % 2
