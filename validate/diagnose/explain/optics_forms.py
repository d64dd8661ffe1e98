"""Displacements of the picture and blurs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import Acts, ImageMaps, exchanges
from numpy.typing import NDArray

from .excess import Excess
from .field import FieldFit, Normal, beside_common, each_band, fixed_spectrum
from .form import Columns, Form, equations

__all__ = ["moves_of_bands", "optics_forms", "smears", "uneven_blurs"]

_ORDER, _ORDER_OF_BLUR = 4, 2
_RADIUS = 2

#: Errors of a round blur are round: of a defocus' chi2 at most 0.006 was left along a line in captures of another
#: simulator, where a smear of 0.7 px along a diagonal left 0.03.
_ROUND_LEAVES = 0.01

#: Directions of streaks that are tried, degrees from the rows, downwards.
_STREAKS_DEG = tuple(range(0, 180, 15))

#: At 0, 45, 90 and 135 degrees from the rows, downwards.
_LINES = "the rows", "the falling diagonal", "the columns", "the rising diagonal"


def optics_forms(excess: Excess) -> Iterator[Form]:
    """The picture moved or blurred: alike everywhere or not, in all bands, in one, or in each."""
    for words, maps, made in _moved(excess):
        yield from _spectra(equations(excess, made), "displacement", words, made, "displacement", maps)
    for words, order in (("the whole picture", 0), ("unevenly over the picture", _ORDER_OF_BLUR)):
        maps, radius = ImageMaps("cosines", order=order), 1 if order else _RADIUS
        n, made = _blurred(excess, maps, radius)
        yield from _spectra(n, "blur", words, made, "neighbours", maps, radius)
    yield from smears(excess)
    wide = _exchanged(excess, "halo")
    yield from _spectra(equations(excess, wide), "blur", "a wide halo", wide, "halo", ImageMaps("cosines"))
    yield max((_streak(excess, angle) for angle in _STREAKS_DEG), key=lambda form: form.evidence)


def _streak(excess: Excess, angle_deg: float) -> Form:
    """Light spread far along one line, in all bands alike: by a lens that was wiped, by blades of a diaphragm."""
    made = _exchanged(excess, "streak", angle_deg)
    fit = fixed_spectrum(equations(excess, made), np.ones(len(excess.bands)))
    words = f"streaks at {angle_deg:g} degrees from the rows"
    return Form(
        "blur",
        words,
        fit,
        made,
        "streak",
        ImageMaps("cosines"),
        choices=len(_STREAKS_DEG),
        angle_deg=angle_deg,
    )


def smears(excess: Excess) -> Iterator[Form]:
    """The whole picture blurred along a line, less what a round blur can imitate of it."""
    made = _exchanged(excess, "moments")
    products = np.zeros((3, 3))
    for band, weight in enumerate(excess.weight.reshape(len(excess.bands), -1)):
        seen = made(band) * weight
        products += seen @ seen.T
    parts = np.column_stack([-products[1:, 0] / max(products[0, 0], 1e-300), np.eye(2)])

    def alone(band: int) -> NDArray[Any]:
        return (parts @ made(band)).astype(np.float32)

    n = equations(excess, alone)
    for form in _spectra(n, "blur", "along a line", alone, "moments", ImageMaps("cosines")):
        fit = replace(form.fit, coefficients=form.fit.coefficients @ parts)
        words = form.words.replace("along a line", f"along {_direction(form.fit)}")
        yield replace(form, words=words, fit=fit, columns=made, sharp=True, effects_leave=_ROUND_LEAVES)


def uneven_blurs(excess: Excess) -> Iterator[Form]:
    """The picture blurred here more than there, in all bands alike, less what a blur of the whole gains and needs:
    errors of the rendered picture's edges are alike everywhere."""
    words, ones = "unevenly over the picture", np.ones(len(excess.bands))
    forms = []
    for order in (_ORDER_OF_BLUR, 0):
        maps = ImageMaps("cosines", order=order)
        n, made = _blurred(excess, maps, 1)
        forms.append(Form("blur", words, fixed_spectrum(n, ones), made, "neighbours", maps, sharp=True))
    uneven, even = forms
    gain, evidence = uneven.fit.gain - even.fit.gain, uneven.fit.evidence - even.fit.evidence
    yield replace(uneven, fit=replace(uneven.fit, gain=gain, evidence=evidence))


