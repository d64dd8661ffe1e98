"""Computations of the workbench, one at a time on one thread, with progress and cancelling."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import Cancelled, Progress, ProgressReporter, stoppable

from ..terminal import Stages

__all__ = ["Jobs"]

Value = TypeVar("Value")

#: Error of a computation that was stopped.
CANCELLED = "cancelled"

#: Largest number of events that wait for a slow listener; older ones are dropped.
_MAX_WAITING = 256

#: Interval at which the elapsed time is sent between two reports of a computation, s.
_TICK_S = 1.0


class Jobs:
    """Computations and the listeners to their progress.

    All methods run on the event loop's thread.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="study")
        self._listeners: set[asyncio.Queue[dict[str, Any]]] = set()
        self._running: tuple[ProgressReporter, asyncio.Task[None], bool] | None = None
        #: Last progress of the running computation; None if none runs.
        self.progress: dict[str, Any] | None = None
        #: Message of the last long computation that failed; empty after a success.
        self.error = ""

    @property
    def busy(self) -> bool:
        """Whether a long computation runs that the user started."""
        return self._running is not None and not self._running[2]

    def listen(self) -> asyncio.Queue[dict[str, Any]]:
        """Queue of all events from now on, until it is passed to ``forget``.

        Returns
        -------
        asyncio.Queue
            Events as records for JSON.
        """
        queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue(_MAX_WAITING)
        self._listeners.add(queue)
        return queue

    def forget(self, queue: asyncio.Queue[dict[str, Any]]) -> None:
        """Send no more events to a queue.

        Parameters
        ----------
        queue
            A queue of ``listen``.
        """
        self._listeners.discard(queue)

    @property
    def has_listeners(self) -> bool:
        """Whether anybody listens."""
        return bool(self._listeners)

    def send(self, event: dict[str, Any]) -> None:
        """Send an event to all listeners.

        Parameters
        ----------
        event
            Record for JSON.
        """
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(event)

    async def quick(self, function: Callable[[], Value]) -> Value:
        """Run a short computation; a background computation is stopped first.

        Parameters
        ----------
        function
            The computation.

        Returns
        -------
        Value
            Its result.

        Raises
        ------
        InputError
            While a long computation runs that the user started.
        """
        await self._make_room()
        return await asyncio.get_running_loop().run_in_executor(self._pool, function)

    async def cancel(self) -> None:
        """Stop the long computation, if one runs, and wait for its end."""
        if self._running is not None:
            reporter, task, _ = self._running
            reporter.cancel()
            await asyncio.wait([task])

    async def start(
        self,
        name: str,
        function: Callable[[Progress], Any],
        done: Callable[[], Awaitable[None]],
        *,
        background: bool = False,
    ) -> None:
        """Start a long computation.

        Parameters
        ----------
        name
            Name of the computation in events.
        function
            The computation, which receives the receiver of its progress.
        done
            Function that is awaited after a success.
        background
            Whether the user did not start it; a step of the user then stops it.

        Raises
        ------
        InputError
            While a long computation runs that the user started.
        """
        await self._make_room()
        loop = asyncio.get_running_loop()

        stages = Stages(name, lambda line: None)

        def receive(stage: str, part: float) -> None:
            loop.call_soon_threadsafe(self._progress, name, stages, stage, part, background)

        reporter = ProgressReporter(receive)
        task = asyncio.create_task(self._run(name, function, reporter, done, stages))
        self._running = (reporter, task, background)
        self._progress(name, stages, "", 0.0, background)

    async def _make_room(self) -> None:
        """Stop a background computation; InputError if the user started the one that runs."""
        if self.busy:
            raise InputError(
                "the workbench", "a computation that is still running", "none", "Wait for its end, or cancel it"
            )
        await self.cancel()

    def _progress(self, name: str, stages: Stages, stage: str, part: float, background: bool) -> None:
        if self._running is not None:
            stages.report(stage, part)
            self.progress = {
                "job": name,
                "stage": stage,
                "done": stages.done,
                "times": stages.times(),
                "background": background,
            }
            self.send({"event": "progress", **self.progress})

    async def _tick(self, stages: Stages) -> None:
        """Send the elapsed time between reports."""
        while True:
            await asyncio.sleep(_TICK_S)
            if self.progress is not None:
                self.progress["times"] = stages.times()
                self.send({"event": "progress", **self.progress})

    async def _run(
        self,
        name: str,
        function: Callable[[Progress], Any],
        reporter: ProgressReporter,
        done: Callable[[], Awaitable[None]],
        stages: Stages,
    ) -> None:
        loop, error, ticking = asyncio.get_running_loop(), "", asyncio.create_task(self._tick(stages))
        background = self._running is not None and self._running[2]

        def compute() -> None:
            with stoppable(reporter, promptly=background):
                function(reporter)

        try:
            await loop.run_in_executor(self._pool, compute)
        except Cancelled:
            error = CANCELLED
        except InputError as fault:
            error = str(fault)
        except Exception as fault:  # the page shows it; the server continues
            error = f"{type(fault).__name__}: {fault}. This is an error of the program"
        ticking.cancel()
        self._running, self.progress = None, None
        self.error = "" if error == CANCELLED else error
        if not error:
            await done()
        self.send({"event": "end", "job": name, "error": error, "background": background})

    def close(self) -> None:
        """Stop the running computation at its next report, and start no other."""
        if self._running is not None:
            self._running[0].cancel()
        self._pool.shutdown(wait=False, cancel_futures=True)
