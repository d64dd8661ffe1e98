"""A capture of known truth calibrated, and each quantity handed on held against the truth.

The capture is written to files, loaded and calibrated as ``cbox calibrate`` does it: is the truth within the 68% and
the 95% interval? benchmarks/calibration/calibration_coverage.py counts that over a thousand captures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.colour.patch_colour import patch_xyz
from cboxlab.calibration.detector.dark_fit import dark_level_sigma, ordinary_pixels
from cboxlab.calibration.geometry.camera_jacobian import parameter_jacobian
from cboxlab.calibration.instrument import LUMINOUS_EFFICACY, colour_matching_functions
from cboxlab.calibration.radiometry.sensor_equation import nominal_constant
from cboxlab.calibration.radiometry.uncertainty import xyz_parts
from cboxlab.calibration.result.calibrate import Calibration, calibrate_capture
from cboxlab.scenes.cornell_box import cornell_box
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2, t

from .coverage_capture import REFERENCE_SIGMA, SERIES_BAND, SIZE, Truth, make_capture

__all__ = ["LEVELS", "Shares", "coverage", "interval", "score"]

#: What the intervals promise: one and two standard deviations of a normal distribution.
LEVELS = (0.6827, 0.9545)

#: By quantity, the share of a capture's intervals of each level that hold the truth.
Shares = dict[str, tuple[float, float]]


def interval(
    error: ArrayLike, sigma: ArrayLike, degrees: float = np.inf, estimated: ArrayLike | None = None
) -> tuple[float, float]:
    """Shares of |error| within sigma times Student's quantile; finite pairs alone count.

    degrees : of freedom of sigma, or of the part ``estimated`` of it (Welch and Satterthwaite).
    """
    error, sigma = np.broadcast_arrays(np.asarray(error, float), np.asarray(sigma, float))
    part = sigma if estimated is None else np.maximum(estimated, 1e-300)
    freedom = np.ravel(degrees * (sigma / part) ** 4)
    pull = np.ravel(np.abs(error / sigma))
    usable = np.isfinite(pull)
    inside = [pull[usable] < t.ppf((1 + level) / 2, freedom[usable]) for level in LEVELS]
    return float(np.mean(inside[0])), float(np.mean(inside[1]))


def region(error: NDArray[np.float64], covariance: NDArray[np.float64]) -> tuple[float, float]:
    """Shares of errors (n, k) within the 68 % and 95 % ellipsoids of covariances (n, k, k)."""
    square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    inside = [square < chi2.ppf(level, error.shape[1]) for level in LEVELS]
    return float(np.mean(inside[0])), float(np.mean(inside[1]))


def _sensor(calibration: Calibration, truth: Truth) -> Shares:
    settings, maps, noise = truth.settings, truth.maps, calibration.noise
    gain, read = settings.gain_e_per_dn, settings.read_noise_e
    shares = {
        "gain": interval(noise.gain_e_per_dn - gain, noise.gain_sigma),
        "read noise": interval(noise.read_noise_e - read, noise.read_noise_sigma),
    }
    transfer, dark = calibration.sensor.transfer, calibration.sensor.dark_fit
    first = float(calibration.dark.exposure_s[0])
    shares |= {
        "K": interval(transfer.gain_dn_per_e - 1 / gain, transfer.gain_sigma),
        "dark noise": interval(
            transfer.dark_noise_e - np.sqrt(read**2 + settings.dark_current_e_s * first),
            transfer.dark_noise_sigma,
        ),
        "DSNU": interval(transfer.dsnu_e - settings.bias_pattern_dn * gain, transfer.dsnu_sigma),
        "PRNU": interval(transfer.prnu - settings.prnu, transfer.prnu_sigma),
    }
    ordinary = ordinary_pixels(calibration.dark, noise)
    bias, rate = (float(values[ordinary].mean()) for values in (maps.bias_dn, maps.dark_current_e_s / gain))
    level = calibration.dark.level[:, ordinary].mean(axis=1) - bias - rate * calibration.dark.exposure_s
    return shares | {
        "dark level": interval(level, dark_level_sigma(calibration.dark, noise)),
        "dark level at no exposure": interval(dark.bias_dn - bias, dark.bias_sigma, dark.degrees),
        "dark level's slope": interval(dark.rate_dn_s - rate, dark.rate_sigma, dark.degrees),
    }


def _response(calibration: Calibration, truth: Truth) -> Shares:
    band = list(calibration.capture.band_ids).index(SERIES_BAND)
    true = truth.field[_order(calibration)[band], 0, 0] * truth.filters[_order(calibration)[band]] * truth.reference
    shares: Shares = {}
    for series in calibration.sensor.responses:
        if series.source == "reference":
            power = truth.settings.f_number**2 if series.key == "f_number" else 1.0
            steady = max(series.fit.setting) if series.key == "exposure" else None
            if steady is None:
                continue
            error = series.fit.slope - true / power
            shares["slope, signal over exposure time"] = interval(error, series.fit.slope_sigma)
    linear = calibration.linearity
    return shares | {
        "black level": interval(linear.black_level_dn, linear.black_level_sigma),
        "exposure offset": interval(linear.exposure_offset_s, linear.exposure_offset_sigma),
    }


def _order(calibration: Calibration) -> list[int]:
    """Places of the capture's bands in the order of wavelength, which is that of ``Truth``."""
    rank = sorted(calibration.capture.band_ids)
    return [rank.index(band) for band in calibration.capture.band_ids]


