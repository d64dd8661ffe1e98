"""Descriptions of materials for Mitsuba, and BSDF values at many wavelengths along one path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from cboxlab.scenes.scene import Material, Scene
from cboxlab.utils.errors import InputError

from ..device import device_array, dr, mi

__all__ = ["SpectralBsdfs", "bsdf_dict"]


def bsdf_dict(material: Material, reflectance: Any) -> dict[str, Any]:
    """Mitsuba's description of a material.

    Parameters
    ----------
    material
        The material; without a BSDF it is Lambertian.
    reflectance
        Description of its reflectance for the active variant; it replaces each value "reflectance".

    Returns
    -------
    dict[str, Any]
        Description for `mi.load_dict`.
    """
    if material.bsdf is None:
        return {"type": "diffuse", "reflectance": reflectance}

    def filled(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: filled(inner) for key, inner in value.items()}
        return reflectance if value == "reflectance" else value

    return filled(material.bsdf)


def load_bsdf(material: Material, reflectance: Any) -> mi.BSDF:
    """The BSDF of a material.

    Parameters
    ----------
    material
        The material.
    reflectance
        Description of its reflectance for the active variant.

    Returns
    -------
    BSDF
        The BSDF.

    Raises
    ------
    InputError
        With Mitsuba's message, for an invalid description.
    """
    try:
        return mi.load_dict(bsdf_dict(material, reflectance))
    except (RuntimeError, ValueError, TypeError) as error:
        fault = f"a description that Mitsuba rejects ({str(error).splitlines()[-1].strip()})"
        raise InputError(f"material.{material.name}.bsdf", fault, "a Mitsuba BSDF") from None


#: Wavelength at which the test reflectance is 0, nm.
_BLACK_NM = 500.0
#: Wavelength at which the test reflectance is 1, nm.
_WHITE_NM = 600.0


class SpectralBsdfs:
    """All materials that are not Lambertian, evaluated at any number of wavelengths.

    Needs a spectral variant of Mitsuba, whose BSDFs are evaluated at four wavelengths at once. If all of them are
    affine in the reflectance, f = f_0 + rho (f_1 - f_0), they are evaluated only for reflectance 0 and 1. This is
    tested numerically. Otherwise they are evaluated in groups of four wavelengths.

    In Mitsuba the sampled direction does not depend on the wavelength, so the same random numbers give the same
    direction for every group. The weights returned by sampling are used, not quotients of value and density, which are
    inconsistent in ``roughdielectric`` of Mitsuba 3.9.

    Parameters
    ----------
    scene
        Scene with its materials.
    wavelengths
        (w,) wavelengths, nm.

    Raises
    ------
    InputError
        For a description that Mitsuba rejects.
    """

    def __init__(self, scene: Scene, wavelengths: np.ndarray) -> None:
        materials = list(scene.materials.values())
        self._count = len(wavelengths)
        self.materials = [index for index, material in enumerate(materials) if material.bsdf is not None]
        with_bsdf = [materials[index] for index in self.materials]
        #: Boundaries that light passes without a change of direction: no bounce.
        self.passing = [i for i in self.materials if (materials[i].bsdf or {}).get("type") == "null"]
        reflectances = np.array([m.reflectance.at(wavelengths) for m in with_bsdf]).reshape(-1, self._count)
        step = wavelengths[1] - wavelengths[0] if self._count > 1 else 1.0
        grid = np.concatenate([[wavelengths[0] - step], wavelengths, [wavelengths[-1] + step]])
        self._bsdfs = [
            load_bsdf(m, _spectrum(grid, np.pad(values, 1, mode="edge")))
            for m, values in zip(with_bsdf, reflectances, strict=True)
        ]
        padded = np.append(wavelengths, np.full(-self._count % 4, wavelengths[-1]))
        self._groups = [mi.Spectrum(*(float(x) for x in group)) for group in padded.reshape(-1, 4)]
        self._rows: mi.Float | None = None
        ramp = _spectrum(np.array([_BLACK_NM, _WHITE_NM]), np.array([0.0, 1.0]))
        ends = [load_bsdf(m, ramp) for m in with_bsdf]
        probe = mi.Spectrum(_BLACK_NM, _WHITE_NM, _BLACK_NM, _WHITE_NM)
        if with_bsdf and all(
            _same(_probed(exact, self._groups)[:, : self._count], low + rho * (high - low))
            for exact, end, rho in zip(self._bsdfs, ends, reflectances, strict=True)
            for low, high in [np.split(_probed(end, [probe])[:, :2], 2, axis=1)]
        ):
            self._bsdfs, self._groups = ends, [probe]
            rows = np.zeros((len(materials), self._count), np.float32)
            rows[self.materials] = reflectances
            self._rows = device_array(mi.Float, rows)

    def _all(self, values: list[mi.Float], material: mi.UInt32, active: mi.Bool) -> list[mi.Float]:
        """Values at each wavelength from those of the groups."""
        if self._rows is None:
            return values[: self._count]
        low, high = values[:2]
        base = material * self._count
        rho = (dr.gather(mi.Float, self._rows, base + k, active) for k in range(self._count))
        return [low + r * (high - low) for r in rho]

    def _at(self, material: mi.UInt32) -> mi.BSDFPtr:
        """Pointer to the BSDF of each lane's material."""
        pointer = mi.BSDFPtr(self._bsdfs[0])
        for index, bsdf in zip(self.materials[1:], self._bsdfs[1:], strict=True):
            pointer = dr.select(material == index, mi.BSDFPtr(bsdf), pointer)
        return pointer

    def interaction(self, position: mi.Point3f, normal: mi.Vector3f, direction: mi.Vector3f) -> mi.SurfaceInteraction3f:
        """Mitsuba's record of a hit.

        Parameters
        ----------
        position
            Points of the hits, mm.
        normal
            Unit normals there.
        direction
            Unit directions of the rays that hit.

        Returns
        -------
        SurfaceInteraction3f
            The record.
        """
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(position))
        si.p, si.n, si.sh_frame = position, mi.Normal3f(normal), mi.Frame3f(normal)
        si.wi = si.to_local(-direction)
        si.t = mi.Float(1)
        return si

    def values(
        self, si: mi.SurfaceInteraction3f, material: mi.UInt32, direction: mi.Vector3f, active: mi.Bool
    ) -> tuple[list[mi.Float], mi.Float]:
        """BSDF times cosine at each wavelength, and the density of sampling the direction.

        Parameters
        ----------
        si
            Record of `interaction`.
        material
            Index of each lane's material.
        direction
            Unit directions, away from the surface.
        active
            Lanes that are evaluated.

        Returns
        -------
        tuple[list[Float], Float]
            f cos(theta) at each wavelength, 1/sr, and the density, 1/sr; 0 for specular parts.
        """
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
        return self._all(values, material, active), density

    def sample(
        self,
        si: mi.SurfaceInteraction3f,
        material: mi.UInt32,
        lobe: mi.Float,
        point: mi.Point2f,
        active: mi.Bool,
    ) -> tuple[mi.Vector3f, list[mi.Float], mi.Float]:
        """Sampled direction, its weight at each wavelength, and its density.

        Parameters
        ----------
        si
            Record of `interaction`.
        material
            Index of each lane's material.
        lobe
            Random number that selects a lobe, in [0, 1).
        point
            Two random numbers for the direction, in [0, 1).
        active
            Lanes that are sampled.

        Returns
        -------
        tuple[Vector3f, list[Float], Float]
            Unit direction, f cos(theta) / density at each wavelength, and the density, 1/sr, infinite for specular
            reflection and transmission.
        """
        pointer, context = self._at(material), mi.BSDFContext()
        weights: list[mi.Float] = []
        for group in self._groups:
            si.wavelengths = group
            record, weight = pointer.sample(context, si, lobe, point, active)
            weights += list(weight)
        jump = mi.has_flag(record.sampled_type, mi.BSDFFlags.Delta)
        weights = self._all(weights, material, active)
        return si.to_world(record.wo), weights, dr.select(jump, mi.Float(dr.inf), record.pdf)


