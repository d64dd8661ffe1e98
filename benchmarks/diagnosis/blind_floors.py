"""Whether effects are found at the size from which a report of a sound capture says that they would have been.

A sound capture is diagnosed; its report states for each effect the smallest size that is found in nine of ten captures
like it. Each effect is then hidden at that size in a new capture, whose noise is drawn again, and diagnosed; those
that are missed, at larger and larger sizes. Laboratories, boxes and instruments are those of blind_diagnosis.py.
Finished captures are kept in --results (JSON lines), so that an interrupted run goes on where it stopped, with the
same code only; --part K/N does a share of the effects.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from blind_diagnosis import Case, code_state, laboratory, write_capture
from blind_places import BOXES, INSTRUMENTS
from blind_scores import with_groups
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.validation.compare.pipeline import validate_capture
from cboxlab.validation.diagnose.diagnosis import Diagnosis, diagnose_validation
from cboxlab.validation.diagnose.evidence import Limit
from scipy import stats

#: Factors on the stated size that are tried, one after the other until the effect is found.
_FACTORS = (1.0, 1.5, 2.5)


def hidden(limit: Mapping[str, Any], factor: float, generator: np.random.Generator) -> AppliedEffect | None:
    """An effect at a factor times its stated size, to either side of null where its bounds allow both; None beyond."""
    effect = catalogue()[limit["effect"]]
    values = {p.name: p.null for p in effect.parameters if p.null is not None} | limit["choices"]
    (number,) = (p for p in effect.parameters if p.name == limit["parameter"])
    low, high = number.coordinate_bounds
    ends = [number.null_coordinate + sign * factor * limit["distance"] for sign in (-1, 1)]
    possible = [end for end in ends if low <= end <= high]
    if not possible:
        return None
    values[number.name] = number.from_coordinate(float(generator.choice(possible)))
    return AppliedEffect(effect, values)


def diagnosed(case: Case, effects: tuple[AppliedEffect, ...]) -> Diagnosis:
    """The diagnosis of a capture with these effects."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "capture"
        write_capture(path, case, effects)
        model = laboratory(case.laboratory, case.box, case.instrument).model
        return diagnose_validation(validate_capture(load_capture(path), model))


def limit_record(limit: Limit) -> dict[str, Any]:
    """What a report states of an effect that it did not find."""
    names = ("effect", "parameter", "unit", "distance", "chi2_per_sample", "visible", "beside_errors")
    return {"choices": dict(limit.choices), **{name: getattr(limit, name) for name in names}}


def print_table(rows: list[dict[str, Any]]) -> None:
    """Each effect's smallest size that was found, and the share found at the stated one with its 95 % interval."""
    print(f"{'effect':22}{'stated':>11}  {'':22}{'limited by':16}found at")
    for limit in next(row["limits"] for row in rows if not row["effect"]):
        results_by_factor = {r["factor"]: r["found"] for r in rows if r["effect"] == limit["effect"]}
        if results_by_factor:
            smallest = next(
                (f"{factor:g} times" for factor in sorted(results_by_factor) if results_by_factor[factor]),
                "none of these",
            )
            by = "errors counted" if limit["beside_errors"] else "size"
            print(f"{limit['effect']:22}{limit['distance']:11.3g}  {limit['parameter']:22}{by:16}{smallest}")
    for factor in _FACTORS:
        trials = [
            any(r["found"] and r["factor"] <= factor for r in rows if r["effect"] == name)
            for name in sorted({r["effect"] for r in rows if r["effect"]})
        ]
        interval = stats.binomtest(sum(trials), len(trials)).proportion_ci(method="wilson")
        print(f"found at {factor:g} times: {sum(trials)} of {len(trials)} ({interval.low:.0%} to {interval.high:.0%})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--box", default="published", choices=[*BOXES])
    parser.add_argument("--instrument", default="plain", choices=[*INSTRUMENTS])
    parser.add_argument("--first-seed", type=int, default=600)
    parser.add_argument("--part", default="1/1")
    parser.add_argument("--results", type=Path, default=Path("blind-floors.jsonl"))
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.results.read_text().splitlines()] if options.results.exists() else []
    code = code_state()
    if others := {row["code"] for row in rows} - {code}:
        sys.exit(f"{options.results}: made by other code ({', '.join(others)}); name another --results")

    def keep(**row: Any) -> None:
        rows.append({**row, "code": code})
        with options.results.open("a") as lines:
            lines.write(json.dumps(rows[-1], default=str) + "\n")

    def case(number: int, *names: str) -> Case:
        seed = options.first_seed + number
        return Case("single", names, "", seed, options.box, options.instrument)

    if not any(not row["effect"] for row in rows):
        sound = diagnosed(case(0), ())
        if sound.selected:
            sys.exit(f"the sound capture shows {', '.join(sound.selected)}")
        keep(effect="", limits=[limit_record(limit) for limit in sound.limits])
    part, parts = (int(n) for n in options.part.split("/"))
    for index, limit in enumerate(next(row["limits"] for row in rows if not row["effect"])):
        if index % parts != part - 1:
            continue
        name, effect_case = limit["effect"], case(1 + index, limit["effect"])
        generator = np.random.default_rng(effect_case.seed)
        for factor in _FACTORS:
            if any(r["effect"] == name and (r["found"] or r["factor"] == factor) for r in rows):
                continue
            if (effect := hidden(limit, factor, generator)) is None:
                break
            diagnosis = diagnosed(effect_case, (effect,))
            answer = {
                "selected": [*diagnosis.selected],
                "groups": [[*g] for g in diagnosis.indistinguishable],
            }
            is_found = name in with_groups(answer, diagnosis.selected[:1])
            keep(effect=name, factor=factor, values=dict(effect.values), found=is_found, **answer)
            print(f"{name} at {factor:g} times: {', '.join(diagnosis.selected) or 'adequate'}", flush=True)
    print_table(rows)


if __name__ == "__main__":
    main()
