"""Learn the odds of the families of explanations from simulated causes, and report how far they can be believed.

The first part simulates excesses (`simulated_excess`) and notes what every family's best form shows, a line each in
--results; it goes on where it stopped. The second part fits the weights of a conditional logit with a ridge. It leaves
each cause out in turn, and of sound captures each laboratory, and prints the confusion matrix and the reliability of
what was left out. Probabilities are means over what the weights may be, a normal distribution about the fit. With
--write the weights and their covariance become the table of the package.
"""

from __future__ import annotations

import argparse
import datetime
import json
import pickle
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cboxlab.validation.diagnose.explain import NONE, SOUND, Registration, Rival, explain
from cboxlab.validation.diagnose.explain.odds import FEATURES, design, expected_shares, features
from excess_laboratory import BASES, Laboratory, laboratory
from scipy.optimize import minimize
from simulated_excess import CAUSES, excess_of

#: Side of the pictures, px, by laboratory in turn.
SIZES_PX = (32, 40, 48)

#: Excess of chi2 per sample by a cause within which captures are taken: seen at all, and not absurd.
LEAST, MOST = 0.03, 60.0

#: Ridge of the weights: standard deviation 3 of features, 1 of offsets of families.
RIDGE = {"weights": 1 / 9, "offsets": 1.0}

TABLE = Path(__file__).parents[2] / "validate" / "diagnose" / "explain" / "data" / "odds.json"

Row = Mapping[str, Any]


