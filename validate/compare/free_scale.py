"""Free factors without an absolute scale, and fall-off without flats, by a rendering.

The photograph of band b is taken as g_b (1 + a_1 q + a_2 q^2 + a_3 x + a_4 y) times the rendering. g is one factor of
all bands or one of each. q is the squared distance from the lens's axis, 1 in the farthest corner, x and y are the
distances along rows and columns. These terms stand only where no flats were taken. The lamp's power is a part of g: it
is not known, and neither is what changes a band as a whole. With an absolute scale the terms alone are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cboxlab.calibration.correction import CorrectedBands, fall_off_terms
from cboxlab.calibration.result import Calibration
from numpy.typing import NDArray

__all__ = ["FreeScale", "free_columns", "refined_scale", "rescaled", "starting_scale"]

#: Terms of the fall-off beyond the cosine-fourth law, in the order of ``fall_off_terms``.
_FALL_OFF_TERMS = ("r^2", "r^4", "x", "y")
#: Standard deviation of each term, relative at the farthest corner: lenses lose 0 to 30 % there by their mounts, and
#: their axes differ from the survey's by a pixel or two.
_FALL_OFF_SIGMA = np.array([0.2, 0.2, 0.05, 0.05])
#: Threshold of the Huber loss in standard deviations, so that flaws of the model hardly affect the factors.
_HUBER = 3.0
#: Gauss-Newton rounds: the model is linear but for the product of factor and fall-off.
_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class FreeScale:
    """Estimated factors of a capture without absolute scale, and fall-off of one without flats."""

    #: Whether each band has its own factor.
    by_band: bool
    #: (band,) constant C of each band, mm^2 m^2 / (e-/DN) or in an arbitrary unit; equal where one factor is free.
    constant: NDArray[np.float64]
    #: (band,) relative standard deviation of the constant.
    relative_sigma: NDArray[np.float64]
    #: Whether the fall-off of the lens is nominal, so that its further terms were fitted.
    nominal_fall_off: bool
    #: (4,) terms of the fall-off beyond the cosine-fourth law, see ``fall_off_terms``; empty with flats.
    fall_off: NDArray[np.float64]
    #: (4,) their standard deviations.
    fall_off_sigma: NDArray[np.float64]
    #: Whether the scale is absolute, so that the fall-off alone is free.
    absolute: bool = False

    @property
    def not_known(self) -> tuple[str, ...]:
        """Quantities that the capture cannot show, in a few words each."""
        gains = ("the bands' gains",) if self.by_band else ()
        fall_off = ("the lens's fall-off beyond cos^4",) if self.nominal_fall_off else ()
        if self.absolute:
            return fall_off
        return ("the lamp's power", *gains, *fall_off)

    @property
    def sentence(self) -> str:
        """The factors with their uncertainty, and what is not known."""
        if self.absolute:
            return "No flats were taken: the lens's fall-off beyond cos^4 is fitted, and not judged."
        low, high = float(self.constant.min()), float(self.constant.max())
        value = f"C = {low:.4g}" if low == high else f"C = {low:.4g} to {high:.4g}"
        of = "each band has a free factor" if self.by_band else "all bands have one free factor"
        first = ", ".join(self.not_known[:-1]) + " and " if len(self.not_known) > 1 else ""
        return (
            f"No absolute scale is claimed: {of}, {value} ± {100 * float(self.relative_sigma.max()):.2g} %. Not known: "
            f"{first}{self.not_known[-1]}."
        )

    def record(self, bands: Sequence[str]) -> dict[str, Any]:
        """Entry ``scale`` of metrics.json.

        Parameters
        ----------
        bands
            Identifiers of the bands.

        Returns
        -------
        dict
            Factors and fall-off with standard deviations, and what is not known.
        """
        pairs = zip(bands, self.constant.tolist(), self.relative_sigma.tolist(), strict=True)
        if self.absolute:
            pairs = zip((), (), (), strict=True)
        return {
            "claim": "absolute" if self.absolute else "free-by-band" if self.by_band else "free",
            "factors": {band: {"value": value, "relative_sigma": sigma} for band, value, sigma in pairs},
            "fall_off": [
                {"term": term, "value": value, "sigma": sigma}
                for term, value, sigma in zip(
                    _FALL_OFF_TERMS, self.fall_off.tolist(), self.fall_off_sigma.tolist(), strict=False
                )
            ],
            "not_known": list(self.not_known),
        }

    @property
    def parameters(self) -> int:
        """Number of fitted parameters, without the one that the lamp's scale counts for."""
        return (len(self.constant) - 1 if self.by_band else 0) + (len(_FALL_OFF_TERMS) if self.nominal_fall_off else 0)


