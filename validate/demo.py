"""The demo: the bundled capture against the published box step by step, then another camera's raw frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from cboxlab.render import variant
from cboxlab.render.sensor_cameras import load_camera

from .blocks import ReportSection
from .console import bar, say
from .diagnosis import diagnose
from .diagnosis_output import diagnosis_sections, path_steps, print_diagnosis, write_diagnosis
from .metrics import PathStep
from .model import Model, write_model
from .pipeline import Validation, validate, write_validation
from .plots import picture_row
from .raw_shots import RawShot, shoot, write_preview, write_shot
from .summary import print_validation
from .verdict import verdict

__all__ = ["DEMO_CAPTURE", "run_demo"]

#: The bundled capture; validate/data/README.md says how it was made.
DEMO_CAPTURE = Path(__file__).parent / "data" / "demo-capture"

#: Every so many nm of the render, 400 to 700 nm by 1 nm, go into the cube that the other camera photographs.
CUBE_STEP_NM = 10


def run_demo(out: Path, model: Model | None = None) -> None:
    """Validate the bundled capture, diagnose what the model lacks, photograph the render with another camera.

    model : the published box where None. Writes report.html, metrics.json, diagnosis.json, the final
    model.toml, maps/, raw.tif and raw.png into ``out``.
    """
    say(f"1. A capture ({DEMO_CAPTURE.name}): seven filters, darks, flats, a reference, surveyed points.")
    with bar("calibrating, rendering, comparing") as report:
        result = validate(DEMO_CAPTURE, model or Model(), report)
    _tell(result)
    print_validation(result)
    sections, path = _diagnosed(result, out)
    shot = _other_camera(result)
    write_validation(result, out, (*sections, _raw_section(shot)), path)
    write_shot(out / "raw.tif", shot)
    write_preview(out / "raw.png", shot)
    say(
        f"6. The rendered light at {1 + 300 // CUBE_STEP_NM} wavelengths, photographed by a simulated "
        f"{shot.camera.name} for {shot.exposure_s:.3g} s: raw mosaic raw.tif "
        f"({shot.counts.min()} to {shot.counts.max()} DN), demosaiced raw.png."
    )
    say(f"Open {out / 'report.html'} in a browser.")


def _diagnosed(result: Validation, out: Path) -> tuple[list[ReportSection], list[PathStep]]:
    """What is missing, told and written; the report's sections and path. Nothing where nothing can be compiled."""
    if result.rendered.predictor is None:
        say(f"5. What is missing cannot be found without LLVM: {variant.HINT}")
        return [], []
    say("5. What is missing? Every effect of the catalogue is tried, camera and lamp refitted with each.")
    with bar("diagnosing") as report:
        diagnosis = diagnose(result, report)
    print_diagnosis(diagnosis)
    write_diagnosis(out / "diagnosis.json", diagnosis)
    write_model(out / "model.toml", diagnosis.model)
    return diagnosis_sections(diagnosis), path_steps(diagnosis)


def _raw_section(shot: RawShot) -> ReportSection:
    counts = shot.counts / shot.camera.detector.full_scale_dn
    raw = np.repeat(np.rint(255 * counts).astype(np.uint8)[..., None], 3, axis=-1)
    return ReportSection(
        f"The same light in another camera: {shot.camera.name}",
        (
            f"The rendered light at {1 + 300 // CUBE_STEP_NM} wavelengths, exposed for {shot.exposure_s:.3g} s: "
            "what the sensor records behind its colour filter array, with its noise and rounding, and the "
            "picture developed from it.",
        ),
        (
            picture_row(
                {"Raw counts, one colour per pixel": raw, "Demosaiced, white balanced": shot.preview()}
            ),
        ),
    )


def _tell(result: Validation) -> None:
    """What happened at each step, in a line each."""
    calibration, fit, c = result.prepared.calibration, result.fit, result.comparison
    survey = calibration.camera_fit
    assert survey is not None
    camera = result.prepared.calibrated_camera
    place = ", ".join(f"{x:.1f}" for x in camera.position_mm)
    say(
        f"2. The camera that took it, from {int(survey.kept.sum())} surveyed points: at ({place}) mm, focal "
        f"length {camera.focal_length_px:.1f} px; reprojection rms {survey.reprojection_rms_px:.3f} px per "
        f"coordinate, stated noise {survey.point_sigma_px:.2f} px."
    )
    corners = np.concatenate([surface.vertices_mm for surface in result.prepared.scene.surfaces])
    moved = np.sqrt(np.nanmean((fit.camera.project(corners) - camera.project(corners)) ** 2))
    say(
        f"3. The model ({result.model.name}) rendered through it, down to "
        f"{c.render_sigma_over_sensor_sigma:.2f} of the sensor's noise; camera and lamp refitted within what "
        f"is known of them: {moved:.2f} px, lamp × {fit.lamp_scale:.4f} ± {fit.lamp_scale_sigma:.1g}."
    )
    say("4. Measured against rendered: " + " ".join(verdict(c).details))


def _other_camera(result: Validation) -> RawShot:
    """The rendered light as a Kodak DCS-200 would have recorded it from the same place."""
    image = result.image
    coarse = replace(
        image, spectra=image.spectra[:, ::CUBE_STEP_NM], wavelength_nm=image.wavelength_nm[::CUBE_STEP_NM]
    )
    return shoot(coarse.cube(), load_camera("dcs200"), seed=result.model.render.seed)
