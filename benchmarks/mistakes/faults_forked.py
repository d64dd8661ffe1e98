"""Commands in forks of a process that has imported the program: each takes tenths of a second."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from cboxlab.validation.app.commands.cli import main

#: Packages that commands import while they run. Dr.Jit is none of them: its threads do not survive a fork.
PACKAGES = (
    "calibration",
    "calibration.result",
    "rendering.effects",
    "rendering.export",
    "rendering.files",
    "rendering.fitted_fields",
    "rendering.model",
    "validation.api",
    "validation.app.commands",
    "validation.compare",
    "validation.compare_renders.regress",
)


def import_all() -> None:
    for package in PACKAGES:
        importlib.import_module(f"cboxlab.{package}")
        for module in Path(importlib.import_module(f"cboxlab.{package}").__file__ or "").parent.glob("[a-z]*.py"):
            importlib.import_module(f"cboxlab.{package}.{module.stem}")


class Forked:
    """What is used of ``subprocess.Popen``, for a ``cbox`` in a fork of this process, which has imported it."""

    def __init__(
        self,
        arguments: tuple[str, ...],
        folder: Path,
        environment: dict[str, str],
        prepare: Callable[[], None] | None,
    ) -> None:
        self.said, said = os.pipe()  # no file, which a limit of file size would cut
        self.returncode: int | None = None
        self.pid = os.fork()
        if self.pid:
            os.close(said)
            return
        code = 1
        try:
            os.setsid()
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(said, 2)
            sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False) for number in (1, 2))
            os.chdir(folder)
            os.environ.update(environment)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.argv = ["cbox", *arguments]
            if prepare is not None:
                prepare()
            main(arguments)
            code = 0
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)

    def poll(self) -> int | None:
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if ended else None
        return self.returncode

    def communicate(self, timeout: float = 900) -> tuple[str, str]:
        limit = time.monotonic() + timeout
        while self.poll() is None and time.monotonic() < limit:
            time.sleep(0.005)
        with os.fdopen(self.said, "rb") as said:
            return "", said.read().decode(errors="replace")

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)
