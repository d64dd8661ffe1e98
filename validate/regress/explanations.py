"""Explanations that need nothing but the two pictures: lamp, shift, mirror, filter, border, wavelengths."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from cboxlab.scenes.frozen import OwnMappings
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import convolve1d

from .evidence import Evidence, Fit
from .sides import Side

__all__ = ["Explanation", "from_pictures", "group_name"]

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
)  # fmt: skip
#: A factor is taken for a known one within this part of it.
_NEAR = 3e-3
#: Largest shift looked for, px.
_REACH_PX = 4
#: A factor further from 1 is a ratio of sums.
_LARGE = 0.3
#: Steps of Gauss and Newton.
_STEPS = 5
#: Neighbours that differ by this part of their sum have an edge between them. Step of finite differences, px.
_EDGE, _SLOPE_PX = 0.05, 0.1


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
    yield from _mirrored(evidence)
    yield _shift(evidence)
    yield _filter(evidence)
    yield from _border(evidence)
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
        factors = {
            group_name(side, mask): 1 + float(a) for mask, a in zip(masks, fit.amplitudes, strict=True)
        }
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


def _exact(evidence: Evidence, picture: NDArray) -> Fit:
    return evidence.fit([], picture - evidence.baseline)


def _mirrored(evidence: Evidence) -> Iterator[Explanation]:
    base = evidence.baseline
    for axis, picture in {
        "horizontal": base[:, ::-1], "vertical": base[::-1], "both": base[::-1, ::-1],
    }.items():  # fmt: skip
        yield Explanation("mirrored", {"axis": axis}, _exact(evidence, picture).chi2, 1)


def moved(picture: NDArray[np.float64], dx: float, dy: float) -> NDArray[np.float64]:
    """The picture (y, x, w) moved by parts of a pixel, edges kept sharp; first along x, then along y.

    A pixel whose value lies between those of its two neighbours, and whose neighbours differ much, holds an edge at the
    place that its value tells (volume of fluid, Hirt and Nichols 1981); all others are uniform.
    """
    return np.swapaxes(_moved_along_x(np.swapaxes(_moved_along_x(picture, dx), 0, 1), dy), 0, 1)


def _moved_along_x(picture: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    if by < 0:
        return _moved_along_x(picture[:, ::-1], -by)[:, ::-1]
    whole, part = int(by), by - int(by)
    count = picture.shape[1]
    picture = picture[:, np.clip(np.arange(count) - whole, 0, count - 1)]
    if part < 1e-6:
        return picture
    before, after = (picture[:, np.clip(np.arange(count) + step, 0, count - 1)] for step in (-1, 1))
    step = before - after
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.where(
            step != 0, (picture - after) / step, -1.0
        )  # part of the pixel that is like the one before
    edge = (np.abs(step) > _EDGE * (before + after)) & (place >= 0) & (place <= 1)
    # means over the pixel's last ``part`` and over the rest of it
    left = np.clip(place - (1 - part), 0, part) / part
    right = np.clip(place, 0, 1 - part) / (1 - part)
    last = np.where(edge, left * before + (1 - left) * after, picture)
    rest = np.where(edge, right * before + (1 - right) * after, picture)
    coming = last[:, np.clip(np.arange(count) - 1, 0, count - 1)]
    return part * coming + (1 - part) * rest


def _shift(evidence: Evidence) -> Explanation:
    """The best whole shift first, from there by the slopes of the moved picture."""
    total = evidence.baseline.sum(axis=-1, keepdims=True)
    goal = evidence.candidate.sum(axis=-1, keepdims=True)
    size = np.maximum(total, 1e-3 * total.mean())
    reach = range(-_REACH_PX, _REACH_PX + 1)
    costs = {
        (dx, dy): float(np.minimum(np.abs((goal - np.roll(total, (dy, dx), (0, 1))) / size), 0.5).sum())
        for dx in reach
        for dy in reach
    }
    place = np.array(min(costs, key=lambda d: costs[d]), float)
    # what a shift brings into the picture at its border cannot be known
    unseen = [evidence.baseline * (distance < 1)[..., None] for distance in _distances(evidence).values()]
    best, chi2 = place, np.inf
    for _ in range(_STEPS):
        picture = moved(evidence.baseline, *place)
        own = evidence.fit(unseen, picture - evidence.baseline).chi2
        if own >= chi2:
            break
        best, chi2 = place, own
        slopes = [
            (moved(evidence.baseline, *(place + step)) - moved(evidence.baseline, *(place - step)))
            / (2 * _SLOPE_PX)
            for step in _SLOPE_PX * np.eye(2)
        ]
        step = evidence.fit([*slopes, *unseen], picture - evidence.baseline).amplitudes[:2]
        place = place + np.clip(step, -1, 1)
    return Explanation("shift", {"dx_px": float(best[0]), "dy_px": float(best[1])}, chi2, 6)


def _curvature(picture: NDArray) -> NDArray[np.float64]:
    kernel = np.array([1.0, -2.0, 1.0])
    return convolve1d(picture, kernel, 0, mode="nearest") + convolve1d(picture, kernel, 1, mode="nearest")


def _filter(evidence: Evidence) -> Explanation:
    once = _curvature(evidence.baseline)
    fit = evidence.fit([once, _curvature(once)])
    blur = 2 * float(fit.amplitudes[0])
    return Explanation("pixel-filter", {"added_variance_px2": blur}, fit.chi2, 2)


def _border(evidence: Evidence) -> Iterator[Explanation]:
    distances = _distances(evidence)
    for ring in (1, 2, 3):
        templates = [evidence.baseline * (distance < ring)[..., None] for distance in distances.values()]
        fit = evidence.fit(templates)
        factors = {f"{name}_factor": 1 + float(a) for name, a in zip(distances, fit.amplitudes, strict=True)}
        yield Explanation("border", {"width_px": ring, **factors}, fit.chi2, 5)


def _distances(evidence: Evidence) -> dict[str, NDArray[np.int64]]:
    """(y, x) px from each side of the picture."""
    height, width = evidence.baseline.shape[:2]
    rows, columns = np.indices((height, width))
    return {"left": columns, "right": width - 1 - columns, "top": rows, "bottom": height - 1 - rows}


def _wavelengths(evidence: Evidence, wavelength_nm: NDArray) -> Iterator[Explanation]:
    """Reversed; and values of wavelengths that are off by a constant, or by a constant and a stretch."""
    base = evidence.baseline
    if wavelength_nm.size < 4:
        return
    yield Explanation("wavelengths", {"order": "reversed"}, _exact(evidence, base[..., ::-1]).chi2, 1)
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
            own = _exact(evidence, picture).chi2
            if own < best[0]:
                best = own, off
            off = np.clip(off + fit.amplitudes, -1.5 * step, 1.5 * step)
        parameters = {"shift_nm": float(best[1][0])}
        if count == 2:
            parameters["stretch_nm"] = float(best[1][1])
        yield Explanation("wavelengths", parameters, best[0], count)
