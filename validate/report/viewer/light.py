"""Light of a rendered pixel: spectrum and shares by reflections; responses of bands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.calibration.instrument import BandResponse
from cboxlab.rendering.image import RenderedImage, light_shares
from numpy.typing import NDArray

from ...compare import Predicted, Validation

__all__ = ["filter_curves", "light_parts", "pixel_spectra"]

#: Share of the spectra's sum of squares that the basis may lack.
_MAX_LACK = 1e-8

#: Most spectra of the basis.
_MAX_RANK = 8


def pixel_spectra(
    image: RenderedImage, lamp_scale: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]:
    """Spectra of all pixels in a basis of few spectra.

    Coefficients times basis is the radiance of every pixel, W m^-2 sr^-1 nm^-1. The basis holds principal components,
    which lack 1e-8 of the sum of squares, or more where eight do not suffice.

    Parameters
    ----------
    image
        The rendered image.
    lamp_scale
        Fitted factor on the lamp's power.

    Returns
    -------
    NDArray
        (w,) wavelengths, nm.
    NDArray
        (k, w) basis.
    NDArray
        (k, y, x) coefficients.
    """
    mean = image.coefficients.mean(axis=0, dtype=np.float64)
    flat = mean.reshape(-1, mean.shape[-1])
    values, vectors = np.linalg.eigh(flat.T @ flat)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    _, sizes, rows = np.linalg.svd(root @ image.spectra, full_matrices=False)
    lack = 1 - np.cumsum(sizes**2) / max(float(np.sum(sizes**2)), 1e-300)
    rank = min(int(np.argmax(lack <= _MAX_LACK)) + 1, _MAX_RANK, len(rows))
    basis = rows[:rank]
    coefficients = lamp_scale * mean @ (image.spectra @ basis.T)
    return image.wavelength_nm, basis, np.moveaxis(coefficients, -1, 0).astype(np.float32)


def light_parts(validation: Validation) -> dict[str, NDArray[np.float32]] | None:
    """Shares of each pixel's luminance by number of reflections.

    Parameters
    ----------
    validation
        The validation.

    Returns
    -------
    dict or None
        (y, x) shares by name, which sum to 1; NaN without light and at the lamp. None where the rendering does not
        separate them: an external rendering, a scene that is not Lambertian, no compiled variant.
    """
    prepared = validation.prepared
    if not isinstance(validation.rendered, Predicted) or not prepared.gathered:
        return None
    responses = np.stack([r.response for r in prepared.responses], axis=-1)
    luminance = responses @ prepared.weights.weights[1]
    shares = light_shares(validation.image, validation.rendered.predictor.light.tracer.scene, luminance[:, None])
    parts = {
        "reflected once": shares.direct[0],
        "reflected twice": shares.via_material.sum(axis=0)[0],
        "three times or more": shares.many[0],
    }
    return {name: part.astype(np.float32) for name, part in parts.items()}


def filter_curves(responses: Sequence[BandResponse]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Responses of the bands, each relative to its largest value.

    Parameters
    ----------
    responses
        Responses of the bands.

    Returns
    -------
    NDArray
        (w,) wavelengths, nm.
    NDArray
        (band, w) responses, largest 1.
    """
    curves = np.stack([r.response / max(float(r.response.max()), 1e-300) for r in responses])
    return responses[0].wavelength_nm, curves
