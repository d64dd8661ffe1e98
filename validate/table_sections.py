"""Sections of the report that are tables."""

from __future__ import annotations

import numpy as np
from cboxlab.scenes.camera import PARAMETER_NAMES
from numpy.typing import NDArray

from .blocks import Cell, ReportSection, Table, number, significant, to_error
from .compare import ChiSquare, Comparison
from .metrics import Run

__all__ = ["camera_section", "masks_section", "tables_section"]


def _chi2(chi2: ChiSquare) -> Cell:
    beyond = chi2.dof > 0 and chi2.p_value < 1e-3
    digits = 3 if chi2.per_dof < 10 else 1
    return Cell(number(chi2.per_dof, digits), f"± {number(chi2.per_dof_sigma, 3)}", beyond)


def tables_section(c: Comparison) -> ReportSection:
    """The figures by band, by surface, and by edges against interiors."""
    bands = Table(
        ("band", "χ²/dof", "mean difference, %", "rms difference, %", "rms of noise, %", "beyond noise, %"),
        [
            (band, _chi2(row.chi2), number(100 * row.relative.mean, 3, True), number(100 * row.relative.rms),
             number(100 * row.relative.rms_noise), number(100 * row.beyond_noise, 2))
            for band, row in c.by_band.items()
        ],
        "By band: (measured − rendered) / rendered over all pixels of surfaces; 'beyond noise' is the rms of "
        "what noise does not explain, relative to the rms signal.",
    )  # fmt: skip
    surfaces = Table(
        ("surface", *(f"{band}, %" for band in c.bands), "ΔE*ab", "CIEDE2000", "χ²/dof", "interior px"),
        [
            (
                name,
                *(Cell(number(100 * r, 2, True), f"± {number(100 * s)}", bool(abs(r) > 3.3 * s))
                  for r, s in zip(row.relative, row.relative_sigma, strict=True)),
                Cell(number(row.delta_e_ab), f"noise {number(row.delta_e_noise)}",
                     bool(row.delta_e_ab > 3 * row.delta_e_noise)),
                number(row.delta_e_2000), _chi2(row.chi2), f"{row.interior_pixels}",
            )
            for name, row in c.by_surface.items()
        ],
        "By surface: relative difference of the means over the interior (at least three pixels from any "
        "edge) with its standard error from pixel noise, and ΔE between these means; χ² over the whole "
        "surface. Bold: more than chance (p < 0.001) for differences and χ²; more than "
        "three times noise for ΔE*ab.",
    )  # fmt: skip
    total = c.chi2_edges.count + c.chi2_interiors.count
    share = c.share_of_excess_at_edges
    places = Table(
        ("where", "χ²/dof", "share of the residuals, %", "share of the excess χ², %"),
        [
            (name, _chi2(chi2), number(100 * chi2.count / max(total, 1), 1), number(100 * part, 1))
            for name, chi2, part in (
                ("edges (less than 3 px)", c.chi2_edges, share), ("interiors", c.chi2_interiors, 1 - share),
            )
        ],
        "Edges against interiors.",
    )  # fmt: skip
    return ReportSection("By surface, by band, edges and interiors", (), (surfaces, bands, places))


UNITS = dict(zip(PARAMETER_NAMES, ("mm",) * 3 + ("°",) * 3 + ("px",) * 3 + ("1",), strict=True))
LABELS = dict(zip(PARAMETER_NAMES, (
    "position x", "position y", "position z", "rotation x", "rotation y", "rotation z", "focal length",
    "principal point u", "principal point v", "radial distortion k1"), strict=True))  # fmt: skip


def camera_section(run: Run) -> ReportSection:
    """Camera parameters with their uncertainty, before and after the refit, and the lamp's scale."""

    def sigmas(covariance: NDArray[np.float64] | None) -> NDArray[np.float64]:
        return np.full(len(PARAMETER_NAMES), np.nan) if covariance is None else np.sqrt(np.diag(covariance))

    before = run.calibrated_camera
    header = ["parameter", "unit", "value"]
    if run.camera.covariance is not None:
        header.append("standard deviation")
    if before is not None:
        header += ["from the points alone", "its standard deviation", "moved by, σ"]
    rows = []
    for i, name in enumerate(PARAMETER_NAMES):
        value, sigma = run.camera.parameters[i], sigmas(run.camera.covariance)[i]
        if before is None:
            row = [LABELS[name], UNITS[name], to_error(value, sigma)]
        else:
            old, old_sigma = before.parameters[i], sigmas(before.covariance)[i]
            # the picture tells more than the points: a digit more
            row = [LABELS[name], UNITS[name], to_error(value, np.fmin(sigma, old_sigma / 10))]
        if run.camera.covariance is not None:
            row.append(significant(sigma, 2))
        if before is not None:
            row += [
                to_error(old, old_sigma),
                significant(old_sigma, 2),
                number((value - old) / old_sigma, 2, True),
            ]
        rows.append(row)
    pull = (run.lamp_scale - 1) / run.lamp_scale_prior_sigma
    lamp = Table(
        ("lamp", "fitted", "standard deviation", "stated standard deviation", "moved by, σ"),
        [("scale of its radiance", number(run.lamp_scale, 5), significant(run.lamp_scale_sigma, 2),
          significant(run.lamp_scale_prior_sigma, 2), number(pull, 2, True))],
    )  # fmt: skip
    return ReportSection(
        "Camera and lamp",
        (f"Surveyed points reproject within {significant(run.reprojection_rms_px)} px rms per coordinate.",),
        (
            Table(header, rows, "Rotation: Rodrigues vector against a camera looking along +z, +y up."),
            lamp,
        ),
    )  # fmt: skip


def masks_section(c: Comparison) -> ReportSection:
    """How many pixels are out, and why."""
    total = c.maps.sizes["y"] * c.maps.sizes["x"]
    rows = [(reason, str(n), number(100 * n / total, 2)) for reason, n in c.masked.items()]
    rows.append(("used in every band", str(c.pixels_used), number(100 * c.pixels_used / total, 2)))
    return ReportSection(
        "Pixels left out",
        (),
        (Table(("reason", "pixels", "% of the picture"), rows,
               "Left out in at least one band; a pixel may have several reasons."),),
    )  # fmt: skip
