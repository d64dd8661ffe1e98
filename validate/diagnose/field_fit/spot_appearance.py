"""Appearance of a localised change: sign, depth, outline, colour and place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..hypotheses import CERTAIN_SIGMA
from .fitted_explanation import FittedExplanation
from .residual_data import ResidualData
from .spot_regions import BORDER_OVER_PEAK

__all__ = [
    "CORE_WEIGHT",
    "OTHER_SIGN",
    "PENALTY_IMPOSSIBLE",
    "PENALTY_ODD",
    "PENALTY_UNLIKELY",
    "SpotAppearance",
    "darker_part",
    "elongation",
]

#: 2 ln of the odds against a depth or sign that the family cannot have.
PENALTY_IMPOSSIBLE = 300.0

#: 2 ln of the odds against an appearance that the family seldom has.
PENALTY_UNLIKELY = 60.0

#: 2 ln of the odds against an appearance that is less usual for the family.
PENALTY_ODD = 15.0

#: Part of the largest weight above which a pixel belongs to the core of a spot.
CORE_WEIGHT = 0.3

#: Relative change of the core above which an object in front is likelier than a stain or dust.
_MAX_DEPTH_OF_STAIN = 0.25

#: Relative change in the other bands below which a spot is of one band: spectra of stains and threads are broad.
_MIN_PART_IN_OTHER_BANDS = 0.05

#: Largest variance across a line that is as thin as pixels resolve, px^2.
_MAX_LINE_VARIANCE_PX2 = 0.6

#: Smallest ratio of the variances along and across a line.
_MIN_LINE_RATIO = 30.0

#: Part of the image's size within which a line ends at a side, or a glow lies at the border.
_BORDER_PART = 0.05

#: Least rms distance of the log reflectance that a paint would need from a line over wavelength, to exclude paint.
_MIN_OFF_LINE = 0.2

#: Largest ratio of the relative changes of two bands by light that has the colour of the box's own light.
_MAX_RATIO_OF_BOX_LIGHT = 2.0

#: Upper limit of an apparent reflectance: above 1, as an object may be closer to the lamp.
_MAX_APPARENT_REFLECTANCE = 2.0

#: Part of a change's chi2 that may have the other sign: noise, and what the fit of the lamp takes up.
OTHER_SIGN = 0.25

#: Distance from a spot within which the orientation of its surface is determined, px.
_SLOPE_RADIUS_PX = 6

#: Fewest fragments from which the orientation is determined: three numbers are fitted to them.
_MIN_SLOPE_PIXELS = 12


@dataclass(frozen=True, eq=False)
class SpotAppearance:
    """A localised change of the signal; properties are computed when they are asked for."""

    #: Residual to be explained.
    data: ResidualData
    #: The fitted explanation.
    candidate: FittedExplanation
    #: (band, y, x) its change of the signal, DN.
    change: NDArray[np.float64]
    #: (y, x) chi2 of the change, summed over the bands; not 0 everywhere.
    weight: NDArray[np.float64]
    #: Whether an object in the place would have a soft outline, as light has.
    soft_outline: bool

    @cached_property
    def relative(self) -> NDArray[np.float64]:
        """(band,) relative change of the signal in the core of the spot."""
        core = self.weight > CORE_WEIGHT * self.weight.max()
        signal = np.maximum(self.data.signal[:, core].mean(axis=1), self.data.least_signal)
        return self.change[:, core].mean(axis=1) / signal

    @cached_property
    def strongest(self) -> float:
        """The largest relative change of a band, with its sign."""
        return float(self.relative[np.argmax(np.abs(self.relative))])

    @property
    def brighter(self) -> bool:
        """Whether the strongest band is brighter."""
        return self.strongest > 0

    @cached_property
    def in_one_band(self) -> bool:
        """Whether one band alone shows the spot."""
        others = np.sort(np.abs(self.relative))[:-1]
        return len(others) > 0 and bool((others < _MIN_PART_IN_OTHER_BANDS * abs(self.strongest)).all())

    @cached_property
    def line(self) -> bool:
        """Whether it is a straight thin line in several bands, such as a thread or a wire."""
        return _sharp_line(self.weight) and not self.in_one_band

    @cached_property
    def deep(self) -> bool:
        """Whether it changes the core by more than a stain or dust does."""
        return float(np.abs(self.relative).max()) > _MAX_DEPTH_OF_STAIN

    @cached_property
    def light(self) -> bool:
        """Whether it is bright like light: without an outline, or in a colour that no paint has."""
        return self.brighter and (self.soft_outline or self._is_other_light())

    @cached_property
    def neutral(self) -> bool:
        """Whether all bands are brighter by similar factors, as where a paint is fresh or clean.

        Other light has another colour than the box's own.
        """
        relative = self.relative
        return bool(relative.min() > 0 and relative.max() < _MAX_RATIO_OF_BOX_LIGHT * relative.min())

    @cached_property
    def darkens(self) -> bool:
        """Whether a part of the image or a band is darker, as by another paint; light only adds."""
        if darker_part(self.data, self.change) > OTHER_SIGN:
            return True
        squares = (self.change * self.data.weight) ** 2
        total, darker = squares.sum(axis=(1, 2)), np.where(self.change < 0, squares, 0.0).sum(axis=(1, 2))
        return bool(np.any((total > CERTAIN_SIGMA**2) & (darker > total / 2)))

    @cached_property
    def at_the_border(self) -> bool:
        """Whether it is strongest at the border of the image, as the glow of an amplifier."""
        peak = np.unravel_index(np.argmax(self.weight), self.weight.shape)
        return any(
            position < _BORDER_PART * size or position > (1 - _BORDER_PART) * size
            for position, size in zip(peak, self.weight.shape, strict=True)
        )

    @cached_property
    def rounder_in_the_image(self) -> bool:
        """Whether it is rounder in the image than on the surface behind it; True if undetermined."""
        centre, shape = _moments(self.weight)
        owner = self.data.surface[round(float(centre[1])), round(float(centre[0]))]
        t = self.data.transport
        near = (t.surface == owner) & (t.coverage > 0.99)
        y, x = np.divmod(t.pixel, self.weight.shape[1])
        near &= np.hypot(x - centre[0], y - centre[1]) < _SLOPE_RADIUS_PX
        if near.sum() < _MIN_SLOPE_PIXELS:
            return True
        design = np.array([np.ones(near.sum()), x[near] - centre[0], y[near] - centre[1]]).T
        slopes = np.linalg.lstsq(design, t.position[near], rcond=None)[0][1:]
        on_surface = slopes @ slopes.T @ shape
        return elongation(shape) <= elongation(on_surface)

    def _is_other_light(self) -> bool:
        """Whether it has the colour of its surface in other light, or is brighter than any paint."""
        owner = int(self.data.surface[np.unravel_index(np.argmax(self.weight), self.weight.shape)])
        if owner < 0 or (self.relative <= 0).any():
            return False
        needed = np.maximum(self.data.reflectance_of(owner), 1e-6) * (1 + self.relative)
        light, paint = (_off_line(self.data.nm, np.log(values)) for values in (self.relative, needed))
        return paint > max(_MIN_OFF_LINE, light) or bool(needed.max() > _MAX_APPARENT_REFLECTANCE)


def darker_part(data: ResidualData, change: NDArray[Any]) -> float:
    """Part of the chi2 of a change that lies where the image is darker.

    Parameters
    ----------
    data
        Residual with its noise.
    change
        (band, y, x) change of the signal, DN.

    Returns
    -------
    float
        Part from 0 to 1.
    """
    squares = (change * data.weight) ** 2
    return float(squares[change < 0].sum() / max(squares.sum(), 1e-300))


def elongation(matrix: NDArray[Any]) -> float:
    """Ratio of the larger to the smaller eigenvalue.

    Parameters
    ----------
    matrix
        (2, 2) matrix with positive eigenvalues.

    Returns
    -------
    float
        The ratio, at least 1.
    """
    values = np.sort(np.abs(np.linalg.eigvals(matrix)))
    return float(values[1] / max(values[0], 1e-12))


def _off_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Rms distance of y (n,) from its best straight line over x (n,)."""
    return float(np.std(y - np.polyval(np.polyfit(x, y, 1), x)))