def moves_of_bands(excess: Excess) -> Iterator[Form]:
    """The picture moved in each band otherwise, or in one, beside what moves all bands alike: errors of the rendered
    picture's edges do that."""
    for words, maps, made in _moved(excess):
        n = beside_common(equations(excess, made))
        _, *apart = _spectra(n, "displacement", words, made, "displacement", maps)
        yield from (replace(form, sharp=True) for form in apart)


def _direction(fit: FieldFit) -> str:
    """Along which of four lines a blur is, from its two numbers in each band: v cos(2 a) / 2 and v sin(2 a) / 4, v its
    variance and a the angle from the rows, downwards. In a picture of steps from
    pixel to pixel it is 17 to 37 degrees off between the lines of rows and columns."""
    across, diagonal = fit.size @ fit.coefficients
    return _LINES[round(np.arctan2(2 * diagonal, across) / (np.pi / 2)) % 4]


def _spectra(
    n: Normal, family: str, words: str, made: Columns, acts: Acts, maps: ImageMaps, radius: int = 1
) -> Iterator[Form]:
    bands = len(n.b)
    yield Form(family, words, fixed_spectrum(n, np.ones(bands)), made, acts, maps, radius=radius)
    each = each_band(n)
    yield Form(family, f"{words}, in each band otherwise", each, made, acts, maps, radius=radius)
    strongest = int(np.argmax(each.size))
    yield Form(
        family,
        f"{words}, in one band",
        fixed_spectrum(n, np.eye(bands)[strongest]),
        made,
        acts,
        maps,
        sharp=True,
        choices=bands,
        radius=radius,
    )


def _moved(excess: Excess) -> Iterator[tuple[str, ImageMaps, Columns]]:
    for words, order in (("the whole picture", 0), ("a smooth field", _ORDER)):
        maps = ImageMaps("cosines", order=order)
        yield words, maps, _moves(excess, maps.matrix(excess.shape))


def _moves(excess: Excess, basis: NDArray[Any]) -> Columns:
    def made(band: int) -> NDArray[Any]:
        return np.concatenate([way[band].ravel() * basis for way in excess.moved]).astype(np.float32)

    return made


def _blurred(excess: Excess, maps: ImageMaps, radius: int) -> tuple[Normal, Columns]:
    """The equations of exchanges with neighbours, less what they gain by averaging the rendered picture's noise."""
    basis = maps.matrix(excess.shape)
    noise = replace(excess, signal=excess.noise, weighed=-excess.noise * excess.weight)
    made = _near(excess, basis, radius)
    n, own = equations(excess, made), equations(noise, _near(noise, basis, radius))
    return Normal(n.a - own.a, n.b - own.b, n.c, n.own_a - own.own_a, n.own_b - own.own_b), made


def _near(excess: Excess, basis: NDArray[Any], radius: int) -> Columns:
    """Light exchanged with neighbours on opposite sides alike: that moves nothing."""

    def made(band: int) -> NDArray[Any]:
        each = exchanges("neighbours", excess.signal[band], radius)
        return np.concatenate([one.ravel() * basis for one in each]).astype(np.float32)

    return made


def _exchanged(excess: Excess, acts: Acts, angle_deg: float = 0.0) -> Columns:
    """Light exchanged alike over the whole picture."""

    def made(band: int) -> NDArray[Any]:
        each = exchanges(acts, excess.signal[band], angle_deg=angle_deg)
        return np.array([one.ravel() for one in each], np.float32)

    return made
