"""Causes that look alike in one capture, distinguished by a second one of the same box?

    python benchmarks/diagnosis/several_captures.py                      # all of them
    python benchmarks/diagnosis/several_captures.py crosstalk defocus    # some, by the true cause
    python benchmarks/diagnosis/several_captures.py --strength medium --seed 3

For each pair of look-alikes either one is hidden in a capture of 128 x 128 pixels, weakly, and the second capture
differs by what separates them: half the exposure, half the aperture, another place of the camera. Prints what the first
capture alone says and what both say. Exit code 1 if both do not name the true cause first.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from blind_diagnosis import random_effect
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.scenes.camera import Camera
from cboxlab.validation.compare import validate_capture
from cboxlab.validation.diagnose import Diagnosis, diagnose_validation
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture
from cboxlab.validation.synthetic.model_capture import photographed_scene
from cboxlab.validation.synthetic.strengths import scale_of

SIZE_PX = 128


def _half_exposure(camera: Camera, settings: CaptureSettings) -> tuple[Camera, CaptureSettings]:
    return camera, replace(settings, level=0.5 * settings.level)


def _half_aperture(camera: Camera, settings: CaptureSettings) -> tuple[Camera, CaptureSettings]:
    return camera, replace(settings, f_number=2 * settings.f_number)


def _elsewhere(camera: Camera, settings: CaptureSettings) -> tuple[Camera, CaptureSettings]:
    return replace(camera, position_mm=camera.position_mm + np.array([60.0, -40.0, 30.0])), settings


#: Pairs of look-alikes, and how the second capture differs.
PAIRS: tuple[tuple[str, str, Callable[..., tuple[Camera, CaptureSettings]]], ...] = (
    ("dark-offset", "veiling-glare", _half_exposure),
    ("crosstalk", "defocus", _half_aperture),
    ("reflectance-gradient", "wall-reflectance", _elsewhere),
    ("camera-pose", "lens-distortion", _elsewhere),
    ("nonlinearity", "shutter-offset", _half_exposure),
)


def _answer(diagnosis: Diagnosis) -> str:
    groups = "; ".join(" or ".join(group) for group in diagnosis.indistinguishable)
    return f"{', '.join(diagnosis.selected) or 'nothing'}{f' (not distinguished: {groups})' if groups else ''}"


def _case(truth: str, change: Callable[..., tuple[Camera, CaptureSettings]], strength: str, seed: int) -> bool:
    camera, settings = perturbed_camera(SIZE_PX, seed), CaptureSettings()
    scale = scale_of(Model(), camera, settings, seed)
    box, bands = photographed_scene(Model()), settings.band_ids
    effect = random_effect(truth, strength, np.random.default_rng(seed), scale, box, bands)
    if effect is None:
        print(f"{truth}: cannot be so strong", flush=True)
        return True
    validations = []
    with tempfile.TemporaryDirectory() as folder:
        for index, (seen_by, how) in enumerate([(camera, settings), change(camera, settings)]):
            path = Path(folder) / f"{index}"
            effect_there = effect.at_aperture(settings.f_number / how.f_number)
            effects: tuple[AppliedEffect, ...] = () if index and effect.effect.own_to_capture else (effect_there,)
            write_model_capture(path, Model(effects=effects), seen_by, how, seed + index, relative_error=2e-3)
            validations.append(validate_capture(load_capture(path), Model()))
        first, both = diagnose_validation(validations[0]), diagnose_validation(validations[0], further=validations[1:])
        if not both.selected and not both.further[0].adequate:
            # as the report advises
            both = diagnose_validation(validations[1], further=validations[:1])
    right = both.selected[:1] == (truth,)
    values = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in effect.values.items())
    print(f"{truth} ({values}): one capture {_answer(first)}; both {_answer(both)}; {both.further[0]}", flush=True)
    return right


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("causes", nargs="*", help="true causes; all where left out")
    parser.add_argument("--strength", default="weak")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    unknown = set(options.causes) - set(catalogue())
    if unknown:
        parser.error(f"no effect {', '.join(unknown)}")
    right = [
        _case(truth, change, options.strength, options.seed)
        for first, other, change in PAIRS
        for truth in (first, other)
        if not options.causes or truth in options.causes
    ]
    print(f"{sum(right)} of {len(right)} named first by both")
    sys.exit(0 if all(right) else 1)


if __name__ == "__main__":
    main()
