"""Figures of a comparison for publications: maps and plots with units."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import matplotlib
import numpy as np
from cboxlab.utils.distributions import normal_density
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..compare import COLOUR_DIFFERENCES, Comparison
from .bands import NamedBand
from .plots import COLOUR, LINE, LUMINANCE, RESIDUAL, STYLE, plain_log_ticks

__all__ = ["FIGURES", "comparison_figure"]

#: Width and height of one map, inches.
_MAP_INCH = (2.3, 2.2)

#: Most maps in a row.
_MAX_COLUMNS = 4

#: Text and axes: black, for paper.
_INK = "black"

#: Label of relative differences, in two lines: one would be longer than a map is high.
_RELATIVE = "(photograph − rendering)\n/ rendering, %"

#: Largest share of the colour map that lines have: its end is too bright for white paper.
_BRIGHTEST_LINE = 0.8

#: Share of the pixels that the scale of signals covers; the lamp is brighter.
_BRIGHT_PERCENTILE = 99.5


def _maps(images: Mapping[str, NDArray[np.float64]], label: str, low: float, high: float, colours: str) -> Figure:
    """Figure of maps on one scale, their axes in pixels; grey where a pixel is left out."""
    rows = -(-len(images) // _MAX_COLUMNS)
    columns = -(-len(images) // rows)
    figure = Figure(figsize=(_MAP_INCH[0] * columns + 1.1, _MAP_INCH[1] * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    colormap = matplotlib.colormaps[colours].with_extremes(bad="0.6")
    for axis, (name, image) in zip(axes.flat, images.items(), strict=False):
        picture = axis.imshow(image, cmap=colormap, vmin=low, vmax=high, interpolation="nearest")
        axis.set_title(name)
        axis.grid(visible=False)
    for axis in axes.flat[len(images) :]:
        axis.set_axis_off()
    for axis in axes.flat[max(len(images) - columns, 0) : len(images)]:
        axis.tick_params(labelbottom=True)  # no map is below
    figure.supxlabel("u, px")
    figure.supylabel("v, px")
    figure.colorbar(picture, ax=list(axes.flat), label=label, extend="both" if low < 0 else "max")
    return figure


def _of_bands(values: NDArray[np.float64], bands: Sequence[NamedBand]) -> dict[str, NDArray[np.float64]]:
    return {name: values[index] for index, name in bands}


def _difference(c: Comparison, bands: Sequence[NamedBand]) -> Figure:
    residual = _of_bands(c.maps["residual_over_sigma"].values, bands)
    return _maps(residual, "(photograph − rendering) / σ", -RESIDUAL, RESIDUAL, "RdBu_r")


def _relative(c: Comparison, bands: Sequence[NamedBand]) -> Figure:
    measured, rendered = c.maps["measured"].values, c.maps["rendered"].values
    is_used = np.isfinite(c.maps["residual_over_sigma"].values) & (rendered > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        percent = np.where(is_used, 100 * (measured / rendered - 1), np.nan)
    return _maps(_of_bands(percent, bands), _RELATIVE, -LUMINANCE, LUMINANCE, "RdBu_r")


def _signals(name: str, label: str) -> Callable[[Comparison, Sequence[NamedBand]], Figure]:
    """Function that draws signals; photograph and rendering have the same scale."""

    def draw(c: Comparison, bands: Sequence[NamedBand]) -> Figure:
        both = [c.maps[each].values for each in ("measured", "rendered")]
        high = float(np.nanpercentile(both, _BRIGHT_PERCENTILE))
        return _maps(_of_bands(c.maps[name].values, bands), label, 0.0, high, "cividis")

    return draw


def _colour(c: Comparison, bands: Sequence[NamedBand]) -> Figure:
    images = {COLOUR_DIFFERENCES[name].label: c.maps[name].values for name in c.colour}
    return _maps(images, "colour difference ΔE", 0.0, COLOUR, "cividis")


def _luminance(c: Comparison, bands: Sequence[NamedBand]) -> Figure:
    image = 100 * c.maps["luminance_relative_difference"].values
    label = _RELATIVE
    return _maps({"luminance Y": image}, label, -LUMINANCE, LUMINANCE, "RdBu_r")


def _plot(x_label: str, y_label: str) -> tuple[Figure, matplotlib.axes.Axes]:
    figure = Figure(figsize=(4.2, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel=x_label, ylabel=y_label)
    return figure, axes


def _residuals(c: Comparison, bands: Sequence[NamedBand]) -> Figure:
    values = c.maps["residual_over_sigma"].values
    values = values[np.isfinite(values)]
    bins = np.linspace(-8, 8, 81)
    figure, axes = _plot("(photograph − rendering) / σ", "share per unit")
    axes.hist(np.clip(values, -7.99, 7.99), list(bins), density=True, color=LINE, label="this comparison")
    axes.plot(bins, normal_density(bins), color=_INK, linestyle=(0, (4, 2)), label="noise alone")
    axes.set(yscale="log", ylim=(0.2 / max(values.size, 10), 9))
    plain_log_ticks(axes.yaxis)
    axes.legend(loc="upper left")
    return figure


def _surfaces(c: Comparison, bands: Sequence[NamedBand]) -> Figure:
    figure, axes = _plot("band", f"mean of {_RELATIVE}")
    markers = "osD^v<>PX*"
    colours = matplotlib.colormaps["cividis"](np.linspace(0, _BRIGHTEST_LINE, max(len(c.by_surface), 1)))
    for number, (name, row) in enumerate(c.by_surface.items()):
        values = [100 * row.relative[index] for index, _ in bands]
        marker = markers[number % len(markers)]
        axes.plot(range(len(bands)), values, marker=marker, color=colours[number], linewidth=1, label=name)
    axes.axhline(0, color=_INK, linewidth=0.8)
    axes.set_xticks(range(len(bands)), [name for _, name in bands], rotation=45, ha="right")
    figure.legend(fontsize=8, loc="outside right upper")
    return figure


#: Figures by name.
FIGURES: Mapping[str, Callable[[Comparison, Sequence[NamedBand]], Figure]] = {
    "difference": _difference,
    "relative": _relative,
    "photograph": _signals("measured", "measured signal, DN"),
    "rendering": _signals("rendered", "rendered signal, DN"),
    "colour": _colour,
    "luminance": _luminance,
    "residuals": _residuals,
    "surfaces": _surfaces,
}


def comparison_figure(c: Comparison, bands: Sequence[NamedBand], what: str) -> Figure:
    """Figure of a comparison.

    Parameters
    ----------
    c
        The comparison.
    bands
        (index, name) of the bands to show, in their order.
    what
        Name of the figure, one of ``FIGURES``.

    Returns
    -------
    Figure
        Matplotlib figure on white; it is not shown.

    Raises
    ------
    InputError
        For another name.
    """
    if what not in FIGURES:
        raise InputError("figure", repr(what), f"one of {', '.join(FIGURES)}", suggestion(what, FIGURES))
    style = {key: _INK if value == STYLE["text.color"] else value for key, value in STYLE.items()}
    with matplotlib.rc_context({**style, "svg.hashsalt": "cboxlab", "axes.titlesize": 9.5}):
        figure = FIGURES[what](c, bands)
        figure.draw_without_rendering()  # the first layout leaves too little space above titles
    return figure
