"""Folder that ``cbox calibrate`` writes: calibration.json, patches.csv, XYZ maps and plots."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.files import origin, replacing, writing_hdf5
from cboxlab.utils.numbers import json_value

from ..colour import ILLUMINANT, ChainCheck, patch_errors, patches_csv
from ..detector import dark_level_sigma
from ..geometry import CameraFit
from ..instrument import Mask
from .calibrate import Calibration
from .geometry_plot import plot_geometry
from .study_record import colour_record, sensor_record, uncertainty_record, weights_record

__all__ = ["calibration_record", "camera_record", "write_calibration", "write_geometry"]


def camera_record(camera: Camera, fit: CameraFit) -> dict[str, Any]:
    """The "camera" object of metrics.json and calibration.json.

    `rotation_deg` is the Rodrigues vector of R R0^T. The 10 x 10 covariance is in the order position_mm, rotation_deg,
    focal_length_px, principal_point_px, k1. A lens of more terms has its own object, "lens", with their standard
    deviations where they were fitted.

    Parameters
    ----------
    camera
        Camera with its covariance; NaN where there is none.
    fit
        Fit with the reprojection error and the outliers.

    Returns
    -------
    dict[str, Any]
        Values for JSON.
    """
    record = {"reprojection_rms_px": fit.reprojection_rms_px, **_parameters_record(camera)}
    if not camera.lens.one_term:
        record["lens"]["sigma"] = dict(fit.lens_sigmas)
    return record | {"outliers": list(fit.outliers)}


def _parameters_record(camera: Camera) -> dict[str, Any]:
    covariance = np.full((10, 10), np.nan) if camera.covariance is None else camera.covariance
    record = {
        "position_mm": camera.position_mm.tolist(),
        "position_sigma_mm": np.sqrt(np.diag(covariance)[:3]).tolist(),
        "rotation_deg": camera.parameters[3:6].tolist(),
        "focal_length_px": camera.focal_length_px,
        "principal_point_px": np.asarray(camera.principal_point_px).tolist(),
        "k1": camera.k1,
        "covariance": covariance.tolist(),
    }
    return record if camera.lens.one_term else record | {"lens": camera.lens.record()}


def write_geometry(camera: Camera, objects: Sequence[Mapping[str, Any]], folder: Path) -> Path:
    """Write geometry.json: the refined camera and the errors of the objects, with covariances.

    Parameters
    ----------
    camera
        Refined camera; NaN stands for a missing covariance.
    objects
        Record of each object's error.
    folder
        Folder of the results.

    Returns
    -------
    Path
        The file.
    """
    record = {"camera": _parameters_record(camera), "objects": [dict(item) for item in objects]}
    path = folder / "geometry.json"
    text = json.dumps(json_value(record), indent=1, allow_nan=False) + "\n"
    _write(path, lambda temporary: temporary.write_text(text))
    return path


def _value(value: float | None, sigma: float | None) -> dict[str, Any] | None:
    return None if value is None else {"value": value, "sigma": sigma}


def _dark_levels(calibration: Calibration) -> list[dict[str, Any]]:
    dark = calibration.dark
    levels = []
    sigmas = dark_level_sigma(dark, calibration.noise)
    for exposure, repeats, level, sigma in zip(dark.exposure_s, dark.repeats, dark.level, sigmas, strict=True):
        levels.append(
            {
                "exposure_s": float(exposure),
                "median_dn": float(np.median(level)),
                "mean_dn": float(level.mean()),
                "sigma_dn": float(sigma),
                "pixel_spread_dn": float(level.std(ddof=1)),
                "frames": int(repeats),
            }
        )
    return levels


def _patch_errors(calibration: Calibration) -> dict[str, Any] | None:
    """Errors of the measured patches for JSON; None without patches of tabulated reflectance."""
    patches = calibration.patches
    reflectances = calibration.capture.label_reflectances()
    errors = None if patches is None else patch_errors(patches, reflectances)
    if patches is None or errors is None:
        return None
    size = np.abs(errors.reflectance)
    return {
        "patches": list(errors.labels),
        "reflectance": {
            band: {"mean": float(size[:, i].mean()), "max": float(size[:, i].max())}
            for i, band in enumerate(patches.bands)
        },
        "reflectance_mean": float(size.mean()),
        "delta_e_ab": {"mean": float(errors.delta_e_ab.mean()), "max": float(errors.delta_e_ab.max())},
        "delta_e_2000": {"mean": float(errors.delta_e_2000.mean()), "max": float(errors.delta_e_2000.max())},
    }


def _chain(check: ChainCheck) -> dict[str, Any]:
    """Check of the colour chain for JSON."""
    return {
        "patches": list(check.labels),
        "delta_e_2000": {"mean": float(check.measured.mean()), "max": float(check.measured.max())},
        "delta_e_2000_of_weights": float(check.of_weights.mean()),
        "delta_e_2000_by_noise": check.by_noise,
    }


def calibration_record(calibration: Calibration) -> dict[str, Any]:
    """Content of calibration.json; None where the capture lacks the data (see its ``notes``).

    Parameters
    ----------
    calibration
        Calibration of a capture.

    Returns
    -------
    dict[str, Any]
        Values for JSON, without NaN and infinity.
    """
    return json_value(_record(calibration))


def _record(calibration: Calibration) -> dict[str, Any]:
    noise, radiometry, linearity = calibration.noise, calibration.radiometry, calibration.linearity
    camera, fit = calibration.camera, calibration.camera_fit
    images, patches = calibration.images, calibration.patches
    flags = {name.split("=")[0].lower(): int(name.split("=")[1]) for name in images["mask"].flags.split(", ")}
    return {
        "capture": calibration.capture.manifest.name,
        "bands": list(calibration.capture.band_ids),
        **({} if calibration.capture.reduction is None else {"reduction": asdict(calibration.capture.reduction)}),
        "channels": calibration.channels,
        "camera": None if fit is None or camera is None else camera_record(camera, fit),
        "target_intrinsics": None
        if calibration.target_fit is None
        else {
            "focal_length_px_principal_point_px_k1": calibration.target_fit.intrinsics.tolist(),
            "covariance": calibration.target_fit.intrinsics_covariance.tolist(),
            "reprojection_rms_px": calibration.target_fit.reprojection_rms_px,
        },
        "gain_e_per_dn": _value(noise.gain_e_per_dn, noise.gain_sigma),
        "read_noise_e": _value(noise.read_noise_e, noise.read_noise_sigma),
        "dark_level": _dark_levels(calibration),
        "linearity": None
        if linearity is None
        else {
            "black_level_dn": _value(linearity.black_level_dn, linearity.black_level_sigma),
            "exposure_offset_s": _value(linearity.exposure_offset_s, linearity.exposure_offset_sigma),
            "rms_deviation": dict(linearity.rms_deviation),
            "rms_deviation_corrected": dict(linearity.rms_corrected),
        },
        "C": None
        if radiometry.constant is None or radiometry.is_free
        else {
            "value": radiometry.constant,
            "sigma": radiometry.sigma,
            "sigma_degrees_of_freedom": radiometry.degrees,
            "nominal": radiometry.nominal,
            "bands": {c.band: {"value": c.constant, "sigma": c.sigma} for c in radiometry.by_band},
            "chi2": radiometry.chi2,
            "degrees_of_freedom": radiometry.chi2_degrees,
            "probability": radiometry.probability,
        },
        "K": None if calibration.responses is None else {r.band: r.factor for r in calibration.responses},
        "filter_weights": None if calibration.weights is None else weights_record(calibration.weights),
        "colour": None if calibration.colour is None else colour_record(calibration.colour),
        "uncertainty": uncertainty_record(calibration.uncertainty),
        "sensor": sensor_record(calibration.sensor),
        "masked": {
            name: int(np.count_nonzero(np.any(images["mask"].values & value, axis=0)))
            for name, value in flags.items()
            if Mask(value).is_defect
        },
        "patches": None
        if patches is None
        else {
            "file": "patches.csv",
            "illuminant": ILLUMINANT,
            "white": patches.white.name,
            "offset": dict(zip(patches.bands, patches.offset.tolist(), strict=True)),
            "shading_order": {band: shading.order for band, shading in patches.shading.items()},
            "error": _patch_errors(calibration),
            **({} if calibration.chain is None else {"chain": _chain(calibration.chain)}),
        },
        "notes": list(calibration.notes),
        "suspicions": [suspicion.record for suspicion in calibration.suspicions],
    }


def _write(path: Path, write: Callable[[Path], object]) -> None:
    with replacing(path) as temporary:
        write(temporary)


def write_calibration(calibration: Calibration, folder: Path) -> tuple[Path, ...]:
    """Write calibration.json, patches.csv (with patches), xyz.nc and the plots.

    Every file is written under a temporary name and renamed when complete.

    Parameters
    ----------
    calibration
        Calibration of a capture.
    folder
        Folder to write; it is made if it does not exist.

    Returns
    -------
    tuple[Path, ...]
        Files written.
    """
    # matplotlib is slow to import, and only needed here
    from .plots import plot_curve, plot_dark, plot_filters, plot_noise, plot_response

    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(calibration_record(calibration), indent=1, allow_nan=False) + "\n"
    jobs: dict[str, Callable[[Path], object]] = {"calibration.json": lambda path: path.write_text(text)}
    if calibration.patches is not None:
        table = patches_csv(calibration.patches)
        jobs["patches.csv"] = lambda path: path.write_text(table)
    if calibration.weights is not None:
        manifest = calibration.capture.manifest
        xyz = calibration.xyz().assign_attrs(origin(capture=manifest.name or calibration.capture.folder.name))
        maps = {n: {"dtype": "float32", "zlib": True} for n in xyz.data_vars if n != "mask"}
        with writing_hdf5(folder / "xyz.nc") as file:
            xyz.to_netcdf(file, engine="h5netcdf", encoding=maps)
    jobs["noise.png"] = lambda path: plot_noise(calibration, path)
    if calibration.dark.exposure_s.size:
        jobs["dark.png"] = lambda path: plot_dark(calibration, path)
    if calibration.weights is not None:
        jobs["filters.png"] = lambda path: plot_filters(calibration, path)
    if calibration.sensor.responses:
        jobs["response.png"] = lambda path: plot_response(calibration.sensor.responses, path)
    if calibration.sensor.curve is not None:
        jobs["curve.png"] = lambda path: plot_curve(calibration, path)
    camera, fit = calibration.camera, calibration.camera_fit
    if camera is not None and fit is not None and fit.points is not None:
        scene = calibration.capture.scene
        photograph = calibration.photograph
        points = fit.points
        jobs["geometry.png"] = lambda path: plot_geometry(photograph, points, fit, camera, scene, path)
    for name, job in jobs.items():
        _write(folder / name, job)
    maps_of_colour = () if calibration.weights is None else (folder / "xyz.nc",)
    return (*(folder / name for name in jobs), *maps_of_colour)
