"""Verdict on a comparison, and warnings, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..compare import HEADLINE, Comparison, Region, regions_of
from .bands import NamedBand
from .metrics import ValidationFacts
from .numerals import chi2_text

__all__ = ["ReportVerdict", "chi2_by_place", "report_verdict", "warnings"]

#: Probability below which a difference is significant.
SIGNIFICANT = 1e-3

#: Reduced chi2 up to which the verdict is 'nearly all'. With a million residuals any error is significant. At this
#: value the rms error is less than half the noise of one pixel: sqrt(1.2 - 1) = 0.45 sigma.
NEARLY = 1.2

#: Reduced chi2 below which the stated noise is too large, whatever the model.
TOO_SMALL = 0.9

#: Standard deviations below 1 of such a chi2: chance alone does not reach it, nor the error of a measured gain.
_TOO_SMALL_SIGMAS = 3.0

#: Share of the pixels below which few pixels are used.
_MIN_USED_SHARE = 0.8

#: Deviation of the lamp scale from 1 that is worth a warning, in stated standard deviations.
_MAX_LAMP_PULL_SIGMA = 2

#: 99.9 % point of chi2 with ten degrees of freedom, those of a camera.
_MAX_CAMERA_DISTANCE = 29.6


@dataclass(frozen=True)
class ReportVerdict:
    """Verdict on a comparison."""

    #: "explained", "nearly" or "unexplained".
    level: str
    #: The verdict in one sentence.
    headline: str
    #: Further sentences.
    details: tuple[str, ...]


def report_verdict(c: Comparison, bands: Sequence[NamedBand] = ()) -> ReportVerdict:
    """Verdict whether noise explains the difference, and where the excess is.

    Parameters
    ----------
    c
        The comparison.
    bands
        (index, name) of bands for the page; others have their identifiers.

    Returns
    -------
    ReportVerdict
        Level and sentences.
    """
    significant = c.chi2.p_value < SIGNIFICANT
    level = "explained" if not significant else "nearly" if c.chi2.per_dof <= NEARLY else "unexplained"
    headline = {
        "explained": "Noise explains the difference.",
        "nearly": "Noise explains nearly all of the difference.",
        "unexplained": "Noise does not explain the difference.",
    }[level]
    colour, noise = c.colour[HEADLINE.id], c.colour_noise[HEADLINE.id]
    by_gain = f" The measured gain's error contributes {c.chi2.variance_sigma:.2g}." if c.chi2.variance_sigma else ""
    details = [
        f"χ² per degree of freedom is {chi2_text(c.chi2.per_dof)}; noise alone gives "
        f"1 ± {c.chi2.per_dof_sigma:.2g}.{by_gain}",
        f"The mean colour difference per pixel is {HEADLINE.label} {colour.mean:.2f}; "
        f"noise alone gives {noise.mean:.2f}.",
    ]
    if significant:
        beyond = np.array([row.beyond_noise for row in c.by_band.values()])
        details.append(
            f"The rms difference beyond noise is {100 * np.nanmedian(beyond):.2g} % of the signal (median over the "
            f"bands), and {100 * np.nanmax(beyond):.2g} % in the worst band."
        )
        regions = regions_of(c)
        region = max(regions["place"], key=lambda r: r.share_of_excess)
        details.append(
            f"The largest part of the excess χ² comes from {region.name}: {100 * region.share_of_excess:.0f} %, with "
            f"{100 * region.share_of_residuals:.0f} % of the residuals."
        )
        surface, band = (_worst(regions[kind]) for kind in ("surface", "band"))
        if surface is not None and band is not None:
            name = {c.bands[i]: label for i, label in bands}.get(band.name, band.name)
            details.append(
                f"The worst region is {surface.name} (χ²/dof {chi2_text(surface.chi2.per_dof)}), the worst band {name} "
                f"({chi2_text(band.chi2.per_dof)})."
            )
    return ReportVerdict(level, headline, tuple(details))


def chi2_by_place(c: Comparison) -> str:
    """Reduced chi2 of interiors, edges and the region outside the box, as text.

    Parameters
    ----------
    c
        The comparison.

    Returns
    -------
    str
        Regions with their values, separated by commas.
    """
    return ", ".join(f"{r.name} {chi2_text(r.chi2.per_dof)}" for r in regions_of(c)["place"] if r.chi2.count)


def _worst(regions: Sequence[Region]) -> Region | None:
    """The region with the highest chi2 per degree of freedom; None where none has residuals."""
    used = [r for r in regions if r.chi2.count]
    return max(used, key=lambda r: r.chi2.per_dof, default=None)


def warnings(c: Comparison, run: ValidationFacts) -> list[str]:
    """Reasons for caution about the results.

    Parameters
    ----------
    c
        The comparison.
    run
        Data of the validation.

    Returns
    -------
    list
        One text per reason.
    """
    reasons = []
    if c.chi2.per_dof < TOO_SMALL and c.chi2.per_dof < 1 - _TOO_SMALL_SIGMAS * c.chi2.per_dof_sigma:
        reasons.append(
            f"χ² per degree of freedom is {chi2_text(c.chi2.per_dof)}: the stated noise is larger than that of the "
            "images. Errors of the model may remain undetected."
        )
    if c.render_sigma_over_sensor_sigma > 1:
        reasons.append(
            "The rendering is noisier than the camera (median ratio "
            f"{c.render_sigma_over_sensor_sigma:.2f}). More samples make the comparison more sensitive."
        )
    total = c.maps.sizes["y"] * c.maps.sizes["x"]
    if c.pixels_used < _MIN_USED_SHARE * total:
        reasons.append(f"Only {100 * c.pixels_used / total:.0f} % of the pixels are usable in every band.")
    empty = [name for name, row in c.by_surface.items() if row.interior_pixels == 0]
    if empty:
        reasons.append(f"These surfaces have no mean colour, for want of usable interior pixels: {', '.join(empty)}.")
    deviation = (run.lamp_scale - 1.0) / run.lamp_scale_prior_sigma
    if abs(deviation) > _MAX_LAMP_PULL_SIGMA:
        reasons.append(
            f"The fitted lamp scale differs from 1 by {abs(deviation):.1f} stated standard deviations. The calibration "
            "of the lamp or of the camera, or the model, is wrong."
        )
    before = run.calibrated_camera
    if before is not None and before.covariance is not None:
        sigma = np.sqrt(np.diag(before.covariance))
        shift = (run.camera.parameters - before.parameters) / sigma
        correlation = before.covariance / np.outer(sigma, sigma)
        distance = float(shift @ np.linalg.pinv(correlation, hermitian=True) @ shift)
        if distance > _MAX_CAMERA_DISTANCE:
            reasons.append(
                f"The refitted camera is not consistent with its calibration: the squared Mahalanobis distance is "
                f"{distance:.0f}, and its 99.9 % point {_MAX_CAMERA_DISTANCE}. The refit may hide errors of the model."
            )
    return reasons