def _signals(calibration: Calibration, truth: Truth) -> Shares:
    capture, images = calibration.capture, calibration.images
    order = _order(calibration)
    exposure = np.array([b.exposure_s for b in capture.manifest.band])
    opened = np.array(
        [
            np.mean([truth.opened_s[f"band {b.id} {b.exposure_s:g} {i}"] for i in range(len(b.frames))])
            for b in capture.manifest.band
        ]
    )
    used = np.all(images["mask"].values == 0, axis=0)
    signal, rate = images["signal"].values[:, used], truth.rate[order][:, used]
    counted = rate * (truth.filters[order] * opened)[:, None]
    sigma = np.sqrt(calibration.predicted_variance(truth.rate[order] * exposure[:, None, None])[:, used])
    true_c = float(nominal_constant(capture) or np.nan)
    shares: Shares = {
        "signal of a pixel (variance of the model's signal)": interval(signal - counted, sigma),
        "signal of a pixel (variance in the dataset)": interval(
            signal - counted, np.sqrt(images["variance"].values[:, used])
        ),
    }
    scale = calibration.radiometry
    if scale.constant is None:
        return shares
    shared, matrix = calibration.uncertainty, _xyz_per_dn(calibration)
    freedom = shared.band_degrees
    shares["C"] = interval(
        scale.constant - true_c,
        np.hypot(scale.sigma, REFERENCE_SIGMA * scale.constant),
        scale.degrees,
        scale.sigma,
    )
    measured = signal * true_c / scale.constant
    expected = rate * exposure[:, None]
    pixel = images["variance"].values[:, used]
    band = np.sqrt(np.diag(shared.band_covariance))[:, None]
    mean_variance = pixel.mean(axis=1) / used.sum()
    shares["light of a band, per pixel"] = interval(
        measured - expected,
        np.sqrt(pixel + expected**2 * (band**2 + shared.common**2)),
        freedom,
        expected * band,
    )
    shares["light of a band, mean of the field"] = interval(
        (measured - expected).mean(axis=1),
        np.sqrt(mean_variance + expected.mean(axis=1) ** 2 * (band[:, 0] ** 2 + shared.common**2)),
        freedom,
        expected.mean(axis=1) * band[:, 0],
    )
    return shares | _colours(calibration, truth, used, matrix, expected * scale.constant / true_c)


def _xyz_per_dn(calibration: Calibration) -> NDArray[np.float64]:
    factors = np.array([response.factor for response in calibration.responses or ()])
    return LUMINOUS_EFFICACY * calibration.weights.weights / factors


def _colours(
    calibration: Calibration,
    truth: Truth,
    used: NDArray[np.bool_],
    matrix: NDArray[np.float64],
    signal: NDArray[np.float64],
) -> Shares:
    """XYZ against the same weights of the true signals, and against the exact integrals of the radiance."""
    xyz = calibration.xyz()
    value = np.moveaxis(xyz["xyz"].values, 0, -1)[used]
    pixel, shared = (xyz[f"covariance_{kind}"].values[used] for kind in ("pixel", "shared"))
    weighted = (matrix @ signal).T
    step = INTEGRAL_GRID.weights
    exact = LUMINOUS_EFFICACY * truth.radiance[used] @ (step * colour_matching_functions()).T
    error = value - weighted
    middle = xyz_parts(signal.mean(axis=1), 0 * signal[:, 0], matrix, calibration.uncertainty)
    total = pixel.mean(axis=0) / len(value) + middle.total
    freedom = calibration.uncertainty.band_degrees
    parts = xyz_parts(calibration.images["signal"].values[:, used], 0 * signal, matrix, calibration.uncertainty)
    shares = {"XYZ of a pixel, as one": region(error, pixel + shared)}
    for axis, name in enumerate("XYZ"):
        shares[f"{name} of a pixel"] = interval(
            error[:, axis],
            np.sqrt((pixel + shared)[:, axis, axis]),
            freedom,
            np.sqrt(parts.band[:, axis, axis]),
        )
    for axis, name in enumerate("XYZ"):
        shares[f"{name}, mean of the field"] = interval(
            error[:, axis].mean(),
            np.sqrt(total[axis, axis]),
            freedom,
            np.sqrt(middle.band[axis, axis]),
        )
    sums = value.sum(axis=1, keepdims=True)
    for axis, name in enumerate("xy"):
        slope = (np.eye(3)[axis] * sums - value[:, axis : axis + 1]) / sums**2
        off = value[:, axis] / sums[:, 0] - weighted[:, axis] / weighted.sum(axis=1)
        spread = np.einsum("ni,nij,nj->n", slope, pixel + shared, slope)
        banded = np.einsum("ni,nij,nj->n", slope, parts.band, slope)
        shares[f"chromaticity {name} of a pixel"] = interval(off, np.sqrt(spread), freedom, np.sqrt(banded))
    if "covariance_weights" in xyz:
        covariance = pixel + shared + xyz["covariance_weights"].values[used]
        for axis, name in enumerate("XYZ"):
            shares[f"exact {name} of a pixel"] = interval(
                value[:, axis] - exact[:, axis], np.sqrt(covariance[:, axis, axis])
            )
    return shares