def _terms(bands: CorrectedBands, so_far: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, y, x) relative changes by the terms next to those so far; k = 0 with flats.

    A fall-off 1 + (a + b) q is 1 + a q times 1 + b q / (1 + a q).
    """
    height, width = bands.images["signal"].shape[1:]
    shape = height, width
    if bands.nominal_axis is None:
        return np.zeros((0, *shape))
    terms = fall_off_terms(bands.nominal_axis, shape)
    return np.asarray(terms / (1 + np.tensordot(so_far, terms, 1)))


def free_columns(
    calibration: Calibration, scale: FreeScale | None, signal: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Changes of the picture that free factors and fall-off make, in addition to the lamp's.

    Parameters
    ----------
    calibration
        Calibration of a capture.
    scale
        Its free scale so far; None for a capture with an absolute scale and flats.
    signal
        (band, y, x) predicted signals, DN.

    Returns
    -------
    list of NDArray
        (band, y, x) DN each; empty for a capture with an absolute scale and flats.
    """
    if scale is None:
        return []
    unit = np.eye(len(signal))[:, :, None, None]
    by_band = [band * signal for band in unit[1:]] if scale.by_band else []
    return [*by_band, *(term * signal for term in _terms(calibration.bands, scale.fall_off))]


def starting_scale(calibration: Calibration) -> FreeScale | None:
    """The free scale of a calibration before any comparison.

    Parameters
    ----------
    calibration
        Calibration of a capture.

    Returns
    -------
    FreeScale | None
        With infinite standard deviations; None for a capture with an absolute scale and flats.
    """
    manifest, constant = calibration.capture.manifest, calibration.radiometry.constant
    nominal = calibration.bands.nominal_axis is not None
    if (manifest.is_absolute and not nominal) or constant is None:
        return None
    unknown = np.full(len(manifest.band), np.inf)
    terms = np.zeros(len(_FALL_OFF_TERMS) if nominal else 0)
    return FreeScale(
        manifest.is_free_by_band,
        np.full(len(manifest.band), constant),
        unknown,
        nominal,
        terms,
        _FALL_OFF_SIGMA[: terms.size].copy(),
        manifest.is_absolute,
    )


