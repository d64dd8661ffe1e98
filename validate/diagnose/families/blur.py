"""Light spread in the image: blurs, smears, halo, streaks, charge that trails, copies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import Acts, ImageMaps, exchanges
from numpy.typing import NDArray

from ..field_fit import (
    Advice,
    Columns,
    Family,
    FieldFit,
    FitInput,
    FittedExplanation,
    MaskedPattern,
    NormalEquations,
    ResidualData,
    equations_in_all_bands,
    fixed_spectrum,
)
from ..hypotheses import SHAPE_ERROR
from ..shared_forms import TRAILS, copies, forms_by_spectrum, moved_charge

__all__ = ["FAMILY"]

#: Highest order of the cosines of an uneven blur: covers a tilted sensor and a curved field.
_UNEVEN_ORDER = 2

#: Radius of the exchange with neighbours by an even blur, px.
_EVEN_RADIUS_PX = 2

#: Directions of streaks that are tried, degrees from the rows, downwards.
_STREAKS_DEG = tuple(range(0, 180, 15))

#: Directions in words, at 0, 45, 90 and 135 degrees from the rows, downwards.
_LINES = ("the rows", "the falling diagonal", "the columns", "the rising diagonal")

#: Form of a blur whose size varies over the image.
_UNEVEN = "unevenly over the picture"


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data = fit_input.data
    for form, order in (("the whole picture", 0), (_UNEVEN, _UNEVEN_ORDER)):
        maps, radius = ImageMaps("cosines", order=order), 1 if order else _EVEN_RADIUS_PX
        n, columns = blur_equations(data, maps, radius)
        yield from forms_by_spectrum(FAMILY, form, n, columns, "neighbours", maps, radius)
    yield from smears(data)
    yield from _lines(data)
    halo = _even_exchange(data, "halo")
    yield from forms_by_spectrum(
        FAMILY, "a wide halo", equations_in_all_bands(data, halo), halo, "halo", ImageMaps("cosines")
    )
    yield max((_streak(data, angle) for angle in _STREAKS_DEG), key=lambda explanation: explanation.evidence)
    if data.charge is None:
        yield from (_trail(data, angle) for angle in TRAILS)
    yield from moved_charge(data, FAMILY)
    yield from copies(data, FAMILY)


def _streak(data: ResidualData, angle_deg: float) -> FittedExplanation:
    """Light spread far along one line, by a wiped lens or the blades of a diaphragm."""
    columns = _even_exchange(data, "streak", angle_deg)
    fit = fixed_spectrum(equations_in_all_bands(data, columns), np.ones(len(data.bands)))
    return FittedExplanation(
        FAMILY,
        f"streaks at {angle_deg:g} degrees from the rows",
        fit,
        columns,
        "streak",
        ImageMaps("cosines"),
        num_choices=len(_STREAKS_DEG),
        angle_deg=angle_deg,
    )


def _trail(data: ResidualData, angle_deg: int) -> FittedExplanation:
    """Charge that stays behind in the register and is read with pixels that follow."""
    columns = _even_exchange(data, "trail", angle_deg)
    fit = fixed_spectrum(equations_in_all_bands(data, columns), np.ones(len(data.bands)))
    form = f"trails {TRAILS[angle_deg]}"
    choices, maps = len(TRAILS), ImageMaps("cosines")
    return FittedExplanation(
        FAMILY, form, fit, columns, "trail", maps, sharp=True, num_choices=choices, angle_deg=angle_deg
    )


def smears(data: ResidualData) -> Iterator[FittedExplanation]:
    """Blur of the whole image along a line, less the part that a round blur imitates.

    Parameters
    ----------
    data
        Residual to be explained.

    Yields
    ------
    FittedExplanation
        In all bands alike, in each band, in one band.
    """
    columns = _even_exchange(data, "moments")
    moments = equations_in_all_bands(data, columns)
    products = moments.a.sum(axis=0)
    parts = np.column_stack([-products[1:, 0] / max(products[0, 0], 1e-300), np.eye(2)])
    n = moments.of_sums(parts)
    for explanation in forms_by_spectrum(FAMILY, "along a line", n, columns, "moments", ImageMaps("cosines")):
        fit = replace(explanation.fit, coefficients=explanation.fit.coefficients @ parts)
        form = explanation.form.replace("along a line", f"along {_direction(explanation.fit)}")
        yield replace(explanation, form=form, fit=fit, sharp=True, effects_leave=SHAPE_ERROR)


def _lines(data: ResidualData) -> Iterator[FittedExplanation]:
    """Blur along one line, by one number.

    The direction that explains most is sought in all bands, and in one band. The number is the variance along the line,
    px^2. It is not negative: no camera that moves sharpens its picture.
    """
    moments, columns = _less_noise(data, lambda each: _even_exchange(each, "moments")), _even_exchange(data, "moments")
    bands = len(data.bands)
    angles = np.deg2rad(_STREAKS_DEG)
    directions = np.array([np.full(angles.size, 0.5), np.cos(2 * angles) / 2, np.sin(2 * angles) / 4]).T
    fits: dict[str, list[tuple[FieldFit, int]]] = {"": [], ", in one band": []}
    for direction, angle_deg in zip(directions, _STREAKS_DEG, strict=True):
        n = moments.of_sums(direction[None])
        along = n.b[:, 0] / np.sqrt(np.maximum(n.a[:, 0, 0], 1e-300))
        spectra = {"": np.ones(bands), ", in one band": np.eye(bands)[int(np.argmax(along))]}
        for where, spectrum in spectra.items():
            fit = fixed_spectrum(n, spectrum)
            if fit.coefficients.max() > 0:
                fits[where].append((replace(fit, coefficients=fit.coefficients * direction), angle_deg))
    for where, trials in fits.items():
        if trials:
            fit, angle_deg = max(trials, key=lambda trial: trial[0].evidence)
            form = f"along a line at {angle_deg:g} degrees from the rows{where}"
            choices = len(_STREAKS_DEG) * (bands if where else 1)
            yield FittedExplanation(
                FAMILY, form, fit, columns, "moments", ImageMaps("cosines"), num_choices=choices, sharp=bool(where)
            )


def uneven_blurs(data: ResidualData) -> Iterator[FittedExplanation]:
    """Blur that varies over the image, less gain and evidence of an even blur.

    Both are alike in all bands. Errors of the rendered edges are even over the image.

    Parameters
    ----------
    data
        Residual to be explained.

    Yields
    ------
    FittedExplanation
        The uneven blur, with what it gains over an even one.
    """
    flat_spectrum = np.ones(len(data.bands))
    blurs = []
    for order in (_UNEVEN_ORDER, 0):
        maps = ImageMaps("cosines", order=order)
        n, columns = blur_equations(data, maps, 1)
        fit = fixed_spectrum(n, flat_spectrum)
        blurs.append(FittedExplanation(FAMILY, _UNEVEN, fit, columns, "neighbours", maps, sharp=True))
    uneven, even = blurs
    gain, evidence = uneven.fit.gain - even.fit.gain, uneven.fit.evidence - even.fit.evidence
    yield replace(uneven, fit=replace(uneven.fit, gain=gain, evidence=evidence))


def _direction(fit: FieldFit) -> str:
    """Direction of a blur among four lines, from its two numbers in each band.

    The numbers are v cos(2 a) / 2 and v sin(2 a) / 4, with the variance v and the angle a from the rows, downwards.
    In an image of steps from pixel to pixel the direction is 17 to 37 degrees off between rows and columns.
    """
    across, diagonal = fit.size @ fit.coefficients
    return _LINES[round(np.arctan2(2 * diagonal, across) / (np.pi / 2)) % 4]


def blur_equations(data: ResidualData, maps: ImageMaps, radius: int) -> tuple[NormalEquations, Columns]:
    """Normal equations of a blur, corrected for its gain by averaging the rendering's noise.

    A blur exchanges light with neighbouring pixels. The rendering's noise is known by its size: the equations of a
    random draw of it are subtracted.

    Parameters
    ----------
    data
        Residual to be explained.
    maps
        Maps over the image by which the blur varies.
    radius
        Largest distance of the neighbours, px.

    Returns
    -------
    tuple
        The equations, and the changes of the signal.
    """
    basis = maps.matrix(data.shape)
    equations = _less_noise(data, lambda each: _neighbour_exchange(each, basis, radius))
    return equations, _neighbour_exchange(data, basis, radius)


def _less_noise(data: ResidualData, exchange: Callable[[ResidualData], Columns]) -> NormalEquations:
    """Normal equations of an exchange of light, less those of a draw of the rendering's noise."""
    noise = replace(data, signal=data.noise, marginal_residual=-data.noise * data.weight)
    n, of_noise = equations_in_all_bands(data, exchange(data)), equations_in_all_bands(noise, exchange(noise))
    return NormalEquations(
        n.a - of_noise.a, n.b - of_noise.b, n.c, n.trial_a - of_noise.trial_a, n.trial_b - of_noise.trial_b
    )


