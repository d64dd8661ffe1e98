"""Explanations that need nothing but the two pictures: lamp, wavelengths, exchanged bands, values."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np
from cboxlab.rendering.files import COLOUR_SPACES, primaries_matrix
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import linear_sum_assignment, minimize_scalar

from .evidence import Evidence, Fit
from .sides import Side

__all__ = ["Explanation", "exact", "from_pictures", "group_name"]

#: Factors by which renderers differ that take a quantity or a unit for another.
#: Each with its name and what it may mean. Candidate over baseline, or the other way round.
_FACTORS = (
    (2.0, "2", "a lamp that emits from both sides, or half of the light's power or area"),
    (math.pi, "pi", "irradiance or radiosity taken for radiance, or a diffuse reflectance that is not divided by pi"),
    (4 * math.pi, "4 pi", "power or intensity of a lamp taken for radiance"),
    (683.0, "683", "photometric units taken for radiometric ones (683 lm/W)"),
    (179.0, "179", "Radiance's photometric units taken for radiometric ones (179 lm/W)"),
    (106.857, "106.857", "division by the integral of the CIE's y in one of them"),
    (1000.0, "1000", "a unit's prefix, such as W and mW, or nm and um"),
)
#: A factor is taken for a known one within this part of it.
_NEAR = 3e-3
#: A factor further from 1 is a ratio of sums.
_LARGE = 0.3
#: Steps of Gauss and Newton.
_STEPS = 5
#: Exponents of values encoded for a screen, and decoded, and how near one is taken for it, relative.
_SCREEN, _NEAR_SCREEN = (1 / 2.2, 2.2), 0.05
#: An exponent nearer to 1 is none.
_NEAR_ONE = 1e-3


@dataclass(frozen=True)
class Explanation(OwnMappings):
    """change : its identifier. chi2 : of what it leaves. free : parameters fitted or chosen."""

    change: str
    parameters: Mapping[str, Any]
    chi2: float
    free: int


def from_pictures(evidence: Evidence, side: Side) -> Iterator[Explanation]:
    """All of them, fitted. side : either of those compared, for what its planes are called."""
    yield from _lamp(evidence, side)
    yield from _values(evidence)
    yield from _exchanged(evidence, side)
    if not side.in_colour:
        yield from _wavelengths(evidence, side.wavelength_nm)


def group_name(side: Side, group: NDArray[np.bool_]) -> str:
    """Of a group of planes (w,): their mean wavelength in nm, or X, Y, Z."""
    if side.in_colour:
        return " ".join(name for name, inside in zip(side.bands, group, strict=True) if inside)
    return f"{float(side.wavelength_nm[group].mean()):.4g}"


def _lamp(evidence: Evidence, side: Side) -> Iterator[Explanation]:
    base = evidence.baseline
    fit = evidence.fit([base])
    factor = 1 + float(fit.amplitudes[0])
    if abs(factor - 1) > _LARGE:  # noise of the baseline, in both sides of the fit, would bias it
        inside = evidence.cell >= 0
        factor = float(evidence.candidate[inside].sum() / base[inside].sum())
    meaning = _meaning(factor)
    known = {} if meaning is None else {"meaning": meaning}
    yield Explanation("lamp-scale", {"factor": factor, **known}, fit.chi2, 1)
    if evidence.groups > 1:
        masks = [evidence.group == g for g in range(evidence.groups)]
        fit = evidence.fit([base * mask for mask in masks])
        factors = {group_name(side, mask): 1 + float(a) for mask, a in zip(masks, fit.amplitudes, strict=True)}
        if min(factors.values()) >= 0:
            yield Explanation("lamp-spectrum", {"factor_by_nm": factors}, fit.chi2, len(masks))


def _meaning(factor: float) -> str | None:
    """A sentence for a factor that is known, or whose inverse is; None for others."""
    if factor <= 0:
        return None
    for known, name, meaning in _FACTORS:
        for value, shown in ((known, name), (1 / known, f"1 / {name}")):
            if abs(factor - value) < _NEAR * value:
                return f"factor {shown}: {meaning}?"
    return None


def exact(evidence: Evidence, picture: NDArray) -> Fit:
    """What is left where the candidate is said to be a picture, without a free number."""
    return evidence.fit([], picture - evidence.baseline)


def _values(evidence: Evidence) -> Iterator[Explanation]:
    """A constant added; values cut off above a largest one; values taken to a power."""
    base, mean = evidence.baseline, float(evidence.baseline.mean())
    if not mean > 0:
        return
    fit = evidence.fit([np.full_like(base, mean)])
    yield Explanation("offset", {"added_over_mean": float(fit.amplitudes[0])}, fit.chi2, 1)
    most = float(evidence.candidate.max())
    if 0 < most < float(base.max()):

        def cut(level: float) -> float:
            return exact(evidence, np.minimum(base, level)).chi2

        found = minimize_scalar(cut, bounds=(0.7 * most, 1.05 * most), method="bounded", options={"maxiter": 12})
        yield Explanation("clipped", {"largest": float(found.x)}, float(found.fun), 1)
    yield from _power(evidence, np.maximum(base / mean, 1e-9), mean)


def _power(evidence: Evidence, base: NDArray[np.float64], mean: float) -> Iterator[Explanation]:
    """base : radiances over their mean."""
    seen = (evidence.cell >= 0)[..., None] & (evidence.candidate > 0) & (base > 1e-3)
    if np.count_nonzero(seen) < 3:
        return
    exponent, level = np.polyfit(np.log(base[seen]), np.log(evidence.candidate[seen] / mean), 1)
    factor, best = float(np.exp(level)), None
    for _ in range(_STEPS):
        picture = factor * mean * base**exponent
        chi2 = exact(evidence, picture).chi2
        if best is None or chi2 < best.chi2:
            screen = [known for known in _SCREEN if abs(exponent / known - 1) < _NEAR_SCREEN]
            told = {"meaning": "values encoded for a screen, or decoded once too often?"} if screen else {}
            parameters = {"exponent": float(exponent), "factor_at_mean": factor, **told}
            best = Explanation("power", parameters, chi2, 2)
        step = evidence.fit([picture, picture * np.log(base)], picture - evidence.baseline).amplitudes
        factor *= float(np.clip(1 + step[0], 0.5, 2.0))
        exponent = float(np.clip(exponent + step[1], 0.05, 20.0))
    if best is not None and abs(best.parameters["exponent"] - 1) > _NEAR_ONE:
        yield best


def _exchanged(evidence: Evidence, side: Side) -> Iterator[Explanation]:
    """Bands in another order; of pictures in colour red, green and blue, whose primaries are not known here."""
    base = evidence.baseline
    if side.in_colour:
        for (space, corners), order in product(COLOUR_SPACES.items(), permutations(range(3))):
            matrix = primaries_matrix(corners)
            chi2 = exact(evidence, base @ (matrix @ np.linalg.inv(matrix)[list(order)]).T).chi2
            names = "".join("RGB"[i] for i in order)
            if names != "RGB":
                yield Explanation("bands-exchanged", {"order": names, "colour_space": space}, chi2, 1)
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
    shown, order = linear_sum_assignment(cost)
    others = int(np.count_nonzero(shown != order))
    if others:
        named = [side.bands[i] for i in order]
        yield Explanation("bands-exchanged", {"order": named}, exact(evidence, base[..., order]).chi2, others)


def _wavelengths(evidence: Evidence, wavelength_nm: NDArray) -> Iterator[Explanation]:
    """Reversed; and values of wavelengths that are off by a constant, or by a constant and a stretch."""
    base = evidence.baseline
    if wavelength_nm.size < 4:
        return
    yield Explanation("wavelengths", {"order": "reversed"}, exact(evidence, base[..., ::-1]).chi2, 1)
    step = float(np.median(np.diff(wavelength_nm)))
    spectrum = CubicSpline(wavelength_nm, base, axis=-1)
    slope = spectrum.derivative()
    middle, half = wavelength_nm.mean(), np.ptp(wavelength_nm) / 2
    shapes = [np.ones(wavelength_nm.size), (wavelength_nm - middle) / half]
    for count in (1, 2):
        off = np.zeros(count)
        best = (np.inf, off)
        for _ in range(_STEPS):
            at = np.clip(
                wavelength_nm + off @ np.array(shapes[:count]),
                wavelength_nm[0] - step,
                wavelength_nm[-1] + step,
            )
            picture, rise = spectrum(at), slope(at)
            fit = evidence.fit([rise * shape for shape in shapes[:count]], picture - base)
            own = exact(evidence, picture).chi2
            if own < best[0]:
                best = own, off
            off = np.clip(off + fit.amplitudes, -1.5 * step, 1.5 * step)
        parameters = {"shift_nm": float(best[1][0])}
        if count == 2:
            parameters["stretch_nm"] = float(best[1][1])
        yield Explanation("wavelengths", parameters, best[0], count)
