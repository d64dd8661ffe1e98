"""Reliability of stated probabilities: of effects, of families, and of an unknown cause.

    python reliability.py ../measured/blind_diagnosis.jsonl ../measured/imperfect_bases.jsonl

reads rows of blind_diagnosis.py and imperfect_bases.py, or such rows of captures by other simulators
(outside_simulators.jsonl). It prints, for bins of the stated probability, how many answers there are and how many of
them are true, with log loss and Brier score. Of the first file the first answer counts, of the others every effect with
a probability of 0.02 or more. A group of effects that a capture does not distinguish shares its probability.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest

#: Limits between the bins of stated probabilities.
_BINS = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.0001)

#: Identifier of an unknown cause.
_UNKNOWN = "unknown"

#: Kinds of captures whose cause the catalogue lacks.
_OUTSIDE = {"weak", "outside", "unknown"}

#: Flaws of a base that an effect describes, too: such a name is neither right nor wrong.
_DESCRIBES = {"leaning-blocks": {"block-pose"}, "sizes": {"block-pose"}, "astigmatism": {"defocus", "crosstalk"}}

Row = Mapping[str, Any]


class Stated(NamedTuple):
    """One stated probability, and what came true. base : a sound one or the kind of its flaw."""

    of: str
    base: str
    probability: float
    right: bool


def stated_probabilities(row: Row) -> Iterator[Stated]:
    """The probabilities that a row states, without those of nothing."""
    base = str(row.get("flaw", "none"))
    if "family_probability" in row and row["family"] not in (None, "none"):
        truth = row.get("family_true", row["truth"])
        yield Stated("family", base, float(row["family_probability"]), row["family"] == truth)
    if "ranking" in row:
        entries = [(str(name), float(probability)) for name, _, _, probability in row["ranking"]]
    elif "probability" in row and row["selected"]:
        entries = [(str(row["first"]), float(row["probability"]))]
    else:
        return
    selected = set(row["selected"]) - {_UNKNOWN}
    for name, probability in entries:
        if probability < _BINS[0] or (name in _DESCRIBES.get(base, ()) and name not in row["truth"]):
            continue
        if name == _UNKNOWN:
            yield Stated(_UNKNOWN, base, probability, row["kind"] in _OUTSIDE)
        elif selected or _UNKNOWN in row["selected"]:
            yield Stated("effect", base, probability, name in row["truth"])


def scores(answers: Sequence[tuple[float, bool]]) -> str:
    """Mean log loss and Brier score of stated probabilities, in words."""
    claimed, right = (np.array(x, float) for x in zip(*answers, strict=True))
    likely = np.clip(np.where(right > 0, claimed, 1 - claimed), _BINS[0], 1)
    return f"mean log loss {-np.mean(np.log(likely)):.3f}, Brier score {np.mean((claimed - right) ** 2):.3f}"


def table(answers: Sequence[Stated]) -> list[str]:
    """Rows of a Markdown table by bins of probability."""
    lines = ["| stated | answers | mean stated | true | 95 % of the true rate |", "|---|---|---|---|---|"]
    for low, high in pairwise(_BINS):
        inside = [a for a in answers if low <= a.probability < high]
        if inside:
            right, mean = sum(a.right for a in inside), sum(a.probability for a in inside) / len(inside)
            least, most = binomtest(right, len(inside)).proportion_ci(method="wilson")
            lines.append(
                f"| {low:g} to {min(high, 1):g} | {len(inside)} | {mean:.2f} | {right / len(inside):.2f} "
                f"| {least:.2f} to {most:.2f} |"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="+", type=Path)
    rows = [json.loads(line) for path in parser.parse_args().results for line in path.read_text().splitlines()]
    answers = [answer for row in rows for answer in stated_probabilities(row)]
    print(f"{len(rows)} captures.")
    for of in ("effect", "family", _UNKNOWN):
        for name, flawed in (("perfect bases", False), ("flawed bases", True)):
            some = [a for a in answers if a.of == of and (a.base != "none") == flawed]
            if some:
                summary = scores([(a.probability, a.right) for a in some])
                print(f"\nProbability of {of}, {name}, {len(some)} answers, {summary}:\n")
                print("\n".join(table(some)))


if __name__ == "__main__":
    main()
