"""All frames of a capture, read once, with their tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...capture import BandTable, BracketTable, Capture, DarkTable, channel_lattice

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

    #: First row, first column and step of the square lattice of pixels that ``counts`` holds, see
    #: ``channel_lattice``; None without a mosaic.
    lattice: tuple[int, int, int] | None

    #: Channel of the mosaic that the band sees; None for darks and without a mosaic.
    channel: str | None = None

    def shares_frames(self, other: Stack) -> bool:
        """Whether both are different channels of the same frames.

        Parameters
        ----------
        other
            Frames of another table.

        Returns
        -------
        bool
            False without a mosaic.
        """
        return self.channel != other.channel and self.paths == other.paths and None not in (self.channel, other.channel)

    @property
    def counts(self) -> NDArray[np.uint16]:
        """(repeat, y, x) DN; with a mosaic only the pixels at ``lattice``."""
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
            (..., y, x); with a mosaic only the pixels of ``lattice``.
        """
        if self.lattice is None:
            return image
        row, column, step = self.lattice
        return image[..., row::step, column::step]

    @cached_property
    def mean(self) -> NDArray[np.float64]:
        """(y, x) DN, mean over the repeats of ``counts``."""
        return np.asarray(self.counts.mean(axis=0), np.float64)


def _lattice(capture: Capture, channels: dict[str, str] | None, band: str | None) -> tuple[int, int, int] | None:
    """Lattice of a band's channel; for darks that of the first one. None without a mosaic."""
    mosaic = capture.manifest.mosaic
    if mosaic is None:
        return None
    if channels is None or band is None:
        return channel_lattice(mosaic.pattern, mosaic.pattern[0])
    return channel_lattice(mosaic.pattern, channels[band])


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
                    _lattice(capture, channels, band),
                    None if channels is None or band is None else channels[band],
                )
            )
    return tuple(stacks)
