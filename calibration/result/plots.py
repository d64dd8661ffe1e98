"""Plots of a calibration: noise, dark level, response to each setting, filter weights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from ..detector import LAWS, ResponseSeries, light_series
from ..instrument import Mask
from .calibrate import Calibration

__all__ = ["plot_curve", "plot_dark", "plot_filters", "plot_noise", "plot_response"]

#: Resolution of the pictures, dots per inch.
_DOTS_PER_INCH = 110

#: Most bands in a legend; one with more would cover the plot.
_MOST_NAMED = 16


#: Margins of the figures, inches: left for numbers and a label, right, below the same, and above for a title.
_MARGINS_INCH = (0.9, 0.15, 0.75, 0.35)

#: Space between two rows of axes, and between columns, as parts of the axes: for a title, or for numbers and a label.
_BETWEEN_AXES = (0.12, 0.35)


def _new_figure(width_inch: float, height_inch: float) -> Figure:
    """Empty figure with fixed margins.

    A layout engine would draw every figure once more to measure its letters.
    """
    figure = Figure(figsize=(width_inch, height_inch))
    left, right, bottom, top = _MARGINS_INCH
    figure.subplots_adjust(
        left=left / width_inch,
        right=1 - right / width_inch,
        bottom=bottom / height_inch,
        top=1 - top / height_inch,
        hspace=_BETWEEN_AXES[0],
        wspace=_BETWEEN_AXES[1],
    )
    return figure


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=_DOTS_PER_INCH, metadata={"Software": None})


def plot_noise(calibration: Calibration, path: Path) -> None:
    """Standard deviation of one count against its charge: the noise model and measured repeats.

    Parameters
    ----------
    calibration
        Calibration with its noise model and bands.
    path
        File to write (PNG).
    """
    figure = _new_figure(7, 5)
    axes = figure.subplots()
    noise, capture = calibration.noise, calibration.capture
    if capture.is_merged:  # no full scale: four decades below the brightest value
        brightest = max(float(capture.frames(band).max()) for band in capture.manifest.band)
        charge = np.geomspace(1e-4 * brightest, brightest, 200)
    else:
        charge = np.geomspace(0.5, capture.saturation_dn, 200)
    few_bands = len(capture.manifest.band) <= _MOST_NAMED
    axes.loglog(charge, np.sqrt(noise.variance(charge)), color="black", label="shot, read and rounding noise")
    for index, band in enumerate(capture.manifest.band):
        if len(band.frames) < 2:
            continue
        stack = capture.frames(band).astype(float)
        good = calibration.images["mask"].values[index] & np.uint8(Mask.SATURATED | Mask.OTHER_CHANNEL) == 0
        level = (stack.mean(axis=0) - calibration.dark.bias)[good]
        variance = stack.var(axis=0, ddof=1)[good]
        edges = np.quantile(level, np.linspace(0, 1, 13))
        which = np.clip(np.searchsorted(edges, level) - 1, 0, 11)
        size = np.maximum(np.bincount(which, minlength=12), 1)
        mean, spread = (np.bincount(which, values, 12) / size for values in (level, variance))
        positive = (mean > 0) & (spread > 0)
        axes.plot(mean[positive], np.sqrt(spread[positive]), ".", label=f"{band.id}, repeats" if few_bands else None)
    title = "Noise" if few_bands else "Noise, and the repeats of every band"
    axes.set(xlabel="count above bias (DN)", ylabel="standard deviation of one count (DN)", title=title)
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
    _save(figure, path)


def plot_dark(calibration: Calibration, path: Path) -> None:
    """Dark level of all pixels against exposure: median and the 1st and 99th percentiles.

    Parameters
    ----------
    calibration
        Calibration with darks.
    path
        File to write (PNG).
    """
    figure = _new_figure(7, 5)
    axes = figure.subplots()
    dark, fit = calibration.dark, calibration.sensor.dark_fit
    if fit is not None:
        line = fit.bias_dn + fit.rate_dn_s * fit.exposure_s
        axes.plot(fit.exposure_s, line, "--", color="tab:red", label=f"line, rms {fit.rms_dn:.2g} DN")
        axes.legend(fontsize="small")
    low, middle, high = np.percentile(dark.level.reshape(dark.exposure_s.size, -1), [1, 50, 99], axis=1)
    axes.errorbar(dark.exposure_s, middle, [middle - low, high - middle], fmt="o-", capsize=4, color="black")
    axes.set(xlabel="exposure (s)", ylabel="dark level (DN): median, 1st to 99th percentile", title="Dark level")
    axes.grid(alpha=0.3)
    _save(figure, path)


def plot_filters(calibration: Calibration, path: Path) -> None:
    """The bands' responses, and the colour-matching functions with their reconstruction.

    Parameters
    ----------
    calibration
        Calibration with filter weights.
    path
        File to write (PNG).

    Raises
    ------
    ValueError
        If the calibration has no filter weights.
    """
    weights, responses, colour_study = calibration.weights, calibration.responses, calibration.colour
    if weights is None or responses is None or colour_study is None:
        raise ValueError("the calibration has no filter weights")
    figure = _new_figure(8, 8)
    top, bottom = figure.subplots(2, 1, sharex=True)
    largest = max(float(response.response.max()) for response in responses)
    for response in responses:
        top.plot(WAVELENGTH_NM, response.response / largest, label=response.band)
    top.set(ylabel="response F Q T_lens T_i (largest = 1)", title="Bands")
    if len(responses) <= _MOST_NAMED:
        top.legend(fontsize="small", ncols=4)
    methods = {method: colour_study.weights[method] for method in ("least squares", weights.method)}
    for index, (name, colour) in enumerate(zip("xyz", ("tab:red", "tab:green", "tab:blue"), strict=True)):
        bottom.plot(WAVELENGTH_NM, weights.target[index], color=colour, label=f"CIE 1931 {name}")
        for (method, curves), style in zip(methods.items(), (":", "--"), strict=False):
            label = f"{method}, rms {curves.residual_rms[index]:.3f}"
            bottom.plot(WAVELENGTH_NM, curves.reconstructed[index], style, color=colour, lw=1, label=label)
    bottom.set(xlabel="wavelength (nm)", ylabel="colour-matching functions", title="Reconstruction sum b F")
    bottom.legend(fontsize="small", ncols=3)
    for axes in (top, bottom):
        axes.grid(alpha=0.3)
    _save(figure, path)


def plot_response(responses: Sequence[ResponseSeries], path: Path) -> None:
    """Signal against each setting that was varied, with the fitted law and its residuals.

    Parameters
    ----------
    responses
        Series of one band and one setting each.
    path
        File to write (PNG).
    """
    keys = [key for key in LAWS if any(s.key == key for s in responses)]
    figure = _new_figure(4.2 * len(keys), 6)
    rows = figure.subplots(2, len(keys), sharex="col", squeeze=False, height_ratios=(3, 1))
    for key, top, bottom in zip(keys, rows[0], rows[1], strict=True):
        law = LAWS[key]
        for series in (s for s in responses if s.key == key):
            fit = series.fit
            dots = top.plot(fit.setting, fit.signal, "o", ms=4, label=f"{series.band} {series.source}")
            grid = np.geomspace(fit.setting.min(), fit.setting.max(), 100)
            top.plot(grid, fit.slope * grid**law.power, lw=1, color=dots[0].get_color())
            errors = 100 * fit.sigma / fit.signal
            bottom.errorbar(fit.setting, 100 * fit.residual, errors, fmt="o", ms=4, color=dots[0].get_color())
        how = "proportional" if law.power == 1 else "inverse square"
        top.set(title=f"{law.setting}: {how}", ylabel="signal (DN)", xscale="log", yscale="log")
        bottom.set(xlabel=f"{law.setting} ({law.unit})", ylabel="residual (%)")
        top.legend(fontsize="x-small")
        bottom.axhline(0, color="black", lw=0.8)
        marks = np.unique(np.concatenate([s.fit.setting for s in responses if s.key == key]))
        bottom.set_xticks(marks, [f"{mark:.3g}" for mark in marks], rotation=60, fontsize="small")
        bottom.xaxis.set_minor_locator(NullLocator())
        for axes in (top, bottom):
            axes.grid(alpha=0.3)
    _save(figure, path)


def plot_curve(calibration: Calibration, path: Path) -> None:
    """Curve from counts to linear light, all series scaled to it, and the residuals.

    Parameters
    ----------
    calibration
        Calibration with a curve.
    path
        File to write (PNG).

    Raises
    ------
    ValueError
        If the calibration has no curve.
    """
    curve = calibration.sensor.curve
    if curve is None:
        raise ValueError("the calibration has no curve")
    figure = _new_figure(7, 6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    top.plot(curve.knot_count, curve.knot_value, color="black", label="calibration curve")
    start = 0
    for series in light_series(calibration.sensor.points):
        if series.name not in curve.scales:
            continue
        top.plot(series.count, curve.scales[series.name] * series.light, "o", ms=4, label=series.name)
        residual = curve.residual[start : start + series.count.size]
        bottom.plot(series.count, 100 * residual, "o", ms=4)
        start += series.count.size
    bottom.axhline(0, color="black", lw=0.8)
    top.set(ylabel="linear light (full scale = 1)", title="Counts and light")
    bottom.set(xlabel="count (DN)", ylabel="residual (% of full scale)")
    top.legend(fontsize="x-small")
    for axes in (top, bottom):
        axes.grid(alpha=0.3)
    _save(figure, path)
