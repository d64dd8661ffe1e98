"""Ways to run tasks: in processes of this machine, or on the workers of a Dask scheduler."""

from __future__ import annotations

import importlib
import logging
import multiprocessing
import os
import platform
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Any

from cboxlab.rendering.device import dr
from cboxlab.rendering.integrators import TIMEOUT_S
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import temporary_folder

from .layout import versions
from .tasks import Task, run_task

__all__ = ["FolderTask", "in_processes", "on_local_cluster", "on_scheduler", "run_from_folder", "run_with_versions"]

#: Ends of worker processes without a finished task between them, after which the run is given up.
_MOST_ENDS = 3

#: Time that the first worker of a scheduler has to join, s: a busy machine takes half a minute to start one.
_WORKER_S = 60.0

#: Time that a scheduler which ended has to answer again, s.
_RESTART_S = 60.0

#: Held by the task that a worker runs: limits on threads hold for a process, so its other threads wait.
_ONE_AT_A_TIME = threading.Lock()

#: Packages whose messages about lost connections are kept off the terminal.
_DASK_LOGGERS = ("distributed", "asyncio", "tornado")

#: Tasks that a scheduler holds at once: enough for a hundred machines, and little of its memory.
_MOST_HELD = 4000

#: Interval at which a run looks whether it was cancelled, s.
_LOOK_S = 0.5


def _share_processors(threads: int) -> None:
    """Use some threads for the kernels of this process."""
    dr.set_thread_count(threads)


