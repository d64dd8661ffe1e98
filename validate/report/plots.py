"""Pictures of a report: maps with a colour scale, and plots as SVG."""

from __future__ import annotations

import base64
import hashlib
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from .numerals import chi2_text, number

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
    "map_next_to",
    "map_row",
    "new_figure",
    "picture_row",
    "plain_log_ticks",
    "png_uri",
    "residual_scale",
]

#: Colour that an SVG replaces by the page's text colour; no other element has it.
INK = "#0a0b0c"

#: Colour of points and lines; legible on light and dark pages.
LINE = "#4382ad"

#: Colours of three curves, after Okabe and Ito: distinct without red and green, legible on light and dark pages.
CURVES = ("#d55e00", "#009e73", "#0072b2")

#: Width of a plot, inches: 400 px.
_WIDTH_INCH = 4.17

#: Margin left of a plot's axes, inches: a label and tick labels of six letters.
_LEFT_INCH = 0.72

#: Margin right of a plot's axes, inches: half of the last tick label.
_RIGHT_INCH = 0.12

#: Margin below a plot's axes, inches: a label and tick labels of two lines.
_BELOW_INCH = 0.52

#: Most pixels across a map; larger ones are shown as means of blocks, and the viewer has every pixel.
_MAX_PIXELS_ACROSS = 256

#: End of the scale of residuals, sigma: the same in every report and in the viewer's standard scale.
RESIDUAL = 5.0

#: End of the scale of colour differences: the same in every report.
COLOUR = 5.0

#: End of the scale of luminance differences, %: the same in every report.
LUMINANCE = 10.0

#: Light that is white in a grey picture, over the median: lamps and highlights are brighter.
_WHITE = 4.0

#: Exponent of a screen.
_SCREEN_GAMMA = 2.2

#: Colour stops of the CSS gradient of a scale.
_NUM_GRADIENT_STOPS = 17


@dataclass(frozen=True)
class Scale:
    """A linear colour scale; values beyond it have the colour of its end."""

    #: Lowest value.
    low: float
    #: Highest value.
    high: float
    #: Unit or name of the quantity, under the bar.
    unit: str
    #: Name of a matplotlib colormap.
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
        colours = matplotlib.colormaps[self.colours](np.linspace(0, 1, _NUM_GRADIENT_STOPS))
        return ", ".join(matplotlib.colors.to_hex(c) for c in colours)

    def paint(self, values: ArrayLike) -> NDArray[np.uint8]:
        """Colours of a map.

        Parameters
        ----------
        values
            (y, x) values.

        Returns
        -------
        NDArray
            (y, x, 4) RGBA, 0 to 255; NaN is transparent.
        """
        values = np.asarray(values, float)
        position = np.clip((values - self.low) / (self.high - self.low), 0, 1)
        rgba = matplotlib.colormaps[self.colours](np.nan_to_num(position), bytes=True)
        rgba[~np.isfinite(values)] = 0
        return rgba


def residual_scale(unit: str = "difference / σ") -> Scale:
    """Scale of differences over sigma, from -5 to 5 in every report.

    Parameters
    ----------
    unit
        Name of the quantity.

    Returns
    -------
    Scale
        Diverging, white at 0.
    """
    return Scale(-RESIDUAL, RESIDUAL, unit, "RdBu_r")


@dataclass(frozen=True)
class Panel:
    """One picture of a row."""

    #: Caption under the picture.
    caption: str
    #: PNG as a data URI.
    uri: str
    #: Width of the picture, px of the capture.
    width: int
    #: Height of the picture, px of the capture.
    height: int

    @property
    def across(self) -> list[tuple[float, str]]:
        """Marks below the picture: position in percent, and pixel number from 0 at the left."""
        return _pixel_ticks(self.width)

    @property
    def down(self) -> list[tuple[float, str]]:
        """Marks left of the picture: position in percent, and pixel number from 0 at the top."""
        return _pixel_ticks(self.height)


