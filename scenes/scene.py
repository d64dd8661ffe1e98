"""The scene: surfaces, materials, the lamps, the medium. Immutable; effects return changed copies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import ArrayLike, NDArray

from .spectra import Spectrum
from .wavelength_grid import WAVELENGTH_NM

__all__ = ["Lamp", "Material", "Medium", "Scene", "Surface", "Texture"]


@dataclass(frozen=True, eq=False)
class Texture:
    """A reflectance that varies over a surface: the sum over k of weights[row, column, k] times spectra[k].

    weights : (rows, columns, k). Columns run along the texture coordinate u, rows along v, both from 0 to 1; bilinear
    between the centres of pixels, held constant beyond the outer ones. spectra : k, held constant beyond their tables.
    The reflectance is 0 to 1 at every pixel and wavelength.
    """

    weights: NDArray[np.float64]
    spectra: tuple[Spectrum, ...]

    @property
    def tables(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Wavelengths (w,) of all tables, nm, between which the spectra are linear, and the spectra (k, w) there."""
        grid = np.unique(np.concatenate([spectrum.wavelength_nm for spectrum in self.spectra]))
        return grid, np.array([spectrum.at(grid) for spectrum in self.spectra])

    @property
    def mean(self) -> Spectrum:
        """The mean reflectance of the pixels."""
        grid, values = self.tables
        return Spectrum(grid, self.weights.mean(axis=(0, 1)) @ values)

    def scaled(self, factor: float) -> Texture:
        """The texture times a number; less in pixels that would reflect more than 1 at a wavelength: just 1 there."""
        _, values = self.tables
        weights = factor * self.weights
        most = np.array([(row @ values).max(axis=-1) for row in weights])
        return Texture(weights / np.maximum(most, 1.0)[..., None], self.spectra)


@dataclass(frozen=True, eq=False)
class Material(OwnMappings):
    """A Lambertian material, one with a texture, or one with any BSDF of Mitsuba.

    reflectance : 0 to 1, held constant beyond its table; of a texture its mean. bsdf : a Mitsuba BSDF dictionary
    (nested keys and plain values) that replaces Lambert's law; the string "reflectance" in it stands for the
    reflectance. texture : on surfaces with texture coordinates; not together with a bsdf.
    """

    name: str
    reflectance: Spectrum
    bsdf: Mapping[str, Any] | None = None
    texture: Texture | None = None

    @property
    def lambertian(self) -> bool:
        """Whether it is Lambertian and alike all over."""
        return self.bsdf is None and self.texture is None


@dataclass(frozen=True, eq=False)
class Medium:
    """A homogeneous medium that fills the space between the surfaces, or the inside of one.

    scattering_per_mm, absorption_per_mm : coefficients >= 0, held constant beyond their tables.
    anisotropy : mean cosine of the scattering angle, -1 to 1 (Henyey and Greenstein 1941); 0 is isotropic.
    """

    scattering_per_mm: Spectrum
    absorption_per_mm: Spectrum
    anisotropy: float = 0.0


