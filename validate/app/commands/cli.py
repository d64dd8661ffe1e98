"""Entry point of the command line, ``cbox``."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

__all__ = ["main"]

#: New objects between two searches for unreachable ones. With Python's 700 they take 0.6 CPU s of `validate`, mostly
#: while modules are imported; with these 0.2 s.
_OBJECTS_PER_COLLECTION = 100_000


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command, with the exit codes of ``app.run``.

    Parameters
    ----------
    arguments
        Arguments of the command; None for those of sys.argv.
    """
    gc.set_threshold(_OBJECTS_PER_COLLECTION, *gc.get_threshold()[1:])
    # NumPy reads these at its import: idle threads of its matrix products would slow down ray tracing.
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
    """One number for each Ctrl-C until now.

    Libraries ignore a Ctrl-C while they are imported, or raise other errors.
    """
    pressed: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        pressed.append(number)
        signal.default_int_handler(number, frame)

    main_thread = threading.current_thread() is threading.main_thread()
    noted = main_thread and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if noted:
        signal.signal(signal.SIGINT, note)
    try:
        yield pressed
    finally:
        if noted:
            signal.signal(signal.SIGINT, signal.default_int_handler)
