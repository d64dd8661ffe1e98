"""Sections of the report that show pictures and plots, and its chapters without a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import matplotlib
import numpy as np
from cboxlab.calibration.colour import FilterWeights
from cboxlab.calibration.instrument import BandResponse
from cboxlab.utils.distributions import normal_density
from matplotlib.colors import LogNorm
from numpy.typing import NDArray

from ..compare import COLOUR_DIFFERENCES, HEADLINE, Comparison
from .bands import NamedBand, named_bands
from .blocks import Headline, ReportSection, ReportTable, Story
from .numerals import chi2_text, number, significant
from .plots import (
    COLOUR,
    CURVES,
    INK,
    LINE,
    LUMINANCE,
    STYLE,
    MapRow,
    Scale,
    drawing,
    map_row,
    new_figure,
    plain_log_ticks,
    residual_scale,
)
from .verdict import report_verdict

__all__ = [
    "NOTHING_MISSING",
    "band_maps",
    "beyond_adequate",
    "maps_section",
    "pooled",
    "residual_section",
    "scatter_section",
    "story_without",
    "weights_section",
]

#: Sentence on an adequate model.
NOTHING_MISSING = "This capture shows nothing that the model lacks."

#: Most bands with a map in the report; the viewer shows every band.
_MAX_BANDS = 8

#: Most bands with labels in the plot of their responses: more would overlap.
_MAX_LABELLED_BANDS = 9


#: Margin above axes with a colour bar, inches: the bar's tick labels and its label.
_BAR_INCH = 0.46


def maps_section(c: Comparison) -> ReportSection:
    """Maps of colour and luminance differences.

    Parameters
    ----------
    c
        The comparison.

    Returns
    -------
    ReportSection
        Maps of colour differences, luminance, and X, Y, Z.
    """
    maps = c.maps
    relative = 100 * maps["luminance_relative_difference"].values
    xyz = np.where(
        np.isfinite(maps[HEADLINE.id].values)[..., None],
        100 * (maps["xyz_measured"].values - maps["xyz_rendered"].values) / c.white.luminance,
        np.nan,
    )
    return ReportSection(
        "Maps of colour and luminance differences",
        (
            "The maps show differences of single pixels, noise included. Hatched pixels are left out: masked, the "
            "lamp, or outside the box. Values beyond a scale have the colour of its end. Every report has the same "
            "scales.",
        ),
        (
            map_row(
                {COLOUR_DIFFERENCES[name].title: maps[name].values for name in c.colour},
                Scale(0.0, COLOUR, "colour difference ΔE", "cividis"),
            ),
            map_row(
                {"Luminance Y, (photograph − rendering) / rendering": relative},
                Scale(-LUMINANCE, LUMINANCE, "%", "RdBu_r"),
            ),
            map_row(
                {f"Δ{axis}, photograph − rendering": xyz[..., i] for i, axis in enumerate("XYZ")},
                Scale(-COLOUR, COLOUR, "% of the white's luminance Yn", "RdBu_r"),
            ),
        ),
    )


def band_maps(c: Comparison, bands: Sequence[NamedBand]) -> MapRow:
    """Maps of residuals over sigma of the bands with the highest chi2, by wavelength.

    Parameters
    ----------
    c
        The comparison.
    bands
        Bands in the order of the page.

    Returns
    -------
    MapRow
        A map per band.
    """
    residual = c.maps["residual_over_sigma"].values
    rows = list(c.by_band.values())
    most = sorted((i for i, _ in bands), key=lambda i: -rows[i].chi2.per_dof)[:_MAX_BANDS]
    maps = {f"{name}, χ²/dof {chi2_text(rows[i].chi2.per_dof)}": residual[i] for i, name in bands if i in most}
    caption = "" if len(maps) == len(rows) else f"The {len(maps)} bands of {len(rows)} with the highest χ²/dof."
    return map_row(maps, residual_scale("(photograph − rendering) / σ"), caption)


@matplotlib.rc_context(STYLE)
def residual_section(c: Comparison) -> ReportSection:
    """Distribution of the residuals over sigma, and their dependence on the distance from edges.

    Parameters
    ----------
    c
        The comparison.

    Returns
    -------
    ReportSection
        Two plots.
    """
    residual = c.maps["residual_over_sigma"].values
    values = residual[np.isfinite(residual)]
    (first, left), (second, right) = new_figure(), new_figure()
    bins = np.linspace(-8, 8, 81)
    left.hist(np.clip(values, -7.99, 7.99), list(bins), density=True, color=LINE, label="this comparison")
    left.plot(bins, normal_density(bins), color=INK, linewidth=1.1, linestyle=(0, (4, 2)), label="noise alone")
    left.set(
        yscale="log",
        ylim=(0.2 / max(values.size, 10), 9),
        xlabel="(photograph − rendering) / σ",
        ylabel="share per unit",
        title="Distribution of the residuals",
    )
    left.set_xticks(np.arange(-8, 9, 4), ["≤ −8", "−4", "0", "4", "≥ 8"])
    left.legend(loc="upper left", ncols=2)
    plain_log_ticks(left.yaxis)
    inside = c.maps["surface"].values >= 0
    distance = c.maps["edge_distance_px"].values
    limits = np.array([0, 1, 2, 3, 4, 6, 8, 12, 16, 24, np.inf])
    labels = ["<1", "1", "2", "3", "4", "6", "8", "12", "16", "≥24"]
    ring = [residual[:, inside & (distance >= low) & (distance < high)] for low, high in pairwise(limits)]
    ring = [r[np.isfinite(r)] for r in ring]
    mean = np.array([np.mean(r**2) if r.size else np.nan for r in ring])
    error = np.array([np.sqrt(2 / r.size) if r.size else np.nan for r in ring])
    right.errorbar(np.arange(len(ring)), mean, error, fmt="o", color=LINE, markersize=5, capsize=2)
    right.axhline(1, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    right.axvline(2.5, color=INK, linewidth=0.7, alpha=0.5)
    right.set_xticks(np.arange(len(ring)), labels)
    right.set(
        xlabel="px from the nearest edge, from (line: 3 px)", ylabel="χ²/dof", title="Surfaces by distance from edges"
    )
    if np.nanmax(mean, initial=1) > 5:
        right.set_yscale("log")
        plain_log_ticks(right.yaxis)
    return ReportSection(
        "Residuals: distribution, and distance from edges",
        (
            "σ includes the camera's noise and the Monte Carlo error of the rendering. If noise explains the "
            "difference, the distribution follows the dashed line and the points lie at 1.",
        ),
        (drawing(first, second),),
    )


@matplotlib.rc_context(STYLE)
def scatter_section(c: Comparison) -> ReportSection:
    """Measured against rendered signals of all bands, as densities of pixels.

    Parameters
    ----------
    c
        The comparison.

    Returns
    -------
    ReportSection
        Two plots; empty axes without light.
    """
    used = np.isfinite(c.maps["residual_over_sigma"].values) & (c.maps["surface"].values >= 0)
    measured, rendered = c.maps["measured"].values[used], c.maps["rendered"].values[used]
    keep = (measured > 0) & (rendered > 0)
    measured, rendered = measured[keep], rendered[keep]
    (first, left), (second, right) = new_figure(3.9, _BAR_INCH), new_figure(3.9, _BAR_INCH)
    if measured.size:
        low, high = np.percentile(rendered, 0.01) * 0.8, max(measured.max(), rendered.max()) * 1.15
        span = (np.log10(low), np.log10(high))
        shared: dict[str, Any] = {
            "gridsize": 60,
            "mincnt": 1,
            "cmap": "cividis",
            "norm": LogNorm(),
            "linewidths": 0,
            "rasterized": True,
        }
        density = left.hexbin(rendered, measured, xscale="log", yscale="log", extent=(*span, *span), **shared)
        left.plot([low, high], [low, high], color=INK, linewidth=0.9, alpha=0.8)
        left.set(
            xlim=(low, high),
            ylim=(low, high),
            xlabel="rendering, DN",
            ylabel="photograph, DN",
        )
        ratio = 100 * (measured / rendered - 1)
        reach = float(np.percentile(np.abs(ratio), 99))
        spread = right.hexbin(rendered, ratio, xscale="log", extent=(*span, -reach, reach), **shared)
        right.axhline(0, color=INK, linewidth=0.9, alpha=0.8)
        right.set(
            xlim=(low, high),
            ylim=(-reach, reach),
            xlabel="rendering, DN",
            ylabel="(photograph − rendering) / rendering, %",
        )
        for axis in (left.xaxis, left.yaxis, right.xaxis):
            plain_log_ticks(axis)
        for figure, axes, density_map in ((first, left, density), (second, right, spread)):
            bar = figure.colorbar(density_map, ax=axes, location="top", pad=0.02, fraction=0.05, aspect=40)
            bar.set_label("pixels, all bands", color=INK)
            bar.outline.set_visible(False)
            plain_log_ticks(bar.ax.xaxis)
    return ReportSection("Measured against rendered", (), (drawing(first, second),))


@matplotlib.rc_context(STYLE)
def weights_section(w: FilterWeights, responses: Sequence[BandResponse]) -> ReportSection:
    """Section on the filter weights: responses, colour-matching functions, errors.

    Parameters
    ----------
    w
        Filter weights.
    responses
        Responses that they were fitted to.

    Returns
    -------
    ReportSection
        Two plots and the table of the weights.
    """
    (first, left), (second, right) = new_figure(3.4), new_figure(3.4)
    highest = max(r.response.max() for r in responses)
    order = [i for i, _ in named_bands([r.band for r in responses], responses)]
    for index in order:
        wavelength, response = responses[index].wavelength_nm, responses[index].response / highest
        left.plot(wavelength, response, color=LINE, linewidth=1.2)
    if len(order) <= _MAX_LABELLED_BANDS:
        for index in order:
            wavelength, response = responses[index].wavelength_nm, responses[index].response / highest
            peak = int(np.argmax(response))
            left.annotate(
                responses[index].band,
                (wavelength[peak], response[peak]),
                (0, 3),
                textcoords="offset points",
                ha="center",
            )
    left.set(
        title="Response of each band",
        xlabel="wavelength, nm",
        ylabel="lens × filter × Q, relative",
        ylim=(0, 1.12),
    )
    thin: dict[str, Any] = {"linewidth": 1.0, "linestyle": (0, (4, 2))}
    for axis, (name, colour) in enumerate(zip(("x̄", "ȳ", "z̄"), CURVES, strict=True)):
        right.plot(w.wavelength_nm, w.target[axis], color=colour, **thin)
        right.plot(w.wavelength_nm, w.reconstructed[axis], color=colour, label=name)
    right.plot([], [], color=INK, label="CIE 1931", **thin)
    right.set(title="Colour-matching functions", xlabel="wavelength, nm")
    right.legend(ncols=2)
    error = w.reconstructed - w.target
    rms = np.sqrt(np.mean(error**2, axis=1) / np.mean(w.target**2, axis=1))
    header = ["band", *"XYZ"]
    rows = [
        *([w.bands[k], *(significant(1e18 * weight) for weight in w.weights[:, k])] for k in order),
        ["rms error of the curve, %", *(number(100 * value, 1) for value in rms)],
        ["noise gain", *(number(gain) for gain in w.noise_gain)],
    ]
    return ReportSection(
        "From bands to colour: the filter weights",
        (
            "XYZ = 683 lm/W Σ b_i S_i / K_i. S_i is the corrected signal of band i in DN. K_i = C t / (N² d²) is the "
            "factor from the band's integral of radiance times response to DN. The weights reconstruct the CIE "
            "functions only approximately. This error affects the absolute colours. It does not affect the colour "
            "differences above, since measured and rendered colours use the same weights. Training selects weights by "
            "the colours of likely spectra, so that the curves of trained weights may be far from the CIE functions.",
        ),
        (
            drawing(first, second),
            ReportTable(
                header,
                rows,
                "Weights b_i in 1e-18 J per quantum. The rms error is relative to the rms of the CIE function. The "
                "noise gain is the relative noise of X, Y, Z for light of equal energy, over that of every band.",
            ),
        ),
    )


def pooled(values: NDArray) -> NDArray[np.float64]:
    """Sum over the bands used, over its standard deviation.

    Parameters
    ----------
    values
        (band, y, x) values over sigma; NaN where a sample is left out.

    Returns
    -------
    NDArray
        (y, x) with the noise of one band; NaN without a band.
    """
    used = np.isfinite(values)
    count = used.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, np.where(used, values, 0.0).sum(axis=0) / np.sqrt(count), np.nan)


def story_without(c: Comparison, bands: Sequence[NamedBand]) -> Story:
    """Chapters of a comparison without a diagnosis.

    Parameters
    ----------
    c
        The comparison.
    bands
        Bands in the order of the page.

    Returns
    -------
    Story
        The verdict, and the advice to run a diagnosis where the model is not adequate.
    """
    result = report_verdict(c, bands)
    residual = pooled(c.maps["residual_over_sigma"].values)
    picture = map_row({"Photograph minus rendering, all bands": residual}, residual_scale())
    adequate = result.level == "explained"
    sentence = (
        "The model is adequate: noise explains the difference."
        if adequate
        else f"{result.headline} No diagnosis looked for the cause."
    )
    advice = (
        "Run a diagnosis of this capture: it tries every effect of the catalogue and names those that the model lacks."
    )
    return Story(
        Headline(sentence, result.details, picture),
        ReportSection(
            "What is missing",
            (NOTHING_MISSING if adequate else "No diagnosis looked for the cause.",),
        ),
        None,
        ReportSection("What to do next", steps=beyond_adequate() if adequate else (advice,)),
    )


def beyond_adequate() -> tuple[str, ...]:
    """Steps after the result that the model is adequate.

    Returns
    -------
    tuple
        Sentences.
    """
    return (
        "You need not add anything to the model.",
        "If you take more frames per band, the noise falls and may reveal smaller errors of the model.",
    )
