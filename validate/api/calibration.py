"""``cboxlab.calibrate``: everything that a capture says about its camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.calibration.colour import patch_errors
from cboxlab.calibration.result import Calibration, calibrate_capture, calibration_record, write_calibration
from cboxlab.utils.arguments import required_folder, required_number
from cboxlab.utils.table import Table

from ..capture_checks import with_scene_checks
from .calibration_rows import calibration_rows, colour_rows, patch_rows
from .inputs import CaptureLike, as_capture
from .result import Result

__all__ = ["CalibrationResult", "calibrate", "suspicion_lines"]


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult(Result):
    """Everything that a capture says about its camera."""

    #: Camera, noise, response, filter weights and absolute scale as objects.
    calibration: Calibration

    def to_dict(self) -> dict[str, Any]:
        """Content of calibration.json.

        Returns
        -------
        dict
            Numbers with standard deviations, suspicions and notes.
        """
        return calibration_record(self.calibration)

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write calibration.json, plots, xyz.nc and patches.csv, as far as the capture allows them.

        Parameters
        ----------
        folder
            Folder of the files.

        Returns
        -------
        tuple of Path
            calibration.json first.
        """
        return write_calibration(self.calibration, required_folder("folder", folder))

    def lines(self) -> list[str]:
        """Suspicions, then camera, noise and scale, one sentence each, then notes.

        Returns
        -------
        list of str
            The sentences.
        """
        result = self.calibration
        camera, fit, noise = result.camera, result.camera_fit, result.noise
        lines = [f"Calibration of {self._title}", *suspicion_lines(result)]
        if camera is not None and fit is not None:
            position = ", ".join(f"{x:.1f}" for x in camera.position_mm)
            lines.append(
                f"Camera at ({position}) mm, focal length {camera.focal_length_px:.1f} px, reprojection rms "
                f"{fit.reprojection_rms_px:.3f} px."
            )
        gain = _with_sigma(noise.gain_e_per_dn, noise.gain_sigma, "e-/DN")
        read = _with_sigma(noise.read_noise_e, noise.read_noise_sigma, "e-")
        lines.append(f"Gain {gain}, read noise {read}.")
        if result.radiometry.constant is not None and not result.radiometry.is_free:
            lines.append(f"Absolute scale C = {result.radiometry.constant:.5g} mm² m² DN/e-.")
        return [*lines, *(f"• {note}" for note in result.notes)]

    def tables(self) -> list[Table]:
        """Figures of the calibration, filter weights, and patches of a chart.

        Returns
        -------
        list of Table
            Tables for which the capture has data.
        """
        result = self.calibration
        tables = [Table(self._title, ("", "value", "± 1 σ", "unit"), tuple(calibration_rows(result)))]
        if result.colour is not None:
            columns = ("weights", "X, %", "Y, %", "Z, %", "ΔE*ab", "CIEDE2000")
            title = "Errors of the weights, with all bands and the best subsets: rms; mean / largest colour difference"
            tables.append(Table(title, columns, tuple(map(tuple, colour_rows(result.colour)))))
        if result.patches is not None:
            errors = patch_errors(result.patches, result.capture.label_reflectances())
            rows = tuple(map(tuple, patch_rows(result.patches, errors)))
            header = ("patch", "X", "Y", "Z", "σ(Y)", "true Y", "Δρ", "ΔE*ab", "ΔE00")
            tables.append(Table("Patches", header, rows))
        return tables

    @property
    def _title(self) -> str:
        return self.calibration.capture.manifest.name or self.calibration.capture.folder.name


def suspicion_lines(calibration: Calibration) -> list[str]:
    """Sentences on likely mistakes of a capture.

    Parameters
    ----------
    calibration
        Calibration of the capture.

    Returns
    -------
    list of str
        One for each suspicion; empty for a sound capture.
    """
    return [f"! Suspected error of the capture: {suspicion}" for suspicion in calibration.suspicions]


def _with_sigma(value: float | None, sigma: float | None, unit: str) -> str:
    if value is None or not np.isfinite(value):
        return "not known"
    return f"{value:.4g} {unit}" if sigma is None else f"{value:.4g} ± {sigma:.1g} {unit}"


def calibrate(capture: CaptureLike, *, reference_uncertainty: float = 0.0) -> CalibrationResult:
    """Measure camera, noise, response, filter weights and absolute scale of a capture.

    Parameters
    ----------
    capture
        A capture, or its folder.
    reference_uncertainty
        Relative standard deviation of the reference source's radiance, 0 to 1, which a capture does not state.

    Returns
    -------
    CalibrationResult
        The calibration. Data that the capture lacks are no error; a note names them.

    Raises
    ------
    InputError
        If the capture is faulty, or the uncertainty is out of its range.

    Examples
    --------
    >>> calibration = cboxlab.calibrate("capture")  # doctest: +SKIP
    >>> calibration.to_dict()["gain_e_per_dn"]["value"]  # doctest: +SKIP
    """
    uncertainty = required_number("reference_uncertainty", reference_uncertainty, least=0.0, most=1.0)
    return CalibrationResult(with_scene_checks(calibrate_capture(as_capture(capture), uncertainty)))
