"""Results of a validation as metrics.json, under the stable keys of docs/metrics.md."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.calibration.instrument import chromaticity
from cboxlab.scenes.camera import Camera
from cboxlab.utils.files import replacing
from numpy.typing import NDArray

from ..compare import (
    HEADLINE,
    ChiSquare,
    Comparison,
    DifferenceStatistics,
    Failure,
    FreeScale,
    RelativeDifference,
    regions_of,
)

__all__ = ["PathStep", "ValidationFacts", "metrics", "write_metrics"]


@dataclass(frozen=True)
class PathStep:
    """One model on the path from the given model to the final one."""

    #: Identifiers of its effects in order.
    effects: tuple[str, ...]
    #: Reduced chi2.
    chi2_per_dof: float
    #: Mean Delta E*ab over pixels.
    delta_e_ab_mean: float


@dataclass(frozen=True, eq=False)
class ValidationFacts:
    """Data of a validation besides the comparison."""

    #: Name of the capture.
    capture: str
    #: Name of the model.
    model: str
    #: Version of the program.
    version: str
    #: Camera of the rendering.
    camera: Camera
    #: Reprojection error of the surveyed points, px rms per coordinate.
    reprojection_rms_px: float
    #: Fitted factor on the lamp's stated radiance; NaN for a capture without absolute scale.
    lamp_scale: float
    #: Standard deviation of the factor.
    lamp_scale_sigma: float
    #: Stated relative uncertainty of the lamp's radiance; NaN if not stated.
    lamp_scale_prior_sigma: float = math.nan
    #: Camera before the refit to the image; None without a refit.
    calibrated_camera: Camera | None = None
    #: Models tried, in order; empty without a diagnosis.
    path: Sequence[PathStep] = ()
    #: Ranked list of where the model fails.
    failures: Sequence[Failure] = ()
    #: Factors of a capture without absolute scale; None with one.
    free_scale: FreeScale | None = None


def _chi2(chi2: ChiSquare) -> dict[str, Any]:
    return {
        "chi2_per_dof": chi2.per_dof,
        "chi2_per_dof_sigma": chi2.per_dof_sigma,
        "residuals": chi2.count,
        "p_value": chi2.p_value,
    }


def _relative(difference: RelativeDifference) -> dict[str, Any]:
    return {
        "mean_relative_difference": difference.mean,
        "rms_relative_difference": difference.rms,
        "rms_relative_noise": difference.rms_noise,
    }


def _colour(figures: DifferenceStatistics, noise: DifferenceStatistics) -> dict[str, Any]:
    expected = {"mean": noise.mean, "p95": noise.p95, "max": noise.maximum}
    return {"mean": figures.mean, "p95": figures.p95, "max": figures.maximum, "expected_from_noise": expected}


def _light(xyz: NDArray[np.float64]) -> dict[str, Any]:
    return {"luminance_cd_m2": xyz[1], **dict(zip(("x", "y"), chromaticity(xyz), strict=True))}


def _camera(run: ValidationFacts, camera: Camera) -> dict[str, Any]:
    values, covariance = camera.parameters, camera.covariance
    record = {
        "reprojection_rms_px": run.reprojection_rms_px,
        "position_mm": values[:3],
        "position_sigma_mm": [math.nan] * 3 if covariance is None else np.sqrt(np.diag(covariance)[:3]),
        "rotation_deg": values[3:6],
        "focal_length_px": camera.focal_length_px,
        "principal_point_px": camera.principal_point_px,
        "k1": camera.k1,
        "covariance": [] if covariance is None else covariance,
    }
    return record if camera.lens.one_term else record | {"lens": camera.lens.record()}


def _plain(value: Any) -> Any:
    """Values for JSON: NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def metrics(comparison: Comparison, run: ValidationFacts, extra: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Content of metrics.json.

    Parameters
    ----------
    comparison
        The comparison.
    run
        Data of the validation.
    extra
        Further keys.

    Returns
    -------
    dict
        Plain values; None for NaN and infinity.

    Raises
    ------
    ValueError
        If ``extra`` contains a stable key.
    """
    c = comparison
    content: dict[str, Any] = {
        "capture": run.capture,
        "model": run.model,
        "version": run.version,
        "camera": _camera(run, run.calibrated_camera or run.camera),
        "camera_refitted": _camera(run, run.camera) if run.calibrated_camera else None,
        "lamp_scale": {
            "value": run.lamp_scale,
            "sigma": run.lamp_scale_sigma,
            "stated_sigma": run.lamp_scale_prior_sigma,
        },
        **_chi2(c.chi2),
        "render_sigma_over_sensor_sigma_median": c.render_sigma_over_sensor_sigma,
        "pixels_used": c.pixels_used,
        "masked": c.masked,
        "bands": {
            band: {**_chi2(row.chi2), **_relative(row.relative), "beyond_noise": row.beyond_noise}
            for band, row in c.by_band.items()
        },
        "surfaces": {
            name: {
                "relative_difference": dict(zip(c.bands, row.relative, strict=True)),
                "relative_difference_sigma": dict(zip(c.bands, row.relative_sigma, strict=True)),
                **row.colour,
                f"{HEADLINE.id}_expected_from_noise": row.colour_noise[HEADLINE.id],
                "measured": _light(row.xyz_measured),
                "rendered": _light(row.xyz_rendered),
                "interior_pixels": row.interior_pixels,
                **_chi2(row.chi2),
            }
            for name, row in c.by_surface.items()
        },
        **{name: _colour(figures, c.colour_noise[name]) for name, figures in c.colour.items()},
        "luminance": _relative(c.luminance),
        "white": {"x": c.white.x, "y": c.white.y, "luminance": c.white.luminance},
        "edges": {"share_of_excess": c.share_of_excess_at_edges, **_chi2(c.chi2_edges)},
        "interiors": _chi2(c.chi2_interiors),
        "regions": {
            kind: {
                r.name: {
                    **_chi2(r.chi2),
                    "share_of_residuals": r.share_of_residuals,
                    "share_of_excess": r.share_of_excess,
                }
                for r in rows
            }
            for kind, rows in regions_of(c).items()
        },
        "failures": [failure.record for failure in run.failures],
        "path": [asdict(step) for step in run.path or [PathStep((), c.chi2.per_dof, c.colour[HEADLINE.id].mean)]],
    }
    if run.free_scale is not None:
        content["scale"] = run.free_scale.record(c.bands)
    for key, value in (extra or {}).items():
        if key in content:
            raise ValueError(f"metrics.json: the key '{key}' exists already")
        content[key] = value
    return _plain(content)


def write_metrics(
    path: Path, comparison: Comparison, run: ValidationFacts, extra: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Write metrics.json; an incomplete file is removed.

    Parameters
    ----------
    path
        File to write.
    comparison
        The comparison.
    run
        Data of the validation.
    extra
        Further keys.

    Returns
    -------
    dict
        The content.
    """
    content = metrics(comparison, run, extra)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return content
