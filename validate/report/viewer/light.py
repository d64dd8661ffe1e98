"""What a render knows of a pixel's light: its spectrum, its parts by number of reflections, the bands' responses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.calibration.instrument import BandResponse
from cboxlab.rendering.image import RenderedImage, light_shares
from numpy.typing import NDArray

from ...compare import Predicted, Validation

__all__ = ["filter_curves", "light_parts", "pixel_spectra"]

#: Share of the spectra's sum of squares that the basis may leave out, and the largest number of its spectra.
_LEFT_OUT, _MOST_SPECTRA = 1e-8, 8


def pixel_spectra(
    image: RenderedImage, lamp_scale: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]:
    """Wavelengths (w,) nm, basis (k, w) and coefficients (k, y, x): their product is the radiance of every pixel in
    W m^-2 sr^-1 nm^-1, the lamp at its fitted power.

    The basis is that of the principal components, which leave out 1e-8 of the sum of squares where eight suffice.
    """
    mean = image.coefficients.mean(axis=0, dtype=np.float64)
    flat = mean.reshape(-1, mean.shape[-1])
    values, vectors = np.linalg.eigh(flat.T @ flat)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    _, sizes, rows = np.linalg.svd(root @ image.spectra, full_matrices=False)
    left = 1 - np.cumsum(sizes**2) / max(float(np.sum(sizes**2)), 1e-300)
    rank = min(int(np.argmax(left <= _LEFT_OUT)) + 1, _MOST_SPECTRA, len(rows))
    basis = rows[:rank]
    coefficients = lamp_scale * mean @ (image.spectra @ basis.T)
    return image.wavelength_nm, basis, np.moveaxis(coefficients, -1, 0).astype(np.float32)


def light_parts(validation: Validation) -> dict[str, NDArray[np.float32]] | None:
    """Shares (y, x) of each pixel's luminance by number of reflections, which sum to 1; NaN without light and at the
    lamp. None where the render does not separate them (another renderer's picture, a scene that is not Lambertian, no
    compiled variant).
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
    """Wavelengths (w,) nm, and the response (band, w) of every band relative to its largest value."""
    curves = np.stack([r.response / max(float(r.response.max()), 1e-300) for r in responses])
    return responses[0].wavelength_nm, curves
