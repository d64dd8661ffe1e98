"""Raw frames on disk: 16-bit TIFF, one channel, linear counts, losslessly compressed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tifffile
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from numpy.typing import NDArray

__all__ = ["write_raw"]


def write_raw(path: Path, counts: NDArray, metadata: Mapping[str, float | int | str] | None = None) -> None:
    """Write counts as a deflate-compressed TIFF.

    Parameters
    ----------
    path
        File to write; an incomplete one is removed.
    counts
        (y, x) uint16 counts, DN.
    metadata
        Values stored as JSON in the ImageDescription tag; None for no tag.

    Raises
    ------
    InputError
        If the counts have another type or shape, or the path cannot be written to.
    """
    counts = np.asarray(counts)
    if counts.ndim != 2 or counts.dtype != np.uint16:
        raise InputError(path, f"{counts.dtype} counts of shape {counts.shape}", "uint16 counts (y, x)")
    description = None if metadata is None else json.dumps(dict(metadata), ensure_ascii=True)
    try:
        with replacing(path) as temporary:
            tifffile.imwrite(
                temporary,
                counts,
                photometric="minisblack",
                compression="zlib",
                compressionargs={"level": 9},
                description=description,
                metadata=None,
            )
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "a file that can be written") from None