def _pixel_ticks(count: int) -> list[tuple[float, str]]:
    values = MaxNLocator(3, integer=True, steps=[1, 2, 2.5, 5, 10]).tick_values(0, count - 1)
    return [(100 * (v + 0.5) / count, f"{v:.0f}") for v in values if 0 <= v < count]


@dataclass(frozen=True)
class MapRow:
    """Pictures side by side with one colour scale."""

    #: The pictures.
    panels: tuple[Panel, ...]
    #: Their colour scale; None for colour pictures.
    scale: Scale | None
    #: Caption above the row; none if empty.
    caption: str = ""


@dataclass(frozen=True)
class Drawing:
    """Plots side by side, below each other on a narrow page."""

    #: Inline SVG elements.
    svgs: tuple[str, ...]
    #: Caption under the plots; none if empty.
    caption: str = ""


def png_uri(pixels: NDArray[np.uint8]) -> str:
    """PNG of a picture as a data URI.

    Parameters
    ----------
    pixels
        (y, x, 3 or 4) RGB or RGBA, 8 bit.

    Returns
    -------
    str
        The URI.
    """
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def blocks(values: ArrayLike) -> NDArray:
    """Means over square blocks where a map is too large for a page.

    Parameters
    ----------
    values
        (y, x, ...) values; NaN does not count.

    Returns
    -------
    NDArray
        The map or its means, at most 256 pixels across; NaN for blocks without values.
    """
    array = np.asarray(values)
    size = -(-max(array.shape[:2]) // _MAX_PIXELS_ACROSS)
    if size == 1:
        return array
    height, width = (n // size * size for n in array.shape[:2])
    cut = array[:height, :width].reshape(height // size, size, width // size, size, *array.shape[2:])
    finite = np.isfinite(cut)
    mean = np.where(finite, cut, 0).sum(axis=(1, 3)) / np.maximum(finite.sum(axis=(1, 3)), 1)
    return np.where(finite.any(axis=(1, 3)), mean, np.nan).astype(array.dtype)


def _panel(caption: str, pixels: NDArray[np.uint8], image: NDArray) -> Panel:
    """Panel of painted pixels, with the size of the original image."""
    return Panel(caption, png_uri(pixels), image.shape[1], image.shape[0])


def map_row(images: Mapping[str, ArrayLike], scale: Scale, caption: str = "") -> MapRow:
    """Row of maps with one colour scale; NaN is hatched.

    Parameters
    ----------
    images
        (y, x) values by caption.
    scale
        The colour scale.
    caption
        Caption of the row.

    Returns
    -------
    MapRow
        The row.
    """
    maps = {name: np.asarray(image) for name, image in images.items()}
    panels = tuple(_panel(name, scale.paint(blocks(image)), image) for name, image in maps.items())
    return MapRow(panels, scale, caption)


def picture_row(images: Mapping[str, NDArray[np.uint8]], caption: str = "") -> MapRow:
    """Row of colour pictures.

    Parameters
    ----------
    images
        (y, x, 3) sRGB, 8 bit, by caption.
    caption
        Caption of the row.

    Returns
    -------
    MapRow
        The row, without a scale.
    """
    return MapRow(tuple(_panel(name, blocks(image), image) for name, image in images.items()), None, caption)


def map_next_to(picture: tuple[str, ArrayLike], image: tuple[str, ArrayLike], unit: str, caption: str = "") -> MapRow:
    """Grey picture, and next to it a signed map in standard errors.

    Parameters
    ----------
    picture
        Caption, and (y, x) light; four times its median and more is white.
    image
        Caption, and (y, x) difference over sigma; NaN is hatched.
    unit
        Name of the difference.
    caption
        Caption of the row.

    Returns
    -------
    MapRow
        The row. Its scale ends at 5 or, where the map goes far beyond it, at the map's largest value.
    """
    name, light = picture[0], np.asarray(picture[1], float)
    white = max(_WHITE * float(np.nanmedian(light)), 1e-3 * float(np.nanmax(light)), 1e-300)
    grey = np.rint(255 * np.clip(blocks(light) / white, 0, 1) ** (1 / _SCREEN_GAMMA)).astype(np.uint8)
    values = np.asarray(image[1], float)
    largest = float(np.nanmax(np.abs(values)))
    end = RESIDUAL if largest <= 2 * RESIDUAL else float(f"{largest:.1g}")
    maps = map_row({image[0]: values}, Scale(-end, end, unit, "RdBu_r"))
    return MapRow((_panel(name, np.stack([grey] * 3, axis=-1), light), *maps.panels), maps.scale, caption)


#: Parameters of matplotlib for every plot of a report; the salt makes identifiers in the SVG repeatable.
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "cboxlab",
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # a position that is looked for takes one more layout of all ticks
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
}


def new_figure(height: float = 3.2, above: float = 0.3) -> tuple[Figure, Axes]:
    """Transparent figure with axes for a page of 400 px, to be used under rc_context(STYLE).

    The margins are fixed: a layout engine would draw every figure twice more to measure its letters.

    Parameters
    ----------
    height
        Height, inches.
    above
        Margin above the axes, inches; the default holds a title of one line.

    Returns
    -------
    Figure
        The figure.
    Axes
        Its axes.
    """
    figure = Figure(figsize=(_WIDTH_INCH, height))
    figure.patch.set_alpha(0)
    axes = figure.subplots()
    figure.subplots_adjust(
        left=_LEFT_INCH / _WIDTH_INCH,
        right=1 - _RIGHT_INCH / _WIDTH_INCH,
        bottom=_BELOW_INCH / height,
        top=1 - above / height,
    )
    axes.patch.set_alpha(0)
    return figure, axes


def plain_log_ticks(axis: matplotlib.axis.Axis) -> None:
    """Label a logarithmic axis with plain numbers or powers of ten, in letters of full size.

    Parameters
    ----------
    axis
        The axis.
    """
    axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
    axis.set_minor_locator(NullLocator())  # its marks take more than half of the time of a chart


def _plain(value: float) -> str:
    if not value or 0.01 <= value < 10000:
        return f"{value:g}"
    return "10" + f"{np.log10(value):.0f}".translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def drawing(*figures: Figure, caption: str = "") -> Drawing:
    """Figures as inline SVG in the page's text colour, with unique identifiers.

    Parameters
    ----------
    figures
        The figures.
    caption
        Caption under them.

    Returns
    -------
    Drawing
        The SVG elements.
    """
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
    """Plots of the error after each added effect.

    Parameters
    ----------
    labels
        Name of each step.
    chi2_per_dof
        Reduced chi2 of each step.
    colour
        Mean colour difference of each step.
    colour_label
        Label of the colour difference.

    Returns
    -------
    Drawing
        Two plots.
    """
    figures = []
    steps = np.arange(len(labels))
    plots: tuple[tuple[Sequence[float], str, Callable[[float], str]], ...] = (
        (chi2_per_dof, "χ² per degree of freedom", chi2_text),
        (colour, f"mean {colour_label}", number),
    )
    for values, title, text in plots:
        figure, ax = new_figure(2.9)
        ax.plot(steps, values, "-o", color=LINE, markersize=5)
        ax.set_title(title)
        ax.set_xticks(steps, [label.replace(" ", "\n", 1) for label in labels])
        ax.margins(x=0.18, y=0.2)
        for step, value in zip(steps, values, strict=True):
            ax.annotate(text(value), (step, value), (6, 5), textcoords="offset points")
        if min(values) > 0 and max(values) > 5 * min(values):
            ax.set_yscale("log")
            plain_log_ticks(ax.yaxis)
        else:
            ax.set_ylim(0, 1.3 * max(values))
        figures.append(figure)
    figures[0].axes[0].axhline(1.0, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    return drawing(*figures, caption="The dashed line is the expectation from noise alone.")
