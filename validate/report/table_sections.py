"""Sections of the report that are tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.calibration.instrument import chromaticity
from cboxlab.scenes.camera import PARAMETER_NAMES
from numpy.typing import NDArray

from ..compare import (
    COLOUR_DIFFERENCES,
    HEADLINE,
    OUTSIDE,
    ChiSquare,
    Comparison,
    Failure,
    Part,
    Region,
    SurfaceRow,
    regions_of,
)
from .bands import NamedBand
from .blocks import Cell, ReportSection, ReportTable
from .metrics import ValidationFacts
from .numerals import chi2_text, number, percent, significant, to_error
from .plots import MapRow
from .verdict import report_verdict

__all__ = ["camera_section", "correlation_section", "masks_section", "parts_section", "tables_section", "where_section"]


#: Caption of the first table of chi2, with the definition for the entire page.
_DEFINITION = (
    "By place. On this page, χ² is the sum of ((photograph − rendering) / σ)². σ includes the noise of the camera and "
    "of the rendering. Noise alone gives 1 per degree of freedom (dof); the excess is the part above it."
)


def _chi2(chi2: ChiSquare) -> Cell:
    beyond = chi2.dof > 0 and chi2.p_value < 1e-3
    return Cell(chi2_text(chi2.per_dof), f"± {number(chi2.per_dof_sigma, 3)}", beyond)


def _regions(
    header: str, regions: Sequence[Region], caption: str, every: ChiSquare, names: Sequence[str] | None = None
) -> ReportTable:
    """A partition of the residuals with a row for all of them."""
    rows = [
        (name, _chi2(r.chi2), percent(r.share_of_residuals), percent(r.share_of_excess))
        for name, r in zip(names or [r.name for r in regions], regions, strict=True)
    ]
    total = sum(r.share_of_residuals for r in regions), sum(r.share_of_excess for r in regions)
    return ReportTable(
        (header, "χ²/dof", "share of the residuals, %", "share of the excess χ², %"),
        [*rows, ("all", _chi2(every), percent(total[0]), percent(total[1]))],
        caption,
    )


def where_section(
    c: Comparison, bands: Sequence[NamedBand], failures: Sequence[Failure], maps: MapRow
) -> ReportSection:
    """Section on the excess by place, surface and band, each summing to 100 %.

    Parameters
    ----------
    c
        The comparison.
    bands
        Bands in the order of the page.
    failures
        Ranked list of where the model fails.
    maps
        Maps of the bands.

    Returns
    -------
    ReportSection
        Sentences, maps and three tables.
    """
    regions = regions_of(c)
    by_band = [regions["band"][i] for i, _ in bands]
    sentences = ["Noise explains the difference: there is no excess to locate."]
    if np.isfinite(regions["place"][0].share_of_excess) and (failures or report_verdict(c).level != "explained"):
        worst = max(regions["place"], key=lambda r: r.share_of_excess)
        sentences = [f.sentence for f in failures] or [
            f"Most of the excess χ² is {_in_place(worst.name)}: {percent(worst.share_of_excess, 0)} %, with "
            f"{percent(worst.share_of_residuals, 0)} % of the residuals."
        ]
        if len(failures) > 1:
            sentences.append(
                "A residual counts in one of these groups only, so that whole surfaces have other numbers."
            )
    return ReportSection(
        "Where it fails",
        sentences,
        (
            maps,
            _regions("place", regions["place"], _DEFINITION, c.chi2),
            _regions("surface", regions["surface"], "By surface, its edges included.", c.chi2),
            _regions("band", by_band, "By band.", c.chi2, [name for _, name in bands]),
        ),
    )


def _in_place(region: str) -> str:
    """Name of a region with its preposition."""
    return region if region == OUTSIDE else f"in {region}" if region.startswith("interiors") else f"on {region}"


def tables_section(c: Comparison, bands: Sequence[NamedBand]) -> ReportSection:
    """Tables of differences by surface and by band.

    Parameters
    ----------
    c
        The comparison.
    bands
        Bands in the order of the page.

    Returns
    -------
    ReportSection
        Relative and colour differences and luminance by surface, relative differences by band.
    """
    by_band = list(c.by_band.items())
    rows = [(name, by_band[i][1]) for i, name in bands]
    band_table = ReportTable(
        ("band", "mean difference, %", "rms difference, %", "rms of noise, %", "beyond noise, %"),
        [
            (
                name,
                number(100 * row.relative.mean, 3, True),
                number(100 * row.relative.rms),
                number(100 * row.relative.rms_noise),
                number(100 * row.beyond_noise, 2),
            )
            for name, row in rows
        ],
        "By band: (photograph − rendering) / rendering over all pixels of surfaces. 'Beyond noise' is the rms "
        "difference that noise does not explain, relative to the rms signal.",
    )
    surfaces = ReportTable(
        (
            "surface",
            *(f"{name}, %" for _, name in bands),
            *(COLOUR_DIFFERENCES[name].label for name in c.colour),
            "interior px",
        ),
        [
            (
                name,
                *(
                    Cell(
                        number(100 * row.relative[i], 2, True),
                        f"± {number(100 * row.relative_sigma[i])}",
                        bool(abs(row.relative[i]) > 3.3 * row.relative_sigma[i]),
                    )
                    for i, _ in bands
                ),
                *_colours(row),
                f"{row.interior_pixels}",
            )
            for name, row in c.by_surface.items()
        ],
        "By surface: relative difference of the means over the interior (at least three pixels from any edge) with its "
        "standard error from pixel noise, and colour differences between these means. Bold values are significant "
        f"(p < 0.001), or {HEADLINE.label} above three times its expectation from noise.",
    )
    return ReportSection("Differences by surface and by band", (), (surfaces, _luminances(c), band_table))


def _colours(row: SurfaceRow) -> list[str | Cell]:
    """Colour differences of a surface; the headline's with its expectation from noise."""
    cells: dict[str, str | Cell] = {name: number(value) for name, value in row.colour.items()}
    value, noise = row.colour[HEADLINE.id], row.colour_noise[HEADLINE.id]
    cells[HEADLINE.id] = Cell(number(value), f"noise {number(noise)}", bool(value > 3 * noise))
    return list(cells.values())


