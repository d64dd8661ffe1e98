"""Fitted explanation as a field with which other captures of the same box can be predicted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import FittedField, ImageMaps, PointMap, SurfaceMap, WaveMap
from numpy.typing import NDArray

from ..field_fit import FittedExplanation, ResidualData, change_dn, lamp_dn

__all__ = ["fitted_field"]

#: Numerics: part of a map's largest value below which a point is left out.
_MIN_POINT_PART = 1e-3


def fitted_field(data: ResidualData, candidate: FittedExplanation) -> FittedField:
    """Field of a fitted explanation, with the coefficients of its fit.

    Maps over the image that stand for something in the scene become values at the points that the pixels show.

    Parameters
    ----------
    data
        Residual that was fitted.
    candidate
        The fitted explanation.

    Returns
    -------
    FittedField
        The field, of amplitude 1.
    """
    common: dict[str, Any] = {
        "acts": candidate.acts,
        "bands": data.bands,
        "nm": data.nm,
        "size": data.shape,
    }
    coefficients = candidate.fit.coefficients
    if candidate.acts == "lamp":
        return FittedField(**common, spectrum=coefficients[:, 0])
    if candidate.mirrored_dn is not None:
        dn = [lamp_dn(data, band) for band in range(len(data.bands))]
        spectrum, image = _rank_one(change_dn(data, candidate) / np.reshape(dn, (-1, 1, 1)))
        return FittedField(**common, surfaces=_points(data, image, candidate.surface), spectrum=spectrum)
    if not isinstance(candidate.maps, ImageMaps):
        spectrum, values = _separated(coefficients)
        if not np.allclose(np.outer(spectrum, values), coefficients, rtol=1e-6, atol=1e-12):
            each = zip(candidate.maps, coefficients.T, strict=True)
            surfaces = tuple(replace(wave, spectrum=of_wave) for wave, of_wave in each)
            return FittedField(**common, surfaces=surfaces, spectrum=np.ones(len(data.bands)))
        return FittedField(**common, surfaces=_waves(candidate.maps, values), spectrum=spectrum)
    if candidate.acts in ("reflectance", "radiance", "front"):
        spectrum, values = _separated(coefficients)
        image = (values @ candidate.maps.matrix(data.shape)).reshape(data.shape)
        if candidate.radiance is not None:
            image = np.clip(image, 0.0, 1.0)
            spectrum = candidate.radiance / [lamp_dn(data, band) for band in range(len(data.bands))]
        return FittedField(**common, surfaces=_points(data, image, candidate.surface), spectrum=spectrum)
    return FittedField(
        **common,
        image=candidate.maps,
        radius=candidate.radius,
        angle_deg=candidate.angle_deg,
        picture_copy=candidate.picture_copy,
        most_dn=candidate.most_dn,
        coefficients=coefficients,
    )


def _separated(coefficients: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Factors of coefficients (band, k): a spectrum (band,), strongest band 1, and values (k,)."""
    strongest = int(np.argmax(np.abs(coefficients).sum(axis=1)))
    values = coefficients[strongest]
    power = float(values @ values)
    return (coefficients @ values / power if power > 0 else np.zeros(len(coefficients))), values


def _rank_one(images: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Best product for images (band, y, x): a spectrum (band,), strongest band 1, and an image."""
    flat = images.reshape(len(images), -1)
    spectrum = np.linalg.eigh(flat @ flat.T)[1][:, -1]
    spectrum = spectrum / spectrum[np.argmax(np.abs(spectrum))]
    return spectrum, (spectrum @ flat / (spectrum @ spectrum)).reshape(images.shape[1:])


def _waves(waves: tuple[WaveMap, ...], values: NDArray[np.float64]) -> tuple[SurfaceMap, ...]:
    """One sum of waves for each surface."""
    each = np.broadcast_to(values, (len(waves),)) if len(values) == 1 else values
    maps = []
    for name in dict.fromkeys(wave.surface for wave in waves):
        members = [i for i, wave in enumerate(waves) if wave.surface == name]
        numbers = np.concatenate([waves[i].waves for i in members])
        amplitudes = np.array([each[i] * waves[i].values[0] for i in members])
        maps.append(replace(waves[members[0]], waves=numbers, values=amplitudes))
    return tuple(maps)


def _points(data: ResidualData, image: NDArray[np.float64], surface: str | None) -> tuple[SurfaceMap, ...]:
    """Values of an image at the scene points that its pixels show, by surface.

    ``surface`` limits them to one surface; None stands for all surfaces but the lamp's.
    """
    t = data.transport
    values = image.ravel()[t.pixel]
    relevant = (np.abs(values) > _MIN_POINT_PART * np.abs(image).max()) & (t.surface < len(data.names))
    maps = []
    for index in np.unique(t.surface[relevant]):
        name = data.names[index]
        if surface is None or name == surface:
            points = relevant & (t.surface == index)
            maps.append(PointMap(name, t.position[points], values[points]))
    return tuple(maps)