def refined_scale(
    scale: FreeScale,
    calibration: Calibration,
    *,
    signal: NDArray[np.float64],
    variance: NDArray[np.float64],
    used: NDArray[np.bool_],
) -> tuple[FreeScale, NDArray[np.float64], NDArray[np.float64]]:
    """Fit factors and fall-off to a rendering by robust least squares.

    Parameters
    ----------
    scale
        The scale so far, which the calibration holds.
    calibration
        Calibration of the capture, see ``rescaled``.
    signal
        (band, y, x) rendered signals with that scale, DN.
    variance
        (band, y, x) variance of measured minus rendered, DN^2.
    used
        (band, y, x) True for the samples used.

    Returns
    -------
    FreeScale
        The refined scale.
    NDArray
        (band,) factors on the bands' constants so far.
    NDArray
        (y, x) factor on the flat fields so far.
    """
    measured, terms = calibration.images["signal"].values, _terms(calibration.bands, scale.fall_off)
    count = len(signal)
    owner = np.arange(count) if scale.by_band else np.zeros(count, int)
    total = owner.max() + 1
    band = owner[np.broadcast_to(np.arange(count)[:, None, None], signal.shape)[used]]
    rows = signal[used]
    shapes = np.array([np.broadcast_to(term, signal.shape)[used] for term in terms]).reshape(len(terms), rows.size)
    data, weight = measured[used], 1 / variance[used]
    factors, further = np.ones(total), np.zeros(len(terms))
    prior = np.diag(np.append(np.zeros(total), _FALL_OFF_SIGMA[: len(terms)] ** -2.0))
    information = np.eye(total + len(terms))
    # starting factors by ratios of sums, which need no weights
    for index in range(total):
        factors[index] = data[band == index].sum() / rows[band == index].sum()
    excess = 1.0
    for _ in range(_ROUNDS):
        bent = 1 + further @ shapes
        fitted = factors[band] * rows * bent
        residual = data - fitted
        pull = np.abs(residual) * np.sqrt(weight)
        robust = weight * np.minimum(1.0, _HUBER / np.maximum(pull, 1e-9))
        design = np.zeros((total + len(terms), rows.size))
        design[band, np.arange(rows.size)] = rows * bent
        design[total:] = factors[band] * rows * shapes
        information = (design * robust) @ design.T + prior
        gradient = (design * robust) @ residual
        gradient[total:] -= _FALL_OFF_SIGMA[: len(terms)] ** -2.0 * (scale.fall_off + further)
        step = np.linalg.solve(information, gradient)
        factors, further = factors + step[:total], further + step[total:]
        excess = max(1.0, float(np.mean(np.minimum(pull, _HUBER) ** 2)))
    sigma = np.sqrt(excess * np.diag(np.linalg.inv(information)))
    bent = 1 + np.tensordot(further, terms, 1)
    of_bands = factors[owner]
    if (
        scale.absolute
    ):  # the factor is the lamp's, and a flat has mean 1: by such a one references measured the constant
        response = next(iter(calibration.bands.flats.values())).response
        of_bands, bent = np.ones(count), bent * response.mean() / np.mean(response * bent)
        return replace(scale, fall_off=scale.fall_off + further, fall_off_sigma=sigma[total:]), of_bands, bent
    refined = replace(
        scale,
        constant=scale.constant * of_bands,
        relative_sigma=(sigma[:total] / factors)[owner],
        fall_off=scale.fall_off + further,
        fall_off_sigma=sigma[total:],
    )
    return refined, of_bands, bent


def rescaled(calibration: Calibration, factors: NDArray[np.float64], bent: NDArray[np.float64]) -> Calibration:
    """The calibration with other constants of the bands and a further fall-off.

    Parameters
    ----------
    calibration
        Calibration of a capture without absolute scale.
    factors
        (band,) factors on the bands' constants.
    bent
        (y, x), or (band, y, x) or a shape that suits it: factor on the flat fields, by which the signals are divided.

    Returns
    -------
    Calibration
        Responses, constants, flat fields and signals changed alike.
    """
    bands, radiometry = calibration.bands, calibration.radiometry
    images, bent = bands.images.copy(), np.broadcast_to(bent, bands.images["signal"].shape)
    images["signal"] = bands.images["signal"] / bent
    images["variance"] = bands.images["variance"] / bent**2
    coefficients = bands.coefficients / np.stack([bent**2, bent, np.ones_like(bent)], axis=1)
    flats = {}
    for band, by in zip(bands.images.band.values, bent, strict=True):
        flat = bands.flats[band]
        flats[band] = replace(flat, response=flat.response * by, relative_variance=flat.relative_variance * by**2)
    before = 1.0 if radiometry.band_factors is None else radiometry.band_factors
    constant = None if radiometry.constant is None else radiometry.constant * float(factors[0])
    responses = calibration.responses
    if responses is not None:
        pairs = zip(responses, factors.tolist(), strict=True)
        responses = tuple(replace(response, factor=response.factor * factor) for response, factor in pairs)
    return replace(
        calibration,
        bands=replace(bands, images=images, coefficients=coefficients, flats=flats),
        radiometry=replace(radiometry, constant=constant, band_factors=before * factors / factors[0]),
        responses=responses,
    )
