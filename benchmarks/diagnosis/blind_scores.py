"""Scores of blind captures: what is right by kind, box and instrument, the stated probabilities, and what fails.

    python benchmarks/diagnosis/blind_scores.py blind-1.jsonl blind-2.jsonl

prints the tables, as Markdown, of results that blind_diagnosis.py kept, of several parts together; one state of the
code must have made them all.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from cboxlab.validation.synthetic.strengths import STRENGTHS
from scipy.stats import binomtest

__all__ = ["exact", "is_right", "print_tables", "summary", "with_groups"]

Row: TypeAlias = Mapping[str, Any]

#: What is hidden in a capture, by its kind and strength, where it is not one effect of the catalogue.
_OTHER_KINDS = {
    ("pair", "medium"): "two",
    ("triple", "medium"): "three",
    ("none", ""): "nothing",
    ("outside", "medium"): "outside the catalogue, medium",
    ("outside", "strong"): "outside the catalogue, strong",
    ("unknown", ""): "a made cause, its family",
}

#: Limits between the bins of stated probabilities.
_BINS = (0.0, 0.5, 0.8, 0.95, 1.01)


def is_right(row: Row) -> bool:
    """Whether the answer names what is hidden: the effect first, or its group; each of several; nothing, or a block
    where it really stands, next to its survey; unknown first, of a made cause its family too."""
    if row["kind"] == "none":
        return not row["selected"] or row["settled_block"]
    if row["kind"] == "unknown":
        return bool(row["right"])
    if row["kind"] == "outside":
        return row["selected"][:1] == ["unknown"]
    if row["kind"] in ("pair", "triple"):
        return all(name in with_groups(row, row["selected"]) for name in row["truth"])
    return bool(set(row["truth"]) & with_groups(row, row["selected"][:1]))


def exact(row: Row) -> bool:
    """Whether the answer names what is hidden and nothing else."""
    others = [
        effect
        for effect in row["selected"]
        if row["kind"] in ("single", "pair", "triple") and not set(row["truth"]) & with_groups(row, [effect])
    ]
    return is_right(row) and not others and (row["kind"] != "outside" or row["selected"] == ["unknown"])


def with_groups(row: Row, names: Sequence[str]) -> set[str]:
    """Effects that an answer names, and those that it cannot distinguish from them."""
    return set(names).union(*(g for g in row["groups"] if g[0] in names)) - {"unknown"}


def kinds(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The captures by what is hidden in them, single effects by strength, in the order of the tables."""
    names = {("single", strength): f"one effect, {strength}" for strength in reversed(STRENGTHS)} | _OTHER_KINDS
    results = {name: [r for r in rows if (r["kind"], r["strength"]) == key] for key, name in names.items()}
    return {name: part for name, part in results.items() if part}


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Right answers, of how many, by kind, box and instrument; numbers, places, time; the stated probabilities."""
    numbers = [right for r in rows for right in r.get("parameters_right", ())]
    placed = [r for r in rows if r["kind"] == "unknown"]
    parts = kinds(rows)
    for name in ("box", "instrument"):
        parts |= {f"{name} {value}": [r for r in rows if r[name] == value] for value in sorted({r[name] for r in rows})}
    with_probability = [r for r in rows if r["selected"] and "probability" in r]
    return {
        "captures": len(rows),
        "right": {name: _count(part, is_right) for name, part in parts.items()},
        "exact": {name: _count(part, exact) for name, part in parts.items()},
        "places": _count(placed, lambda r: bool(r["place"])),
        "numbers": [sum(numbers), len(numbers)],
        "median_cpu_seconds": {n: float(np.median([r["cpu_seconds"] for r in part])) for n, part in parts.items()},
        "reliability": reliability(with_probability),
        "log_loss": log_loss(with_probability),
    }


def _count(rows: Sequence[Row], of: Callable[[Row], bool]) -> list[int]:
    return [sum(map(of, rows)), len(rows)]


def _first_right(row: Row) -> bool:
    """Whether the effect that stands first, or unknown, is true."""
    return row["first"] == "unknown" if row["kind"] == "outside" else row["first"] in row["truth"]


def reliability(rows: Sequence[Row]) -> list[dict[str, float]]:
    """Stated probability of the first answer against how often it was right, in bins of probability."""
    table = []
    for low, high in pairwise(_BINS):
        inside = [r for r in rows if low <= r["probability"] < high]
        if inside:
            mean_probability = float(np.mean([r["probability"] for r in inside]))
            right, count = _count(inside, _first_right)
            table.append({"stated": mean_probability, "right": right, "captures": count})
    return table


def log_loss(rows: Sequence[Row]) -> float:
    """Mean of -log(probability stated for what came true: the first answer or any other), nats; NaN without rows."""
    probabilities = [r["probability"] if _first_right(r) else 1 - r["probability"] for r in rows]
    return float(-np.mean(np.log(np.maximum(probabilities, 1e-3)))) if rows else float("nan")


def print_tables(rows: Sequence[Row]) -> None:
    """The scores as Markdown tables, with the 95 % interval of each rate (Wilson), and what is wrong."""
    scores = summary(rows)
    print("\n| hidden | right | nothing else | 95 % of right | CPU s, median |\n|---|---|---|---|---|")
    for name, (right, count) in scores["right"].items():
        low, high = binomtest(right, count).proportion_ci(method="wilson")
        print(
            f"| {name} | {right} of {count} | {scores['exact'][name][0]} | {100 * low:.0f} to {100 * high:.0f} % "
            f"| {scores['median_cpu_seconds'][name]:.0f} |"
        )
    print(
        "\nNumbers right {} of {}.".format(*scores["numbers"]),
        "Places right {} of {}.".format(*scores["places"]),
    )
    for bin_record in scores["reliability"]:
        print(f"Stated {bin_record['stated']:.2f}: right {bin_record['right']} of {bin_record['captures']}.")
    print(f"Log-loss {scores['log_loss']:.3f}.\n")
    for row in rows:
        if not exact(row):
            family = f", {row['family']} for {row['family_true']}" if row["kind"] == "unknown" else ""
            print(
                f"{row['key']} {_hidden(row['truth'])} -> {' + '.join(row['selected']) or 'adequate'}{family}, "
                f"chi2 {row['chi2_per_dof']:.3f}"
            )


def _hidden(truth: Mapping[str, Mapping[str, Any]]) -> str:
    """What is hidden, its numbers to three digits."""
    return "; ".join(
        " ".join([name, *(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in values.items())])
        for name, values in truth.items()
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="+", type=Path)
    rows = [json.loads(line) for path in parser.parse_args().results for line in path.read_text().splitlines()]
    if len(states := {row["code"] for row in rows}) > 1:
        sys.exit(f"made by several states of the code: {', '.join(sorted(states))}")
    print_tables(rows)


if __name__ == "__main__":
    main()