def _neighbour_exchange(data: ResidualData, basis: NDArray[Any], radius: int) -> Columns:
    """Light exchanged with neighbours on opposite sides alike, times maps (k, pixel)."""

    def columns(band: int) -> NDArray[Any]:
        each = exchanges("neighbours", data.signal[band], radius)
        return np.concatenate([exchange.ravel() * basis for exchange in each]).astype(np.float32)

    return columns


def _even_exchange(data: ResidualData, acts: Acts, angle_deg: float = 0.0) -> Columns:
    """Light exchanged alike over the whole image."""

    def columns(band: int) -> NDArray[Any]:
        each = exchanges(acts, data.signal[band], angle_deg=angle_deg)
        return np.array([exchange.ravel() for exchange in each], np.float32)

    return columns


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "copy of the picture in one band",
        "in one filter, or between it and the lens",
        (
            "a filter in its holder the wrong way round",
            "a filter that reflects light back and forth",
            "a double exposure",
        ),
        "Turn the filter over in its holder and photograph the band again: a copy that moves or goes was made there.",
    ),
    Advice(
        "copy of the picture",
        "in the light's way before the sensor",
        ("a pane or filter that reflects twice", "a ghost between lens and sensor", "a double exposure"),
        "Turn or take away the filter or pane and photograph again: a copy that moves or goes was made there.",
    ),
    Advice(
        "trails",
        "in the register of the sensor",
        ("charge left behind in a cold register", "a read-out that is too fast", "radiation damage"),
        "Photograph a bright edge on a dark ground with a slower read-out: trails of a register get shorter.",
    ),
    Advice(
        "charge that leaks",
        "between pixels of the sensor",
        (
            "wells whose walls leak along one line",
            "charge left behind at each shift",
            "amplifiers of neighbours that couple",
        ),
        "Light single pixels through a pinhole, or look at hot pixels of long darks: only neighbours in that way are "
        "brighter. Turn the camera by 90 degrees and photograph again: the way keeps to the sensor.",
    ),
    Advice(
        "along ",
        "while the shutter is open",
        ("a camera that shakes", "a moving table", "a filter wheel that still turns"),
        "Photograph again with the shutter released by time, on a heavy tripod.",
    ),
    Advice(
        "streaks",
        "on the lens",
        ("a wiped lens", "a scratched filter", "the blades of the diaphragm"),
        "Clean the lens, turn it if it turns, and photograph a small lamp: its streaks show the direction.",
    ),
    Advice(
        "halo",
        "on or in the lens",
        ("dew or grease on the lens", "haze inside the lens", "a scattering filter"),
        "Clean the lens and photograph a small lamp before black cloth: its halo shows what remains.",
    ),
    Advice(
        "one band",
        "in one filter",
        ("a filter of another thickness", "a tilted filter", "a lens that is not achromatic"),
        "Focus again with this filter in place and photograph the band again.",
    ),
    Advice(
        "unevenly",
        "between lens and sensor",
        ("a tilted sensor", "a curved field of the lens", "a decentred lens"),
        "Photograph a flat test chart and compare the sharpness of its corners.",
    ),
    Advice(
        "",
        "in the lens",
        ("a lens out of focus", "an aperture that is too small or too wide", "a camera that shakes"),
        "Focus again, photograph an edge, and compare its width with this capture's.",
    ),
)

FAMILY = Family(
    id="blur",
    title="a blur",
    acts_on="image",
    generate=_generate,
    order=40,
    rivals=_generate,
    masked=(MaskedPattern(rank=1, generate=smears), MaskedPattern(rank=2, generate=uneven_blurs)),
    advice=_ADVICE,
)
