"""Entry point of the command line, ``cbox``."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType, ModuleType

__all__ = ["main"]

#: New objects between two searches for unreachable ones. With Python's 700 they take 0.6 CPU s of `validate`, mostly
#: while modules are imported; with these 0.2 s. Fewer searches would let a workbench grow.
_OBJECTS_PER_COLLECTION = 100_000

#: Module that colour-science imports and no command uses: a quarter of the time of all imports.
_UNUSED_MODULE = "colour.plotting"

#: Options of glibc's `mallopt` with values in bytes: freed arrays below 32 MiB stay with the program, up to 256 MiB at
#: the end of its heap. Taken again from the system they cost 75,000 page faults of `validate`, 0.4 of its 1.7 CPU s in
#: the system; its largest memory is the same.
_MALLOC_OPTIONS = {"M_MMAP_THRESHOLD": (-3, 2**25), "M_TRIM_THRESHOLD": (-1, 2**28)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command, with the exit codes of ``app.run``.

    Parameters
    ----------
    arguments
        Arguments of the command; None for those of sys.argv.
    """
    gc.set_threshold(_OBJECTS_PER_COLLECTION, *gc.get_threshold()[1:])
    atexit.register(gc.freeze)  # else Python searches all objects as it ends, 0.15 CPU s
    sys.modules.setdefault(_UNUSED_MODULE, ModuleType(_UNUSED_MODULE))
    _keep_freed_memory()
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


def _keep_freed_memory() -> None:
    """Set ``_MALLOC_OPTIONS`` where the C library is glibc."""
    if sys.platform == "linux" and hasattr(library := ctypes.CDLL(None), "gnu_get_libc_version"):
        for option, value in _MALLOC_OPTIONS.values():
            library.mallopt(option, value)


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
