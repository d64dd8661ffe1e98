"""Raw frames on disk: 16-bit TIFF, one channel, linear counts, losslessly compressed."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tifffile
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.files import replacing
from numpy.typing import NDArray

__all__ = ["read_raw", "write_raw"]


def write_raw(path: Path, counts: NDArray, metadata: Mapping[str, float | int | str] | None = None) -> None:
    """Write uint16 counts (y, x) as a deflate-compressed TIFF; an incomplete file is removed.

    metadata : stored as JSON in the ImageDescription tag. Raises InputError for counts of another type or shape, or
    a path that cannot be written to.
    """
    counts = np.asarray(counts)
    if counts.ndim != 2 or counts.dtype != np.uint16:
        raise InputError(path, f"{counts.dtype} counts of shape {counts.shape}", "uint16 counts (y, x)")
    description = None if metadata is None else json.dumps(dict(metadata), ensure_ascii=True)
    try:
        with replacing(path) as temporary:
            tifffile.imwrite(
                temporary, counts, photometric="minisblack", compression="zlib",
                compressionargs={"level": 9}, description=description, metadata=None,
            )  # fmt: skip
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a file that can be written") from None


def read_raw(path: Path) -> tuple[NDArray[np.uint16], dict[str, float | int | str]]:
    """Counts (y, x) and metadata of a file written by ``write_raw``; {} without metadata.

    Raises InputError for a file that is not a one-channel 16-bit TIFF.
    """
    expected = "a one-channel 16-bit TIFF"
    try:
        with tifffile.TiffFile(path) as file:
            counts, description = file.asarray(), file.pages.first.description
    except (OSError, ValueError, IndexError, RuntimeError, struct.error, tifffile.TiffFileError) as error:
        raise InputError(path, f"a file that cannot be read ({error})", expected) from None
    if counts.ndim != 2 or counts.dtype != np.uint16:
        raise InputError(path, f"{counts.dtype} pixels of shape {counts.shape}", expected)
    try:
        metadata = json.loads(description) if description else {}
    except ValueError:
        metadata = {}
    return counts, metadata if isinstance(metadata, dict) else {}
