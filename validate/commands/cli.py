"""Entry point of the command line, ``cbox``."""

from __future__ import annotations

import os
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command. Parameters and exit codes as in ``app.run``."""
    # Read when NumPy is imported: the idle threads of its matrix products would slow down ray tracing.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    from .app import run

    run(arguments)
