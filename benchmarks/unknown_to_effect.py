"""From an unknown cause to an effect of one's own, by the commands that a user would type, and confirmed on a second
capture of the same box: the same cause and camera, other noise.

The causes are those of ``made_causes``, which share no formula with the diagnosis. Finished causes are kept in
--results (JSON lines), so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from unknown_causes import write_capture

_CAUSES = "floor_stain,row_noise,bleached"


def _cbox(folder: Path, *arguments: str) -> dict[str, Any]:
    """What a command writes with --json."""
    command = [str(Path(sys.executable).parent / "cbox"), *arguments, "--json", "out.json"]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    found: dict[str, Any] = json.loads((folder / "out.json").read_text())
    return found


def run(name: str, seed: int) -> dict[str, Any]:
    """Diagnose, write the effect, add it with its amplitude fitted, and look at both captures with and without it."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for taken, capture in enumerate(("first", "second")):
            truth = write_capture(folder / capture, name, seed, taken)
        found = _cbox(folder, "diagnose", "first")["explanation"]
        (folder / "out.json").rename(folder / "diagnosis.json")
        _cbox(folder, "effects", "--new", "found", "--from", "diagnosis.json")
        row = {
            "key": f"{name}:{seed}",
            "truth": truth.family,
            "family": found["family"],
            "form": found["form"],
            "bytes": (folder / "found.toml").stat().st_size,
        }
        for capture in ("first", "second"):
            fitted = _cbox(folder, "add", f"{capture}.toml", "found.toml", "--fit", capture)
            row[capture] = {
                "amplitude": fitted["added"]["parameters"]["amplitude"],
                "sigma": fitted["added"]["sigma"]["amplitude"],
                "chi2_without": _chi2(folder, capture),
                "chi2_with": _chi2(folder, capture, "--model", "first.toml"),
            }
        return row


def _chi2(folder: Path, capture: str, *model: str) -> float:
    return float(_cbox(folder, "validate", capture, *model)["chi2_per_dof"])


def main() -> None:
    """Run what is not in the results yet, and print all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--causes", default=_CAUSES)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--results", type=Path, default=Path("unknown_to_effect.jsonl"))
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    lines = options.results.read_text().splitlines() if options.results.exists() else []
    rows = {row["key"]: row for row in map(json.loads, lines)}
    for name in options.causes.split(","):
        if f"{name}:{options.seed}" not in rows:
            row = run(name, options.seed)
            rows[row["key"]] = row
            with options.results.open("a") as file:
                file.write(json.dumps(row) + "\n")
    for row in rows.values():
        print(row["key"], row["truth"], "->", row["family"], f"({row['form']}), {row['bytes']} bytes")
        for capture in ("first", "second"):
            one = row[capture]
            print(
                f"  {capture}: chi2 per degree of freedom {one['chi2_without']:.3f} -> {one['chi2_with']:.3f}; "
                f"amplitude fitted here {one['amplitude']:.3f} +- {one['sigma']:.3f}"
            )


if __name__ == "__main__":
    main()
