"""Demonstration: validation and diagnosis of the bundled capture, and a raw frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.device import variant
from cboxlab.rendering.model import Model, write_model

from ...api import DiagnosisResult, RawFrame, ValidationResult, simulate, write_manifest
from ...compare import Predicted, Validation, validate_capture
from ...diagnose import Diagnosis, diagnose_validation
from ...report import ReportSection, picture_row, report_verdict, write_diagnosis, write_validation
from .console import bar, print_result, say

__all__ = ["DEMO_CAPTURE", "run_demo"]

#: Folder of the bundled capture; validate/data/README.md says how it was made.
DEMO_CAPTURE = Path(__file__).parents[2] / "data" / "demo-capture"

#: Wavelength step of the cube for the other camera, nm; the rendering has 400 to 700 nm by 1 nm.
CUBE_STEP_NM = 10


def run_demo(out: Path, model: Model | None = None) -> tuple[Validation, Diagnosis | None]:
    """Validate and diagnose the bundled capture, and simulate a raw frame of another camera.

    Parameters
    ----------
    out
        Folder for report.html, metrics.json, diagnosis.json, the final model.toml, maps/, raw.tif, raw.png and
        manifest.json.
    model
        Model to compare; None for the published box.

    Returns
    -------
    validation
        The validation.
    diagnosis
        The diagnosis; None without a compiled variant.
    """
    say(f"1. Capture ({DEMO_CAPTURE.name}): seven filters, darks, flats, a reference, surveyed points.")
    with bar("calibrating, rendering, comparing") as report:
        result = validate_capture(load_capture(DEMO_CAPTURE), model or Model(), report)
    _print_steps(result)
    validation = ValidationResult(result)
    print_result(validation.lines(), validation.tables())
    diagnosis = _diagnosed(result)
    shot = _other_camera(result)
    written = [*write_validation(result, out, diagnosis, (_raw_section(shot),)), *shot.write(out)]
    if diagnosis is not None:
        written += [out / "diagnosis.json", out / "model.toml"]
        write_diagnosis(written[-2], diagnosis)
        write_model(written[-1], diagnosis.model)
    write_manifest(out, written, [DEMO_CAPTURE], seed=result.model.render.seed)
    say(
        f"6. Simulated {shot.camera.name}, with the rendered light at {1 + 300 // CUBE_STEP_NM} wavelengths and an "
        f"exposure of {shot.exposure_s:.3g} s: raw mosaic raw.tif ({shot.counts.min()} to {shot.counts.max()} DN), "
        "demosaiced raw.png."
    )
    say(f"Open {out / 'report.html'} in a browser.")
    return result, diagnosis


def _diagnosed(result: Validation) -> Diagnosis | None:
    """Print and return the diagnosis; None without a compiled variant."""
    if not isinstance(result.rendered, Predicted):
        say(f"5. No diagnosis without LLVM: {variant.HINT}")
        return None
    say("5. Diagnosis: the program fits every effect of the catalogue, with camera and lamp.")
    with bar("diagnosing") as report:
        diagnosis = diagnose_validation(result, report)
    outcome = DiagnosisResult(diagnosis, result)
    print_result(outcome.lines(), outcome.tables())
    return diagnosis


def _raw_section(shot: RawFrame) -> ReportSection:
    """Section of the report on the raw frame."""
    counts = shot.counts / shot.camera.detector.full_scale_dn
    raw = np.repeat(np.rint(255 * counts).astype(np.uint8)[..., None], 3, axis=-1)
    return ReportSection(
        f"The same light in another camera: {shot.camera.name}",
        (
            f"Simulated exposure of {shot.exposure_s:.3g} s, from the rendered light at {1 + 300 // CUBE_STEP_NM} "
            "wavelengths: raw counts with the colour filter array, noise and rounding, and the picture developed from "
            "them.",
        ),
        (picture_row({"Raw counts, one colour per pixel": raw, "Demosaiced, white balanced": shot.preview()}),),
    )


def _print_steps(result: Validation) -> None:
    """Print one paragraph for each step."""
    survey, fit, c = result.prepared.camera_fit, result.fit, result.comparison
    camera = result.prepared.calibrated_camera
    position = ", ".join(f"{x:.1f}" for x in camera.position_mm)
    say(
        f"2. Camera, from {int(survey.in_use.sum())} surveyed points: position ({position}) mm, focal length "
        f"{camera.focal_length_px:.1f} px. The reprojection rms is {survey.reprojection_rms_px:.3f} px per coordinate; "
        f"the stated noise is {survey.point_sigma_px:.2f} px."
    )
    moved = camera.motion_px(fit.camera, result.prepared.scene.corners_mm)
    say(
        f"3. Rendering of the model ({result.model.name}). Its noise is {c.render_sigma_over_sensor_sigma:.2f} times "
        f"the sensor's. Camera and lamp were fitted again with their priors: corners moved {moved:.2f} px rms, "
        f"lamp power × {fit.lamp_scale:.4f} ± {fit.lamp_scale_sigma:.1g}."
    )
    say("4. Comparison: " + " ".join(report_verdict(c).details))


def _other_camera(result: Validation) -> RawFrame:
    """Simulated raw frame of the rendered light by a Kodak DCS-200 at the same position."""
    image = result.image
    coarse = replace(image, spectra=image.spectra[:, ::CUBE_STEP_NM], wavelength_nm=image.wavelength_nm[::CUBE_STEP_NM])
    cube = coarse.cube()
    # the camera refuses negative light; the mean over batches has no standard error by which to judge it
    return simulate(cube.assign(radiance=cube.radiance.clip(min=0)), "dcs200", seed=result.model.render.seed)
