"""Gloss: one material has a specular coat above its diffuse base.

The coat reflects s F(theta) into a GGX lobe of alpha = roughness, F Fresnel's reflectance of index 1.5. The base gets
the rest: rho (1 - s F(in)) (1 - s F(out)) / pi. The cause is a binder that covers the pigment, or a varnish.

Parameters: material, name of the paint; specular s, without unit, null value 0; roughness, without unit, no null value.
Source: Walter et al., 'Microfacet models for refraction through rough surfaces', EGSR 2007.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..device import device_array, dr, mi
from ..perturbation import Coat, PatchLight, Reflection, fresnel, with_albedo, with_reflection
from .effect import Effect, Parameter, index_of

__all__ = ["EFFECT"]

#: Fresnel's reflectance of index 1.5 for diffuse light from outside: 2 Int F(c) c dc over cosines 0 to 1.
_DIFFUSE_FRESNEL = 0.0918

#: Alpha below which a lobe takes more samples: reflections of narrower lobes vary more from sample to sample.
_BROAD = 0.15


def _apply(light: PatchLight, material: str, specular: float, roughness: float) -> PatchLight:
    if specular == 0:
        return light
    index = index_of(material, light.scene.materials, "gloss: material")
    coat = Coat(specular, roughness)
    cosine = np.linspace(0.02, 1.0, 50)
    reflected = coat.albedo(cosine)
    passed = 1 - specular * np.array(fresnel(device_array(mi.Float, cosine)))
    through = 1 - specular * _DIFFUSE_FRESNEL

    def albedo(rho: NDArray, base: NDArray | float, mirrored: NDArray | float) -> NDArray:
        return rho * base * through + mirrored

    changed = with_albedo(
        light,
        index,
        lambda rho: albedo(rho, through, 2 * float(np.trapezoid(reflected * cosine, cosine))),
        lambda rho, c: albedo(rho, np.interp(c, cosine, passed), np.interp(c, cosine, reflected)),
    )

    def base(incoming: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Float:
        return (1 - coat.scale * fresnel(incoming.z)) * (1 - coat.scale * fresnel(outgoing.z))

    # an opaque number is not part of a kernel's code, so one kernel serves all values
    held_back = dr.opaque(mi.Float, through)
    table = device_array(mi.Float, reflected)

    def means(cosine_in: mi.Float) -> tuple[mi.Float, mi.Float]:
        row = dr.clip((cosine_in - cosine[0]) / (cosine[1] - cosine[0]), 0, len(cosine) - 1.001)
        below = dr.minimum(mi.UInt32(row), len(cosine) - 2)
        part = row - mi.Float(below)
        low, high = dr.gather(mi.Float, table, below), dr.gather(mi.Float, table, below + 1)
        return (1 - coat.scale * fresnel(cosine_in)) * held_back, low + part * (high - low)

    samples = 2 ** round(np.log2(light.samples * min(8.0, 1 + (_BROAD / roughness) ** 2)))
    return with_reflection(
        changed,
        index,
        Reflection(base, coat, means),
        of=("gloss", specular, roughness),
        samples=(samples, max(light.samples, samples // 4)),
    )


EFFECT = Effect(
    id="gloss",
    stage="transport",
    title="a paint has a specular coat",
    summary="A coat above the diffuse base reflects specular times Fresnel's part (index 1.5) with a GGX lobe of "
    "alpha = roughness. The base gets the light that the coat lets through on the way in and out.",
    parameters=(
        Parameter("material", choices=("white", "red", "green"), kind="material"),
        Parameter("specular", "1", null=0.0, low=0.0, high=1.0, step=0.05),
        Parameter("roughness", "1", low=0.03, high=0.8, step=0.02, default=0.25, starts=(0.08, 0.2, 0.45)),
    ),
    apply=_apply,
    is_coat=True,
    confirm="Look at the paint near grazing incidence, or photograph it through a polariser before and after a turn "
    "by 90 degrees: gloss changes, diffuse reflection does not.",
    sources=("Walter et al., 'Microfacet models for refraction through rough surfaces', EGSR 2007",),
)