@dataclass(frozen=True, eq=False)
class Surface:
    """A named triangle mesh.

    vertices_mm : (n, 3). faces : (m, 3) indices, counter-clockwise seen from the lit side. texture_uv : (n, 2) texture
    coordinates of the vertices, u along a texture's columns and v along its rows, or None. inside : what fills a closed
    surface, whose faces are lit from outside; None for nothing else than what is around it. ball : whether the
    triangles stand for a sphere of their area about the mean of their vertices, as those of ``sphere_mesh`` do.
    """

    name: str
    material: str
    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int64]
    texture_uv: NDArray[np.float64] | None = None
    inside: Medium | None = None
    ball: bool = False

    @property
    def areas_mm2(self) -> NDArray[np.float64]:
        """(m,) triangle areas."""
        a, b, c = (self.vertices_mm[self.faces[:, i]] for i in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    @property
    def sphere_mm(self) -> tuple[NDArray[np.float64], float]:
        """Centre (3,) and radius of the sphere that a ball's triangles stand for."""
        return self.vertices_mm.mean(axis=0), float(np.sqrt(self.areas_mm2.sum() / (4 * np.pi)))


def _black() -> Spectrum:
    return Spectrum(np.array([550.0]), np.array([0.0]))


@dataclass(frozen=True, eq=False)
class Lamp:
    """The light source: a surface that emits, and reflects by Lambert's law.

    radiance : W m^-2 sr^-1 nm^-1, mean over the lamp, along its normal; zero beyond its table.
    edge_ratio : 0 to 1, radiance at the corners relative to the centre. The radiance is proportional to
        e + (1 - e) (1 - X^2) (1 - Z^2), X and Z from -1 to 1 across the lamp, its mean unchanged; 1 is uniform.
    exponent : the radiance is proportional to cos^n of the angle from the normal; 0 is Lambert's law.
    pattern : (rows, columns) radiance of equal cells relative to the mean, or None. Columns run along the first
        edge of the lamp's first quad, rows along its last edge, both from its first corner.
    reflectance : 0 to 1, held constant beyond its table, alike all over the lamp.
    """

    surface: Surface
    radiance: Spectrum
    edge_ratio: float = 1.0
    exponent: float = 0.0
    pattern: NDArray[np.float64] | None = None
    reflectance: Spectrum = field(default_factory=_black)

    @property
    def reflects(self) -> bool:
        """Whether the reflectance is above 0 anywhere."""
        return bool(self.reflectance.values.any())


@dataclass(frozen=True, eq=False)
class Scene(OwnMappings):
    """One scene. Lengths in mm. ``surfaces`` does not contain the lamps' surfaces; ``materials`` is by name.

    lamp : the first of the lamps, whose radiance a capture states. further_lamps : the others.
    """

    name: str
    surfaces: tuple[Surface, ...]
    materials: Mapping[str, Material]
    lamp: Lamp
    source: str = field(default="")
    medium: Medium | None = None
    further_lamps: tuple[Lamp, ...] = ()

    @property
    def lamps(self) -> tuple[Lamp, ...]:
        """All lamps, the first one first."""
        return (self.lamp, *self.further_lamps)

    @property
    def all_surfaces(self) -> tuple[Surface, ...]:
        """All surfaces, those of the lamps last."""
        return (*self.surfaces, *(lamp.surface for lamp in self.lamps))

    @property
    def diffuse(self) -> bool:
        """Whether all materials in use are Lambertian, without a texture, and there is no medium."""
        used = {surface.material for surface in self.surfaces}
        clear = self.medium is None and all(surface.inside is None for surface in self.surfaces)
        return clear and all(self.materials[name].lambertian for name in used)

    @property
    def lambertian(self) -> Scene:
        """The same scene with Lambert's law, mean reflectances in place of textures, and without media."""
        plain = {name: replace(one, bsdf=None, texture=None) for name, one in self.materials.items()}
        opaque = tuple(replace(s, inside=None) if s.inside is not None else s for s in self.surfaces)
        return replace(self, surfaces=opaque, medium=None, materials=plain)

    def meets_sphere(self, surface: Surface) -> bool:
        """Whether rays meet a ball's sphere: an opaque one's. Of others, which light enters, they meet triangles."""
        return surface.ball and surface.inside is None and self.materials[surface.material].bsdf is None

    @property
    def corners_mm(self) -> NDArray[np.float64]:
        """(n, 3) vertices of all surfaces except the lamps."""
        return np.concatenate([surface.vertices_mm for surface in self.surfaces])

    def surface(self, name: str) -> Surface:
        """The surface of that name; KeyError with the known names otherwise."""
        for surface in self.surfaces:
            if surface.name == name:
                return surface
        raise KeyError(f"no surface '{name}'; there are {', '.join(s.name for s in self.surfaces)}")

    def reflectances(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """(m + lamps, w) reflectances of the materials in their order, then those of the lamps."""
        rows = [material.reflectance for material in self.materials.values()]
        rows += [lamp.reflectance for lamp in self.lamps]
        return np.array([row.at(wavelength_nm) for row in rows])

    @property
    def lamp_areas(self) -> NDArray[np.float64]:
        """(lamps,) part of the lamps' area that each has; they sum to 1."""
        areas = np.array([lamp.surface.areas_mm2.sum() for lamp in self.lamps])
        return areas / areas.sum()

    def lamp_radiance(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """(w,) mean radiance of the lamps over their area, W m^-2 sr^-1 nm^-1."""
        return self.lamp_areas @ self._radiances(wavelength_nm)

    def lamp_shares(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """(lamps, w) each lamp's radiance over ``lamp_radiance``; 1 where all are dark."""
        radiances = self._radiances(wavelength_nm)
        mean = self.lamp_areas @ radiances
        return np.divide(radiances, mean, out=np.ones_like(radiances), where=mean > 0)

    def _radiances(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        return np.array([lamp.radiance.at(wavelength_nm) for lamp in self.lamps])

    def with_lamp(self, radiance: Spectrum) -> Scene:
        """The same scene with another spectrum of the first lamp, and further lamps as bright beside it as before.

        A meter whose scale is off is off for all lamps alike. Ratios are those of sums over 400 to 700 nm.
        """
        now, before = (float(one.at(WAVELENGTH_NM).sum()) for one in (radiance, self.lamp.radiance))
        factor = now / before if min(now, before) > 0 else 1.0
        further = tuple(replace(one, radiance=one.radiance.scaled(factor)) for one in self.further_lamps)
        return replace(self, lamp=replace(self.lamp, radiance=radiance), further_lamps=further)

    def with_lamps(self, change: Callable[[Lamp], Lamp]) -> Scene:
        """The same scene with every lamp changed."""
        return replace(self, lamp=change(self.lamp), further_lamps=tuple(map(change, self.further_lamps)))
