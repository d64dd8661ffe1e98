"""What a comparison says, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .compare import Comparison
from .metrics import Run
from .regions import INTERIOR_DISTANCE_PX

__all__ = ["Verdict", "verdict", "warnings"]

#: Below this probability a difference counts as more than noise.
SIGNIFICANT = 1e-3

#: With a million residuals any flaw is significant; up to this chi2 per degree of freedom the flaw is smaller
#: than half the noise of one pixel, sqrt(1.2 - 1) = 0.45 sigma, and the verdict says 'nearly all'.
NEARLY = 1.2

#: Less than this means that the stated noise is too large, whatever the model.
TOO_SMALL = 0.9


@dataclass(frozen=True)
class Verdict:
    """level : "explained", "nearly" or "unexplained". headline, details : sentences."""

    level: str
    headline: str
    details: tuple[str, ...]


def verdict(c: Comparison) -> Verdict:
    """Whether noise explains the difference; if not, where the excess sits."""
    significant = c.chi2.p_value < SIGNIFICANT
    level = "explained" if not significant else "nearly" if c.chi2.per_dof <= NEARLY else "unexplained"
    headline = {
        "explained": "Noise explains the difference.",
        "nearly": "Noise explains nearly all of the difference.",
        "unexplained": "Noise does not explain the difference.",
    }[level]
    e, noise = c.delta_e_ab, c.delta_e_ab_noise
    details = [
        f"χ² per degree of freedom is {c.chi2.per_dof:.3g}, where noise alone gives "
        f"1 ± {c.chi2.per_dof_sigma:.2g}.",
        f"Pixel by pixel the colours differ by ΔE*ab {e.mean:.2f} on average; noise alone would give "
        f"{noise.mean:.2f}.",
    ]
    if significant:
        beyond = np.array([row.beyond_noise for row in c.by_band.values()])
        details.append(
            f"What noise does not explain amounts to {100 * np.nanmedian(beyond):.2g} % of the signal "
            f"(rms, median over the bands; {100 * np.nanmax(beyond):.2g} % in the worst)."
        )
        details.append(
            f"{100 * c.share_of_excess_at_edges:.0f} % of the excess sits less than "
            f"{INTERIOR_DISTANCE_PX:g} pixels from an edge, where "
            f"{100 * c.chi2_edges.count / c.chi2.count:.0f} % of the residuals are."
        )
        surface = max(c.by_surface.items(), key=lambda item: item[1].chi2.excess, default=None)
        band = max(c.by_band.items(), key=lambda item: item[1].chi2.excess)
        worst = f"the worst band {band[0]} (χ²/dof {band[1].chi2.per_dof:.3g})"
        if surface is not None:
            worst = f"The worst surface is {surface[0]} (χ²/dof {surface[1].chi2.per_dof:.3g}), {worst}"
        details.append(f"{worst[0].upper()}{worst[1:]}, by the size of their excess.")
    return Verdict(level, headline, tuple(details))


def warnings(c: Comparison, run: Run) -> list[str]:
    """What a reader has to know before trusting the figures."""
    found = []
    if c.chi2.per_dof < TOO_SMALL:
        found.append(
            f"χ² per degree of freedom is {c.chi2.per_dof:.2f}: the stated noise is larger than what the "
            "images show, so a flaw of the model may hide in it."
        )
    if c.render_sigma_over_sensor_sigma > 1:
        found.append(
            "The render is noisier than the camera (median ratio "
            f"{c.render_sigma_over_sensor_sigma:.2f}): more samples would make the comparison sharper."
        )
    total = c.maps.sizes["y"] * c.maps.sizes["x"]
    if c.pixels_used < 0.8 * total:
        found.append(f"Only {100 * c.pixels_used / total:.0f} % of the pixels could be used in every band.")
    empty = [name for name, row in c.by_surface.items() if row.interior_pixels == 0]
    if empty:
        found.append(f"No usable interior, so no mean colour: {', '.join(empty)}.")
    pull = (run.lamp_scale - 1.0) / run.lamp_scale_prior_sigma
    if abs(pull) > 2:
        found.append(
            f"The fitted lamp scale lies {abs(pull):.1f} of its stated standard deviations from 1: the "
            "lamp's calibration, the camera's or the model is off."
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
                f"The refit moved the camera beyond its calibration (Mahalanobis square {distance:.0f}, "
                "99.9 % point 29.6): the refit may be covering up a flaw of the model."
            )
    return found