def _moments(weight: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre (x, y) of a weight (y, x), px, and its second moments (2, 2) about it, px^2."""
    rows, columns = np.indices(weight.shape)
    positions, parts = np.array([columns, rows], float), weight / weight.sum()
    centre = np.einsum("iyx,yx->i", positions, parts)
    offsets = positions - centre[:, None, None]
    return centre, np.einsum("iyx,jyx,yx->ij", offsets, offsets, parts)


def _sharp_line(weight: NDArray[Any]) -> bool:
    """Whether a weight (y, x) is a straight thin line in the scene: a thread or a wire.

    It is as thin as pixels resolve. It follows no row or column, or ends within the image. Objects on the sensor's
    window are out of focus, hairs are bent, and a faulty column is wrong up to a side.
    """
    _, moments = _moments(weight)
    across, along = np.linalg.eigvalsh(moments)
    if across > _MAX_LINE_VARIANCE_PX2 or along <= _MIN_LINE_RATIO * across:
        return False
    pixels, margin = np.argwhere(weight > BORDER_OVER_PEAK * weight.max()), _BORDER_PART * max(weight.shape)
    if (pixels > margin).all() and (pixels < np.array(weight.shape) - 1 - margin).all():
        return True
    # distance of its ends across the rows or columns along which it runs, px
    return bool(abs(moments[0, 1]) / max(np.diag(moments)) * np.sqrt(12 * along) > 1.0)
