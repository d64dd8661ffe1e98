"""The smallest effect that a capture shows, beside what its noise alone would allow, and what limits it.

    python benchmarks/floors.py                                  # a sound capture of our own, 128 x 128
    python benchmarks/floors.py --capture FOLDER --model M.toml  # another one; M should leave nothing

Strengths are chi-square per sample, to first order, camera and lamp fitted. For each effect, in the most visible of its
ways to act:

- noise: found in 90 % of captures at five standard deviations of noise, were the picture without errors.
- size: by size alone, since errors of the picture may gain as much.
- beside errors: found in 90 % of captures where the picture's errors are counted in the covariance.

The limit is the smaller one of the last two; the number is how far from null the effect's own is there. ``left`` is the
part of the effect's chi-square that the picture's errors leave. blind_diagnosis.py measures the same by blind captures.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from cboxlab.scenes.progress import QUIET
from cboxlab.validate.compare import validate
from cboxlab.validate.diagnose.evidence import CERTAIN, least_gain_of, square
from cboxlab.validate.diagnose.linearised_fit import linearised_fit
from cboxlab.validate.diagnose.stepwise import beside_errors, signatures_of, small_errors
from cboxlab.validate.model import Model
from cboxlab.validate.model.model_file import load_model
from cboxlab.validate.synthetic import perturbed_camera, write_model_capture
from cboxlab.validate.synthetic.varied import varied_settings

#: Standard deviations beyond a limit at which 90 % lie above it.
_NINE_OF_TEN = 1.2816


def limits(capture: Path, model: Model) -> list[dict[str, object]]:
    """One row an effect: its name, the limits, and the number at the smallest."""
    validation = validate(capture, model)
    plain = linearised_fit(validation.prepared, validation.rendered, model.effects)
    known = signatures_of(plain, model.effects, model.render, QUIET)
    counting = plain.counting_errors(small_errors(plain, known))
    count, best = plain.model.count, {}
    for one in known:
        if one.changes is None:
            continue
        change = plain.scale * one.changes[0]
        whole, left = (square(fit.model.whiten_used(change)) for fit in (plain, counting))
        if whole == 0:
            continue
        noise = (5 + _NINE_OF_TEN) ** 2 / count
        size = least_gain_of(plain.model.whiten_used(change), plain.model) / count
        certain = max((CERTAIN**0.5 + _NINE_OF_TEN) ** 2, least_gain_of(change, counting.model))
        beside = certain / count * whole / left if beside_errors(one, plain.model, counting.model) else np.inf
        limit = min(size, beside)
        name, number = one.hypothesis.effect.id, abs(one.steps[0]) * float(np.sqrt(limit * count / whole))
        if name not in best or limit < best[name]["limit"]:
            best[name] = {
                "effect": name, "way": dict(one.hypothesis.fixed), "noise": noise, "size": size,
                "beside errors": beside, "limit": limit, "left": left / whole, "number": number,
                "of": one.hypothesis.free[0].name if one.hypothesis.free else "",
            }  # fmt: skip
    return sorted(best.values(), key=lambda row: row["limit"])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--seed", type=int, default=7000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    model = load_model(options.model) if options.model else Model()
    with tempfile.TemporaryDirectory() as folder:
        capture = options.capture
        if capture is None:
            capture = Path(folder) / "capture"
            write_model_capture(
                capture, model, perturbed_camera(options.size, options.seed), varied_settings(options.seed),
                options.seed, relative_error=2e-3,
            )  # fmt: skip
        rows = limits(capture, model)
    if options.json:
        print(json.dumps(rows, default=str))
        return
    print(f"{'effect':22}{'noise':>10}{'size':>10}{'beside errors':>15}{'left':>7}  number at the limit")
    for row in rows:
        print(
            f"{row['effect']:22}{row['noise']:10.5f}{row['size']:10.5f}{row['beside errors']:15.5f}"
            f"{row['left']:7.2f}  {row['of']} {row['number']:.3g}"
        )


if __name__ == "__main__":
    main()
