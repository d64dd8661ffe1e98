"""``cboxlab.calibrate``: everything that a capture says about its camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.calibration.result import Calibration, calibration_record, write_calibration
from cboxlab.calibration.result import calibrate as calibrated

from ..capture_checks import with_scene_checks
from .inputs import as_capture
from .result import Result

__all__ = ["CalibrationResult", "calibrate"]


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult(Result):
    """calibration : camera, noise, response, filter weights and absolute scale as objects."""

    calibration: Calibration

    def to_dict(self) -> dict[str, Any]:
        """The content of calibration.json."""
        return calibration_record(self.calibration)

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """calibration.json, plots, xyz.nc and patches.csv, as far as the capture allows them."""
        return write_calibration(self.calibration, Path(folder))

    def lines(self) -> list[str]:
        """Camera, noise and scale in a line each, then suspicions and notes."""
        found = self.calibration
        camera, fit, noise = found.camera, found.camera_fit, found.noise
        lines = [f"Calibration of {found.capture.manifest.name or found.capture.folder.name}"]
        if camera is not None and fit is not None:
            place = ", ".join(f"{x:.1f}" for x in camera.position_mm)
            lines.append(
                f"camera at ({place}) mm, focal length {camera.focal_length_px:.1f} px; reprojection rms "
                f"{fit.reprojection_rms_px:.3f} px"
            )
        gain = _with_sigma(noise.gain_e_per_dn, noise.gain_sigma, "e-/DN")
        read = _with_sigma(noise.read_noise_e, noise.read_noise_sigma, "e-")
        lines.append(f"gain {gain}, read noise {read}")
        if found.radiometry.constant is not None:
            lines.append(f"absolute scale C = {found.radiometry.constant:.5g} mm² m² DN/e-")
        lines += [f"suspicion: {suspicion}" for suspicion in found.suspicions]
        return lines + [f"note: {note}" for note in found.notes]


def _with_sigma(value: float | None, sigma: float | None, unit: str) -> str:
    if value is None or not np.isfinite(value):
        return "not known"
    return f"{value:.4g} {unit}" if sigma is None else f"{value:.4g} ± {sigma:.1g} {unit}"


def calibrate(capture: Capture | str | Path, *, reference_uncertainty: float = 0.0) -> CalibrationResult:
    """Camera, noise, response, filter weights and absolute scale, as far as a capture allows.

    capture : its folder, or what ``load_capture`` returned. reference_uncertainty : relative standard deviation of
    the reference source's radiance.

    Raises InputError for faulty captures; what a capture lacks is no error, a note says so.
    """
    return CalibrationResult(with_scene_checks(calibrated(as_capture(capture), reference_uncertainty)))