def _camera(calibration: Calibration, truth: Truth) -> Shares:
    camera = calibration.camera
    error, sigma = camera.parameters - truth.camera.parameters, np.sqrt(np.diag(camera.covariance))
    groups = {
        "position": slice(0, 3),
        "orientation": slice(3, 6),
        "focal length": slice(6, 7),
        "principal point": slice(7, 9),
        "distortion": slice(9, 10),
    }
    shares = {f"camera: {name}": interval(error[part], sigma[part]) for name, part in groups.items()}
    shares["camera, all ten as one"] = region(error[None], camera.covariance[None])
    corners = np.unique(np.concatenate([s.vertices_mm for s in cornell_box().surfaces]).round(2), axis=0)
    off = camera.project(corners) - truth.camera.project(corners)
    by = parameter_jacobian(camera, corners)
    spread = np.einsum("ni,ij,nj->n", by, camera.covariance, by)
    visible = np.isfinite(off).ravel()
    return shares | {"image positions of the box's corners": interval(off.ravel()[visible], np.sqrt(spread[visible]))}


def _chart(calibration: Calibration, truth: Truth) -> Shares:
    table = calibration.patches
    spectra = np.array([np.interp(table.grid.nm, WAVELENGTH_NM, reflectance) for reflectance in truth.reflectance])
    expected = spectra @ table.filters.T
    dyed = slice(1, len(expected))
    # Information of the patches on the light has this number of degrees of freedom.
    degrees = min(shading.degrees for shading in table.shading.values())
    shares = {"reflectance of a patch": interval((table.reflectance - expected)[dyed], table.sigma[dyed], degrees)}
    ratios, sigmas = [], []
    centre = (SIZE - 1) / 2
    for shading in table.shading.values():
        # The middle of the frame lies between four pixels.
        middle = truth.light[SIZE // 2 - 1 : SIZE // 2 + 1, SIZE // 2 - 1 : SIZE // 2 + 1]
        true = truth.light / np.exp(np.mean(np.log(middle)))
        for u, v in ((8, 8), (39, 8), (8, 39), (39, 39)):
            ratios.append(float(shading.at(u, v) / shading.at(centre, centre)) / true[v, u] - 1)
            sigmas.append(float(shading.relative_sigma(u, v, (centre, centre))))
    shares["shading, corner over the middle"] = interval(ratios, sigmas, degrees)
    xyz, sigma = patch_xyz(table)
    exact = replace(table, reflectance=expected)
    return shares | {
        "XYZ of a patch, for its band reflectances": interval((xyz - patch_xyz(exact)[0])[dyed], sigma[dyed], degrees)
    }


def score(folder: Path, seed: int) -> Shares:
    """Make the capture of a seed in a new folder, calibrate it, and hold everything against the truth."""
    truth = make_capture(folder, seed)
    calibration = calibrate_capture(load_capture(folder), REFERENCE_SIGMA)
    return (
        _sensor(calibration, truth)
        | _response(calibration, truth)
        | _signals(calibration, truth)
        | _camera(calibration, truth)
        | _chart(calibration, truth)
    )


def coverage(results: Sequence[Mapping[str, Sequence[float]]]) -> dict[str, list[tuple[float, float]]]:
    """By quantity and level, the mean share over captures and its standard error; (share, error) pairs."""
    shares_by_quantity: dict[str, list[tuple[float, float]]] = {}
    for name in dict.fromkeys(name for result in results for name in result):
        values = np.array([result[name] for result in results if name in result])
        # Where a capture has one such interval, by what should hold; else by what the captures show.
        error = np.sqrt(np.array(LEVELS) * (1 - np.array(LEVELS)) / len(values))
        if np.any((values > 0) & (values < 1)):
            error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
        shares_by_quantity[name] = list(zip(values.mean(axis=0).tolist(), error.tolist(), strict=True))
    return shares_by_quantity
