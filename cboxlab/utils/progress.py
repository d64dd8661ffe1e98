"""Progress reports and cancellation of long computations."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol

from .arguments import described
from .errors import InputError

__all__ = [
    "NO_PROGRESS",
    "Cancelled",
    "Progress",
    "ProgressReporter",
    "checkpoint",
    "share",
    "stoppable",
    "stops_promptly",
]


class Cancelled(Exception):
    """A computation was cancelled; it leaves no incomplete files."""


class Progress(Protocol):
    """Receiver of the progress of a computation.

    Each method may raise `Cancelled`, which ends the computation.
    """

    def stage(self, name: str) -> None:
        """Report that a stage begins.

        Parameters
        ----------
        name
            Name of the stage, such as "rendering".
        """

    def part(self, done: float) -> None:
        """Report the completed share of the computation.

        Parameters
        ----------
        done
            Share, 0 to 1. It may decrease if more work turns out to be needed.
        """


class ProgressReporter:
    """Progress that calls a function, and can be cancelled, also from another thread.

    Parameters
    ----------
    callback
        Function of the name of the stage ("" before the first) and the completed share, 0 to 1. Its result is ignored.
        By default nothing is called.
    """

    def __init__(self, callback: Callable[[str, float], object] = lambda stage, done: None) -> None:
        if not callable(callback):
            raise InputError("callback", described(callback), "a function of a stage and a completed share")
        self._callback = callback
        self._stage, self._done = "", 0.0
        self._stop = threading.Event()

    def cancel(self) -> None:
        """Stop the computation at its next report or checkpoint."""
        self._stop.set()

    def stage(self, name: str) -> None:
        """Report that a stage begins.

        Parameters
        ----------
        name
            Name of the stage.

        Raises
        ------
        Cancelled
            After `cancel`.
        """
        self._stage = name
        self._report()

    def part(self, done: float) -> None:
        """Report the completed share of the computation.

        Parameters
        ----------
        done
            Share, 0 to 1.

        Raises
        ------
        Cancelled
            After `cancel`.
        """
        self._done = done
        self._report()

    def check(self) -> None:
        """Report nothing.

        Raises
        ------
        Cancelled
            After `cancel`.
        """
        if self._stop.is_set():
            raise Cancelled("the computation was stopped")

    def _report(self) -> None:
        self.check()
        self._callback(self._stage, self._done)


#: Reporter of the present computation that checkpoints ask, and whether kernel calls are short; None for neither.
_stoppable: ContextVar[tuple[ProgressReporter, bool] | None] = ContextVar("stoppable", default=None)


@contextmanager
def stoppable(reporter: ProgressReporter, *, promptly: bool = False) -> Iterator[None]:
    """Block whose computations also stop at checkpoints, once a reporter is cancelled.

    Parameters
    ----------
    reporter
        The reporter.
    promptly
        Whether kernel calls are so short that a checkpoint comes within a tenth of a second. It costs a fifth of the
        speed and changes no result.

    Yields
    ------
    None
    """
    token = _stoppable.set((reporter, promptly))
    try:
        yield
    finally:
        _stoppable.reset(token)


def checkpoint() -> None:
    """Place at which a computation may stop, see `stoppable`.

    Raises
    ------
    Cancelled
        If the reporter of the present computation is cancelled.
    """
    present = _stoppable.get()
    if present is not None:
        present[0].check()


def stops_promptly() -> bool:
    """Whether the present computation takes short kernel calls, see `stoppable`.

    Returns
    -------
    bool
        False outside of `stoppable`.
    """
    present = _stoppable.get()
    return present is not None and present[1]


class _NoProgress:
    """Progress that ignores all reports."""

    def stage(self, name: str) -> None:
        pass

    def part(self, done: float) -> None:
        pass


#: Ignores all reports; the default of computations that report progress.
NO_PROGRESS: Progress = _NoProgress()


class _PartOf:
    """Progress of a part of a larger computation."""

    def __init__(self, parent: Progress, first: float, last: float) -> None:
        self._parent, self._first, self._last = parent, first, last

    def stage(self, name: str) -> None:
        self._parent.stage(name)

    def part(self, done: float) -> None:
        self._parent.part(self._first + (self._last - self._first) * done)


def share(progress: Progress, first: float, last: float) -> Progress:
    """Progress of a part of a larger computation.

    Its shares from 0 to 1 are reported to the larger one as `first` to `last`; stages are passed on.

    Parameters
    ----------
    progress
        Progress of the larger computation.
    first
        Completed share at which the part begins, 0 to 1.
    last
        Completed share at which it ends, 0 to 1.

    Returns
    -------
    Progress
        Progress for the part.
    """
    return _PartOf(progress, first, last)
