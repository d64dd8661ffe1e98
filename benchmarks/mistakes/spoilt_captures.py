"""How many mistakes in captures the suspicions of a calibration name, and how often sound captures raise one.

    python benchmarks/mistakes/spoilt_captures.py CAPTURE... [--sound FOLDER] [--only PATTERN] [--json F]

Each capture is copied and spoilt in the ways of ``manifest_mistakes.py``, ``frame_mistakes.py`` and
``further_mistakes.py``, calibrated from its files as ``cbox calibrate`` does it, and counted as named where a
suspicion, or the refusal, matches what the mistake expects. --sound : a folder of sound captures, which should all
raise no suspicion. The table has a row for each mistake, a column for each capture: named (+), another suspicion (~),
missed (-), not applicable (blank).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import tempfile
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import frame_mistakes  # noqa: F401  (fills the list)
import further_mistakes  # noqa: F401
import manifest_mistakes  # noqa: F401
import numpy as np
from capture_mistakes import MISTAKES, Draft, Mistake, Unsuitable
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.result import calibrate_capture
from cboxlab.utils.errors import InputError
from cboxlab.validation.capture_checks import with_scene_checks

__all__ = ["suspicions_of", "verdict_on"]


def suspicions_of(folder: Path) -> list[str]:
    """Every suspicion of a capture as text; the refusal where it is refused."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            calibration = with_scene_checks(calibrate_capture(load_capture(folder)))
            return [str(suspicion) for suspicion in calibration.suspicions]
    except InputError as fault:
        return [f"refused: {fault}"]
    except Exception as crash:  # a traceback for the user: counted as missed
        return [f"CRASH: {type(crash).__name__}: {crash}"]


def verdict_on(mistake: Mistake, source: Path, others: tuple[Path, ...], seed: int) -> tuple[str, list[str]]:
    """("+", "~" or "-", what was suspected) of a mistake made in a copy of a capture; "" where it cannot be made."""
    with tempfile.TemporaryDirectory() as scratch:
        draft = Draft(source, Path(scratch) / "capture", others)
        try:
            mistake.make(draft, np.random.default_rng(seed))
        except (Unsuitable, KeyError, StopIteration):
            return "", []
        draft.save()
        suspicions = suspicions_of(draft.folder)
    good = any(re.search(mistake.expected, text) for text in suspicions)
    return ("+" if good else "~" if suspicions else "-"), suspicions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--sound", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    record: dict[str, dict[str, object]] = {}
    for source in options.captures:
        others = tuple(p for p in options.captures if p != source)
        counts = {"+": 0, "~": 0, "-": 0, "": 0}
        for number, mistake in enumerate(MISTAKES):
            if not re.search(options.only, mistake.name):
                continue
            mark, suspicions_found = verdict_on(mistake, source, others, options.seed + 100 * number)
            counts[mark] += 1
            record.setdefault(mistake.name, {})[source.name] = {"mark": mark, "suspicions": suspicions_found}
            if mark in ("~", "-"):
                print(f"  {mark} {source.name}: {mistake.name}: {' | '.join(suspicions_found)[:200]}", flush=True)
        total = sum(counts.values()) - counts[""]
        print(
            f"{source.name}: {counts['+']} of {total} mistakes named, {counts['~']} others suspected",
            flush=True,
        )
    sound = sorted(p.parent for p in options.sound.glob("*/capture.toml")) if options.sound else []
    false = {path.name: suspicions_found for path in sound if (suspicions_found := suspicions_of(path))}
    for name, suspicions_found in false.items():
        print(f"  sound {name}: {' | '.join(suspicions_found)}")
    if sound:
        print(f"{len(false)} of {len(sound)} sound captures raise a suspicion")
    for name, row in record.items():
        print(f"{name:50s} " + " ".join(f"{cell['mark']:1s}" for cell in row.values()))  # type: ignore[index]
    if options.json:
        options.json.write_text(json.dumps({"mistakes": record, "false": false}, indent=1))


if __name__ == "__main__":
    main()
