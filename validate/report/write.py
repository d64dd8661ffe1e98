"""Files of a validation: report.html, metrics.json and the maps."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cboxlab.rendering.model import model_text
from cboxlab.utils.files import origin, this_command

from ..compare import Failure, Validation, failures, write_maps
from .bands import named_bands
from .blocks import ReportSection, Story
from .metrics import PathStep, ValidationFacts, metrics, write_metrics
from .page import ReportInputs, build_report
from .table_sections import parts_section
from .viewer import viewer_data

if TYPE_CHECKING:
    from ..diagnose import Diagnosis

__all__ = ["validation_record", "write_validation"]

#: Packages whose versions can change a figure.
_PACKAGES = (
    "cboxlab",
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "colour-science",
)


def _assumptions(result: Validation) -> list[str]:
    """Assumptions of a validation, one text each."""
    prepared, fit = result.prepared, result.fit
    sigma = prepared.lamp_sigma
    lamp = (
        f"within its stated {100 * sigma:.2g} % (one standard deviation)"
        if sigma
        else "freely: no uncertainty is stated"
    )
    expected = prepared.expected_camera(result.model.effects)
    moved = expected.motion_px(fit.camera, prepared.scene.corners_mm)
    bounces = result.model.render.max_bounces
    light = "All interreflection is included" if bounces is None else f"Only {bounces} reflections are included"
    effects = ", ".join(effect.id for effect in result.model.effects) or "none"
    lamps = prepared.scene.lamps
    several, reflecting = len(lamps) > 1, any(lamp.reflects for lamp in lamps)
    emitters = f"The {len(lamps)} lamps are" if several else "The lamp is"
    reflects = "as the scene states" if reflecting else "nothing"
    external = prepared.picture
    error = "the standard error of the rendering"
    if external is not None and external.estimated:
        error = f"the scatter of neighbouring pixels of {external.path.name}, which states no standard error"
    materials = prepared.complete.materials.values()
    special = [f"{m.name} ({m.bsdf['type'] if m.bsdf else 'a texture'})" for m in materials if not m.lambertian]
    paints = "Materials are Lambertian" + (f" but for {', '.join(special)}" if special else "")
    air = "The air is clear" if prepared.complete.medium is None else "The scene's medium fills the air"
    return [
        f"Scene: {prepared.scene.name}. The following holds unless an effect below changes it. {paints}. {emitters} "
        f"uniform and Lambertian, and {'reflect' if several else 'reflects'} {reflects}. {air}, and the front is open "
        "and dark.",
        f"Effects in the model: {effects}.",
        f"The lamp's spectrum is that of the capture. Its power was fitted {lamp}."
        if prepared.free_scale is None or prepared.free_scale.absolute
        else "The lamp's spectrum is that of the capture.",
        *prepared.unknown_sentences,
        "The camera was fitted to the surveyed points, then refitted to the picture with the survey's covariance as "
        f"prior. The refit moved the box's corners by {moved:.2f} px (rms per coordinate).",
        f"{light}. All results include {error}.",
        "Measured and rendered XYZ use the same filter weights. Colour differences do not include the error of the "
        "weights relative to the CIE functions, which the section on the weights shows.",
    ]


def _run(result: Validation, failed: Sequence[Failure], path: Sequence[PathStep]) -> ValidationFacts:
    """Data of a validation besides the comparison."""
    prepared, fit = result.prepared, result.fit
    lamp_is_free = prepared.free_scale is not None and not prepared.free_scale.absolute
    return ValidationFacts(
        capture=prepared.calibration.capture.manifest.name or prepared.calibration.capture.folder.name,
        model=result.model.name,
        version=version("cboxlab"),
        camera=fit.camera,
        calibrated_camera=prepared.calibrated_camera,
        reprojection_rms_px=prepared.camera_fit.reprojection_rms_px,
        lamp_scale=float("nan") if lamp_is_free else fit.lamp_scale,
        lamp_scale_sigma=float("nan") if lamp_is_free else fit.lamp_scale_sigma,
        lamp_scale_prior_sigma=prepared.lamp_sigma if prepared.lamp_sigma is not None else float("nan"),
        path=path,
        failures=failed,
        free_scale=prepared.free_scale,
    )


def _another_box(result: Validation) -> list[str]:
    """A warning where a capture is compared with another packaged scene than the one it states."""
    scene, origin = result.prepared.calibration.capture.manifest.scene, result.model.scene.origin
    if scene is None or origin is None or not origin.packaged or origin.reference == scene:
        return []
    return [f"The capture states the scene '{scene}', but the model has '{origin.reference}'."]


def _provenance(result: Validation) -> list[tuple[str, str]]:
    """Command, date, versions and seeds of a validation, (name, value)."""
    manifest = result.prepared.calibration.capture
    settings = result.model.render
    return [
        ("command", this_command()),
        ("date", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"),
        ("capture", manifest.manifest.name or manifest.folder.name),
        ("model", f"{result.model.name}; effects {', '.join(e.id for e in result.model.effects) or 'none'}"),
        ("rendering seed", str(settings.seed)),
        ("seed of the noise in expected ΔE", "0"),
        ("requested rendering noise", f"{settings.noise:g} of the sensor's"),
        ("time of the validation", f"{result.seconds:.0f} s"),
        ("versions", ", ".join(f"{package} {version(package)}" for package in _PACKAGES)),
        ("Python and machine", f"{platform.python_version()}, {platform.system()} {platform.machine()}"),
    ]


def validation_record(result: Validation) -> dict[str, Any]:
    """Content of metrics.json.

    Parameters
    ----------
    result
        The validation.

    Returns
    -------
    dict
        Plain values.
    """
    return metrics(result.comparison, _run(result, failures(result)[1], ()))


def write_validation(
    result: Validation,
    folder: Path,
    diagnosis: Diagnosis | None = None,
    sections: Sequence[ReportSection] = (),
) -> tuple[Path, ...]:
    """Write report.html, metrics.json and the maps.

    Parameters
    ----------
    result
        The validation.
    folder
        Folder for the files.
    diagnosis
        Diagnosis, for the chapters on causes and the path of models; None without one.
    sections
        Further sections of the report, folded.

    Returns
    -------
    tuple
        Paths of the report, of the metrics, and of the folder of maps.
    """
    prepared, c = result.prepared, result.comparison
    calibration = prepared.calibration
    subsets, failed = failures(result)
    steps: list[PathStep] = []
    chapters: Story | None = None
    layers: list[dict[str, Any]] = []
    if diagnosis is not None:
        from .diagnosis import path_steps  # slow to import, and only needed here
        from .story import signature_layers, story

        steps, layers = path_steps(diagnosis), signature_layers(diagnosis)
        chapters = story(diagnosis, named_bands(c.bands, prepared.responses))
    run = _run(result, failed, steps)
    report, figures, maps = folder / "report.html", folder / "metrics.json", folder / "maps"
    settings = result.model.render
    remarks = ReportSection("Remarks of the calibration", steps=calibration.notes)
    write_maps(maps, c, origin(capture=run.capture, model=model_text(result.model), seed=str(settings.seed)))
    write_metrics(figures, c, run)
    build_report(
        report,
        ReportInputs(
            c,
            run,
            _assumptions(result),
            weights=prepared.weights,
            responses=prepared.responses,
            story=chapters,
            viewer=viewer_data(result, layers),
            sections=(parts_section(c, subsets), *sections, remarks),
            further_warnings=_another_box(result),
            suspicions=calibration.suspicions,
            provenance=_provenance(result),
        ),
    )
    return report, figures, maps
