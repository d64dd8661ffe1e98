"""A function's code exchanged in the running process, and tests run in it: a tenth of the time of a new process.

Whoever imported the function has the changed one, also methods, properties and what is cached.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import resource
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import CodeType, FunctionType
from typing import Any

import pytest

__all__ = ["OutOfTime", "exchanged", "run_here"]


class OutOfTime(Exception):
    """Tests that took more processor time than they had."""


def _functions(code: CodeType) -> dict[str, CodeType]:
    """By qualified name, the code of functions of a module and of methods of its classes, not of functions inside."""
    codes: dict[str, CodeType] = {}
    for inner in (c for c in code.co_consts if isinstance(c, CodeType)):
        if inner.co_flags & 1:  # a function; the body of a class has no fast locals
            codes[inner.co_qualname] = inner
        else:
            codes |= _functions(inner)
    return codes


def _alike(a: CodeType, b: CodeType) -> bool:
    if a.co_code != b.co_code or a.co_names != b.co_names or len(a.co_consts) != len(b.co_consts):
        return False
    pairs = zip(a.co_consts, b.co_consts, strict=True)
    return all(_alike(x, y) if isinstance(x, CodeType) else repr(x) == repr(y) for x, y in pairs)


def _function(module: Any, name: str) -> FunctionType:
    """The function of a qualified name, taken out of what wraps it; forgets what its cache holds."""
    member = module
    for part in name.split("."):
        member = member.__dict__[part] if isinstance(member, type) else getattr(member, part)
    while not isinstance(member, FunctionType):
        if hasattr(member, "cache_clear"):
            member.cache_clear()
        inner = [getattr(member, key) for key in ("fget", "func", "__func__", "__wrapped__") if hasattr(member, key)]
        member = inner[0]
    return member


@contextmanager
def exchanged(name: str, source: str, mutated: str) -> Iterator[None]:
    """Within it the module of that name behaves as if ``mutated`` were its source, which differs in functions alone."""
    module = importlib.import_module(name)
    before, after = (_functions(compile(text, name, "exec")) for text in (source, mutated))
    changed = {key: after[key] for key in before if not _alike(before[key], after[key])}
    functions = {key: _function(module, key) for key in changed}
    codes = {key: function.__code__ for key, function in functions.items()}
    try:
        for key, function in functions.items():
            function.__code__ = changed[key]
        yield
    finally:
        for key, function in functions.items():
            function.__code__ = codes[key]
            _function(module, key)  # forgets what the other one computed


class _Failures:
    def __init__(self) -> None:
        self.first: str | None = None

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and self.first is None:
            self.first = report.nodeid

    pytest_collectreport = pytest_runtest_logreport


def _used_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def run_here(paths: Sequence[str], limit_s: float, skipped: Sequence[str] = ()) -> tuple[str | None, float]:
    """The first test that fails, None if all pass; and the processor time in s. skipped : tests that do not run.

    Raises OutOfTime after the limit. A kernel that does not end is not interrupted.
    """
    failures, before = _Failures(), _used_s()
    arguments = [
        "-x",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        *paths,
        *(f"--deselect={test}" for test in skipped),
    ]
    signal.signal(signal.SIGPROF, _interrupt)
    signal.setitimer(signal.ITIMER_PROF, max(limit_s, 0.1))
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = int(pytest.main(arguments, plugins=[failures]))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    if failures.first is None and code == pytest.ExitCode.INTERRUPTED:
        raise OutOfTime
    return failures.first, _used_s() - before
