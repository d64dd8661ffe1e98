"""Progress reports and cancellation of long computations."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

__all__ = ["NO_PROGRESS", "Cancelled", "Progress", "ProgressReporter", "share"]


class Cancelled(Exception):
    """Raised inside a cancelled computation, which leaves no incomplete files."""


class Progress(Protocol):
    """Receives the progress of a computation. Each method may raise ``Cancelled``, which ends the computation."""

    def stage(self, name: str) -> None:
        """A stage begins, such as "rendering"."""

    def part(self, done: float) -> None:
        """The completed share of the whole computation, 0 to 1. It can decrease if more work turns out to be needed."""


class ProgressReporter:
    """Passes stage and completed share on to a function; can be cancelled, also from another thread.

    callback : called with the name of the stage ("" before the first) and the completed share, 0 to 1.
    """

    def __init__(self, callback: Callable[[str, float], object] = lambda stage, done: None) -> None:
        self._callback = callback
        self._stage, self._done = "", 0.0
        self._stop = threading.Event()

    def cancel(self) -> None:
        """Stop the computation at its next progress report, after a kernel call or a pass."""
        self._stop.set()

    def stage(self, name: str) -> None:
        """See ``Progress``. Raises Cancelled."""
        self._stage = name
        self._report()

    def part(self, done: float) -> None:
        """See ``Progress``. Raises Cancelled."""
        self._done = done
        self._report()

    def _report(self) -> None:
        if self._stop.is_set():
            raise Cancelled("the computation was stopped")
        self._callback(self._stage, self._done)


class _NoProgress:
    def stage(self, name: str) -> None:
        pass

    def part(self, done: float) -> None:
        pass


#: Ignores all reports.
NO_PROGRESS: Progress = _NoProgress()


class _Share:
    def __init__(self, whole: Progress, first: float, last: float) -> None:
        self._whole, self._first, self._last = whole, first, last

    def stage(self, name: str) -> None:
        self._whole.stage(name)

    def part(self, done: float) -> None:
        self._whole.part(self._first + (self._last - self._first) * done)


def share(whole: Progress, first: float, last: float) -> Progress:
    """Progress of a computation that covers the share from ``first`` to ``last`` (0 to 1) of a larger one."""
    return _Share(whole, first, last)
