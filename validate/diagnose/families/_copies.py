"""Copies of the picture: shifted, mirrored or turned, by panes, lenses or double exposures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps, PictureCopy, exchanges
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2

from ..field_fit import Family, FittedExplanation, ResidualData, equations_in_all_bands, fixed_spectrum

__all__ = ["copies"]

#: Smallest shift of a copy that is neither mirrored nor turned, px: nearer ones are blurs.
_MIN_SHIFT_PX = 2

#: Least sum of a copy's brightness at its nine places over the sum of their sizes: light is added, not taken away.
_MIN_ADDED = 0.5

#: Part of the picture's light that a copy brings into the frame at the least: a small part of it resembles steps.
_MIN_OVERLAP = 0.6

#: Least chi2 of a copy that the lamp's power does not take up, over the largest of all shifts: less is rounding.
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
        Copies that all bands share.
    """
    quarter = (0, 1, 2, 3) if data.shape[0] == data.shape[1] else (0, 2)
    for form, orientations in (
        ("a faint copy of the picture", [PictureCopy()]),
        (
            "a mirrored copy of the picture",
            [PictureCopy(turns, True) for turns in quarter],
        ),
        ("a turned copy of the picture", [PictureCopy(turns) for turns in quarter[1:]]),
    ):
        trials = [_best_shift(data, orientation) for orientation in orientations]
        _, best = max(trials, key=lambda trial: trial[0])
        copy = _fitted(data, family, form, best, len(orientations) * data.used[0].size)
        parts = copy.fit.coefficients[0]
        if parts.sum() > _MIN_ADDED * np.abs(parts).sum():
            yield copy


def _fitted(
    data: ResidualData, family: Family, form: str, picture_copy: PictureCopy, num_choices: int
) -> FittedExplanation:
    def columns(band: int) -> NDArray[Any]:
        each = exchanges("copy", data.signal[band], picture_copy=picture_copy)
        return np.array([part.ravel() for part in each], np.float32)

    fit = fixed_spectrum(equations_in_all_bands(data, columns), np.ones(len(data.bands)))
    down, right = picture_copy.shift_px
    where = f"{form}, shifted by ({right}, {down}) pixels"
    return FittedExplanation(
        family,
        where,
        fit,
        columns,
        "copy",
        ImageMaps("cosines"),
        sharp=True,
        num_choices=num_choices,
        picture_copy=picture_copy,
    )


def _best_shift(data: ResidualData, orientation: PictureCopy) -> tuple[float, PictureCopy]:
    """Gain of chi2 and place of the copy that explains most, over all shifts by whole pixels.

    The part of a copy that the lamp's power takes up is deducted.
    """
    rows, columns = data.shape
    size = [next_fast_len(2 * n) for n in (rows, columns)]
    product = power = cross = overlap = np.zeros(1)
    for signal, weight, residual in zip(data.signal, data.weight, data.marginal_residual, strict=True):
        picture = orientation.turned(signal)
        copy, square = (np.conj(rfft2(image, size)) for image in (picture, picture**2))
        product = product + irfft2(rfft2(residual * weight, size) * copy, size)
        power = power + irfft2(rfft2(weight**2, size) * square, size)
        cross = cross + irfft2(rfft2(weight**2 * signal, size) * copy, size)
        overlap = overlap + irfft2(rfft2(weight > 0, size) * copy, size)
    power = power - cross**2 / max(float(np.sum((data.weight * data.signal) ** 2)), 1e-300)
    enough = (overlap > _MIN_OVERLAP * data.signal.sum()) & (power > _MIN_POWER * power.max())
    gain = np.where(enough, product * np.abs(product) / np.maximum(power, 1e-30), -1.0)
    down, right = (np.fft.fftfreq(n, 1 / n).astype(int) for n in size)
    if orientation == PictureCopy():
        gain[np.hypot(down[:, None], right) < _MIN_SHIFT_PX] = -1
    i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return float(gain[i, j]), PictureCopy(orientation.turns, orientation.mirrored, (int(down[i]), int(right[j])))