def _spectrum(wavelengths: np.ndarray, values: np.ndarray) -> dict[str, Any]:
    """Mitsuba's description of a spectrum.

    "regular" if possible, since "irregular" makes a render 25% slower.
    """
    at, listed = (",".join(f"{x:.9g}" for x in table) for table in (wavelengths, values))
    steps = np.diff(wavelengths)
    if np.allclose(steps, steps[0], rtol=1e-9):
        ends = {"wavelength_min": float(wavelengths[0]), "wavelength_max": float(wavelengths[-1])}
        return {"type": "regular", "values": listed, **ends}
    return {"type": "irregular", "wavelengths": at, "values": listed}


def _probed(bsdf: mi.BSDF, groups: list[mi.Spectrum]) -> np.ndarray:
    """(n, 4 times groups) BSDF values for n pairs of random directions on the sphere."""
    directions = np.random.default_rng(1).standard_normal((2, 256, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    wi, wo = (mi.Vector3f(d.T.astype(np.float32)) for d in directions)
    si = dr.zeros(mi.SurfaceInteraction3f, 256)
    si.wi, si.sh_frame, si.n, si.t = wi, mi.Frame3f(mi.Normal3f(0, 0, 1)), mi.Normal3f(0, 0, 1), mi.Float(1)
    columns = []
    for group in groups:
        si.wavelengths = group
        columns += [np.array(x) for x in bsdf.eval(mi.BSDFContext(), si, wo)]
    return np.stack([np.broadcast_to(column, 256) for column in columns], axis=1)


def _same(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether values agree to 1e-5 of each and of the largest."""
    return bool(np.all(np.abs(first - second) <= 1e-5 * np.abs(first).max() + 1e-5 * np.abs(first)))
