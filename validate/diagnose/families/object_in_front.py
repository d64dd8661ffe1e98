"""Object that the model lacks: light blocked and added within an outline."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import ImageMaps
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import (
    CORE_WEIGHT,
    LEAST_DIVISOR,
    PENALTY_UNLIKELY,
    Advice,
    Columns,
    Family,
    FitInput,
    FittedExplanation,
    ResidualData,
    SpotAppearance,
    equations_in_all_bands,
    fixed_spectrum,
    scaled,
)

__all__ = ["FAMILY"]

#: Numerics: rounds of the alternating fit of an object's outline and radiance.
_ROUNDS = 3


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    if fit_input.bells is not None:
        yield _object(fit_input.data, fit_input.bells)


def _object(data: ResidualData, bells: ImageMaps) -> FittedExplanation:
    """Object of one radiance in each band in front of the scene: the change is a (o - s).

    The outline a and the radiance o are fitted in turn; s is the signal of the scene. One start is the radiance
    measured in the core, which the object may cover. The other is zero, as of a thread that covers little of a pixel.
    """
    basis = csr_matrix(bells.matrix(data.shape))
    measured = data.signal + data.residual * np.where(data.used, data.sigma, 0.0)
    over = np.sum(data.residual.astype(float) ** 2, axis=0).ravel() * (np.asarray(basis.sum(axis=0)).ravel() > 0)
    core = over > CORE_WEIGHT * over.max()
    in_core = np.array([np.median(band.ravel()[core]) for band in measured])
    objects = (_fitted(data, basis, bells, measured, start) for start in (in_core, np.zeros(len(in_core))))
    return max(objects, key=lambda explanation: explanation.fit.evidence)


def _fitted(
    data: ResidualData, basis: csr_matrix, bells: ImageMaps, measured: NDArray[Any], radiance: NDArray[Any]
) -> FittedExplanation:
    """Object from a starting radiance (band,), DN; ``measured`` is the signal (band, y, x), DN."""
    num_bands = len(data.bands)
    flat_spectrum = np.ones(num_bands)
    for _ in range(_ROUNDS):
        fitted_with, columns = radiance, _in_front(data, basis, radiance)
        fit = fixed_spectrum(equations_in_all_bands(data, columns), flat_spectrum)
        outline = np.clip(fit.coefficients[0] @ basis, 0.0, 1.0)
        weight = (data.weight.reshape(num_bands, -1) * outline) ** 2
        behind = data.signal.reshape(num_bands, -1)
        emitted = (measured - data.signal).reshape(num_bands, -1) + outline * behind
        per_outline = np.where(outline > LEAST_DIVISOR, weight / np.maximum(outline, LEAST_DIVISOR), 0.0)
        radiance = np.sum(per_outline * emitted, axis=1) / np.maximum(weight.sum(axis=1), 1e-30)
    penalty = num_bands * np.log(max(fit.gain, 2.0))
    fit = replace(fit, evidence=fit.evidence - penalty)
    return FittedExplanation(FAMILY, "a thing in front", fit, columns, "front", bells, local=True, radiance=fitted_with)


def _in_front(data: ResidualData, basis: csr_matrix, radiance: NDArray[Any]) -> Columns:
    return lambda band: scaled(basis, radiance[band] - data.signal[band])


def _spot_log_odds(spot: SpotAppearance) -> float:
    """An object changes its place by much, or is a thin line; it does not look like light."""
    return 0.0 if (spot.deep or spot.line) and not spot.light else -PENALTY_UNLIKELY


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "",
        "in the scene, before the surfaces",
        (
            "a tool or a cloth left in the box",
            "a thread or cable in the opening",
            "something that hangs into the picture",
        ),
        "Look into the box from the camera's place, take the thing away, and photograph again.",
    ),
)

FAMILY = Family(
    id="object",
    title="an object that the model lacks",
    acts_on="scene",
    generate=_generate,
    order=110,
    opaque=True,
    spot_log_odds=_spot_log_odds,
    advice=_ADVICE,
)
