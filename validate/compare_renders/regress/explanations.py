"""Explanations by the two pictures alone: lamp, wavelengths, exchanged bands, values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import permutations, product
from typing import Any

import numpy as np
from cboxlab.rendering.files import COLOUR_SPACES, primaries_matrix
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment, minimize_scalar

from .evidence import Evidence, Fit
from .sides import Side

__all__ = ["FittedChange", "exact", "from_pictures", "group_name"]

#: Factors between renderers that take a quantity or a unit for another: value, name, meaning. They are those of
#: candidate over baseline, or of baseline over candidate.
_FACTORS = (
    (2.0, "2", "a lamp that emits from both sides, or half of the light's power or area"),
    (math.pi, "pi", "irradiance or radiosity taken for radiance, or a diffuse reflectance that is not divided by pi"),
    (4 * math.pi, "4 pi", "power or intensity of a lamp taken for radiance"),
    (683.0, "683", "photometric units taken for radiometric ones (683 lm/W)"),
    (179.0, "179", "Radiance's photometric units taken for radiometric ones (179 lm/W)"),
    (106.857, "106.857", "division by the integral of the CIE's y in one of them"),
    (1000.0, "1000", "a unit's prefix, such as W and mW, or nm and um"),
)
#: Largest relative distance of a factor from one of these that it is taken for: noise of a mean.
_FACTOR_TOLERANCE = 3e-3
#: Distance of a factor from 1 beyond which it is a ratio of sums: noise of the baseline would bias the fit.
_LARGE_FACTOR = 0.3
#: Steps of Gauss and Newton.
_STEPS = 5
#: Exponents of values encoded for a screen, and of values decoded.
_SCREEN_EXPONENTS = (1 / 2.2, 2.2)
#: Largest relative distance of an exponent from one of these that it is taken for.
_EXPONENT_TOLERANCE = 0.05
#: Bounds of an exponent.
_EXPONENTS = (0.05, 20.0)
#: Smallest distance of an exponent from 1.
_MIN_EXPONENT_CHANGE = 1e-3
#: Least value over the mean that is raised to a power: values below 0 have none.
_LEAST_VALUE = 1e-9
#: Fewest wavelengths for which shifts of wavelengths are fitted.
_MIN_WAVELENGTHS = 4


@dataclass(frozen=True)
class FittedChange(FrozenMappings):
    """A fitted explanation of a change."""

    #: Identifier of the change.
    change: str
    #: Parameters by name.
    parameters: Mapping[str, Any]
    #: Fit whose remainder counts.
    fit: Fit
    #: Number of parameters that were fitted or selected.
    free: int
    #: Parts of the change's chi-square that the error of its shape leaves, in cells and single pixels; None by name.
    shape_errors: tuple[float, float] | None = None
    #: Function that changes pictures (..., y, x, w) in this way; None for a change whose shape is computed or moved.
    applied: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None

    @property
    def chi2(self) -> float:
        """Chi-square of the remainder."""
        return self.fit.chi2


def from_pictures(evidence: Evidence, side: Side) -> Iterator[FittedChange]:
    """Fitted explanations that need no scene.

    Parameters
    ----------
    evidence
        Numbers that a change has to explain.
    side
        Either side, for the names of its planes.

    Yields
    ------
    FittedChange
        Lamp, values, exchanged bands, wavelengths.
    """
    yield from _lamp(evidence, side)
    yield from _values(evidence)
    yield from _exchanged(evidence, side)
    if not side.in_colour:
        yield from _wavelengths(evidence, side.wavelength_nm)


def group_name(side: Side, group: NDArray[np.bool_]) -> str:
    """Name of a group of planes: their mean wavelength in nm, X, Y, Z, or R, G, B.

    Parameters
    ----------
    side
        Side with these planes.
    group
        (w,) planes of the group.

    Returns
    -------
    str
        The name.
    """
    if side.in_colour:
        return " ".join(name for name, inside in zip(side.bands, group, strict=True) if inside)
    return f"{float(side.wavelength_nm[group].mean()):.4g}"


def _lamp(evidence: Evidence, side: Side) -> Iterator[FittedChange]:
    """All light times a factor; and times one factor for each group of bands."""
    base = evidence.baseline
    fit = evidence.fit([base])
    factor = 1 + float(fit.amplitudes[0])
    if abs(factor - 1) > _LARGE_FACTOR:
        inside = evidence.cell >= 0
        factor = float(evidence.candidate[inside].sum() / base[inside].sum())
    meaning = _meaning(factor)
    remark = {} if meaning is None else {"meaning": meaning}
    yield FittedChange("lamp-scale", {"factor": factor, **remark}, fit, 1, applied=lambda p: p * factor)
    if evidence.groups > 1:
        masks = [evidence.group == g for g in range(evidence.groups)]
        fit = evidence.fit([base * mask for mask in masks])
        factors = {group_name(side, mask): 1 + float(a) for mask, a in zip(masks, fit.amplitudes, strict=True)}
        if min(factors.values()) >= 0:
            gains = 1 + fit.amplitudes[evidence.group]
            names = ("channel-gains", "factor_by_channel") if side.as_stored else ("lamp-spectrum", "factor_by_nm")
            yield FittedChange(names[0], {names[1]: factors}, fit, len(masks), applied=lambda p: p * gains)


def _meaning(factor: float) -> str | None:
    """Sentence for a factor of the list, or the inverse of one; None for others."""
    if factor <= 0:
        return None
    for listed, name, meaning in _FACTORS:
        for value, label in ((listed, name), (1 / listed, f"1 / {name}")):
            if abs(factor - value) < _FACTOR_TOLERANCE * value:
                return f"factor {label}: {meaning}?"
    return None


def exact(evidence: Evidence, picture: NDArray) -> Fit:
    """Fit of a picture that the candidate should be, without a free number.

    Parameters
    ----------
    evidence
        Numbers that a change has to explain.
    picture
        (y, x, w) expected candidate.

    Returns
    -------
    Fit
        Chi-square of the remainder.
    """
    return evidence.fit([], picture - evidence.baseline)


def _values(evidence: Evidence) -> Iterator[FittedChange]:
    """A constant added; values clipped at a largest one; values raised to a power."""
    base, mean = evidence.baseline, float(evidence.baseline.mean())
    if not mean > 0:
        return
    fit = evidence.fit([np.full_like(base, mean)])
    added = float(fit.amplitudes[0])
    yield FittedChange("offset", {"added_over_mean": added}, fit, 1, applied=lambda p: p + added * mean)
    most = float(evidence.candidate.max())
    if 0 < most < float(base.max()):

        def cut(level: float) -> float:
            return exact(evidence, np.minimum(base, level)).chi2

        best = minimize_scalar(cut, bounds=(0.7 * most, 1.05 * most), method="bounded", options={"maxiter": 12})
        yield FittedChange("clipped", {"largest": float(best.x)}, exact(evidence, np.minimum(base, best.x)), 1)
    yield from _power(evidence, np.maximum(base / mean, _LEAST_VALUE), mean)


def _power(evidence: Evidence, base: NDArray[np.float64], mean: float) -> Iterator[FittedChange]:
    """Values raised to a power, times a factor. base : (y, x, w) radiances over their mean."""
    used = (evidence.cell >= 0)[..., None] & (evidence.candidate > 0) & (base > 1e-3)
    if np.count_nonzero(used) < 3 or not np.ptp(base[used]):
        return
    exponent, level = np.polyfit(np.log(base[used]), np.log(evidence.candidate[used] / mean), 1)
    factor, best = float(np.exp(level)), None
    for _ in range(_STEPS):
        picture = factor * mean * base**exponent
        fit = exact(evidence, picture)
        if best is None or fit.chi2 < best.chi2:
            screen = [e for e in _SCREEN_EXPONENTS if abs(exponent / e - 1) < _EXPONENT_TOLERANCE]
            remark = {"meaning": "values encoded for a screen, or decoded once too often?"} if screen else {}
            parameters = {"exponent": float(exponent), "factor_at_mean": factor, **remark}
            best = FittedChange("power", parameters, fit, 2, applied=partial(_powered, mean, factor, exponent))
        step = evidence.fit([picture, picture * np.log(base)], picture - evidence.baseline).amplitudes
        factor *= float(np.clip(1 + step[0], 0.5, 2.0))
        exponent = float(np.clip(exponent + step[1], *_EXPONENTS))
    # an exponent at its bound has not been found, as of a picture with hardly any contrast
    if best is not None and _sound_exponent(best.parameters["exponent"]):
        yield best


def _powered(mean: float, factor: float, exponent: float, picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values over their mean raised to a power."""
    powered = factor * mean * np.maximum(picture / mean, _LEAST_VALUE) ** exponent
    return np.where(picture > 0, powered, picture)


