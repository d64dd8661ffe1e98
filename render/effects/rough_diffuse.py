"""Rough-diffuse: one material is rough, Oren and Nayar's reflection instead of Lambert's."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..device import dr, mi
from ..perturbation import PatchLight, Reflection, with_albedo, with_reflection
from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]


_COSINES = np.linspace(0.01, 1.0, 60)


@lru_cache(maxsize=1)
def _lobe_albedo() -> NDArray[np.float64]:
    """Mean over the cosine-weighted hemisphere of max(0, cos phi) sin(larger) tan(smaller angle), at _COSINES."""
    nodes, weights = np.polynomial.legendre.leggauss(96)
    angle, weight = (nodes + 1) * np.pi / 4, weights * np.pi / 4
    a, b = np.meshgrid(np.arccos(_COSINES), angle, indexing="ij")
    lobe = np.sin(np.maximum(a, b)) * np.tan(np.minimum(a, b))
    return lobe @ (2 * np.sin(angle) * np.cos(angle) * weight) / np.pi


def _apply(light: PatchLight, material: str, sigma_rad: float) -> PatchLight:
    if sigma_rad == 0:
        return light
    materials = light.scene.materials
    own = index_of(material, materials, "rough-diffuse: material")
    square = sigma_rad**2
    a, b = 1 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
    lobe = _lobe_albedo()
    mean = 2 * float(np.trapezoid(lobe * _COSINES, _COSINES))
    changed = with_albedo(
        light,
        own,
        lambda rho: rho * (a + b * mean),
        lambda rho, cosine: rho * (a + b * np.interp(cosine, _COSINES, lobe)),
    )

    # opaque numbers are no part of a kernel's code, which is thus compiled once
    constant, back = dr.opaque(mi.Float, a), dr.opaque(mi.Float, b)

    def base(incoming: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Float:
        sine_in, sine_out = (
            dr.safe_sqrt(1 - incoming.z * incoming.z),
            dr.safe_sqrt(1 - outgoing.z * outgoing.z),
        )
        across = incoming.x * outgoing.x + incoming.y * outgoing.y
        # sin sin cos(phi) = across; sin(larger) tan(smaller) = sin sin / cos(smaller angle)
        backward = dr.maximum(across, 0) / dr.maximum(dr.maximum(incoming.z, outgoing.z), 1e-6)
        return constant + back * dr.select((sine_in > 0) & (sine_out > 0), backward, 0)

    table = mi.Float(lobe.astype(np.float32))

    def means(cosine: mi.Float) -> tuple[mi.Float, mi.Float]:
        place = dr.clip((cosine - _COSINES[0]) / (_COSINES[1] - _COSINES[0]), 0, len(_COSINES) - 1.001)
        index = mi.UInt32(place)
        part = place - mi.Float(index)
        low, high = dr.gather(mi.Float, table, index), dr.gather(mi.Float, table, index + 1)
        return constant + back * (low + part * (high - low)), mi.Float(0)

    return with_reflection(
        changed,
        own,
        Reflection(base, albedo=means),
        of=("rough-diffuse", sigma_rad),
        samples=(light.samples, light.samples),
    )


EFFECT = Effect(
    id="rough-diffuse",
    stage="transport",
    title="a paint is rough, not Lambertian",
    summary="Oren and Nayar's qualitative model (A, B from sigma in radians), without the interreflection term.",
    parameters=(
        Parameter("material", choices=("white", "red", "green"), kind="material"),
        Parameter("sigma_rad", "rad", null=0.0, low=0.0, high=1.2, step=0.1),
    ),
    apply=_apply,
    confirm="Measure the paint's reflection at two angles under one lamp: Lambert's radiance is the same, a rough "
    "paint's grows towards the lamp's own direction.",
    sources=("Oren and Nayar, 'Generalization of Lambert's reflectance model', SIGGRAPH 1994",),
)
