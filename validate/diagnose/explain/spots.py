"""What is known of things in one place: how dust, stains, light, gloss and objects look."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray

from .excess import Excess
from .form import Form, changed

__all__ = ["darker_part", "fits_the_place", "soft_outline"]

#: What a wrong depth, a wrong sign or an odd outline costs, 2 ln of the odds.
_TOO_DEEP = 300.0
_UNLIKELY = 60.0
_ODD = 15.0

#: A thing in front changes the picture by more than this part in its core, a stain or dust by less.
_OPAQUE = 0.25

#: A thing's outline falls from 1 to 0 within so many pixels, or so many times the distance of the bells that it is made
#: of. Of discs, plates and rods by formula 0.7 to 2.3 (one of 14: 3.5), of a small lamp's light on a wall 2 to 8.
_WIDEST_OUTLINE = 2.6

#: Variance across a line that pixels show as thin as they can, px^2, and how many times it is along one.
_THIN_PX2, _LONG = 0.6, 30.0

#: A line goes as far as its weight is above this part of the largest.
_FAINT = 0.05

#: What comes within this part of the picture's size of a side ends there.
_AT_SIDE = 0.05

#: A stain or a thread seen in one band is seen in others by this part of it, at least: their spectra are broad.
_BROAD = 0.05

#: The logarithm of a light's change over the signal keeps to a line over wavelength within half of what the
#: reflectance does that a thing would need, and that one is off its line by this much, rms.
_OF_THE_SURFACE = 0.2

#: Light of the box's own colour brightens no band by so many times the part of another.
_OF_THE_BOX = 2.0

#: No thing is brighter than a white one, but for one nearer to the lamp by so much.
_BRIGHTEST = 2.0

#: Families that may make a place brighter by any factor, without an outline, but not darker: light and charge add. Of
#: the squares of what they change over sigma no more than this part is darker, by noise and what the lamp takes up.
_SHINING, _DARKER = ("extra-light", "reflection-lobe", "sensor-offset"), 0.25

#: A band is darker where most of the squares of its change over sigma are, if there are so many of them.
_SEEN = 30.0

#: A film has two faces, each of which mirrors at most what a coat does; its fitted map rings below 0 by this part.
_MOST_MIRRORED, _LEAST_MIRRORED = 2.0, 0.5

#: A paint covers all of a place at most, and nowhere less than nothing, but for as much as a fitted map rings.
_MOST_COVERED, _LEAST_COVERED = 1.3, 0.3

#: Where there is less light than this part of a band's mean, changes are compared with that part.
_DARK = 0.05


def soft_outline(excess: Excess, thing: Form) -> bool:
    """Whether what a thing in front covers fades away like light, and has no outline.

    Across a straight ramp of width w the integral of a (1 - a) is w / 6. The integral of the slope of a is the mean
    length of its level lines.
    """
    bells = cast("ImageMaps", thing.maps)
    covered = np.clip(thing.fit.coefficients[0] @ bells.matrix(excess.shape), 0.0, 1.0).reshape(excess.shape)
    length = np.hypot(np.diff(covered, axis=0)[:, :-1], np.diff(covered, axis=1)[:-1]).sum()
    return bool(6 * np.sum(covered * (1 - covered)) > _WIDEST_OUTLINE * bells.pitch * length)


def darker_part(excess: Excess, change: NDArray[Any]) -> float:
    """The part of the squares of a change (band, y, x) in DN over sigma by which the picture is darker."""
    squares = (change * excess.weight) ** 2
    return float(squares[change < 0].sum() / max(squares.sum(), 1e-300))


def _a_band_is_darker(excess: Excess, change: NDArray[Any]) -> bool:
    """Whether a change (band, y, x) in DN makes a band darker, as another paint does and no light."""
    squares = (change * excess.weight) ** 2
    whole, darker = squares.sum(axis=(1, 2)), np.where(change < 0, squares, 0.0).sum(axis=(1, 2))
    return bool(np.any((whole > _SEEN) & (darker > whole / 2)))


def fits_the_place(excess: Excess, form: Form, soft: bool) -> float:
    """2 ln of prior odds of a form in one place, by its sign, depth and outline; 0 for all others. What no film and no
    paint can do gains nothing.

    soft : whether the outline of a thing where the excess is densest would be soft.
    """
    if not form.local:
        return 0.0
    if form.mirrored is not None:
        return 0.0 if _as_a_film(excess, form) else -form.fit.gain
    if form.covered is not None:
        return -_ODD if _as_a_paint(excess, form, form.covered) else -form.fit.gain
    change = changed(excess, form)
    weight = np.sum((change * excess.weight) ** 2, axis=0)
    if not weight.any():
        return 0.0
    core = weight > 0.3 * weight.max()
    dark = _DARK * excess.signal.mean(axis=(1, 2))
    relative = change[:, core].mean(axis=1) / np.maximum(excess.signal[:, core].mean(axis=1), dark)
    strongest = float(relative[np.argmax(np.abs(relative))])
    others = np.sort(np.abs(relative))[:-1]
    one_band = len(others) > 0 and bool((others < _BROAD * abs(strongest)).all())
    line = _sharp_line(weight) and not one_band
    deep = float(np.abs(relative).max()) > _OPAQUE
    found = 0.0
    if form.family == "sensor-offset":
        found -= 0.0 if _at_the_border(weight) else _UNLIKELY
    lit = strongest > 0 and (soft or _lit(excess, weight, relative))
    if form.family == "object":
        return 0.0 if (deep or line) and not lit else -_UNLIKELY
    if deep and not (lit and form.family in _SHINING):
        found -= _TOO_DEEP
    if form.family in _SHINING and (darker_part(excess, change) > _DARKER or _a_band_is_darker(excess, change)):
        found -= _TOO_DEEP
    if form.family in ("reflectance-map", "extra-light") and strongest > 0:
        found -= _ODD if (form.family == "extra-light") == _alike(relative) else 0.0
    if form.family == "reflectance-map":
        found -= _UNLIKELY if one_band else 0.0
    if form.family == "sensor-gain":
        found -= _UNLIKELY if strongest > 0 else 0.0
        found -= _TOO_DEEP if line else 0.0
        if not rounder_in_the_picture(excess, weight):
            found -= _ODD
    return found


def _alike(relative: NDArray[np.float64]) -> bool:
    """Whether all bands are brighter by about the same part (band,), as where a paint is fresh or clean: other light
    has another colour than the box's own."""
    return bool(relative.min() > 0 and relative.max() < _OF_THE_BOX * relative.min())


