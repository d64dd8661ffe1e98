"""How often the stated intervals of a calibration hold the truth, over many simulated captures.

    python benchmarks/calibration/calibration_coverage.py --captures 1000 --results coverage.jsonl [--part 1/2] [--json]

Every capture is written to files, loaded and calibrated as ``cbox calibrate`` does it, and each quantity handed on is
held against what the capture was made of: is the truth within the 68% and the 95% interval? Finished captures are
kept in --results (JSON lines), so that an interrupted run goes on where it stopped; parts may run side by side,
each into its file; --results then takes several files. The table has the share of intervals that hold the truth with
its standard error over captures (binomial where a capture has one such interval), and marks what is off by more than
three of them.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from oracles.calibration_coverage import LEVELS, coverage, score

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=int, default=1000)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--results", type=Path, nargs="+", default=[Path("coverage.jsonl")])
    parser.add_argument("--part", default="1/1", help="K/N: every N-th capture, from the K-th on, into the first file")
    parser.add_argument("--json", action="store_true", help="end with one line of JSON")
    options = parser.parse_args()
    part, parts = (int(number) for number in options.part.split("/"))
    lines = [line for path in options.results if path.exists() for line in path.read_text().splitlines()]
    done = {int(entry["seed"]): entry["shares"] for entry in map(json.loads, lines)}
    for seed in range(options.first_seed + part - 1, options.first_seed + options.captures, parts):
        if seed in done:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            done[seed] = score(Path(scratch) / "capture", seed)
        with open(options.results[0], "a", encoding="utf-8") as stream:
            stream.write(json.dumps({"seed": seed, "shares": done[seed]}) + "\n")
    table = coverage(list(done.values()))
    print(
        f"{len(done)} captures; shares of intervals that hold the truth, {LEVELS[0]:.1%} and {LEVELS[1]:.1%} expected"
    )
    for name, levels in table.items():
        off = any(abs(share - level) > 3 * error for (share, error), level in zip(levels, LEVELS, strict=True))
        table_row = "  ".join(f"{100 * share:6.1f} +- {100 * error:.1f}" for share, error in levels)
        print(f"{name:52s} {table_row}{'  *' if off else ''}")
    if options.json:
        print(json.dumps({"captures": len(done), "coverage": table}))


if __name__ == "__main__":
    main()
