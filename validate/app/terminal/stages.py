"""The stages of a computation in the terminal: one bar for the whole, or plain lines where there is no terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, TaskProgressColumn, TextColumn
from rich.progress import Progress as ProgressBar

from .output import errors, this_run

__all__ = ["ProgressBar", "Stages", "told_time", "watch_stages"]

#: Without a terminal a stage that takes longer than this, s, is told of again and again.
_REMIND_S = 30.0
#: No time left is stated before this share is done and this time, s, is gone: it would be a guess.
_SMALLEST_SHARE, _SHORTEST_S = 0.05, 2.0
#: Stages shorter than this, s, have no line of their own.
_BRIEF_S = 0.5


def told_time(seconds: float) -> str:
    """A time as people say it: 0.4 s, 12 s, 1 min 05 s, 2 h 03 min."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


class Stages:
    """Follows a computation by its name of stages and its share done, and says how long it may still take.

    The time left is that of the whole, from the time gone and the share done. Where a computation finds that more is
    to be done, the share falls, and the time left grows with it.

    line : takes a line about a stage that is over, or that has lasted long. clock : seconds.
    """

    def __init__(self, title: str, line: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._line, self._clock = line, clock
        self._begun = self._stage_begun = self._reminded = clock()
        self.stage, self.done = title, 0.0

    def tell(self, stage: str, done: float) -> None:
        """A report of the computation: the stage's name ("" before the first) and the share done, 0 to 1."""
        now = self._clock()
        if stage and stage != self.stage:
            self.end_stage()
            self.stage, self._stage_begun, self._reminded = stage, now, now
        self.done = min(max(done, 0.0), 1.0)
        if now - self._reminded >= _REMIND_S and self.done < 1:
            self._reminded = now
            self._line(f"{self.stage}: {self.done:.0%} of the whole, {self.times()}")

    def end_stage(self) -> None:
        """The stage is over: a line says what it took."""
        taken = self._clock() - self._stage_begun
        if taken >= _BRIEF_S:
            self._line(f"{self.stage}: {told_time(taken)}")

    def left_s(self) -> float | None:
        """Time left, s; None where nothing can be said yet."""
        gone = self._clock() - self._begun
        if self.done < _SMALLEST_SHARE or gone < _SHORTEST_S:
            return None
        return gone * (1 - self.done) / self.done

    def times(self) -> str:
        """Time gone and time left, in words."""
        left = self.left_s()
        gone = f"{told_time(self._clock() - self._begun)} gone"
        return gone if left is None else f"{gone}, about {told_time(left)} left"


@contextmanager
def watch_stages(title: str) -> Iterator[Callable[[str, float], None]]:
    """What a ``ProgressReporter`` reports to while a computation runs. title : the stage's name until one is reported.

    With a terminal one bar shows the stage, the share of the whole, the time gone and left. Without one, or where the
    user asks for more, a line is printed when a stage is over. Nothing is printed where the user wants it quiet.
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
    with ProgressBar(*columns, console=errors, transient=True, disable=not terminal) as shown:
        task = shown.add_task(title, total=1.0, times="")

        def report(stage: str, done: float) -> None:
            stages.tell(stage, done)
            shown.update(task, description=stages.stage, completed=stages.done, times=stages.times())

        yield report
        stages.end_stage()
