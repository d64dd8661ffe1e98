"""Rows of tables for the terminal: results of a calibration, patches, colour methods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.calibration.colour import ColourError, ColourStudy, PatchErrors, PatchTable, patch_xyz
from cboxlab.calibration.geometry import CameraFit
from cboxlab.calibration.result import Calibration
from cboxlab.scenes.camera import Camera

__all__ = ["calibration_rows", "colour_rows", "patch_rows"]

Row = tuple[str, str, str, str]

#: Most subsets of the bands in a table: the error changes little from one to the next.
_MOST_SUBSETS = 8
#: Most names of bands in a row of a table: more would be wrapped over several lines.
_MOST_NAMES = 5

_CAMERA_ROWS = (
    ("camera x", "mm"),
    ("camera y", "mm"),
    ("camera z", "mm"),
    ("camera rotation x", "deg"),
    ("camera rotation y", "deg"),
    ("camera rotation z", "deg"),
    ("focal length", "px"),
    ("principal point u", "px"),
    ("principal point v", "px"),
    ("distortion k1", "1"),
)


def _row(name: str, value: float | None, sigma: float | None, unit: str, missing: str = "") -> Row:
    """Row with value and sigma rounded to two digits of the sigma; a dash and why for none."""
    if value is None or not np.isfinite(value):
        return f"{name}, {missing}" if missing else name, "–", "", unit
    if sigma is None or not np.isfinite(sigma) or sigma <= 0:
        return name, f"{value:.6g}", "", unit
    digits = 1 - int(np.floor(np.log10(sigma)))
    if digits > 8:
        return name, f"{value:.6g}", f"{sigma:.2g}", unit
    return name, f"{value:.{max(digits, 0)}f}", f"{sigma:.{max(digits, 0)}f}", unit


def _camera(camera: Camera, fit: CameraFit) -> list[Row]:
    covariance = camera.covariance
    sigmas = np.full(len(camera.parameters), np.nan) if covariance is None else np.sqrt(np.diag(covariance))
    rows = [
        _row(name, value, sigma, unit)
        for (name, unit), value, sigma in zip(_CAMERA_ROWS, camera.parameters, sigmas, strict=True)
    ]
    if not camera.lens.one_term:
        terms = {key: value for key, value in camera.lens.record().items() if isinstance(value, float)}
        names = {"aspect": "fy over fx"}
        rows += [
            _row(names.get(term, f"distortion {term}"), value, fit.lens_sigmas.get(term), "1")
            for term, value in terms.items()
        ]
    points = f"{int(fit.in_use.sum())} of {len(fit.in_use)} points"
    rows.append((f"reprojection rms, {points}", f"{fit.reprojection_rms_px:.3f}", f"{fit.point_sigma_px:.3g}", "px"))
    return rows


def calibration_rows(calibration: Calibration) -> list[Row]:
    """All results of a calibration.

    Parameters
    ----------
    calibration
        The calibration.

    Returns
    -------
    list
        (quantity, value, standard deviation, unit); a dash for missing values.
    """
    rows = []
    if calibration.camera is not None and calibration.camera_fit is not None:
        rows += _camera(calibration.camera, calibration.camera_fit)
    if calibration.target_fit is not None:
        target = calibration.target_fit
        rows.append(("reprojection rms on targets", f"{target.reprojection_rms_px:.3f}", "", "px"))
    noise, scale, linearity = calibration.noise, calibration.radiometry, calibration.linearity
    rows.append(_row("gain", noise.gain_e_per_dn, noise.gain_sigma, "e-/DN"))
    rows.append(_row("read noise", noise.read_noise_e, noise.read_noise_sigma, "e-"))
    if scale.is_free:
        rows.append(("C, free: estimated with a model alone", "–", "", "mm² m² DN/e-"))
    elif scale.constant is not None and scale.nominal is not None:
        sigma = None if scale.sigma is None else scale.sigma / scale.nominal
        rows.append(_row("C over its nominal value", scale.constant / scale.nominal, sigma, "1"))
    else:
        rows.append(("C", "–" if scale.constant is None else f"{scale.constant:.5g}", "", "mm² m² DN/e-"))
    if scale.by_band:
        rows.append(("C equal in all bands: probability", f"{scale.probability:.3f}", "", "1"))
    if linearity is not None:
        rows.append(_row("black level", linearity.black_level_dn, linearity.black_level_sigma, "DN"))
        rows.append(_row("exposure offset", linearity.exposure_offset_s, linearity.exposure_offset_sigma, "s"))
        worst = max(linearity.rms_corrected.items(), key=lambda item: item[1], default=None)
        if worst is not None:
            rows.append((f"nonlinearity, rms, worst band {worst[0]}", f"{100 * worst[1]:.2f}", "", "%"))
    transfer, curve = calibration.sensor.transfer, calibration.sensor.curve
    if transfer is not None:
        rows.append(_row("DSNU", transfer.dsnu_e, transfer.dsnu_sigma, "e-", "below the noise of the darks"))
        rows.append(_row("PRNU", 100 * transfer.prnu, 100 * transfer.prnu_sigma, "%", "below the noise of the flats"))
        rows.append(_row("full well", transfer.saturation_e, None, "e-", "reached in no frame"))
    if curve is not None:
        rms, line = 100 * curve.statistics["rms"], 100 * curve.line_rms
        rows.append((f"calibration curve: rms residual (straight line: {line:.2g})", f"{rms:.2g}", "", "% of full"))
    if calibration.weights is not None:
        gain = calibration.weights.noise_gain
        rows += [(f"noise of {axis} relative to the bands", f"{gain[i]:.2f}", "", "1") for i, axis in enumerate("XYZ")]
    return rows


def patch_rows(patches: PatchTable, errors: PatchErrors | None) -> list[tuple[str, ...]]:
    """Colours and errors of every patch of a chart.

    Parameters
    ----------
    patches
        Measured patches; the white patch has Y = 100.
    errors
        Errors of patches with a known reflectance; None without any.

    Returns
    -------
    list
        (label, X, Y, Z, sigma of Y, true Y, largest reflectance error, Delta E*ab, CIEDE2000), a dash for errors that
        are not known. With errors, the last two rows are their mean and maximum.
    """
    values, sigmas = patch_xyz(patches)
    judged = {} if errors is None else {label: i for i, label in enumerate(errors.labels)}
    rows: list[tuple[str, ...]] = []
    for label, xyz, sigma in zip(patches.labels, values, sigmas, strict=True):
        deviations: tuple[str, ...] = ("–", "–", "–", "–")
        if errors is not None and label.label in judged:
            i = judged[label.label]
            deviations = (
                f"{errors.known_xyz[i, 1]:.2f}",
                f"{np.abs(errors.reflectance[i]).max():.3f}",
                f"{errors.delta_e_ab[i]:.1f}",
                f"{errors.delta_e_2000[i]:.1f}",
            )
        rows.append((f"{label.label} {label.name}", *(f"{v:.2f}" for v in xyz), f"{sigma[1]:.2f}", *deviations))
    if errors is not None:
        for name, summary in (("mean", np.mean), ("largest", np.max)):
            figures = (np.abs(errors.reflectance), errors.delta_e_ab, errors.delta_e_2000)
            cells = [f"{summary(f):.{digits}f}" for f, digits in zip(figures, (4, 2, 2), strict=True)]
            rows.append((f"{name} of {len(errors.labels)}", "", "", "", "", "", *cells))
    return rows


def colour_rows(study: ColourStudy) -> list[tuple[str, ...]]:
    """Errors of the filter weights, by method and by best subset of the bands.

    Parameters
    ----------
    study
        The study of methods and subsets.

    Returns
    -------
    list
        (method, or bands left out or alone in use; rms error of X, Y, Z in %; mean / largest Delta E*ab and CIEDE2000).
        Of many subsets eight are listed, from the largest to the smallest.
    """
    everything = next(iter(study.weights.values())).bands

    def row(name: str, error: ColourError) -> tuple[str, ...]:
        differences = (error.delta_e_ab, error.delta_e_2000)
        return (
            name,
            *(f"{100 * rms:.1f}" for rms in error.rms),
            *(f"{d.mean():.2f} / {d.max():.1f}" for d in differences),
        )

    methods = [
        row(method + (" (used)" if method == study.recommended else ""), error)
        for method, error in study.errors.items()
    ]
    subsets = study.choices[2:-1]
    listed = sorted({round(index) for index in np.linspace(0, len(subsets) - 1, _MOST_SUBSETS)}) if subsets else []
    return methods + [row(_subset_name(subsets[k].bands, everything), subsets[k].error) for k in reversed(listed)]


def _subset_name(bands: Sequence[str], everything: Sequence[str]) -> str:
    """Words for a subset of the bands, by the shorter list of those in it and those left out."""
    left_out = [band for band in everything if band not in bands]
    word, names = ("without", left_out) if len(left_out) <= len(bands) else ("only", list(bands))
    if len(names) > _MOST_NAMES:
        return f"{word} {', '.join(names[: _MOST_NAMES - 1])} and {len(names) - _MOST_NAMES + 1} more"
    return f"{word} {', '.join(names)}"
