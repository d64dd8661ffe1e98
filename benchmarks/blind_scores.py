"""Scores of blind captures: what is right, shares by kind, calibration of the stated probabilities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from cboxlab.validate.synthetic.strengths import STRENGTHS

__all__ = ["named", "print_tables", "summary", "with_groups"]


def named(row: dict[str, Any]) -> bool:
    """Whether the answer is right: the effect, its group, both of a pair, nothing (or a block where it really stands,
    beside its survey), or unknown."""
    if row["kind"] == "none":
        return not row["selected"] or row["settled_block"]
    if row["kind"] == "unknown":
        return bool(row["right"])
    if row["kind"] == "outside":
        return row["selected"][:1] == ["unknown"]
    if row["kind"] in ("pair", "triple"):
        return all(name in with_groups(row, row["selected"]) for name in row["truth"])
    return bool(set(row["truth"]) & with_groups(row, row["selected"][:1]))


def with_groups(row: dict[str, Any], names: Sequence[str]) -> set[str]:
    """Effects that an answer names, and those that it cannot tell from them."""
    return set(names).union(*(g for g in row["groups"] if g[0] in names)) - {"unknown"}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Shares of right answers by kind, strength, box and instrument; groups, time, and calibration."""

    def share(chosen: Sequence[dict[str, Any]], of: Callable[[dict[str, Any]], bool] = named) -> list[float]:
        return [float(np.mean([of(r) for r in chosen])) if chosen else float("nan"), len(chosen)]

    singles = [r for r in rows if r["kind"] == "single"]
    numbers = [right for r in singles for right in r["parameters_right"]]
    sizes = [len(next((g for g in r["groups"] if g[0] == r["first"]), [1])) for r in singles if r["selected"]]
    return {
        **{f"right_{s}": share([r for r in singles if r["strength"] == s]) for s in STRENGTHS},
        "first_three": share(singles, lambda r: bool(set(r["truth"]) & set(r["first_three"]))),
        "none_right": share([r for r in rows if r["kind"] == "none"]),
        "outside_unknown": share([r for r in rows if r["kind"] == "outside"]),
        "unknown_family": share([r for r in rows if r["kind"] == "unknown"]),
        "unknown_place": share([r for r in rows if r["kind"] == "unknown"], lambda r: bool(r["place"])),
        "pairs_both": share([r for r in rows if r["kind"] == "pair"]),
        "triples_all": share([r for r in rows if r["kind"] == "triple"]),
        **{f"box {b}": share([r for r in rows if r["box"] == b]) for b in sorted({r["box"] for r in rows})},
        **{
            f"instrument {i}": share([r for r in rows if r["instrument"] == i])
            for i in sorted({r["instrument"] for r in rows})
        },
        "parameters_right": [float(np.mean(numbers)) if numbers else float("nan"), len(numbers)],
        "mean_group": float(np.mean(sizes)) if sizes else float("nan"),
        "median_seconds": float(np.median([r["seconds"] for r in rows])),
        "median_cpu_seconds": float(np.median([r["cpu_seconds"] for r in rows])),
        "reliability": reliability(singles),
        "log_loss": log_loss(singles),
    }


def reliability(rows: list[dict[str, Any]]) -> list[dict[str, float]]:
    """Stated probability of the first answer against how often it was right, in bins of probability."""
    table = []
    for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        inside = [r for r in rows if low <= r["probability"] < high and r["selected"]]
        if inside:
            right = [r["first"] in r["truth"] for r in inside]
            stated = float(np.mean([r["probability"] for r in inside]))
            table.append({"stated": stated, "right": float(np.mean(right)), "captures": len(inside)})
    return table


def log_loss(rows: list[dict[str, Any]]) -> float:
    """Mean of -log(probability stated for what came true, the first answer or any other), nats."""
    told = [r for r in rows if r["selected"]]
    right = [r["first"] in r["truth"] for r in told]
    stated = [r["probability"] if yes else 1 - r["probability"] for r, yes in zip(told, right, strict=True)]
    return float(-np.mean(np.log(np.maximum(stated, 1e-3)))) if told else float("nan")


def print_tables(rows: list[dict[str, Any]]) -> None:
    """The confusion table as it is, and the summary."""
    answers: dict[str, Counter[str]] = {}
    for row in rows:
        truth = "+".join(row["truth"]) or "none"
        answers.setdefault(truth, Counter())["+".join(row["selected"]) or "none"] += 1
    print("\ntruth -> answers")
    for truth, counts in sorted(answers.items()):
        print(f"  {truth:40} " + ", ".join(f"{name} {count}" for name, count in counts.most_common()))
    print("\nmeasure: share, of how many")
    for name, value in summary(rows).items():
        print(f"  {name:18} {value}")