def in_processes(
    tasks: Sequence[Task],
    count: int,
    idle: Callable[[], None],
    run: Callable[[Task], list[dict[str, Any]]] = run_task,
    start: Callable[[int], Any] = _share_processors,
) -> Iterator[list[dict[str, Any]]]:
    """Run tasks in processes of this machine.

    Parameters
    ----------
    tasks
        The tasks.
    count
        Number of processes.
    idle
        Function that is called while tasks run; what it raises ends the run.
    run
        Function of a task to its records.
    start
        Function of a number of threads that begins each process.

    Yields
    ------
    list of dict
        Records of each task, in the order of their ends.

    Raises
    ------
    InputError
        If processes end again and again without a finished task.
    """
    threads = max(1, (os.cpu_count() or 1) // count)
    remaining, ends = list(tasks), 0
    while remaining:
        pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=start, initargs=(threads,))
        waiting: dict[Future[list[dict[str, Any]]], Task] = {pool.submit(run, task): task for task in remaining}
        try:
            while waiting:
                over, _ = wait(waiting, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
                for future in over:
                    records = future.result()
                    remaining.remove(waiting.pop(future))
                    ends = 0
                    yield records
                idle()
        except BrokenProcessPool:
            ends += 1
            if ends >= _MOST_ENDS:
                fault = f"{ends} worker processes that ended before a task was finished"
                raise InputError("dataset", fault, "memory for the pictures", "Use fewer processes.") from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _dask() -> Any:
    """Package distributed; InputError if it is not installed."""
    try:
        import distributed
    except ImportError:
        hint = "pip install 'cboxlab[distributed]'"
        raise InputError("scheduler", "Dask is not installed", "Dask", hint) from None
    return distributed


def on_scheduler(
    tasks: Sequence[Any], address: str, idle: Callable[[], None], run: Callable[[Any], Any] | None = None
) -> Iterator[Any]:
    """Run tasks on the workers of a Dask scheduler, which share a file system with this machine.

    Parameters
    ----------
    tasks
        The tasks.
    address
        Address such as ``tcp://host:8786``.
    idle
        As of ``in_processes``.
    run
        Function of a task that its worker calls; None for the pictures of a data set.

    Yields
    ------
    object
        Result of each task, in the order of their ends: of a data set the records of its pictures.

    Raises
    ------
    InputError
        If Dask is not installed, no scheduler or worker answers, the scheduler ends and does not answer again, or a
        worker has other versions.
    """
    dask, remaining, losses = _dask(), list(tasks), 0
    checked = partial(run_with_versions, versions(), run or _run_on_worker)
    with _without_log():
        while remaining:
            try:
                with _connected(dask, address, _RESTART_S if losses else TIMEOUT_S) as client:
                    for task, result in _on_client(dask, client, remaining, idle, checked):
                        remaining.remove(task)
                        losses = 0
                        yield result
            except _SchedulerEnded:
                losses += 1
                if losses >= _MOST_ENDS:
                    hint = "Start it again and repeat the command: finished pictures are kept."
                    raise InputError("scheduler", "a scheduler that ends", "a Dask scheduler", hint) from None


def run_with_versions(expected: Mapping[str, str], run: Callable[[Any], Any], task: Any) -> Any:
    """Run a task in a process with the versions of the run.

    Parameters
    ----------
    expected
        Version of each package on which results depend.
    run
        Function of a task.
    task
        The task.

    Returns
    -------
    object
        Result of the task.

    Raises
    ------
    InputError
        If this process has other versions.
    """
    installed = versions()
    pairs = [(name, installed.get(name), version) for name, version in expected.items()]
    if other := [f"{name} {mine} (not {version})" for name, mine, version in pairs if mine != version]:
        fault = f"a worker on {platform.node()} with {', '.join(other)}"
        raise InputError("scheduler", fault, "the same versions on every worker")
    return run(task)


@dataclass(frozen=True)
class FolderTask:
    """Call of a function in a module that no package has, such as a benchmark."""

    #: Absolute path of the module's folder, the same on every worker.
    folder: str
    #: Name of the module.
    module: str
    #: Name of the function.
    function: str
    #: Arguments of the call.
    arguments: tuple[Any, ...]


def run_from_folder(task: FolderTask) -> Any:
    """Call the function of a task.

    Parameters
    ----------
    task
        The task.

    Returns
    -------
    object
        Result of the call.
    """
    if task.folder not in sys.path:
        sys.path.insert(0, task.folder)
    return getattr(importlib.import_module(task.module), task.function)(*task.arguments)


class _SchedulerEnded(Exception):
    """The connection to the scheduler was lost."""


@contextmanager
def _without_log() -> Iterator[None]:
    """Keep Dask's messages about lost connections off the terminal: errors say what they mean."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _DASK_LOGGERS]
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _connected(dask: Any, address: str, seconds: float) -> Iterator[Any]:
    """Client of a scheduler that answers within some seconds and has a worker."""
    try:
        client = dask.Client(address, timeout=seconds)
    except (OSError, ValueError) as error:
        hint = "Repeat the command when it runs: finished pictures are kept."
        raise InputError("scheduler", f"no answer from {address} ({error})", "a Dask scheduler", hint) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_WORKER_S)
        except TimeoutError:
            hint = f"Start one with `dask worker {address}`."
            raise InputError("scheduler", f"no worker at {address}", "at least one worker", hint) from None
        yield client


def on_local_cluster(tasks: Sequence[Task], count: int, idle: Callable[[], None]) -> Iterator[list[dict[str, Any]]]:
    """Run tasks on a Dask cluster that is started on this machine and ends with the run.

    Parameters
    ----------
    tasks
        The tasks.
    count
        Number of worker processes.
    idle
        As of ``in_processes``.

    Yields
    ------
    list of dict
        Records of each task, in the order of their ends.

    Raises
    ------
    InputError
        As ``on_scheduler``.
    """
    dask = _dask()
    with (
        temporary_folder() as folder,
        importlib.import_module("dask").config.set(temporary_directory=str(folder)),
        dask.LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None) as cluster,
        dask.Client(cluster) as client,
    ):
        client.run(_share_processors, max(1, (os.cpu_count() or 1) // count))
        yield from on_scheduler(tasks, cluster.scheduler_address, idle)


def _run_on_worker(task: Task) -> list[dict[str, Any]]:
    """Run a task on a worker of Dask, in a thread that Dask does not sample.

    Dask's profiler holds the frames of Dask's threads for a moment. HDF5 objects then close later, and the layout of
    a file, though not its content, changes from run to run.
    """
    import dask

    with _ONE_AT_A_TIME, dask.config.set(scheduler="threads"), ThreadPoolExecutor(1) as thread:
        return thread.submit(run_task, task).result()


def _on_client(
    dask: Any, client: Any, tasks: Sequence[Any], idle: Callable[[], None], run: Callable[[Any], Any]
) -> Iterator[tuple[Any, Any]]:
    """Tasks with their results, run on the workers of a client.

    A worker that ends or joins changes nothing else.
    """
    later, waiting, over = iter(tasks), {}, SimpleQueue[Any]()

    def submit(count: int) -> None:
        for task in islice(later, count):
            future = client.submit(run, task, pure=False)
            waiting[future] = task
            future.add_done_callback(over.put)

    try:
        submit(_MOST_HELD)
        while waiting:
            with suppress(Empty):
                future = over.get(timeout=_LOOK_S)
                yield waiting.pop(future), future.result()
                submit(1)
            idle()
    except OSError as error:
        if error.filename is not None:
            raise  # a file of the data set, such as on a full disk
        raise _SchedulerEnded from None
    except (CancelledError, dask.client.ClosedClientError):  # Dask's errors of cancelled futures are of the first kind
        raise _SchedulerEnded from None
    except (ImportError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "deserialization" not in str(error):
            raise
        fault = f"a scheduler or worker that cannot read a task ({error.__cause__ or error})"
        hint = "Install the same version of cboxlab where the scheduler and its workers run."
        raise InputError("scheduler", fault, "the same packages on every machine", hint) from None
    except dask.KilledWorker:
        fault = "a task during which several workers ended"
        raise InputError("scheduler", fault, "memory for the pictures", "Use fewer or smaller workers.") from None
    finally:
        for future in waiting:
            future.cancel()
