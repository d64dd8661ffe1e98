"""Pictures of a report: maps with a colour scale, and plots as SVG in the ink of the page."""

from __future__ import annotations

import base64
import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter
from numpy.typing import ArrayLike, NDArray
from PIL import Image

__all__ = [
    "INK", "LINE", "STYLE", "Drawing", "MapRow", "Panel", "Scale", "diverging_scale", "drawing",
    "falling_curve", "map_row", "new_figure", "picture_row", "plain_log_ticks", "png_uri", "sequential_scale",
]  # fmt: skip

#: Sentinel that becomes the page's text colour in an SVG; nothing else may use it.
INK = "#0a0b0c"

#: Points and lines; legible on light and dark paper.
LINE = "#4382ad"


@dataclass(frozen=True)
class Scale:
    """A colour scale from ``low`` to ``high``; values beyond take the colour of the end.

    colours : name of a matplotlib colormap.
    """

    low: float
    high: float
    unit: str
    colours: str

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Position on the bar in percent, and label."""
        values = MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(self.low, self.high)
        margin = 1e-9 * (self.high - self.low)
        inside = [float(v) for v in values if self.low - margin <= v <= self.high + margin]
        return [(100 * (v - self.low) / (self.high - self.low), f"{v:g}".replace("-", "−")) for v in inside]

    @property
    def gradient(self) -> str:
        """CSS colour stops from left to right."""
        colours = matplotlib.colormaps[self.colours](np.linspace(0, 1, 17))
        return ", ".join(matplotlib.colors.to_hex(c) for c in colours)

    def paint(self, values: ArrayLike) -> NDArray[np.uint8]:
        """RGBA (y, x, 4) of values (y, x); NaN is transparent."""
        values = np.asarray(values, float)
        position = np.clip((values - self.low) / (self.high - self.low), 0, 1)
        rgba = matplotlib.colormaps[self.colours](np.nan_to_num(position), bytes=True)
        rgba[~np.isfinite(values)] = 0
        return rgba


def _round_up(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * next(step for step in (1, 2, 5, 10) if value <= step * power * (1 + 1e-9)))


def _reach(values: ArrayLike, percentile: float, at_least: float) -> float:
    finite = np.abs(np.asarray(values, float))
    finite = finite[np.isfinite(finite)]
    return _round_up(max(float(np.percentile(finite, percentile)), at_least) if finite.size else at_least)


def sequential_scale(values: ArrayLike, unit: str, at_least: float = 1e-6) -> Scale:
    """From 0 to a round number near the 99.5th percentile."""
    return Scale(0.0, _reach(values, 99.5, at_least), unit, "viridis")


def diverging_scale(values: ArrayLike, unit: str, at_least: float = 1e-6) -> Scale:
    """Centred on 0, out to a round number near the 99th percentile of the magnitude; blue is negative."""
    reach = _reach(values, 99.0, at_least)
    return Scale(-reach, reach, unit, "RdBu_r")


@dataclass(frozen=True)
class Panel:
    """One picture of a row. uri : PNG as a data URI."""

    caption: str
    uri: str
    width: int
    height: int


@dataclass(frozen=True)
class MapRow:
    """Pictures side by side under one colour scale (None for pictures in natural colours)."""

    panels: tuple[Panel, ...]
    scale: Scale | None
    caption: str = ""


@dataclass(frozen=True)
class Drawing:
    """A plot. svg : one inline SVG element."""

    svg: str
    caption: str = ""


def png_uri(pixels: NDArray[np.uint8]) -> str:
    """Data URI of a PNG of 8-bit RGB or RGBA (y, x, 3 or 4)."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _panel(caption: str, pixels: NDArray[np.uint8]) -> Panel:
    return Panel(caption, png_uri(pixels), pixels.shape[1], pixels.shape[0])


def map_row(images: Mapping[str, ArrayLike], scale: Scale, caption: str = "") -> MapRow:
    """Maps (y, x) by caption, painted with one scale; NaN shows as hatched."""
    return MapRow(tuple(_panel(name, scale.paint(image)) for name, image in images.items()), scale, caption)


def picture_row(images: Mapping[str, NDArray[np.uint8]], caption: str = "") -> MapRow:
    """Pictures (y, x, 3), 8 bit, by caption."""
    return MapRow(tuple(_panel(name, image) for name, image in images.items()), None, caption)


STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "cboxlab",
    "font.size": 10, "axes.titlesize": 10.5, "axes.titleweight": "bold", "axes.titlelocation": "left",
    "text.color": INK, "axes.edgecolor": INK, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK,
    "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.8,
    "axes.grid": True, "grid.color": INK, "grid.alpha": 0.12, "grid.linewidth": 0.7, "axes.axisbelow": True,
    "legend.frameon": False, "lines.linewidth": 1.6, "figure.constrained_layout.use": True,
}  # fmt: skip


def new_figure(columns: int = 1, height: float = 3.4, width: float = 9.6) -> tuple[Figure, list]:
    """A transparent figure with a row of axes, sized in inches. Call it under rc_context(STYLE)."""
    figure = Figure(figsize=(width, height))
    figure.patch.set_alpha(0)
    axes = list(np.atleast_1d(figure.subplots(1, columns)))
    for ax in axes:
        ax.patch.set_alpha(0)
    return figure, axes


def plain_log_ticks(axis: matplotlib.axis.Axis) -> None:
    """Powers of ten as plain numbers on a logarithmic axis."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def drawing(figure: Figure, caption: str = "") -> Drawing:
    """The figure as inline SVG in the page's ink, with identifiers of its own."""
    buffer = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    prefix = "d" + hashlib.sha256(svg.encode()).hexdigest()[:8]
    svg = re.sub(r'\bid="', f'id="{prefix}-', svg)
    svg = re.sub(r'href="#', f'href="#{prefix}-', svg)
    svg = svg.replace("url(#", f"url(#{prefix}-").replace(INK, "currentColor")
    return Drawing(svg, caption)


@matplotlib.rc_context(STYLE)
def falling_curve(labels: Sequence[str], chi2_per_dof: Sequence[float], delta_e: Sequence[float]) -> Drawing:
    """How the error fell while effects were added; labels name what was added at each step."""
    figure, axes = new_figure(2, 3.2)
    steps = np.arange(len(labels))
    for ax, values, title in zip(
        axes, (chi2_per_dof, delta_e), ("χ² per degree of freedom", "mean ΔE*ab"), strict=True
    ):
        ax.plot(steps, values, "-o", color=LINE, markersize=5)
        ax.set_title(title)
        ax.set_xticks(steps, labels)
        ax.margins(x=0.12, y=0.2)
        for step, value in zip(steps, values, strict=True):
            ax.annotate(f"{value:.3g}", (step, value), (6, 5), textcoords="offset points", fontsize=9)
        if min(values) > 0:
            ax.set_yscale("log")
            plain_log_ticks(ax.yaxis)
            ax.yaxis.set_minor_formatter(NullFormatter())
    axes[0].axhline(1.0, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    return drawing(figure, "The dashed line is what noise alone gives.")