def laboratories(folder: Path, count: int) -> Iterator[Laboratory]:
    """Laboratories of several sizes and flaws, kept in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(1, count + 1):
        path = folder / f"laboratory-{seed}.pickle"
        if not path.exists():
            path.write_bytes(pickle.dumps(laboratory(seed, SIZES_PX[seed % 3], BASES[seed % len(BASES)])))
        yield pickle.loads(path.read_bytes())


def simulate(results: Path, folder: Path, count: int, rounds: int) -> None:
    """Append what is missing of all causes in turn, each in one of the laboratories a round."""
    finished = {(row["cause"], row["seed"]) for row in _rows(results)}
    labs = list(laboratories(folder, count))
    with results.open("a", encoding="utf-8") as out:
        for seed in range(100, 100 + rounds):
            for index, name in enumerate(CAUSES):
                lab = labs[(index + 3 * seed) % len(labs)]
                if (name, seed) in finished:
                    continue
                truth, data = excess_of(name, seed, lab)
                excess = (data.chi2 - lab.data.chi2) / data.count
                if truth.family != SOUND and not LEAST < excess < MOST:
                    continue
                explanation = explain(data)
                row = {
                    "laboratory": lab.seed,
                    "base": lab.base,
                    "cause": name,
                    "seed": seed,
                    "truth": truth.family,
                    "family": explanation.family,
                    "told": explanation.told_apart,
                    "rivals": [asdict(rival) for rival in explanation.rivals],
                    "registration": asdict(explanation.registration),
                }
                out.write(json.dumps(row, default=float) + "\n")
                out.flush()


def _rows(results: Path) -> list[Row]:
    if not results.exists():
        return []
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]


class Sample:
    """One capture: outcomes, their features, and which of them is true."""

    def __init__(self, row: Row) -> None:
        rivals = [Rival(**rival) for rival in row["rivals"]]
        self.cause, self.truth, self.judged = row["cause"], row["truth"], row["family"]
        #: What is left out together: a cause, or a laboratory without one.
        self.group = f"{SOUND} {row['laboratory']}" if self.truth == SOUND else self.cause
        self.outcomes, self.table = features(rivals, Registration(**row["registration"]))
        self.true = self.outcomes.index(self.truth)


class Fit(NamedTuple):
    """Weights of the features, then offsets of the families, and their covariance."""

    weights: np.ndarray
    covariance: np.ndarray


def fit(samples: Sequence[Sample], names: Sequence[str]) -> Fit:
    """Weights by penalised likelihood; the covariance by its curvature."""
    counts = Counter(sample.cause for sample in samples)
    designs = [(design(s.outcomes, s.table, names), s.true, 1 / counts[s.cause] ** 0.5) for s in samples]
    ridge = np.array([RIDGE["weights"]] * len(FEATURES) + [RIDGE["offsets"]] * len(names))

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = 0.5 * float(ridge @ weights**2), ridge * weights
        for columns, true, importance in designs:
            utility = columns @ weights
            share = np.exp(utility - utility.max())
            share /= share.sum()
            value -= importance * float(np.log(share[true]))
            slope = slope + importance * (share @ columns - columns[true])
        return value, slope

    weights = np.asarray(minimize(loss, np.zeros(len(ridge)), jac=True, method="L-BFGS-B").x)
    curvature = np.diag(ridge)
    for columns, _, importance in designs:
        utility = columns @ weights
        share = np.exp(utility - utility.max())
        share /= share.sum()
        mean = share @ columns
        curvature = curvature + importance * (columns.T * share @ columns - np.outer(mean, mean))
    return Fit(weights, np.linalg.inv(curvature))


def shares(sample: Sample, fitted: Fit, names: Sequence[str]) -> np.ndarray:
    """Probability of each outcome of a sample."""
    columns = design(sample.outcomes, sample.table, names)
    return expected_shares(columns @ fitted.weights, columns @ fitted.covariance @ columns.T)


def left_out(samples: Sequence[Sample], names: Sequence[str]) -> list[tuple[Sample, np.ndarray]]:
    """Every sample with its probabilities by a fit without its cause, or without its laboratory where sound."""
    answers = []
    for group in sorted({sample.group for sample in samples}):
        fitted = fit([sample for sample in samples if sample.group != group], names)
        answers += [(sample, shares(sample, fitted, names)) for sample in samples if sample.group == group]
    return answers


def _when_likely(answers: Sequence[tuple[Sample, np.ndarray]], least: float) -> str:
    """Right and wrong families where only those of a least probability are named."""
    counts: Counter[str] = Counter()
    for sample, share in answers:
        likely = dict(zip(sample.outcomes, share, strict=True)).get(sample.judged, 1.0) >= least
        answer = sample.judged if likely else NONE
        truth = NONE if sample.truth == SOUND else sample.truth
        kind = sample.truth if sample.truth in (NONE, SOUND) else "families"
        counts[kind] += 1
        counts[f"{kind} right"] += answer == truth
        counts[f"{kind} wrong"] += answer not in (truth, NONE)
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))


def report(answers: Sequence[tuple[Sample, np.ndarray]]) -> None:
    """Rates of right answers, confusion, and reliability, of causes left out."""
    best = [(sample, sample.outcomes[int(np.argmax(share))], float(share.max())) for sample, share in answers]
    for kind, members in (
        ("families", [a for a in best if a[0].truth not in (NONE, SOUND)]),
        ("none of these", [a for a in best if a[0].truth == NONE]),
        ("sound", [a for a in best if a[0].truth == SOUND]),
    ):
        learnt = sum(sample.truth == answer for sample, answer, _ in members)
        truth = {SOUND: NONE}
        by_rule = sum(truth.get(sample.truth, sample.truth) == sample.judged for sample, _, _ in members)
        print(f"{kind}: {learnt} of {len(members)} by the learnt odds, {by_rule} by the largest evidence that holds")
    confusion = Counter((sample.truth, answer) for sample, answer, _ in best)
    print("\n| truth | answers |\n|---|---|")
    for truth_name in sorted({sample.truth for sample, *_ in best}):
        row = sorted(((n, a) for (t, a), n in confusion.items() if t == truth_name), reverse=True)
        print(f"| {truth_name} | {', '.join(f'{answer} {n}' for n, answer in row)} |")
    print("\n| probability of the answer | captures | mean probability | right |\n|---|---|---|---|")
    for low, high in ((0, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.9), (0.9, 0.97), (0.97, 1.01)):
        inside = [(s.truth == a, p) for s, a, p in best if low <= p < high]
        if inside:
            right, mean = np.mean([r for r, _ in inside]), np.mean([p for _, p in inside])
            print(f"| {low:g} to {min(high, 1):g} | {len(inside)} | {mean:.2f} | {right:.2f} |")
    loss = -np.mean([np.log(share[sample.true]) for sample, share in answers])
    for least in (0.0, 0.5, 0.75):
        print(f"\nnamed from a probability of {least:g}: {_when_likely(answers, least)}")
    print(f"\nmean log loss {loss:.3f}, of causes left out")


def main() -> None:
    """Simulate, fit, report; write the table where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, default=Path("families.jsonl"))
    parser.add_argument("--folder", type=Path, default=Path("laboratories"), help="folder of the laboratories")
    parser.add_argument("--laboratories", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=0, help="captures of each cause; 0 simulates nothing")
    parser.add_argument("--write", action="store_true", help="replace the table of the package")
    options = parser.parse_args()
    if options.rounds:
        simulate(options.results, options.folder, options.laboratories, options.rounds)
    samples = [Sample(row) for row in _rows(options.results)]
    names = sorted({outcome for sample in samples for outcome in sample.outcomes} - {NONE, SOUND})
    report(left_out(samples, names))
    weights, covariance = fit(samples, names)
    table = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "captures": len(samples),
        "causes": len({sample.cause for sample in samples}),
        "weights": {name: round(float(w), 4) for name, w in zip(FEATURES, weights, strict=False)},
        "offsets": {name: round(float(w), 4) for name, w in zip(names, weights[len(FEATURES) :], strict=True)},
        "covariance": [[round(float(c), 4) for c in row[: i + 1]] for i, row in enumerate(covariance)],
    }
    text = re.sub(r"(?<=[\d\[,])\s+(?=[-\d\]])", " ", json.dumps(table, indent=1)) + "\n"
    print(text)
    if options.write:
        TABLE.parent.mkdir(exist_ok=True)
        TABLE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
