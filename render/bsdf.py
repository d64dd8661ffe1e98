"""Materials' descriptions for Mitsuba, and their values at many wavelengths along one path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.scene import Material, Scene

__all__ = ["SpectralBsdfs", "bsdf_dict"]


def bsdf_dict(material: Material, reflectance: Any) -> dict[str, Any]:
    """Mitsuba's description of a material; ``reflectance`` is that of its reflectance in the active variant."""
    if material.bsdf is None:
        return {"type": "diffuse", "reflectance": reflectance}

    def filled(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: filled(inner) for key, inner in value.items()}
        return reflectance if value == "reflectance" else value

    return filled(material.bsdf)


def load_bsdf(material: Material, reflectance: Any) -> mi.BSDF:
    """The BSDF of a material. Raises InputError with Mitsuba's own words where it knows no such surface."""
    try:
        return mi.load_dict(bsdf_dict(material, reflectance))
    except (RuntimeError, ValueError, TypeError) as error:
        found = f"a description that Mitsuba refuses ({str(error).splitlines()[-1].strip()})"
        raise InputError(f"material.{material.name}.bsdf", found, "a BSDF of Mitsuba") from None


class SpectralBsdfs:
    """All materials that are not Lambertian, evaluated at any number of wavelengths in groups of four.

    Needs a spectral variant of Mitsuba. A direction is drawn once, at the first group, and evaluated at all.
    """

    def __init__(self, scene: Scene, wavelengths: np.ndarray) -> None:
        self._count = len(wavelengths)
        padded = np.resize(wavelengths, 4 * -(-self._count // 4))
        padded[self._count :] = wavelengths[-1]
        self._groups = [mi.Spectrum(*(float(x) for x in group)) for group in padded.reshape(-1, 4)]
        grid = np.concatenate([[wavelengths[0] - 1], wavelengths, [wavelengths[-1] + 1]])
        self._bsdfs = []
        for index, material in enumerate(scene.materials.values()):
            if material.bsdf is not None:
                values = np.pad(material.reflectance.at(wavelengths), 1, mode="edge")
                spectrum = {"type": "irregular", "wavelengths": _listed(grid), "values": _listed(values)}
                self._bsdfs.append((index, load_bsdf(material, spectrum)))
        self._jumps = any(mi.has_flag(b.flags(), mi.BSDFFlags.Delta) for _, b in self._bsdfs)
        self.materials = [index for index, _ in self._bsdfs]

    def _at(self, material: mi.UInt32) -> mi.BSDFPtr:
        pointer = mi.BSDFPtr(self._bsdfs[0][1])
        for index, bsdf in self._bsdfs[1:]:
            pointer = dr.select(material == index, mi.BSDFPtr(bsdf), pointer)
        return pointer

    def interaction(
        self, position: mi.Point3f, normal: mi.Vector3f, direction: mi.Vector3f
    ) -> mi.SurfaceInteraction3f:
        """What Mitsuba needs to know of a hit by a ray along ``direction``."""
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(position))
        si.p, si.n, si.sh_frame = position, mi.Normal3f(normal), mi.Frame3f(normal)
        si.wi = si.to_local(-direction)
        si.t = mi.Float(1)
        return si

    def values(
        self, si: mi.SurfaceInteraction3f, material: mi.UInt32, direction: mi.Vector3f, active: mi.Bool
    ) -> tuple[list[mi.Float], mi.Float]:
        """BSDF times cosine towards ``direction`` at each wavelength, and the density of drawing it, 1/sr."""
        pointer, wo, context = self._at(material), si.to_local(direction), mi.BSDFContext()
        values: list[mi.Float] = []
        density = mi.Float(0)
        for number, group in enumerate(self._groups):
            si.wavelengths = group
            if number == 0:
                value, density = pointer.eval_pdf(context, si, wo, active)
            else:
                value = pointer.eval(context, si, wo, active)
            values += list(value)
        return values[: self._count], density

    def sample(
        self, si: mi.SurfaceInteraction3f, material: mi.UInt32, lobe: mi.Float, point: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.Vector3f, list[mi.Float], mi.Float]:
        """A direction, BSDF times cosine over density at each wavelength, and the density, 1/sr.

        The density is infinite where a mirror or clear glass left no choice.
        """
        pointer, context = self._at(material), mi.BSDFContext()
        si.wavelengths = self._groups[0]
        drawn, _ = pointer.sample(context, si, lobe, point, active)
        direction = si.to_world(drawn.wo)
        jump = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        good = active & (drawn.pdf > 0)
        values, _ = self.values(si, material, direction, good & ~jump)
        weights = [dr.select(good & ~jump, value / drawn.pdf, 0) for value in values]
        if self._jumps:
            jumped: list[mi.Float] = []
            for group in self._groups:
                si.wavelengths = group
                jumped += list(pointer.sample(context, si, lobe, point, good & jump)[1])
            weights = [dr.select(good & jump, new, old) for old, new in zip(weights, jumped, strict=False)]
        return direction, weights, dr.select(jump, mi.Float(dr.inf), drawn.pdf)


def _listed(values: np.ndarray) -> str:
    return ",".join(f"{v:.9g}" for v in values)
