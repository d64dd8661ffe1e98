"""OpenEXR files of counts: one channel is a frame, several channels are bands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cboxlab.utils.errors import InputError
from numpy.typing import NDArray

from ._frame_reader import FrameHeader, FrameReader, as_counts, require_plausible_size


def _header(path: Path) -> FrameHeader:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
        names = tuple(channel.name for channel in file.header()["channels"])
        low, high = file.header()["dataWindow"]
    if not names:
        raise InputError(path, "no channels", "one channel per band")
    shape = int(high[1] - low[1] + 1), int(high[0] - low[0] + 1)
    require_plausible_size(path, (len(names), *shape))
    return FrameHeader(shape, len(names), bands=names if len(names) > 1 else ())


def _read(path: Path, pictures: range) -> NDArray[np.uint16]:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = list(file.channels().values())
        planes = [np.asarray(channels[k].pixels) for k in pictures]
    return np.concatenate([as_counts(path, plane[None]) for plane in planes])


def _values(path: Path, pictures: range) -> NDArray[np.float64]:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = list(file.channels().values())
        return np.stack([np.asarray(channels[k].pixels, np.float64) for k in pictures])


READER = FrameReader("exr", "OpenEXR", (".exr",), None, _header, _read, values=_values)
