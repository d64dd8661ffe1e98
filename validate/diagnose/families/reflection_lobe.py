"""Reflection that depends on the angle: sheen, coats, films, and matte paints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..field_fit import (
    Advice,
    Family,
    FitInput,
    FittedExplanation,
    ResidualData,
    SmoothSurfaceMaps,
    SurfaceSpot,
    equations_in_all_bands,
    fixed_spectrum,
    lamp_dn,
    scaled,
)

__all__ = ["FAMILY"]

#: Parts of the light that a coat withholds from what is beneath: Fresnel's reflection at refractive index 1.5 on the
#: way in and out, of one face or of the two faces of a film.
_COAT_LOSSES = (0.14, 0.3)

#: Highest order of the cosines of a coat: even, or changing from one side of a surface to the other.
_COAT_ORDER = 1


def _generate(fit_input: FitInput) -> Iterator[FittedExplanation]:
    data, maps = fit_input.data, fit_input.surface_maps
    surfaces, even = maps.even_maps()
    paint = maps.paints(surfaces)
    for index in range(len(data.materials)):
        same = [i for i, material in enumerate(paint) if material == index]
        if len(same) > 1:
            yield _matte_lobe(data, maps, index, [int(even[i]) for i in same])
    by_surface = maps.by_surface()
    for surface, some in by_surface.items():
        yield from _sheens(data, maps, some, data.names[surface], len(by_surface))
    if fit_input.surface_spot is not None:
        yield from _glossy_places(fit_input.surface_spot)


def _sheens(
    data: ResidualData, maps: SmoothSurfaceMaps, some: Sequence[int], name: str, num_surfaces: int
) -> Iterator[FittedExplanation]:
    """A surface that mirrors the lamp by a smooth map, and coats of each roughness.

    The paint may be darker or brighter beneath a coat.
    """
    waves = tuple(maps.waves[i] for i in some)
    visible, flat_spectrum = maps.visible(some), np.ones(len(data.bands))
    kinds = len(data.transport.roughness)
    even = [i for i, wave in enumerate(waves) if wave.waves.sum() <= _COAT_ORDER]
    maps_of_coat = (*(waves[i] for i in even), waves[0])

    def of_lamp(band: int) -> NDArray[Any]:
        return visible * np.float32(maps.dn[band])

    fit = fixed_spectrum(equations_in_all_bands(data, of_lamp), flat_spectrum)
    yield FittedExplanation(FAMILY, "a sheen", fit, of_lamp, "radiance", waves, name, num_choices=num_surfaces)
    for mirrored, roughness in _coats(data):

        def coated(band: int, mirrored: NDArray[np.float32] = mirrored) -> NDArray[Any]:
            beneath = scaled(visible[:1], data.signal[band])
            return np.concatenate([scaled(visible[even], mirrored[band]), beneath])

        fit = fixed_spectrum(equations_in_all_bands(data, coated), flat_spectrum)
        yield FittedExplanation(
            FAMILY,
            f"a coat, {roughness}",
            fit,
            coated,
            "radiance",
            maps_of_coat,
            name,
            num_choices=num_surfaces * kinds,
            mirrored_dn=mirrored,
        )


def _matte_lobe(data: ResidualData, maps: SmoothSurfaceMaps, material: int, even: Sequence[int]) -> FittedExplanation:
    """A paint whose brightness depends on the angles of view and incidence.

    Its reflection is the same on all its surfaces, and not Lambertian, as that of rough paint, fibres or dust.
    ``even`` are the maps that are 1 on one of its surfaces each.
    """

    def lobe(band: int) -> NDArray[Any]:
        constant = maps.reflectance(band, even).sum(axis=0, keepdims=True)
        return np.concatenate([constant, maps.lobe(band, material)])

    fit = fixed_spectrum(equations_in_all_bands(data, lobe), np.ones(len(data.bands)))
    return FittedExplanation(
        FAMILY,
        f"the paint {data.materials[material]}, not Lambertian",
        fit,
        lobe,
        "radiance",
        tuple(maps.waves[i] for i in even),
        num_choices=len(data.materials),
        mirrored_dn=data.signal,
    )


def _glossy_places(spot: SurfaceSpot) -> Iterator[FittedExplanation]:
    """A place of a surface that mirrors the lamp, and coats of each roughness there."""
    data, flat_spectrum = spot.data, np.ones(len(spot.data.bands))

    def of_lamp(band: int) -> csr_matrix:
        return spot.basis * float(lamp_dn(data, band))

    fit = fixed_spectrum(equations_in_all_bands(data, of_lamp), flat_spectrum)
    glossy = FittedExplanation(FAMILY, "a glossy spot", fit, of_lamp, "radiance", spot.maps, spot.name, local=True)
    yield glossy
    coats = [
        (mirrored - loss * data.signal, roughness) for mirrored, roughness in _coats(data) for loss in _COAT_LOSSES
    ]
    for change, roughness in coats:

        def coated(band: int, change: NDArray[np.floating] = change) -> csr_matrix:
            return scaled(spot.basis, change[band])

        fit = fixed_spectrum(equations_in_all_bands(data, coated), flat_spectrum)
        yield replace(
            glossy,
            form=f"a coated place, {roughness}",
            fit=fit,
            columns=coated,
            mirrored_dn=change,
            num_choices=len(coats),
        )


def _coats(data: ResidualData) -> Iterator[tuple[NDArray[np.float32], str]]:
    """(band, y, x) signal that coats mirror, DN, and their roughness in words."""
    dn = np.array([lamp_dn(data, band) for band in range(len(data.bands))], np.float32)
    for alpha, coat in zip(data.transport.roughness, data.transport.coats, strict=True):
        yield dn[:, None, None] * coat, f"roughness {alpha:g}"


#: Words for the laboratory.
_ADVICE = (
    Advice(
        "not Lambertian",
        "in a paint, by the angle",
        ("a paint with a sheen", "rough or fibrous paint", "dust on horizontal faces"),
        "Photograph a painted card at five angles to the lamp: matte paint follows the cosine of the angle.",
    ),
    Advice(
        "place",
        "on a surface, by the angle",
        ("tape or film", "a drop of varnish or grease", "a polished place"),
        "Photograph again from another place: a mirrored patch moves over the surface, a stain stays.",
    ),
    Advice(
        "spot",
        "on a surface, by the angle",
        ("a bright reflex of the lamp", "a drop of varnish", "a picture of the lamp in a pane"),
        "Photograph again from another place: a reflex moves over the surface, a stain stays.",
    ),
    Advice(
        "",
        "on a surface, by the angle",
        ("a paint with a sheen", "a varnish or film", "a polished surface"),
        "Photograph again from another place: a sheen moves over the surface, a stain stays.",
    ),
)

FAMILY = Family(
    id="reflection-lobe",
    title="a reflection that depends on the angle",
    acts_on="scene",
    generate=_generate,
    order=100,
    additive=True,
    advice=_ADVICE,
)
