"""The verdict on a comparison, and warnings, as sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..compare import HEADLINE, Comparison, Region, regions_of
from .bands import NamedBand
from .metrics import Run

__all__ = ["Verdict", "chi2_by_place", "verdict", "warnings"]

#: Probability below which a difference is significant.
SIGNIFICANT = 1e-3

#: With a million residuals any error is significant. Up to this chi2 per degree of freedom the rms error is less than
#: half the noise of one pixel, sqrt(1.2 - 1) = 0.45 sigma, and the verdict is 'nearly all'.
NEARLY = 1.2

#: A chi2 per degree of freedom below this means that the stated noise is too large, for any model.
TOO_SMALL = 0.9


@dataclass(frozen=True)
class Verdict:
    """level : "explained", "nearly" or "unexplained". headline, details : sentences."""

    level: str
    headline: str
    details: tuple[str, ...]


def verdict(c: Comparison, bands: Sequence[NamedBand] = ()) -> Verdict:
    """Whether noise explains the difference; if not, where the excess is. bands : names for some of them."""
    significant = c.chi2.p_value < SIGNIFICANT
    level = "explained" if not significant else "nearly" if c.chi2.per_dof <= NEARLY else "unexplained"
    headline = {
        "explained": "Noise explains the difference.",
        "nearly": "Noise explains nearly all of the difference.",
        "unexplained": "Noise does not explain the difference.",
    }[level]
    colour, noise = c.colour[HEADLINE.id], c.colour_noise[HEADLINE.id]
    details = [
        f"χ² per degree of freedom is {c.chi2.per_dof:.3g}; noise alone gives 1 ± {c.chi2.per_dof_sigma:.2g}.",
        f"The mean colour difference per pixel is {HEADLINE.label} {colour.mean:.2f}; "
        f"noise alone gives {noise.mean:.2f}.",
    ]
    if significant:
        beyond = np.array([row.beyond_noise for row in c.by_band.values()])
        details.append(
            f"The difference beyond noise is {100 * np.nanmedian(beyond):.2g} % of the signal (rms, median over the "
            f"bands; {100 * np.nanmax(beyond):.2g} % in the worst)."
        )
        regions = regions_of(c)
        place = max(regions["place"], key=lambda r: r.share_of_excess)
        details.append(
            f"{100 * place.share_of_excess:.0f} % of the excess χ² is in one place: {place.name}, with "
            f"{100 * place.share_of_residuals:.0f} % of the residuals."
        )
        surface, band = (_worst(regions[kind]) for kind in ("surface", "band"))
        if surface is not None and band is not None:
            name = {c.bands[i]: known for i, known in bands}.get(band.name, band.name)
            details.append(
                f"The worst region is {surface.name} (χ²/dof {surface.chi2.per_dof:.3g}), the worst band {name} "
                f"({band.chi2.per_dof:.3g})."
            )
    return Verdict(level, headline, tuple(details))


def chi2_by_place(c: Comparison) -> str:
    """Chi2 per degree of freedom of interiors, edges and what is outside the box, in words."""
    return ", ".join(f"{r.name} {r.chi2.per_dof:.3f}" for r in regions_of(c)["place"] if r.chi2.count)


def _worst(regions: Sequence[Region]) -> Region | None:
    """The region with the highest chi2 per degree of freedom; None where none has residuals."""
    known = [r for r in regions if r.chi2.count]
    return max(known, key=lambda r: r.chi2.per_dof, default=None)


def warnings(c: Comparison, run: Run) -> list[str]:
    """Reasons for caution about the results, one sentence each."""
    found = []
    if c.chi2.per_dof < TOO_SMALL:
        found.append(
            f"χ² per degree of freedom is {c.chi2.per_dof:.2f}: the stated noise is larger than that of the images, so "
            "an error of the model may not be detected."
        )
    if c.render_sigma_over_sensor_sigma > 1:
        found.append(
            "The render is noisier than the camera (median ratio "
            f"{c.render_sigma_over_sensor_sigma:.2f}): more samples would make the comparison more sensitive."
        )
    total = c.maps.sizes["y"] * c.maps.sizes["x"]
    if c.pixels_used < 0.8 * total:
        found.append(f"Only {100 * c.pixels_used / total:.0f} % of the pixels could be used in every band.")
    empty = [name for name, row in c.by_surface.items() if row.interior_pixels == 0]
    if empty:
        found.append(f"No mean colour, since there are no usable interior pixels: {', '.join(empty)}.")
    deviation = (run.lamp_scale - 1.0) / run.lamp_scale_prior_sigma
    if abs(deviation) > 2:
        found.append(
            f"The fitted lamp scale differs from 1 by {abs(deviation):.1f} stated standard deviations: the calibration "
            "of the lamp or of the camera, or the model, is wrong."
        )
    before = run.calibrated_camera
    if before is not None and before.covariance is not None:
        sigma = np.sqrt(np.diag(before.covariance))
        shift = (run.camera.parameters - before.parameters) / sigma
        correlation = before.covariance / np.outer(sigma, sigma)
        distance = float(shift @ np.linalg.pinv(correlation, hermitian=True) @ shift)
        # 99.9% point of chi-square with ten degrees of freedom.
        if distance > 29.6:
            found.append(
                f"The refitted camera is not consistent with its calibration (squared Mahalanobis distance "
                f"{distance:.0f}, 99.9 % point 29.6): the refit may hide an error of the model."
            )
    return found