def _luminances(c: Comparison) -> ReportTable:
    """Table of luminance and chromaticity of photograph and rendering, by surface."""

    def cells(xyz: NDArray[np.float64]) -> list[str]:
        return [significant(float(xyz[1]), 4), *(number(value, 4) for value in chromaticity(xyz))]

    return ReportTable(
        ("surface", "photograph, cd/m²", "x", "y", "rendering, cd/m²", "x", "y", "interior px"),
        [
            (name, *cells(row.xyz_measured), *cells(row.xyz_rendered), f"{row.interior_pixels}")
            for name, row in c.by_surface.items()
        ],
        "By surface: mean luminance and CIE 1931 chromaticity of photograph and rendering over the same interiors, "
        "both computed with the filter weights.",
    )


#: Unit of each camera parameter.
UNITS = dict(zip(PARAMETER_NAMES, ("mm",) * 3 + ("°",) * 3 + ("px",) * 3 + ("1",), strict=True))
#: Label of each camera parameter.
LABELS = dict(
    zip(
        PARAMETER_NAMES,
        (
            "position x",
            "position y",
            "position z",
            "rotation x",
            "rotation y",
            "rotation z",
            "focal length",
            "principal point u",
            "principal point v",
            "radial distortion k1",
        ),
        strict=True,
    )
)