def _sound_exponent(exponent: float) -> bool:
    """Whether an exponent changes a picture, and lies inside its bounds."""
    low, high = _EXPONENTS
    return 2 * low < exponent < high / 2 and abs(exponent - 1) > _MIN_EXPONENT_CHANGE


def _exchanged(evidence: Evidence, side: Side) -> Iterator[FittedChange]:
    """Bands in another order; in colour red, green and blue, for each known set of primaries."""
    base = evidence.baseline
    if side.as_stored:
        for order in permutations(range(len(side.bands))):
            letters = "".join(side.bands[i] for i in order)
            if letters != "RGB":
                yield FittedChange("bands-exchanged", {"order": letters}, exact(evidence, base[..., list(order)]), 1)
        return
    if side.in_colour:
        for (space, corners), order in product(COLOUR_SPACES.items(), permutations(range(3))):
            matrix = primaries_matrix(corners)
            fit = exact(evidence, base @ (matrix @ np.linalg.inv(matrix)[list(order)]).T)
            names = "".join("RGB"[i] for i in order)
            if names != "RGB":
                yield FittedChange("bands-exchanged", {"order": names, "colour_space": space}, fit, 1)
        return
    inside = evidence.cell >= 0
    if not inside.any():
        return
    cell, cells = evidence.cell[inside], evidence.level.shape[0]
    before, after = (
        np.log(np.maximum([np.bincount(cell, band, cells) for band in picture[inside].T], 1e-300))
        for picture in (base, evidence.candidate)
    )
    cost = np.abs(after[:, None] - before[None]).mean(axis=-1)
    rows, order = linear_sum_assignment(cost)
    others = int(np.count_nonzero(rows != order))
    if others:
        labels = [side.bands[i] for i in order]
        yield FittedChange("bands-exchanged", {"order": labels}, exact(evidence, base[..., order]), others)


