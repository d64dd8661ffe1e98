"""Copies of the picture, shifted, mirrored, turned or blurred.

Panes, filters, lenses and double exposures make them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps, PictureCopy, exchanges
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter

from ..field_fit import Family, FittedExplanation, ResidualData, equations_in_all_bands, fixed_spectrum

__all__ = ["copies"]

#: Smallest shift of a copy that is neither mirrored nor turned, px: nearer ones are blurs.
_MIN_SHIFT_PX = 2

#: Blurs of copies out of focus that are tried, px: standard deviations, twice the one before.
_BLURS_PX = (2.0, 4.0)

#: The same of mirrored and turned copies.
_UNSHARP_PX = (2.0, 4.0, 8.0)

#: Least sum of the brightness of a copy of a point over the sum of its sizes: light is added, not taken away.
_MIN_ADDED = 0.5

#: Numerics: width of the picture of a point on either side, in standard deviations of its blur: 0.3 % of a Gaussian
#: lies beyond.
_POINT_REACH = 3.0

#: Part of the picture's light that a copy brings into the frame at the least: a small part of it resembles steps.
_MIN_OVERLAP = 0.6

#: Numerics: least chi2 of a copy that the lamp's power does not take up, over the largest of all shifts: less is
#: rounding.
_MIN_POWER = 1e-3


def copies(data: ResidualData, family: Family) -> Iterator[FittedExplanation]:
    """The best shifted copy of the picture, the best mirrored and the best turned one.

    Parameters
    ----------
    data
        Residual to be explained.
    family
        Family of the forms.

    Yields
    ------
    FittedExplanation
        Copies that all bands share; for shifted ones also out of focus, and in one band alone.
    """
    bands = len(data.bands)
    quarter = (0, 1, 2, 3) if data.shape[0] == data.shape[1] else (0, 2)
    for form, orientations in (
        ("a faint copy of the picture", [PictureCopy()]),
        ("a blurred copy of the picture", [PictureCopy(blur_px=blur) for blur in _BLURS_PX]),
        ("a mirrored copy of the picture", [PictureCopy(turns, True) for turns in quarter]),
        ("a turned copy of the picture", [PictureCopy(turns) for turns in quarter[1:]]),
    ):
        choices = len(orientations) * data.used[0].size
        trials = [_best_shifts(data, orientation) for orientation in orientations]
        best = max((shared for shared, _ in trials), key=lambda shift: shift[0])[1]
        yield from _if_added(_fitted(data, family, form, best, np.ones(bands), choices))
        if not orientations[0].turned_or_mirrored:
            in_one_band = (
                _fitted(data, family, f"{form} in one band", where, np.eye(bands)[band], choices * bands)
                for _, (_, where, band) in trials
            )
            yield from _if_added(max(in_one_band, key=lambda copy: copy.evidence))
            continue
        # a pane far from the focus mirrors an unsharp copy
        unsharp = [_best_shifts(data, replace(best, blur_px=blur))[0] for blur in _UNSHARP_PX]
        where, choices = max(unsharp, key=lambda shift: shift[0])[1], choices * len(unsharp)
        yield from _if_added(_fitted(data, family, f"{form}, out of focus", where, np.ones(bands), choices))


def _if_added(copy: FittedExplanation) -> Iterator[FittedExplanation]:
    """The copy, if it adds light to the picture of a point."""
    parts, blur = copy.fit.coefficients.sum(axis=0).reshape(3, 3), copy.picture_copy.blur_px
    reach = int(np.ceil(_POINT_REACH * blur)) + 1
    away = max(round(blur), 1)
    point = np.zeros((2 * (reach + away) + 1, 2 * (reach + away) + 1))
    point[reach : reach + 2 * away + 1 : away, reach : reach + 2 * away + 1 : away] = parts
    point = gaussian_filter(point, blur, mode="constant") if blur else point
    if point.sum() > _MIN_ADDED * np.abs(point).sum():
        yield copy


def _fitted(
    data: ResidualData,
    family: Family,
    form: str,
    picture_copy: PictureCopy,
    spectrum: NDArray[np.float64],
    num_choices: int,
) -> FittedExplanation:
    def columns(band: int) -> NDArray[Any]:
        each = exchanges("copy", data.signal[band], picture_copy=picture_copy)
        return np.array([part.ravel() for part in each], np.float32)

    fit = fixed_spectrum(equations_in_all_bands(data, columns), spectrum)
    down, right = picture_copy.shift_px
    where = f"{form}, shifted by ({right}, {down}) pixels"
    return FittedExplanation(
        family,
        where,
        fit,
        columns,
        "copy",
        ImageMaps("cosines"),
        sharp=not picture_copy.blur_px,
        num_choices=num_choices,
        picture_copy=picture_copy,
    )


def _best_shifts(
    data: ResidualData, orientation: PictureCopy
) -> tuple[tuple[float, PictureCopy], tuple[float, PictureCopy, int]]:
    """Gain of chi2 and place of the copy that explains most, over all shifts by whole pixels.

    The first is of all bands alike, without the part of a copy that the lamp's power takes up. The second is of one
    band alone, with that band, where the lamp's power takes up nothing.
    """
    rows, columns = data.shape
    size = [next_fast_len(2 * n) for n in (rows, columns)]

    def transform(image: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(rfft2(image.astype(np.float32), size))  # single precision: half of the time

    down, right = (np.fft.fftfreq(n, 1 / n).astype(int) for n in size)
    near = (np.hypot(down[:, None], right) < _MIN_SHIFT_PX) & (not orientation.turned_or_mirrored)

    def best(gain: NDArray[np.float64]) -> tuple[float, PictureCopy]:
        i, j = np.unravel_index(int(np.argmax(np.where(near, -1.0, gain))), gain.shape)
        return float(gain[i, j]), replace(orientation, shift_px=(int(down[i]), int(right[j])))

    alone = []
    product = power = cross = overlap = np.zeros(1)
    for signal, weight, residual in zip(data.signal, data.weight, data.marginal_residual, strict=True):
        picture = orientation.turned(signal)
        copy, square = (np.conj(transform(image)) for image in (picture, picture**2))
        of_band = [
            irfft2(transform(image) * by, size)
            for image, by in ((residual * weight, copy), (weight**2, square), (weight**2 * signal, copy))
        ]
        reached = irfft2(transform(weight > 0) * copy, size)
        level = max(float(np.sum((weight * signal) ** 2)), 1e-300)
        enough = (reached > _MIN_OVERLAP * signal.sum()) & (of_band[1] > _MIN_POWER * of_band[1].max())
        # the band's own level is free: a copy is a pattern
        along = float(np.sum(residual * weight * signal)) / level
        pattern, rest = of_band[0] - along * of_band[2], of_band[1] - of_band[2] ** 2 / level
        alone.append(_gain(pattern, np.maximum(rest, _MIN_POWER * of_band[1]), enough))
        product, power, cross = product + of_band[0], power + of_band[1], cross + of_band[2]
        overlap = overlap + reached
    power = power - cross**2 / max(float(np.sum((data.weight * data.signal) ** 2)), 1e-300)
    enough = (overlap > _MIN_OVERLAP * data.signal.sum()) & (power > _MIN_POWER * power.max())
    band, of_one = max(enumerate(map(best, alone)), key=lambda each: each[1][0])
    return best(_gain(product, power, enough)), (*of_one, band)


def _gain(product: NDArray[np.float64], power: NDArray[np.float64], enough: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Signed chi2 that copies gain, by shift; -1 where too little light is in the frame."""
    gain = np.full(power.shape, -1.0)
    return np.divide(product * np.abs(product), power, out=gain, where=enough)
