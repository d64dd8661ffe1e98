"""Pictures of a report: maps with a colour scale, and plots as SVG in the page's text colour."""

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
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter
from numpy.typing import ArrayLike, NDArray
from PIL import Image

__all__ = [
    "COLOUR",
    "INK",
    "LINE",
    "LUMINANCE",
    "STYLE",
    "Drawing",
    "MapRow",
    "Panel",
    "Scale",
    "drawing",
    "falling_curve",
    "map_row",
    "new_figure",
    "picture_row",
    "plain_log_ticks",
    "png_uri",
    "residual_scale",
]

#: Placeholder that is replaced by the page's text colour in an SVG; not used otherwise.
INK = "#0a0b0c"

#: Points and lines; legible on light and dark pages.
LINE = "#4382ad"

#: Width of a plot, inches: 400 px.
_WIDTH_INCH = 4.17

#: Pictures of more pixels across are shown as means of blocks; the viewer has every pixel.
_MOST_ACROSS = 256

#: Ends of the scales that are the same in every report (the viewer's standard ones).
RESIDUAL, COLOUR, LUMINANCE = 5.0, 5.0, 10.0


@dataclass(frozen=True)
class Scale:
    """A colour scale from ``low`` to ``high``; values beyond have the colour of the end.

    colours : name of a matplotlib colormap.
    """

    low: float
    high: float
    unit: str
    colours: str

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Position on the bar in percent, and label."""
        values = MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]).tick_values(self.low, self.high)
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


def residual_scale(unit: str = "difference / σ") -> Scale:
    """The scale of differences over sigma, from -5 to 5 in every report."""
    return Scale(-RESIDUAL, RESIDUAL, unit, "RdBu_r")


@dataclass(frozen=True)
class Panel:
    """One picture of a row. uri : PNG as a data URI. width, height : of the whole picture, in its pixels."""

    caption: str
    uri: str
    width: int
    height: int

    @property
    def across(self) -> list[tuple[float, str]]:
        """Pixels marked below the picture: place in percent, and number from 0 at the left."""
        return _pixel_ticks(self.width)

    @property
    def down(self) -> list[tuple[float, str]]:
        """Pixels marked beside the picture: place in percent, and number from 0 at the top."""
        return _pixel_ticks(self.height)


def _pixel_ticks(count: int) -> list[tuple[float, str]]:
    values = MaxNLocator(3, integer=True, steps=[1, 2, 2.5, 5, 10]).tick_values(0, count - 1)
    return [(100 * (v + 0.5) / count, f"{v:.0f}") for v in values if 0 <= v < count]


@dataclass(frozen=True)
class MapRow:
    """Pictures side by side with one colour scale (None for colour pictures)."""

    panels: tuple[Panel, ...]
    scale: Scale | None
    caption: str = ""


@dataclass(frozen=True)
class Drawing:
    """Plots side by side, one below the other on a narrow page. svgs : inline SVG elements."""

    svgs: tuple[str, ...]
    caption: str = ""


def png_uri(pixels: NDArray[np.uint8]) -> str:
    """Data URI of a PNG of 8-bit RGB or RGBA (y, x, 3 or 4)."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def blocks(values: ArrayLike) -> NDArray:
    """Values (y, x, ...) as means of square blocks where they are too many for a page; NaN is left out."""
    array = np.asarray(values)
    size = -(-max(array.shape[:2]) // _MOST_ACROSS)
    if size == 1:
        return array
    height, width = (n // size * size for n in array.shape[:2])
    cut = array[:height, :width].reshape(height // size, size, width // size, size, *array.shape[2:])
    known = np.isfinite(cut)
    mean = np.where(known, cut, 0).sum(axis=(1, 3)) / np.maximum(known.sum(axis=(1, 3)), 1)
    return np.where(known.any(axis=(1, 3)), mean, np.nan).astype(array.dtype)


def _panel(caption: str, pixels: NDArray[np.uint8], whole: NDArray) -> Panel:
    return Panel(caption, png_uri(pixels), whole.shape[1], whole.shape[0])


def map_row(images: Mapping[str, ArrayLike], scale: Scale, caption: str = "") -> MapRow:
    """Maps (y, x) by caption, with one colour scale; NaN is hatched."""
    whole = {name: np.asarray(image) for name, image in images.items()}
    panels = tuple(_panel(name, scale.paint(blocks(image)), image) for name, image in whole.items())
    return MapRow(panels, scale, caption)


def picture_row(images: Mapping[str, NDArray[np.uint8]], caption: str = "") -> MapRow:
    """Pictures (y, x, 3), 8 bit, by caption."""
    return MapRow(tuple(_panel(name, blocks(image), image) for name, image in images.items()), None, caption)


STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "cboxlab",
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.color": INK,
    "grid.alpha": 0.12,
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "figure.constrained_layout.use": True,
}


def new_figure(height: float = 3.2) -> tuple[Figure, Axes]:
    """A transparent figure with axes, narrow enough for a page of 400 px. Use it under rc_context(STYLE)."""
    figure = Figure(figsize=(_WIDTH_INCH, height))
    figure.patch.set_alpha(0)
    axes = figure.subplots()
    axes.patch.set_alpha(0)
    return figure, axes


def plain_log_ticks(axis: matplotlib.axis.Axis) -> None:
    """Label a logarithmic axis with plain numbers, or powers of ten, in letters of full size."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
    axis.set_minor_formatter(NullFormatter())


def _plain(value: float) -> str:
    if not value or 0.01 <= value < 10000:
        return f"{value:g}"
    return "10" + f"{np.log10(value):.0f}".translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def drawing(*figures: Figure, caption: str = "") -> Drawing:
    """Figures as inline SVG in the page's text colour, with unique identifiers."""
    return Drawing(tuple(_svg(figure) for figure in figures), caption)


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    prefix = "d" + hashlib.sha256(svg.encode()).hexdigest()[:8]
    svg = re.sub(r'\bid="', f'id="{prefix}-', svg)
    svg = re.sub(r'href="#', f'href="#{prefix}-', svg)
    return svg.replace("url(#", f"url(#{prefix}-").replace(INK, "currentColor")


@matplotlib.rc_context(STYLE)
def falling_curve(
    labels: Sequence[str], chi2_per_dof: Sequence[float], colour: Sequence[float], colour_label: str
) -> Drawing:
    """The error after each added effect. labels : what was added at each step."""
    figures = []
    steps = np.arange(len(labels))
    for values, title in ((chi2_per_dof, "χ² per degree of freedom"), (colour, f"mean {colour_label}")):
        figure, ax = new_figure(2.9)
        ax.plot(steps, values, "-o", color=LINE, markersize=5)
        ax.set_title(title)
        ax.set_xticks(steps, [label.replace(" ", "\n", 1) for label in labels])
        ax.margins(x=0.18, y=0.2)
        for step, value in zip(steps, values, strict=True):
            ax.annotate(f"{value:.3g}", (step, value), (6, 5), textcoords="offset points")
        if min(values) > 0 and max(values) > 5 * min(values):
            ax.set_yscale("log")
            plain_log_ticks(ax.yaxis)
        else:
            ax.set_ylim(0, 1.3 * max(values))
        figures.append(figure)
    figures[0].axes[0].axhline(1.0, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    return drawing(*figures, caption="Dashed line: expected from noise alone.")
