"""Every command of the README and the tutorial, run as it is written, with a cold cache.

    python benchmarks/speed/manual_trial.py [PAGE ...]

Runs the commands of each page one after the other in a folder that holds the bundled data alone, with an empty cache,
and prints the time and the exit code of each. Exit code 1 where one fails. Reckon with half an hour.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from helpers.places import ROOT
from helpers.programs.manual_commands import NEW_USER, commands


def trial(page: str) -> bool:
    """Whether all commands of a page ended well."""
    print(page, flush=True)
    program, good, start = Path(sys.executable).with_name("cbox"), True, time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "validate").mkdir()
        (Path(folder) / "validate" / "data").symlink_to(ROOT / "validate" / "data")
        environment = {**os.environ, "XDG_CACHE_HOME": str(Path(folder) / "cache")}
        for command in commands(page, "shell"):
            begun = time.perf_counter()
            done = subprocess.run(
                [program, *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
            )
            print(f"  {time.perf_counter() - begun:6.1f} s, exit code {done.returncode}: cbox {shlex.join(command)}")
            if done.returncode:
                print(done.stderr)
                good = False
            sys.stdout.flush()
    print(f"  {time.perf_counter() - start:6.1f} s in all", flush=True)
    return good


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", default=NEW_USER)
    raise SystemExit(not all([trial(page) for page in parser.parse_args().pages]))


if __name__ == "__main__":
    main()
