"""The smallest effect that a capture shows, next to what its noise alone would allow, and what limits it.

    python benchmarks/diagnosis/floors.py                                  # a sound capture of our own, 128 x 128
    python benchmarks/diagnosis/floors.py --capture FOLDER --model M.toml  # another one; M should leave nothing

Strengths are chi-square per sample, to first order, camera and lamp fitted. For each effect, in the most visible of its
ways to act:

- noise alone: found in 90 % of captures at five standard deviations of noise, were the picture without errors.
- by size: what errors of the picture could gain.
- limit: the smaller one of that and of what is found in 90 % of captures with the picture's errors in the covariance.

``visible`` is the part of the effect's chi-square that the picture's errors leave; the number is how far from null the
effect's own is at the limit. blind_diagnosis.py measures the same by blind captures.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.model import Model
from cboxlab.rendering.model.model_file import load_model
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.compare import validate_capture
from cboxlab.validation.diagnose.evidence import Limit, least_gain_of, limit_of
from cboxlab.validation.diagnose.linearised_fit import linearised_fit
from cboxlab.validation.diagnose.stepwise import limits_of, signatures_of, tolerated_changes
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture
from cboxlab.validation.synthetic.varied import varied_settings

#: Standard deviations at which 90 % lie beyond five.
_FIVE_NINE_TIMES_IN_TEN = 6.2816


def limits(capture: Path, model: Model) -> tuple[float, list[tuple[Limit, float]]]:
    """The strength that noise alone would allow; each effect's limit, and the strength that size alone asks for."""
    validation = validate_capture(load_capture(capture), model)
    plain = linearised_fit(validation.prepared, validation.rendered, model.effects)
    signatures = signatures_of(plain, model.effects, model.render, NO_PROGRESS)
    counting, count = plain.counting_errors(tolerated_changes(plain, signatures)).model, plain.model.count
    trials = [(signature, limit_of(signature, plain.model, counting, plain.scale)) for signature in signatures]
    sizes: dict[str, float] = {}
    for signature, limit in trials:
        if limit:
            size = least_gain_of(plain.model.whiten_used(plain.scale * signature.changes[0]), plain.model) / count
            sizes[limit.effect] = min(size, sizes.get(limit.effect, size))
    limited = limits_of(plain, counting, [(signature, limit) for signature, limit in trials if limit])
    return _FIVE_NINE_TIMES_IN_TEN**2 / count, [(limit, sizes[limit.effect]) for limit in limited]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--seed", type=int, default=7000)
    options = parser.parse_args()
    model = load_model(options.model) if options.model else Model()
    with tempfile.TemporaryDirectory() as folder:
        capture = options.capture
        if capture is None:
            capture = Path(folder) / "capture"
            write_model_capture(
                capture,
                model,
                perturbed_camera(options.size, options.seed),
                varied_settings(options.seed),
                options.seed,
                relative_error=2e-3,
            )
        noise, rows = limits(capture, model)
    print(f"noise alone: {noise:.5f}")
    print(f"{'effect':22}{'by size':>10}{'limit':>10}{'visible':>9}  limited by          number at the limit")
    for limit, size in rows:
        print(
            f"{limit.effect:22}{size:10.5f}{limit.chi2_per_sample:10.5f}{limit.visible:9.2f}  "
            f"{'errors counted' if limit.beside_errors else 'size':20}{limit.parameter} {limit.distance:.3g}"
        )


if __name__ == "__main__":
    main()
