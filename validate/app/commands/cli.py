"""Entry point of the command line, ``cbox``."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command. Parameters and exit codes as in ``app.run``."""
    # Read when NumPy is imported: the idle threads of its matrix products would slow down ray tracing.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with _interrupts_noted() as pressed:
        try:
            from .app import run
        except (KeyboardInterrupt, Exception):
            if not pressed:
                raise
        if pressed:
            print("interrupted", file=sys.stderr)
            sys.exit(130)
        run(arguments, pressed)


@contextmanager
def _interrupts_noted() -> Iterator[list[int]]:
    """The Ctrl-C pressed until now. Libraries lose one that meets them while they are imported, or end in errors of
    their own.
    """
    pressed: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        pressed.append(number)
        signal.default_int_handler(number, frame)

    here = threading.current_thread() is threading.main_thread()
    noted = here and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if noted:
        signal.signal(signal.SIGINT, note)
    try:
        yield pressed
    finally:
        if noted:
            signal.signal(signal.SIGINT, signal.default_int_handler)
