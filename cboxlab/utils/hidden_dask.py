"""Dask out of xarray's sight, for commands.

Where Dask is installed, xarray imports it with its first array, to ask whether that array is one of Dask's. No array of
a command is, and the import takes half a second.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["hidden_dask", "show_dask"]


@contextmanager
def hidden_dask() -> Iterator[None]:
    """Hide Dask for a block, unless it is imported already.

    Yields
    ------
    None
        An import of Dask fails as if it were not installed.
    """
    sys.modules.setdefault("dask", None)  # type: ignore[arg-type]  # Python's own mark of what cannot be imported
    try:
        yield
    finally:
        show_dask()


def show_dask() -> None:
    """Allow the import of Dask, by a computation that uses it."""
    if sys.modules.get("dask", False) is None:
        del sys.modules["dask"]
