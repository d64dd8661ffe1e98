"""Sections of the report that show pictures and plots."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import matplotlib
import numpy as np
from cboxlab.calibration.colorimetry import FilterWeights
from cboxlab.calibration.sensor_equation import BandResponse
from matplotlib.colors import LogNorm
from scipy.stats import norm

from .blocks import ReportSection, Table, number, significant
from .compare import Comparison
from .plots import (
    INK,
    LINE,
    STYLE,
    Scale,
    diverging_scale,
    drawing,
    map_row,
    new_figure,
    plain_log_ticks,
    sequential_scale,
)

__all__ = ["maps_section", "residual_section", "scatter_section", "weights_section"]


def maps_section(c: Comparison) -> ReportSection:
    """Colour and luminance differences in the picture."""
    maps = c.maps
    both = np.concatenate([maps["delta_e_ab"].values.ravel(), maps["delta_e_2000"].values.ravel()])
    relative = 100 * maps["luminance_relative_difference"].values
    xyz = np.where(
        np.isfinite(maps["delta_e_ab"].values)[..., None],
        100 * (maps["xyz_measured"].values - maps["xyz_rendered"].values) / c.white.luminance, np.nan,
    )  # fmt: skip
    return ReportSection(
        "Where they differ",
        (
            "Single pixels, noise included. Hatched pixels are left out (masked, the lamp, or outside the "
            "box); values beyond a scale take the colour of its end.",
        ),
        (
            map_row(
                {"ΔE*ab (1976)": maps["delta_e_ab"].values, "CIEDE2000": maps["delta_e_2000"].values},
                sequential_scale(both, "colour difference ΔE", 1.0),
            ),
            map_row(
                {"Luminance Y, (measured − rendered) / rendered": relative},
                diverging_scale(relative, "%", 1.0),
            ),
            map_row(
                {f"Δ{axis}, measured − rendered": xyz[..., i] for i, axis in enumerate("XYZ")},
                diverging_scale(xyz, "% of the white's luminance Yn", 0.5),
            ),
        ),
    )  # fmt: skip


@matplotlib.rc_context(STYLE)
def residual_section(c: Comparison) -> ReportSection:
    """Residual over its standard deviation: by band, by size, by distance from an edge."""
    residual = c.maps["residual_over_sigma"].values
    values = residual[np.isfinite(residual)]
    figure, (left, right) = new_figure(2, 3.3)
    bins = np.linspace(-8, 8, 81)
    left.hist(np.clip(values, -7.99, 7.99), bins, density=True, color="#7aa6c2", label="this comparison")
    left.plot(bins, norm.pdf(bins), color=INK, linewidth=1.1, linestyle=(0, (4, 2)), label="noise alone")
    left.set(yscale="log", ylim=(0.2 / max(values.size, 10), 2), xlabel="(measured − rendered) / σ",
             title="How large the residuals are")  # fmt: skip
    left.legend(loc="upper right", fontsize=8.5)
    left.set_ylabel("share per unit")
    distance = c.maps["edge_distance_px"].values
    limits = np.array([0, 0.4, 1, 2, 3, 4, 6, 8, 12, 16, 24, np.inf])
    labels = ["0", "0.5", "1–2", "2–3", "3–4", "4–6", "6–8", "8–12", "12–16", "16–24", "> 24"]
    ring = [residual[:, (distance >= low) & (distance < high)] for low, high in pairwise(limits)]
    ring = [r[np.isfinite(r)] for r in ring]
    mean = np.array([np.mean(r**2) if r.size else np.nan for r in ring])
    error = np.array([np.sqrt(2 / r.size) if r.size else np.nan for r in ring])
    right.errorbar(np.arange(len(ring)), mean, error, fmt="o", color=LINE, markersize=5, capsize=2)
    right.axhline(1, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    right.axvline(3.5, color=INK, linewidth=0.7, alpha=0.5)
    right.set_xticks(np.arange(len(ring)), labels, rotation=35)
    right.set(xlabel="distance from the nearest edge, px (line: edges | interiors)",
              ylabel="mean (residual / σ)²", title="How much sits at edges")  # fmt: skip
    if np.nanmax(mean, initial=1) > 5:
        right.set_yscale("log")
        plain_log_ticks(right.yaxis)
    return ReportSection(
        "Residual over noise, band by band",
        (
            "σ holds the camera's noise and the render's Monte Carlo error. Where noise explains the "
            "difference, these maps are featureless; structure is a flaw of the model or of the calibration.",
        ),
        (
            map_row({f"{band}  χ²/dof {significant(c.by_band[band].chi2.per_dof)}": residual[i]
                     for i, band in enumerate(c.bands)}, Scale(-5, 5, "residual / σ", "RdBu_r")),
            drawing(figure),
        ),
    )  # fmt: skip


@matplotlib.rc_context(STYLE)
def scatter_section(c: Comparison) -> ReportSection:
    """Measured against rendered, all bands, as a density on logarithmic axes."""
    used = np.isfinite(c.maps["residual_over_sigma"].values) & (c.maps["surface"].values >= 0)
    measured, rendered = c.maps["measured"].values[used], c.maps["rendered"].values[used]
    keep = (measured > 0) & (rendered > 0)
    measured, rendered = measured[keep], rendered[keep]
    figure, (left, right) = new_figure(2, 3.9)
    if measured.size:
        low, high = np.percentile(rendered, 0.01) * 0.8, max(measured.max(), rendered.max()) * 1.15
        span = (np.log10(low), np.log10(high))
        shared: dict[str, Any] = {
            "gridsize": 70, "mincnt": 1, "cmap": "viridis", "norm": LogNorm(), "linewidths": 0,
            "rasterized": True,
        }  # fmt: skip
        density = left.hexbin(rendered, measured, xscale="log", yscale="log", extent=(*span, *span), **shared)
        left.plot([low, high], [low, high], color=INK, linewidth=0.9, alpha=0.8)
        left.set(xlim=(low, high), ylim=(low, high), xlabel="rendered, DN", ylabel="measured, DN",
                 title="Signal")  # fmt: skip
        ratio = 100 * (measured / rendered - 1)
        reach = float(np.percentile(np.abs(ratio), 99))
        right.hexbin(rendered, ratio, xscale="log", extent=(*span, -reach, reach), **shared)
        right.axhline(0, color=INK, linewidth=0.9, alpha=0.8)
        right.set(xlim=(low, high), ylim=(-reach, reach), xlabel="rendered, DN",
                  ylabel="(measured − rendered) / rendered, %", title="Relative difference")  # fmt: skip
        for axis in (left.xaxis, left.yaxis, right.xaxis):
            plain_log_ticks(axis)
        bar = figure.colorbar(density, ax=[left, right], pad=0.015, fraction=0.025)
        bar.set_label("pixels, all bands", color=INK)
        bar.outline.set_visible(False)
    return ReportSection("Measured against rendered", (), (drawing(figure),))


@matplotlib.rc_context(STYLE)
def weights_section(w: FilterWeights, responses: Sequence[BandResponse]) -> ReportSection:
    """Responses of the bands, reconstructed colour-matching functions, and the weights' own error."""
    figure, (left, right) = new_figure(2, 3.4)
    order = np.argsort([np.argmax(r.response) for r in responses])
    highest = max(r.response.max() for r in responses)
    colours = matplotlib.colormaps["turbo"](np.linspace(0.08, 0.9, len(order)))
    for colour, index in zip(colours, order, strict=True):
        wavelength, response = responses[index].wavelength_nm, responses[index].response / highest
        left.plot(wavelength, response, color=colour)
        peak = int(np.argmax(response))
        left.annotate(
            responses[index].band, (wavelength[peak], response[peak]), (0, 3), textcoords="offset points",
            ha="center", fontsize=8,
        )  # fmt: skip
    left.set(title="Response of each band", xlabel="wavelength, nm", ylabel="F × Q × lens × filter, relative")
    thin: dict[str, Any] = {"linewidth": 1.0, "linestyle": (0, (4, 2))}
    for axis, (name, colour) in enumerate((("x̄", "#b5534b"), ("ȳ", "#5b8f55"), ("z̄", "#4a74b4"))):
        right.plot(w.wavelength_nm, w.target[axis], color=colour, **thin)
        right.plot(w.wavelength_nm, w.reconstructed[axis], color=colour, label=name)
    right.plot([], [], color=INK, label="CIE 1931", **thin)
    right.set(title="Reconstructed colour-matching functions", xlabel="wavelength, nm")
    right.legend(fontsize=8, ncols=2)
    error = w.reconstructed - w.target
    rms = np.sqrt(np.mean(error**2, axis=1) / np.mean(w.target**2, axis=1))
    header = ["", *w.bands, "rms error of the curve, %", "noise gain"]
    rows = [
        [
            axis,
            *(significant(1e18 * v) for v in w.weights[i]),
            number(100 * rms[i], 1),
            number(w.noise_gain[i]),
        ]
        for i, axis in enumerate("XYZ")
    ]
    return ReportSection(
        "From bands to colour: the filter weights",
        (
            "XYZ = 683 lm/W Σ b_i S_i / K_i. The weights reconstruct the CIE functions only approximately. "
            "That error is not in the colour differences above, since measured and rendered go through the "
            "same weights; it is how far the absolute colours may be from the truth.",
        ),
        (
            drawing(figure),
            Table(header, rows,
                  "Weights b_i in 1e-18 J per quantum; rms error relative to the rms of the CIE function; "
                  "noise gain: relative noise of X, Y, Z for light of equal energy over that of every band."),
        ),
    )  # fmt: skip
