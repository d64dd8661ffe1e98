"""One computation at a time on one thread: short ones at once, long ones told stage by stage and stopped on demand."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import Cancelled, Progress, ProgressReporter

from ..terminal import Stages

__all__ = ["Jobs"]

Value = TypeVar("Value")

#: What the end of a computation that was stopped is called.
CANCELLED = "cancelled"

#: Events that a slow listener may lag behind; older ones are dropped.
_LAG = 256

#: Between two reports of a computation the time gone is told every so many seconds.
_TICK_S = 1.0


class Jobs:
    """Runs computations and tells listeners of them. All methods belong to the event loop's thread.

    told : the last progress of what runs, None where nothing does. error : how the last long computation failed.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="study")
        self._listeners: set[asyncio.Queue[dict[str, Any]]] = set()
        self._running: tuple[ProgressReporter, asyncio.Task[None], bool] | None = None
        self.told: dict[str, Any] | None = None
        self.error = ""

    @property
    def busy(self) -> bool:
        """Whether a long computation runs that the user asked for."""
        return self._running is not None and not self._running[2]

    def listen(self) -> asyncio.Queue[dict[str, Any]]:
        """A queue of all events from now on; give it back to ``forget``."""
        queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue(_LAG)
        self._listeners.add(queue)
        return queue

    def forget(self, queue: asyncio.Queue[dict[str, Any]]) -> None:
        """Send nothing to a queue any more."""
        self._listeners.discard(queue)

    @property
    def heard(self) -> bool:
        """Whether anybody listens."""
        return bool(self._listeners)

    def tell(self, event: dict[str, Any]) -> None:
        """Send an event to all listeners."""
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(event)

    async def quick(self, function: Callable[[], Value]) -> Value:
        """Run a short computation; a background one is stopped first.

        Raises InputError while a long one runs that the user asked for.
        """
        if self.busy:
            raise InputError("the workbench", "a computation that is not finished", "none", "Wait for it, or cancel it")
        await self.cancel()
        return await asyncio.get_running_loop().run_in_executor(self._pool, function)

    async def cancel(self) -> None:
        """Stop the long computation that runs, if one does, and wait until it has."""
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
        """Begin a long computation. done : awaited when it has succeeded. Raises InputError as ``quick`` does."""
        if self.busy:
            raise InputError("the workbench", "a computation that is not finished", "none", "Wait for it, or cancel it")
        await self.cancel()
        loop = asyncio.get_running_loop()

        stages = Stages(name, lambda line: None)

        def told(stage: str, part: float) -> None:
            loop.call_soon_threadsafe(self._progress, name, stages, stage, part, background)

        reporter = ProgressReporter(told)
        task = asyncio.create_task(self._run(name, function, reporter, done, stages))
        self._running = (reporter, task, background)
        self._progress(name, stages, "", 0.0, background)

    def _progress(self, name: str, stages: Stages, stage: str, part: float, background: bool) -> None:
        if self._running is not None:
            stages.tell(stage, part)
            self.told = {
                "job": name,
                "stage": stage,
                "done": stages.done,
                "times": stages.times(),
                "background": background,
            }
            self.tell({"event": "progress", **self.told})

    async def _tick(self, stages: Stages) -> None:
        """Tell the time gone between reports, too."""
        while True:
            await asyncio.sleep(_TICK_S)
            if self.told is not None:
                self.told["times"] = stages.times()
                self.tell({"event": "progress", **self.told})

    async def _run(
        self,
        name: str,
        function: Callable[[Progress], Any],
        reporter: ProgressReporter,
        done: Callable[[], Awaitable[None]],
        stages: Stages,
    ) -> None:
        loop, error, ticking = asyncio.get_running_loop(), "", asyncio.create_task(self._tick(stages))
        try:
            await loop.run_in_executor(self._pool, function, reporter)
        except Cancelled:
            error = CANCELLED
        except InputError as fault:
            error = str(fault)
        except Exception as fault:  # the page must tell it; the server goes on
            error = f"{type(fault).__name__}: {fault}. This is a fault of the program"
        ticking.cancel()
        background = self._running is not None and self._running[2]
        self._running, self.told = None, None
        self.error = "" if error == CANCELLED else error
        if not error:
            await done()
        self.tell({"event": "end", "job": name, "error": error, "background": background})

    def close(self) -> None:
        """Stop whatever runs at its next report, and take nothing more."""
        if self._running is not None:
            self._running[0].cancel()
        self._pool.shutdown(wait=False, cancel_futures=True)
