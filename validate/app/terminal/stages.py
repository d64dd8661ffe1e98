"""Stages of a computation: one progress bar, or plain lines without a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, TaskProgressColumn, TextColumn
from rich.progress import Progress as ProgressBar

from .output import errors, this_run

__all__ = ["ProgressBar", "Stages", "time_text", "watch_stages"]

#: Interval of lines about a long stage where there is no terminal, s.
REMINDER_S = 30.0
#: Completed share below which no remaining time is stated: it would be a guess.
MIN_SHARE = 0.05
#: Elapsed time below which no remaining time is stated, s.
MIN_ELAPSED_S = 2.0
#: Shortest stage that gets a line, s.
MIN_STAGE_S = 0.5


def time_text(seconds: float) -> str:
    """Duration as text.

    Parameters
    ----------
    seconds
        Duration, s.

    Returns
    -------
    str
        "0.4 s", "12 s", "1 min 05 s" or "2 h 03 min".
    """
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    rounded = round(seconds)
    if rounded < 60:
        return f"{rounded} s"
    if rounded < 3600:
        return f"{rounded // 60} min {rounded % 60:02d} s"
    return f"{rounded // 3600} h {rounded % 3600 // 60:02d} min"


class Stages:
    """Stage, completed share and remaining time of a computation.

    The remaining time follows from elapsed time and completed share. If a computation finds more work, the share falls
    and the remaining time grows.

    Parameters
    ----------
    title
        Name of the stage until the first report.
    line
        Receiver of a line about each completed stage, and about a long one while it lasts.
    clock
        Function that returns the time, s.
    """

    def __init__(self, title: str, line: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._line, self._clock = line, clock
        self._begun = self._stage_begun = self._reminded = clock()
        self.stage, self.done = title, 0.0

    def report(self, stage: str, done: float) -> None:
        """Receive a report of the computation.

        Parameters
        ----------
        stage
            Name of the stage; "" keeps the present one.
        done
            Completed share, 0 to 1.
        """
        now = self._clock()
        if stage and stage != self.stage:
            self.end_stage()
            self.stage, self._stage_begun, self._reminded = stage, now, now
        self.done = min(max(done, 0.0), 1.0)
        if now - self._reminded >= REMINDER_S and self.done < 1:
            self._reminded = now
            self._line(f"{self.stage}: {self.done:.0%} of the computation, {self.times()}")

    def end_stage(self) -> None:
        """End the stage, with a line that states its duration."""
        duration = self._clock() - self._stage_begun
        if duration >= MIN_STAGE_S:
            self._line(f"{self.stage}: {time_text(duration)}")

    def remaining_s(self) -> float | None:
        """Remaining time.

        Returns
        -------
        float or None
            Time, s; None while it would be a guess.
        """
        elapsed = self._clock() - self._begun
        if not MIN_SHARE <= self.done < 1 or elapsed < MIN_ELAPSED_S:
            return None
        return elapsed * (1 - self.done) / self.done

    def times(self) -> str:
        """Elapsed and remaining time.

        Returns
        -------
        str
            "30 s elapsed, about 1 min 30 s left"; without the second part while it would be a guess.
        """
        remaining = self.remaining_s()
        elapsed = f"{time_text(self._clock() - self._begun)} elapsed"
        return elapsed if remaining is None else f"{elapsed}, about {time_text(remaining)} left"


@contextmanager
def watch_stages(title: str) -> Iterator[Callable[[str, float], None]]:
    """Show the stages of a computation while it runs.

    In a terminal one bar shows the stage, the completed share, elapsed and remaining time. Without a terminal, or with
    ``--verbose``, each completed stage gets a line. With ``--quiet`` nothing is printed.

    Parameters
    ----------
    title
        Name of the stage until the first report.

    Yields
    ------
    Callable
        Receiver of reports (stage, completed share), for a ``ProgressReporter``.
    """
    terminal = errors.is_terminal and not this_run.quiet
    plain = not this_run.quiet and (not terminal or this_run.verbose)
    stages = Stages(title, lambda text: errors.print(text, highlight=False, soft_wrap=True) if plain else None)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[times]}"),
    )
    with ProgressBar(*columns, console=errors, transient=True, disable=not terminal) as progress_bar:
        task = progress_bar.add_task(title, total=1.0, times="")

        def report(stage: str, done: float) -> None:
            stages.report(stage, done)
            progress_bar.update(task, description=stages.stage, completed=stages.done, times=stages.times())

        yield report
        stages.end_stage()
