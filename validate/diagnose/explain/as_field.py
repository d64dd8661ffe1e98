"""A fitted form as a field that other captures of the same box can be predicted with."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import FittedField, ImageMaps, PointMap, SurfaceMap, WaveMap
from numpy.typing import NDArray

from .excess import Excess
from .form import Form, changed
from .surface_bases import lamp_dn

__all__ = ["fitted_field"]

#: Places where a map is below this part of its largest value are left out.
_NOTHING = 1e-3


def fitted_field(excess: Excess, form: Form) -> FittedField:
    """The field of a form, with the coefficients of its fit.

    Maps over the picture that stand for something in the scene become values at the points that the pixels see.
    """
    common: dict[str, Any] = {
        "acts": form.acts,
        "bands": excess.bands,
        "nm": excess.nm,
        "size": excess.shape,
    }
    coefficients = form.fit.coefficients
    if form.acts == "lamp":
        return FittedField(**common, spectrum=coefficients[:, 0])
    if form.mirrored is not None:
        dn = [lamp_dn(excess, band) for band in range(len(excess.bands))]
        spectrum, image = _rank_one(changed(excess, form) / np.reshape(dn, (-1, 1, 1)))
        return FittedField(**common, surfaces=_points(excess, image, form.surface), spectrum=spectrum)
    if not isinstance(form.maps, ImageMaps):
        spectrum, values = _separated(coefficients)
        if not np.allclose(np.outer(spectrum, values), coefficients, rtol=1e-6, atol=1e-12):
            each = zip(form.maps, coefficients.T, strict=True)
            surfaces = tuple(replace(wave, spectrum=own) for wave, own in each)
            return FittedField(**common, surfaces=surfaces, spectrum=np.ones(len(excess.bands)))
        return FittedField(**common, surfaces=_waves(form.maps, values), spectrum=spectrum)
    if form.acts in ("reflectance", "radiance", "front"):
        spectrum, values = _separated(coefficients)
        image = (values @ form.maps.matrix(excess.shape)).reshape(excess.shape)
        if form.radiance is not None:
            image = np.clip(image, 0.0, 1.0)
            spectrum = form.radiance / [lamp_dn(excess, band) for band in range(len(excess.bands))]
        return FittedField(**common, surfaces=_points(excess, image, form.surface), spectrum=spectrum)
    return FittedField(
        **common,
        image=form.maps,
        radius=form.radius,
        angle_deg=form.angle_deg,
        most_dn=form.most_dn,
        coefficients=coefficients,
    )


def _separated(coefficients: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(band,) and (k,) whose product the coefficients (band, k) are; the largest number of the spectrum is 1."""
    strongest = int(np.argmax(np.abs(coefficients).sum(axis=1)))
    values = coefficients[strongest]
    power = float(values @ values)
    return (coefficients @ values / power if power > 0 else np.zeros(len(coefficients))), values


def _rank_one(pictures: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(band,) and (y, x) whose product is nearest to pictures (band, y, x); the largest number of the spectrum is 1."""
    flat = pictures.reshape(len(pictures), -1)
    spectrum = np.linalg.eigh(flat @ flat.T)[1][:, -1]
    spectrum = spectrum / spectrum[np.argmax(np.abs(spectrum))]
    return spectrum, (spectrum @ flat / (spectrum @ spectrum)).reshape(pictures.shape[1:])


def _waves(waves: tuple[WaveMap, ...], values: NDArray[np.float64]) -> tuple[SurfaceMap, ...]:
    """One sum of waves for each surface."""
    each = np.broadcast_to(values, (len(waves),)) if len(values) == 1 else values
    found = []
    for name in dict.fromkeys(wave.surface for wave in waves):
        own = [i for i, wave in enumerate(waves) if wave.surface == name]
        numbers = np.concatenate([waves[i].waves for i in own])
        found.append(
            replace(waves[own[0]], waves=numbers, values=np.array([each[i] * waves[i].values[0] for i in own]))
        )
    return tuple(found)


def _points(excess: Excess, image: NDArray[np.float64], surface: str | None) -> tuple[SurfaceMap, ...]:
    """The image's values at the points of the scene that its pixels see, on one surface or on all but the lamp's."""
    t = excess.transport
    values = image.ravel()[t.pixel]
    there = (np.abs(values) > _NOTHING * np.abs(image).max()) & (t.surface < len(excess.names))
    found = []
    for index in np.unique(t.surface[there]):
        name = excess.names[index]
        if surface is None or name == surface:
            own = there & (t.surface == index)
            found.append(PointMap(name, t.position[own], values[own]))
    return tuple(found)
