"""Spot at which two pictures differ most clearly, and the map that shows it.

The difference is smoothed by Gaussians of several widths and divided by its standard error. The width at which it is
least probable by chance shows best where it is: a small object in few pixels, a gradient over the picture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from cboxlab.utils.distributions import student_tail
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.ndimage import find_objects, gaussian_filter, label

__all__ = ["Spot", "spot_of"]

#: Widths of the Gaussians, px, the first one for single pixels.
_WIDTHS_PX = (0.0, 1.0, 2.0, 4.0, 8.0)
#: Widest Gaussian over the shorter side of the picture.
_WIDEST = 0.125
#: Degrees of freedom of a single pixel, whose noise is not normal.
_PIXEL_DEGREES = 5.0
#: Most degrees of freedom of a smoothed picture.
_MOST_DEGREES = 1e3
#: Probability of a peak, all places and widths counted, below which it is a place.
_CLEAR = 1e-3
#: Standard errors from which a pixel of the map differs.
_SIGMAS = 3.0
#: Standard errors of all light from which a difference without a place is an even one.
_EVENLY_SIGMAS = 4.0
#: Part of the peak down to which its surroundings belong to the place.
_OF_PEAK = 0.5
#: Part of the picture from which a place is most of it.
_MOST_OF_IT = 0.5
#: Part of a place that a surface covers to lend its name.
_COVERS = 0.6
#: Names of thirds of a picture, from the top and from the left.
_THIRDS = (("upper", "", "lower"), ("left", "", "right"))


@dataclass(frozen=True, eq=False)
class Spot(FrozenMappings):
    """Part of a picture in which two pictures differ most clearly, and by how much."""

    #: (y, x) difference over its standard error, smoothed; NaN without light.
    sigmas: NDArray[np.float64]
    #: (y, x) baseline, summed over its bands.
    baseline: NDArray[np.float64]
    #: Standard deviation of the Gaussian that smoothed the map, px; 0 for none.
    width_px: float
    #: Probability of a peak this high in equal pictures, all places and widths counted.
    probability: float
    #: Column and row of the peak, from 0 at the left and at the top.
    peak: tuple[int, int]
    #: First column and row of the place, and one after the last ones.
    bounds: tuple[int, int, int, int]
    #: Difference over the baseline's light in the place.
    difference: float
    #: Part of the lit pixels that belongs to the place.
    part: float
    #: Surface that covers most of the place; empty without one.
    surface: str = ""
    #: Band that the map shows; empty for the sum over all.
    band: str = ""
    #: Difference of all light over that of the baseline, and the same over its standard error.
    all_light: tuple[float, float] = (0.0, 0.0)

    @property
    def clear(self) -> bool:
        """Whether there is a place that noise does not explain."""
        return self.probability < _CLEAR

    @property
    def sentence(self) -> str:
        """Spot in words."""
        if not self.clear:
            change, sigmas = self.all_light
            if abs(sigmas) < _EVENLY_SIGMAS:
                return "Where: no place stands out; the difference is spread over the picture's structure."
            evenly = "brighter" if change > 0 else "darker"
            return f"Where: evenly over the picture, {_written(abs(100 * change))} % {evenly}; no place stands out."
        (x, y), (left, top, right, bottom) = self.peak, self.bounds
        more = "brighter" if self.difference > 0 else "darker"
        size = f"{_written(abs(100 * self.difference))} % {more}" + (f" in band {self.band}" if self.band else "")
        clearest = f"{_written(abs(float(self.sigmas[y, x])))} standard errors"
        if self.part >= _MOST_OF_IT:
            return f"Where: over {self.part:.0%} of the picture, {size}; most clearly at x {x}, y {y}, by {clearest}."
        where = f" on {self.surface}" if self.surface else ""
        region = f"{right - left} × {bottom - top} px in the {self._third()}{where}"
        return f"Where: {region}, {size}; most clearly at x {x}, y {y}, by {clearest}."

    def record(self) -> dict[str, Any]:
        """Content of the JSON file.

        Returns
        -------
        dict
            Numbers and texts.
        """
        x, y = self.peak
        return {
            "clear": self.clear,
            "x_px": x,
            "y_px": y,
            "sigmas": float(self.sigmas[y, x]),
            "smoothed_over_px": self.width_px,
            "probability": self.probability,
            "bounds_px": list(self.bounds),
            "relative_difference": self.difference,
            "part_of_the_picture": self.part,
            "surface": self.surface or None,
            "band": self.band or None,
        }

    def _third(self) -> str:
        """Part of the picture in which the peak is."""
        height, width = self.sigmas.shape
        x, y = self.peak
        down, across = _THIRDS[0][3 * y // height], _THIRDS[1][3 * x // width]
        return " ".join(filter(None, (down, across))) + " part" if down or across else "middle"


def _written(number: float) -> str:
    """Number of two digits, larger ones without decimals."""
    return f"{number:.0f}" if number >= 10 else f"{number:.2g}"


def spot_of(
    difference: NDArray[np.float64],
    level: NDArray[np.float64],
    variance: NDArray[np.float64],
    used: NDArray[np.bool_],
    clustering: float = 1.0,
    surfaces: Mapping[str, NDArray[np.bool_]] | None = None,
    *,
    band: str = "",
    within: tuple[int, int, int, int] | None = None,
) -> Spot | None:
    """Spot at which two pictures differ most clearly.

    Parameters
    ----------
    difference
        (y, x) candidate less baseline, summed over wavelengths.
    level
        (y, x) baseline.
    variance
        (y, x) variance of ``difference``.
    used
        (y, x) pixels with light.
    clustering
        Number of pixels that correlation makes one.
    surfaces
        (y, x) pixels of each surface.
    band
        Name of the band that the pictures show; empty for the sum over all.
    within
        First column and row of the part in which the peak is, and one after the last ones; None for all of the picture.

    Returns
    -------
    Spot or None
        The place; None without light.
    """
    if not used.any():
        return None
    searched = used & _inside(used.shape, within)
    looks, best = float(searched.sum()), (np.inf, 0.0, 0.0, difference, (0, 0))
    for width in _WIDTHS_PX:
        if width > _WIDEST * min(used.shape):
            break
        area = 1 + 4 * np.pi * width**2
        sigmas = np.where(used, _smoothed(difference, variance, used, width, clustering), 0.0)
        position = np.unravel_index(int(np.where(searched, np.abs(sigmas), -1.0).argmax()), sigmas.shape)
        peak = abs(float(sigmas[position]))
        degrees = min(_PIXEL_DEGREES * area / min(clustering, area), _MOST_DEGREES)
        # maxima of a smooth random field above a peak: its square for each area of a Gaussian (Adler 1981)
        maxima = min(max(looks * peak**2 / area, 1.0), looks)
        share = 2 * maxima * float(student_tail(peak, degrees))
        if (share, -peak) < best[:2]:
            best = share, -peak, width, sigmas, (int(position[0]), int(position[1]))
    share, _, width, sigmas, (y, x) = best
    around = _around(sigmas, (y, x))
    rows, columns = find_objects(around.astype(int))[0]
    light = float(level[around].sum())
    total, noise = float(difference[used].sum()), float(np.sqrt(variance[used].sum() * clustering))
    all_light = total / max(float(level[used].sum()), 1e-300), total / max(noise, 1e-300)
    names = {name: float(mask[around].mean()) for name, mask in (surfaces or {}).items()}
    surface = max(names, key=lambda name: names[name], default="")
    return Spot(
        np.where(used, sigmas, np.nan),
        level,
        width,
        min(1.0, share * len(_WIDTHS_PX)),
        (x, y),
        (columns.start, rows.start, columns.stop, rows.stop),
        float(difference[around].sum()) / light if light > 0 else 0.0,
        float(around.sum()) / float(used.sum()),
        surface if names.get(surface, 0.0) >= _COVERS else "",
        band,
        all_light,
    )


def _inside(shape: tuple[int, ...], bounds: tuple[int, int, int, int] | None) -> NDArray[np.bool_]:
    """(y, x) pixels inside some bounds; all without any."""
    left, top, right, bottom = bounds or (0, 0, shape[1], shape[0])
    inside = np.zeros(shape, bool)
    inside[top:bottom, left:right] = True
    return inside


def _smoothed(
    difference: NDArray[np.float64],
    variance: NDArray[np.float64],
    used: NDArray[np.bool_],
    width: float,
    clustering: float,
) -> NDArray[np.float64]:
    """(y, x) smoothed difference over its standard error.

    A Gaussian of some width averages over 4 pi width^2 pixels. The noise of neighbours that correlation makes one does
    not average out.
    """
    area = 4 * np.pi * width**2
    sums, squares = (np.where(used, picture, 0.0) for picture in (difference, variance))
    if width > 0:
        sums = gaussian_filter(sums, width, mode="constant")
        squares = gaussian_filter(squares, width / np.sqrt(2), mode="constant") / area
    squares = squares * clustering * (1 + area) / (clustering + area)
    return np.asarray(sums / np.sqrt(np.maximum(squares, 1e-300)))


def _around(sigmas: NDArray[np.float64], position: tuple[int, int]) -> NDArray[np.bool_]:
    """(y, x) connected pixels around a peak that differ with its sign."""
    peak = float(sigmas[position])
    high = sigmas * np.sign(peak) >= min(max(_SIGMAS, _OF_PEAK * abs(peak)), abs(peak))
    parts, _ = label(high)
    return np.asarray(parts == parts[position]) if peak else np.zeros(sigmas.shape, bool) | (sigmas == 0)
