"""Rough-diffuse: one material is rough and reflects by Oren and Nayar's model.

f = rho / pi (A + B max(0, cos phi) sin(alpha) tan(beta)). Alpha is the larger and beta the smaller of the two polar
angles, phi the difference of the azimuths. A = 1 - 0.5 s^2 / (s^2 + 0.33) and B = 0.45 s^2 / (s^2 + 0.09). The term
of interreflection is left out. The cause is a surface of facets with tilts of standard deviation s.

Parameters: material, name of the paint; sigma_rad s, rad, null value 0 (Lambert's law).
Source: Oren and Nayar, 'Generalization of Lambert's reflectance model', SIGGRAPH 1994.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from ..perturbation import PatchLight, Reflection, with_albedo, with_reflection
from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]

#: Cosines of the angle of incidence at which the lobe's albedo is tabulated; linear in between.
_COSINES = np.linspace(0.01, 1.0, 60)


@lru_cache(maxsize=1)
def _lobe_albedo() -> NDArray[np.float64]:
    """(60,) albedo of the lobe max(0, cos phi) sin(alpha) tan(beta), at the angles of _COSINES."""
    nodes, weights = np.polynomial.legendre.leggauss(96)
    angle, weight = (nodes + 1) * np.pi / 4, weights * np.pi / 4
    a, b = np.meshgrid(np.arccos(_COSINES), angle, indexing="ij")
    lobe = np.sin(np.maximum(a, b)) * np.tan(np.minimum(a, b))
    return lobe @ (2 * np.sin(angle) * np.cos(angle) * weight) / np.pi


def _apply(light: PatchLight, material: str, sigma_rad: float) -> PatchLight:
    if sigma_rad == 0:
        return light
    materials = light.scene.materials
    index = index_of(material, materials, "rough-diffuse: material")
    square = sigma_rad**2
    a, b = 1 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
    lobe = _lobe_albedo()
    mean = 2 * float(np.trapezoid(lobe * _COSINES, _COSINES))
    changed = with_albedo(
        light,
        index,
        lambda rho: rho * (a + b * mean),
        lambda rho, cosine: rho * (a + b * np.interp(cosine, _COSINES, lobe)),
    )

    # an opaque number is not part of a kernel's code, so one kernel serves all values
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

    table = device_array(mi.Float, lobe)

    def means(cosine: mi.Float) -> tuple[mi.Float, mi.Float]:
        row = dr.clip((cosine - _COSINES[0]) / (_COSINES[1] - _COSINES[0]), 0, len(_COSINES) - 1.001)
        below = mi.UInt32(row)
        part = row - mi.Float(below)
        low, high = dr.gather(mi.Float, table, below), dr.gather(mi.Float, table, below + 1)
        return constant + back * (low + part * (high - low)), mi.Float(0)

    return with_reflection(
        changed,
        index,
        Reflection(base, albedo=means),
        of=("rough-diffuse", sigma_rad),
        samples=(light.samples, light.samples),
    )


EFFECT = Effect(
    id="rough-diffuse",
    stage="transport",
    title="a paint is rough, not Lambertian",
    summary="The paint reflects by Oren and Nayar's qualitative model (A, B from sigma in radians), without the "
    "interreflection term.",
    parameters=(
        Parameter("material", choices=("white", "red", "green"), kind="material"),
        Parameter("sigma_rad", "rad", null=0.0, low=0.0, high=1.2, step=0.1),
    ),
    apply=_apply,
    confirm="Measure the paint's radiance at two angles under one lamp. A Lambertian paint has the same radiance at "
    "both; the radiance of a rough paint grows towards the lamp's direction.",
    sources=("Oren and Nayar, 'Generalization of Lambert's reflectance model', SIGGRAPH 1994",),
)