def camera_section(run: ValidationFacts) -> ReportSection:
    """Section on the camera before and after the refit, and on the lamp's scale.

    Parameters
    ----------
    run
        Data of the validation.

    Returns
    -------
    ReportSection
        Two tables.
    """

    def sigmas(covariance: NDArray[np.float64] | None) -> NDArray[np.float64]:
        return np.full(len(PARAMETER_NAMES), np.nan) if covariance is None else np.sqrt(np.diag(covariance))

    before = run.calibrated_camera
    header = ["parameter", "unit", "value"]
    if run.camera.covariance is not None:
        header.append("standard deviation")
    if before is not None:
        header += ["from the points only", "its standard deviation", "change, σ"]
    rows = []
    for i, name in enumerate(PARAMETER_NAMES):
        value, sigma = run.camera.parameters[i], sigmas(run.camera.covariance)[i]
        if before is None:
            row = [LABELS[name], UNITS[name], to_error(value, sigma)]
        else:
            old, old_sigma = before.parameters[i], sigmas(before.covariance)[i]
            # one more digit, since the picture determines the camera better than the points
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
    lamp = ReportTable(
        ("lamp", "fitted", "standard deviation", "stated standard deviation", "change, σ"),
        [
            (
                "scale of its radiance",
                number(run.lamp_scale, 5),
                significant(run.lamp_scale_sigma, 2),
                significant(run.lamp_scale_prior_sigma, 2),
                number(pull, 2, True),
            )
        ],
    )
    return ReportSection(
        "Camera and lamp",
        (f"Reprojection error of the surveyed points: {significant(run.reprojection_rms_px)} px rms per coordinate.",),
        (
            ReportTable(
                header, rows, "The rotation is a Rodrigues vector, relative to a camera that looks along +z with +y up."
            ),
            lamp,
        ),
    )


def masks_section(c: Comparison) -> ReportSection:
    """Numbers of pixels left out, by reason.

    Parameters
    ----------
    c
        The comparison.

    Returns
    -------
    ReportSection
        One table.
    """
    total = c.maps.sizes["y"] * c.maps.sizes["x"]
    rows = [(reason, str(n), number(100 * n / total, 2)) for reason, n in c.masked.items()]
    rows.append(("used in every band", str(c.pixels_used), number(100 * c.pixels_used / total, 2)))
    return ReportSection(
        "Pixels left out",
        (),
        (
            ReportTable(
                ("reason", "pixels", "% of the picture"),
                rows,
                "These pixels are left out in at least one band. A pixel may have several reasons.",
            ),
        ),
    )


def parts_section(c: Comparison, subsets: Sequence[Part]) -> ReportSection:
    """Section on the excess by kind of light, paint and part of the picture.

    Parameters
    ----------
    c
        The comparison.
    subsets
        Subsets of the residuals; those by band, surface and edge distance have other tables.

    Returns
    -------
    ReportSection
        One table.
    """
    z = c.maps["residual_over_sigma"].values
    used = np.isfinite(z)
    excess = np.where(used, np.nan_to_num(z) ** 2 - 1, 0.0)
    total = float(excess.sum())
    rows = []
    for part in subsets:
        members = part.where & used
        if not members.any() or part.kind in ("band", "surface", "edge distance"):
            continue
        share = float(excess[members].sum())
        rows.append(
            (
                part.label,
                number(100 * members.sum() / used.sum(), 0),
                number(100 * share / total if total > 0 else np.nan, 0),
                chi2_text(1 + share / members.sum()),
            )
        )
    table = ReportTable(
        ("where", "residuals, %", "excess χ², %", "χ²/dof"),
        rows,
        "These parts overlap. Light is direct if the visible surface is the first that reflects it. The model "
        "determines the shares of light.",
    )
    return ReportSection("Excess by kind of light and part of the picture", (), (table,))


def correlation_section(
    names: Sequence[str], correlations: NDArray[np.float64], sentences: Sequence[str]
) -> ReportSection:
    """Section on the correlations of fitted numbers.

    Parameters
    ----------
    names
        Effect and parameter of each number.
    correlations
        (n, n) correlations, -1 to 1; NaN where there is none.
    sentences
        Sentence for each strong correlation.

    Returns
    -------
    ReportSection
        For ``write_validation``.
    """
    rows = [(name, *(number(value, 2) for value in row)) for name, row in zip(names, correlations, strict=True)]
    caption = "Correlation of the errors of two fitted numbers; camera and lamp are free within their priors."
    return ReportSection("Correlations of fitted numbers", sentences, (ReportTable(("", *names), rows, caption),))
