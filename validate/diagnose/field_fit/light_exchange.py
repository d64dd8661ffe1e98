"""Light transport of a capture's picture, as the families of explanations need it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from cboxlab.rendering.chain import after_stage
from cboxlab.rendering.device import mi
from cboxlab.rendering.perturbation import Coat, PatchTransport, Reflection, changed_reflection, patch_light
from cboxlab.rendering.radiosity import LampSampler, solve_exchange
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray

from ...predict import Predictor
from .residual_data import Transport

__all__ = ["light_exchange"]

#: Numerics: step of the single wavelengths at which a filter may pass light, nm: paints change little over half of it.
_LINE_STEP_NM = 20.0

#: Roughnesses (GGX alpha) of the coats that a surface may have: mirror-like, glossy, silky.
_COAT_ROUGHNESS = (0.03, 0.12, 0.35)

#: Numerics: rays of a pixel for each coat.
_COAT_SAMPLES = 64

#: Numerics: places across a lamp from which light is summed, over its half size.
_PLACES = (-0.8, -0.4, 0.0, 0.4, 0.8)


@lru_cache(maxsize=1)
def light_exchange(predictor: Predictor) -> Transport:
    """Light transport of a picture on patches, for the families that act on surfaces.

    That of the last picture is kept: all of its residuals share it.

    Parameters
    ----------
    predictor
        Predictor of the picture.

    Returns
    -------
    Transport
        Exchange between patches, lamps and pixels, with the light in all bands and at single wavelengths.
    """
    traced = predictor.transport
    exchange, patches = traced.light.exchange, traced.light.patches
    nm, scene = predictor.effective_nm, after_stage(predictor.scene, predictor.included, "scene")
    reflectance = scene.reflectances(nm)
    line_nm = WAVELENGTH_NM[np.isclose(WAVELENGTH_NM % _LINE_STEP_NM, 0)]
    at_lines = (WAVELENGTH_NM == line_nm[:, None]).astype(float)
    lines = patch_light(traced, scene, line_nm, WAVELENGTH_NM, at_lines, scene.lamp_radiance(WAVELENGTH_NM))
    shares = predictor.lamp_shares
    first = exchange.direct @ shares
    radiance = solve_exchange(exchange, reflectance[patches.material], first).astype(np.float32)
    direct = traced.direct @ shares
    arriving = direct + traced.gather @ radiance
    lamps = [lamp.centre for lamp in traced.light.lamps]
    return Transport(
        pixel=traced.pixel,
        coverage=traced.coverage,
        surface=traced.surface,
        material=traced.material,
        position=traced.position,
        gather=traced.gather,
        patch_surface=patches.surface,
        patch_material=patches.material,
        patch_position=patches.centre,
        form_factors=exchange.form_factors,
        reflectance=reflectance,
        arriving=arriving,
        direct=direct,
        view=_cosine(traced.position, traced.normal, [traced.camera.position_mm], np.ones((len(direct), 1))),
        incidence=_cosine(traced.position, traced.normal, lamps, traced.direct),
        patch_arriving=first + exchange.form_factors @ radiance,
        patch_direct=first,
        patch_incidence=_cosine(patches.centre, patches.normal, lamps, exchange.direct),
        emission=_emission(traced.position, traced.light.lamps, traced.direct),
        patch_emission=_emission(patches.centre, traced.light.lamps, exchange.direct),
        side=_sides(traced.position, traced.normal, traced.light.lamps, traced.direct),
        patch_side=_sides(patches.centre, patches.normal, traced.light.lamps, exchange.direct),
        picture=traced.pixels(reflectance[traced.material] * arriving),
        line_nm=line_nm,
        lines=lines.picture(),
        roughness=_COAT_ROUGHNESS,
        coats=np.array(
            [_coated(traced, radiance, reflectance, shares, alpha) for alpha in _COAT_ROUGHNESS], np.float32
        ),
    )


def _cosine(
    position: NDArray[Any], normal: NDArray[Any], points: Sequence[NDArray[Any]], weight: NDArray[Any]
) -> NDArray[np.float64]:
    """(n,) mean cosine, 0 to 1, between normals (n, 3) and the directions to points.

    weight : (n, point) of the mean; where all are 0, the points count alike.
    """
    direction = np.array(points)[:, None] - position
    cosines = np.abs(np.einsum("kni,ni->kn", direction, normal)) / np.maximum(np.linalg.norm(direction, axis=2), 1e-9)
    weights = weight.T + np.float32(1e-9)
    return np.sum(weights * cosines, axis=0) / weights.sum(axis=0)


def _emission(position: NDArray[Any], lamps: Sequence[LampSampler], weight: NDArray[Any]) -> NDArray[np.float64]:
    """(n,) mean cosine, 0 to 1, between the lamps' normals and directions from them.

    The directions lead to positions (n, 3). weight : (n, lamp) of the mean; where all are 0, the lamps count alike.
    """
    cosines = []
    for lamp in lamps:
        direction = position - lamp.centre
        normal = np.array([lamp.normal.x[0], lamp.normal.y[0], lamp.normal.z[0]])
        cosines.append(np.abs(direction @ normal) / np.maximum(np.linalg.norm(direction, axis=1), 1e-9))
    weights = weight.T + np.float32(1e-9)
    return np.asarray(np.sum(weights * np.array(cosines), axis=0) / weights.sum(axis=0))


def _sides(
    position: NDArray[Any], normal: NDArray[Any], lamps: Sequence[LampSampler], weight: NDArray[Any]
) -> NDArray[np.float64]:
    """(n, 2) mean offset on even lamps, over their half sizes, from which light comes.

    Nothing is between the lamps and the positions (n, 3). weight : (n, lamp) of the mean over lamps; where all are 0,
    the lamps count alike.
    """
    sides = []
    for lamp in lamps:
        of_lamp = np.array([lamp.normal.x[0], lamp.normal.y[0], lamp.normal.z[0]])
        axes = np.linalg.svd(of_lamp[None])[2][1:]
        axes = axes * (np.abs(axes) @ lamp.half_size)[:, None]
        light, moment = np.full(len(position), 1e-30), np.zeros((len(position), 2))
        for offset in product(_PLACES, repeat=2):
            direction = position - lamp.centre - np.array(offset) @ axes
            square = np.sum(direction**2, axis=1)
            both = np.abs(direction @ of_lamp) * np.maximum(-np.sum(direction * normal, axis=1), 0.0)
            light += both / square**2
            moment += (both / square**2)[:, None] * offset
        sides.append(moment / light[:, None])
    weights = weight.T[..., None] + np.float32(1e-9)
    return np.asarray(np.sum(weights * np.array(sides), axis=0) / weights.sum(axis=0))


def _coated(
    traced: PatchTransport,
    radiance: NDArray[Any],
    reflectance: NDArray[Any],
    shares: NDArray[Any],
    alpha: float,
) -> NDArray[np.float64]:
    """(band, y, x) radiance over the lamps' that a coat on all surfaces mirrors to the camera."""
    coat = Reflection(lambda incoming, outgoing: mi.Float(1), Coat(1.0, alpha))
    materials = np.unique(traced.material)
    each = [
        changed_reflection(
            traced.light,
            traced.camera,
            radiance,
            reflectance,
            shares,
            coat,
            material=int(material),
            seen_in=traced.pixels_of(material),
            samples=(_COAT_SAMPLES, 0),
            spread=traced.spread,
        )
        for material in materials
    ]
    return np.sum(each, axis=0)