def _lit(excess: Excess, weight: NDArray[Any], relative: NDArray[np.float64]) -> bool:
    """Whether a bright place has the colour of its surface, in light of another colour, and that of no other paint, or
    is brighter than any paint would be there. relative : (band,) its change over the signal."""
    owner = int(excess.surface[np.unravel_index(np.argmax(weight), weight.shape)])
    if owner < 0 or (relative <= 0).any():
        return False
    needed = np.maximum(excess.reflectance_of(owner), 1e-6) * (1 + relative)
    light, thing = (_off_a_line(excess.nm, np.log(values)) for values in (relative, needed))
    of_the_surface = thing > max(_OF_THE_SURFACE, 2 * light)
    return of_the_surface or bool(needed.max() > _BRIGHTEST)


def _off_a_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Rms distance of y (n,) from a straight line over x (n,)."""
    return float(np.std(y - np.polyval(np.polyfit(x, y, 1), x)))


def _as_a_film(excess: Excess, form: Form) -> bool:
    """Whether a place mirrors what a film of plastic on it could: nowhere less than nothing, with or without an
    outline."""
    mirrors = form.fit.coefficients[0] @ cast("ImageMaps", form.maps).matrix(excess.shape)
    return bool(-_LEAST_MIRRORED * mirrors.max() < mirrors.min() and mirrors.max() < _MOST_MIRRORED)


def _as_a_paint(excess: Excess, form: Form, covered: NDArray[np.float64]) -> bool:
    """Whether another paint covers a place, see ``Form.covered``: no part less than nothing or more than all."""
    band = int(np.argmax(np.abs(covered)))
    bells = cast("ImageMaps", form.maps).matrix(excess.shape)
    part = form.fit.coefficients[band] / covered[band] @ bells
    return bool(-_LEAST_COVERED * part.max() < part.min() and part.max() < _MOST_COVERED)


def _moments(weight: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre (2,) as (x, y), px, of a weight (y, x), and its second moments (2, 2) about it, px^2."""
    rows, columns = np.indices(weight.shape)
    places, parts = np.array([columns, rows], float), weight / weight.sum()
    centre = np.einsum("iyx,yx->i", places, parts)
    offsets = places - centre[:, None, None]
    return centre, np.einsum("iyx,jyx,yx->ij", offsets, offsets, parts)


def _sharp_line(weight: NDArray[Any]) -> bool:
    """Whether a weight (y, x) is a straight line as thin as pixels show it, which keeps to no row or column, or ends
    at neither side of the picture: a thread or a wire in the scene. What lies on the sensor's window is out of focus,
    hairs are bent, and a faulty column is wrong as far as the register."""
    _, moments = _moments(weight)
    across, along = np.linalg.eigvalsh(moments)
    if across > _THIN_PX2 or along <= _LONG * across:
        return False
    places, at_side = np.argwhere(weight > _FAINT * weight.max()), _AT_SIDE * max(weight.shape)
    if (places > at_side).all() and (places < np.array(weight.shape) - 1 - at_side).all():
        return True
    # how far its ends lie apart across the rows or columns that it runs along
    return bool(abs(moments[0, 1]) / max(np.diag(moments)) * np.sqrt(12 * along) > 1.0)


def _at_the_border(weight: NDArray[Any]) -> bool:
    """Whether a glow is brightest at the border of the picture, where amplifiers sit."""
    peak = np.unravel_index(np.argmax(weight), weight.shape)
    return any(
        place < _AT_SIDE * size or place > (1 - _AT_SIDE) * size for place, size in zip(peak, weight.shape, strict=True)
    )


def rounder_in_the_picture(excess: Excess, weight: NDArray[Any]) -> bool:
    """Whether a spot is rounder in the picture than on the surface that it is seen on."""
    centre, shape = _moments(weight)
    owner = excess.surface[round(float(centre[1])), round(float(centre[0]))]
    t = excess.transport
    near = (t.surface == owner) & (t.coverage > 0.99)
    y, x = np.divmod(t.pixel, weight.shape[1])
    near &= np.hypot(x - centre[0], y - centre[1]) < 6
    if near.sum() < 12:
        return True
    design = np.array([np.ones(near.sum()), x[near] - centre[0], y[near] - centre[1]]).T
    slopes = np.linalg.lstsq(design, t.position[near], rcond=None)[0][1:]
    on_surface = slopes @ slopes.T @ shape
    return elongation(shape) <= elongation(on_surface)


def elongation(matrix: NDArray[Any]) -> float:
    """Larger over smaller of two positive eigenvalues."""
    values = np.sort(np.abs(np.linalg.eigvals(matrix)))
    return float(values[1] / max(values[0], 1e-12))