def _wavelengths(evidence: Evidence, wavelength_nm: NDArray) -> Iterator[FittedChange]:
    """Wavelengths reversed, shifted, or shifted and stretched."""
    from scipy.interpolate import CubicSpline  # slow to import

    base = evidence.baseline
    if wavelength_nm.size < _MIN_WAVELENGTHS:
        return
    yield FittedChange("wavelengths", {"order": "reversed"}, exact(evidence, base[..., ::-1]), 1)
    step = float(np.median(np.diff(wavelength_nm)))
    spectrum = CubicSpline(wavelength_nm, base, axis=-1)
    slope = spectrum.derivative()
    middle, half = wavelength_nm.mean(), np.ptp(wavelength_nm) / 2
    shapes = [np.ones(wavelength_nm.size), (wavelength_nm - middle) / half]
    for count in (1, 2):
        off = np.zeros(count)
        best = (exact(evidence, spectrum(wavelength_nm)), off)
        for _ in range(_STEPS):
            at = np.clip(
                wavelength_nm + off @ np.array(shapes[:count]),
                wavelength_nm[0] - step,
                wavelength_nm[-1] + step,
            )
            picture, rise = spectrum(at), slope(at)
            fit = evidence.fit([rise * shape for shape in shapes[:count]], picture - base)
            moved = exact(evidence, picture)
            if moved.chi2 < best[0].chi2:
                best = moved, off
            off = np.clip(off + fit.amplitudes, -1.5 * step, 1.5 * step)
        parameters = {"shift_nm": float(best[1][0])}
        if count == 2:
            parameters["stretch_nm"] = float(best[1][1])
        yield FittedChange("wavelengths", parameters, best[0], count)
