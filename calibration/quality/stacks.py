"""All frames of a capture, read once, with their tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..capture import BandTable, BracketTable, Capture, DarkTable, channel_lattice

__all__ = ["Stack", "read_stacks"]


@dataclass(frozen=True, eq=False)
class Stack:
    """The frames of one table.

    kind : "band", "dark", "flat", "reference" or "bracket". key : the table in capture.toml. band : its band, None
    of darks. counts : (repeat, y, x) DN, of a sensor with a mosaic only the pixels of the band's channel that fill
    one square lattice (see ``channel_lattice``). whole : (repeat, y, x) DN, all pixels.
    """

    kind: str
    key: str
    band: str | None
    exposure_s: float
    start_s: float | None
    paths: tuple[str, ...]
    whole: NDArray[np.uint16]
    place: tuple[int, int, int] | None

    @property
    def counts(self) -> NDArray[np.uint16]:
        return self.thinned(self.whole)

    def thinned(self, image: NDArray) -> NDArray:
        """The pixels (..., y, x) of an image that ``counts`` holds."""
        if self.place is None:
            return image
        row, column, step = self.place
        return image[..., row::step, column::step]

    @cached_property
    def mean(self) -> NDArray[np.float64]:
        """(y, x) DN, mean over the repeats of ``counts``."""
        return np.asarray(self.counts.mean(axis=0), np.float64)


def _place(capture: Capture, channels: dict[str, str] | None, band: str | None) -> tuple[int, int, int] | None:
    mosaic = capture.manifest.mosaic
    if mosaic is None:
        return None
    if channels is None or band is None:
        return channel_lattice(mosaic.pattern, mosaic.pattern[0])
    return channel_lattice(mosaic.pattern, channels[band])


def read_stacks(capture: Capture, channels: dict[str, str] | None = None) -> tuple[Stack, ...]:
    """All tables with frames, except those of flat targets, in the manifest's order.

    channels : by band, the channel of a sensor with a mosaic. Raises InputError for a faulty frame.
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
                    _place(capture, channels, band),
                )
            )
    return tuple(stacks)
