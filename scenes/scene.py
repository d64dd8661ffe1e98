"""Scene: surfaces, materials, lamps and medium.

All values are immutable; effects and methods return changed copies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.arguments import described, require_word, required_number, required_path
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import combined, suggestion
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.page_text import escaped
from numpy.typing import ArrayLike, NDArray

from .shapes import turned_about_vertical
from .spectra import Spectrum, as_spectrum
from .spectrum_checks import radiance_faults, reflectance_faults
from .wavelength_grid import WAVELENGTH_NM

__all__ = ["Lamp", "Material", "Medium", "Scene", "SceneOrigin", "Surface", "Texture"]


@dataclass(frozen=True, eq=False)
class Texture:
    """Reflectance that varies over a surface.

    It is the sum over k of weights[row, column, k] spectra[k], from 0 to 1 at every pixel and wavelength. It is
    bilinear between the centres of pixels and constant beyond the outer ones.
    """

    #: (rows, columns, k) weights. Columns run along the texture coordinate u, rows along v, both from 0 to 1.
    weights: NDArray[np.float64]
    #: k spectra, held constant beyond their tables.
    spectra: tuple[Spectrum, ...]

    @property
    def tables(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Wavelengths (w,) of all tables, nm, and the spectra (k, w) there.

        The spectra are linear between these wavelengths.
        """
        grid = np.unique(np.concatenate([spectrum.wavelength_nm for spectrum in self.spectra]))
        return grid, np.array([spectrum.at(grid) for spectrum in self.spectra])

    @property
    def mean(self) -> Spectrum:
        """Mean reflectance of the pixels."""
        grid, values = self.tables
        return Spectrum(grid, self.weights.mean(axis=(0, 1)) @ values)

    def scaled(self, factor: float) -> Texture:
        """Texture times a number, at most 1.

        Parameters
        ----------
        factor
            The number, 0 or more.

        Returns
        -------
        Texture
            The texture. A pixel that would reflect more than 1 at a wavelength is scaled so that its maximum is 1.
        """
        _, values = self.tables
        weights = factor * self.weights
        most = np.array([(row @ values).max(axis=-1) for row in weights])
        return Texture(weights / np.maximum(most, 1.0)[..., None], self.spectra)


@dataclass(frozen=True, eq=False)
class Material(FrozenMappings):
    """Material: Lambertian, with a texture, or with any BSDF of Mitsuba.

    A material has a texture or a BSDF, not both.
    """

    #: Name that surfaces use.
    name: str
    #: Reflectance, 0 to 1, held constant beyond its table; the mean of a texture.
    reflectance: Spectrum
    #: Mitsuba BSDF in place of Lambert's law, as a dictionary; the string "reflectance" in it is the reflectance.
    bsdf: Mapping[str, Any] | None = None
    #: Reflectance that varies over surfaces with texture coordinates; None if it does not vary.
    texture: Texture | None = None

    @property
    def lambertian(self) -> bool:
        """Whether it is Lambertian with the same reflectance everywhere."""
        return self.bsdf is None and self.texture is None


@dataclass(frozen=True, eq=False)
class Medium:
    """Homogeneous medium between the surfaces, or inside a closed one.

    Its phase function is that of Henyey and Greenstein 1941.
    """

    #: Scattering coefficient, mm^-1, 0 or more, held constant beyond its table.
    scattering_per_mm: Spectrum
    #: Absorption coefficient, mm^-1, 0 or more, held constant beyond its table.
    absorption_per_mm: Spectrum
    #: Mean cosine of the scattering angle, -1 to 1; 0 is isotropic.
    anisotropy: float = 0.0


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangle mesh with a name and a material."""

    #: Name of the surface, unique in its scene.
    name: str
    #: Name of its material.
    material: str
    #: (n, 3) vertices, mm.
    vertices_mm: NDArray[np.float64]
    #: (m, 3) indices of the triangles' vertices, counter-clockwise from the lit side.
    faces: NDArray[np.int64]
    #: (n, 2) texture coordinates of the vertices, u along columns and v along rows; None without a texture.
    texture_uv: NDArray[np.float64] | None = None
    #: Medium inside a closed surface, whose faces are lit from outside; None for the medium around it.
    inside: Medium | None = None
    #: Whether the triangles represent a sphere of their area about the mean of their vertices, see ``sphere_mesh``.
    ball: bool = False

    @property
    def areas_mm2(self) -> NDArray[np.float64]:
        """(m,) areas of the triangles, mm^2."""
        a, b, c = (self.vertices_mm[self.faces[:, i]] for i in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    @property
    def sphere_mm(self) -> tuple[NDArray[np.float64], float]:
        """Centre (3,) and radius, mm, of the sphere that a ball's triangles represent."""
        return self.vertices_mm.mean(axis=0), float(np.sqrt(self.areas_mm2.sum() / (4 * np.pi)))


def _require_none(faults: Sequence[InputError]) -> None:
    """Raise the faults as one InputError, if there are any."""
    if faults:
        raise combined(list(faults))


def _black() -> Spectrum:
    """Reflectance of 0 at all wavelengths."""
    return Spectrum(np.array([550.0]), np.array([0.0]))


@dataclass(frozen=True, eq=False)
class Lamp:
    """Light source: a surface that emits light, and reflects by Lambert's law.

    The radiance is proportional to (e + (1 - e) (1 - X^2) (1 - Z^2)) cos(t)^n. X and Z run from -1 to 1 across the
    lamp, t is the angle from its normal.
    """

    #: The emitting surface.
    surface: Surface
    #: Spectral radiance along the normal, mean over the lamp, W m^-2 sr^-1 nm^-1; zero beyond its table.
    radiance: Spectrum
    #: Radiance e at the corners relative to that at the centre, 0 to 1, at the same mean; 1 is uniform.
    edge_ratio: float = 1.0
    #: Exponent n of the cosine; 0 is Lambert's law.
    exponent: float = 0.0
    #: (rows, columns) radiance of equal cells relative to the mean; None if uniform. Columns run along the first edge
    #: of the lamp's first quad, rows along its last edge, both from its first corner.
    pattern: NDArray[np.float64] | None = None
    #: Reflectance, 0 to 1, the same all over the lamp, held constant beyond its table.
    reflectance: Spectrum = field(default_factory=_black)

    @property
    def reflects(self) -> bool:
        """Whether the reflectance is above 0 anywhere."""
        return bool(self.reflectance.values.any())


@dataclass(frozen=True)
class SceneOrigin:
    """File or name that a scene was read from."""

    #: Name of a packaged scene, or absolute path of a scene file.
    reference: str
    #: The scene file and the tables, meshes and images that it names; empty for a packaged scene.
    files: tuple[Path, ...] = ()

    @property
    def packaged(self) -> bool:
        """Whether the scene is part of the program."""
        return not self.files


@dataclass(frozen=True, eq=False, repr=False)
class Scene(FrozenMappings):
    """Surfaces, materials, lamps and medium of one box, in mm.

    A scene is a value. Methods return changed copies; a changed copy has no ``origin``.

    Examples
    --------
    >>> import cboxlab
    >>> box = cboxlab.load_scene("cornell-box").with_reflectance("red", [400, 700], [0.05, 0.6])
    >>> box.materials["red"].reflectance.at(550).round(3).item()
    0.325
    """

    #: Title of the scene.
    name: str
    #: All surfaces but those of the lamps.
    surfaces: tuple[Surface, ...]
    #: Materials by name.
    materials: Mapping[str, Material]
    #: First lamp, the one whose radiance a capture states.
    lamp: Lamp
    #: Publication or measurement that the scene was taken from.
    source: str = ""
    #: Medium between the surfaces; None for air without scattering.
    medium: Medium | None = None
    #: Lamps other than the first one.
    further_lamps: tuple[Lamp, ...] = ()
    #: File or name that the scene was read from; None for a scene built or changed in memory.
    origin: SceneOrigin | None = field(default=None, init=False)

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

    def require_diffuse(self, hint: str = "") -> None:
        """Raise InputError unless the scene is diffuse.

        Parameters
        ----------
        hint
            Advice for the message; empty for none.

        Raises
        ------
        InputError
            For surfaces that are not Lambertian or have a texture, and for a medium.
        """
        if not self.diffuse:
            fault = "surfaces that are not Lambertian or have a texture, or a medium"
            raise InputError(f"scene {self.name}", fault, "a diffuse scene", hint)

    @property
    def lambertian(self) -> Scene:
        """Scene with Lambert's law and mean reflectances for all materials, without media."""
        plain = {name: replace(material, bsdf=None, texture=None) for name, material in self.materials.items()}
        opaque = tuple(replace(s, inside=None) if s.inside is not None else s for s in self.surfaces)
        return replace(self, surfaces=opaque, medium=None, materials=plain)

    def meets_sphere(self, surface: Surface) -> bool:
        """Whether rays meet the exact sphere of a ball instead of its triangles.

        They do for an opaque ball. Light that enters a ball meets its triangles.

        Parameters
        ----------
        surface
            A surface of the scene.

        Returns
        -------
        bool
            True for an opaque ball.
        """
        return surface.ball and surface.inside is None and self.materials[surface.material].bsdf is None

    @property
    def corners_mm(self) -> NDArray[np.float64]:
        """(n, 3) vertices of all surfaces except the lamps, mm."""
        return np.concatenate([surface.vertices_mm for surface in self.surfaces])

    def surface(self, name: str) -> Surface:
        """Surface of a name.

        Parameters
        ----------
        name
            Name of a surface that is not a lamp.

        Returns
        -------
        Surface
            The surface.

        Raises
        ------
        InputError
            If there is no such surface; the message lists the names.
        """
        surfaces = {surface.name: surface for surface in self.surfaces}
        require_word("surface", name, surfaces)
        return surfaces[name]

    def reflectances(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Reflectances of all materials and lamps.

        Parameters
        ----------
        wavelength_nm
            (w,) wavelengths, nm.

        Returns
        -------
        NDArray
            (materials + lamps, w) reflectances, materials in their order first.
        """
        rows = [material.reflectance for material in self.materials.values()]
        rows += [lamp.reflectance for lamp in self.lamps]
        return np.array([row.at(wavelength_nm) for row in rows])

    @property
    def lamp_areas(self) -> NDArray[np.float64]:
        """(lamps,) area of each lamp over the area of all; the sum is 1."""
        areas = np.array([lamp.surface.areas_mm2.sum() for lamp in self.lamps])
        return areas / areas.sum()

    def lamp_radiance(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Mean radiance of the lamps over their area.

        Parameters
        ----------
        wavelength_nm
            (w,) wavelengths, nm.

        Returns
        -------
        NDArray
            (w,) radiance, W m^-2 sr^-1 nm^-1.
        """
        return self.lamp_areas @ self._radiances(wavelength_nm)

    def lamp_shares(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Radiance of each lamp over the mean radiance of the lamps.

        Parameters
        ----------
        wavelength_nm
            (w,) wavelengths, nm.

        Returns
        -------
        NDArray
            (lamps, w) ratios; 1 at wavelengths where all lamps are dark.
        """
        radiances = self._radiances(wavelength_nm)
        mean = self.lamp_areas @ radiances
        return np.divide(radiances, mean, out=np.ones_like(radiances), where=mean > 0)

    def _radiances(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """(lamps, w) radiances of the lamps, W m^-2 sr^-1 nm^-1."""
        return np.array([lamp.radiance.at(wavelength_nm) for lamp in self.lamps])

    def with_lamp(self, radiance: Spectrum | ArrayLike, values: ArrayLike | None = None) -> Scene:
        """Copy of the scene with another spectral radiance of the first lamp.

        Further lamps keep their radiance relative to the first one: a meter whose scale is off is off for all lamps
        alike. The ratio is that of the sums over 400 to 700 nm.

        Parameters
        ----------
        radiance
            Spectrum in W m^-2 sr^-1 nm^-1, or its wavelengths (n,) in nm.
        values
            (n,) radiance at these wavelengths.

        Returns
        -------
        Scene
            The changed copy.

        Raises
        ------
        InputError
            If the tables differ in length, do not ascend, or hold a negative or no finite number.
        """
        spectrum = as_spectrum(radiance, values, "zero", "Scene.with_lamp: radiance")
        if spectrum is not radiance:
            _require_none(radiance_faults(spectrum, "Scene.with_lamp: radiance"))
        now, before = (float(item.at(WAVELENGTH_NM).sum()) for item in (spectrum, self.lamp.radiance))
        factor = now / before if min(now, before) > 0 else 1.0
        further = tuple(replace(lamp, radiance=lamp.radiance.scaled(factor)) for lamp in self.further_lamps)
        return replace(self, lamp=replace(self.lamp, radiance=spectrum), further_lamps=further)

    def with_reflectance(
        self, material: str, reflectance: Spectrum | ArrayLike, values: ArrayLike | None = None
    ) -> Scene:
        """Copy of the scene in which a material has another reflectance.

        Parameters
        ----------
        material
            Name of the material, such as "red".
        reflectance
            Spectrum from 0 to 1, one number for all wavelengths, or the wavelengths (n,) of ``values`` in nm.
        values
            (n,) reflectance at these wavelengths, 0 to 1.

        Returns
        -------
        Scene
            The changed copy. The material keeps its BSDF; a texture is replaced.

        Raises
        ------
        InputError
            If the scene has no such material, or the table is no reflectance.
        """
        self.material(material)
        where = f"Scene.with_reflectance: {material}"
        spectrum = as_spectrum(reflectance, values, "hold", where)
        _require_none(reflectance_faults(spectrum, where))
        return self.with_material(replace(self.material(material), reflectance=spectrum, texture=None))

    def with_material(self, material: Material) -> Scene:
        """Copy of the scene with one material replaced or added, by the material's name.

        Parameters
        ----------
        material
            The new material.

        Returns
        -------
        Scene
            The changed copy.

        Raises
        ------
        InputError
            If the argument is no ``Material``.
        """
        if not isinstance(material, Material):
            raise InputError("Scene.with_material", described(material), "a Material")
        return replace(self, materials={**self.materials, material.name: material})

    def material(self, name: str) -> Material:
        """Material of a name.

        Parameters
        ----------
        name
            Name of the material.

        Returns
        -------
        Material
            The material.

        Raises
        ------
        InputError
            If the scene has no such material.
        """
        if not isinstance(name, str) or name not in self.materials:
            expected = f"one of {', '.join(self.materials)}"
            hint = suggestion(name, self.materials) if isinstance(name, str) else ""
            raise InputError(f"scene '{self.name}': material", described(name), expected, hint)
        return self.materials[name]

    def moved(self, surface: str, by_mm: ArrayLike = (0.0, 0.0, 0.0), turn_deg: float = 0.0) -> Scene:
        """Copy of the scene in which one surface is shifted, and turned about the vertical.

        Parameters
        ----------
        surface
            Name of the surface, such as "tall-block".
        by_mm
            (3,) shift in mm along x, y and z.
        turn_deg
            Angle in degrees about +y, right-handed, through the mean of the footprint's corners.

        Returns
        -------
        Scene
            The changed copy.

        Raises
        ------
        InputError
            If the scene has no such surface, or the shift or angle is not finite.

        Examples
        --------
        >>> import cboxlab
        >>> box = cboxlab.load_scene("cornell-box")
        >>> shifted = box.moved("tall-block", by_mm=[5, 0, 0]).surface("tall-block")
        >>> (shifted.vertices_mm - box.surface("tall-block").vertices_mm).max(axis=0).round(6).tolist()
        [5.0, 0.0, 0.0]
        """
        require_word("Scene.moved: surface", surface, [item.name for item in self.surfaces])
        where = f"Scene.moved: {surface}"
        angle = required_number(f"{where}: turn_deg", turn_deg)
        try:
            shift = np.asarray(by_mm, float)
        except (TypeError, ValueError, OverflowError):
            shift = np.array(np.nan)
        if shift.shape != (3,) or not np.isfinite(shift).all():
            raise InputError(f"{where}: by_mm", described(by_mm), "three finite numbers, mm")
        mesh = self.surface(surface)
        vertices = turned_about_vertical(mesh.vertices_mm, angle) + shift
        changed = tuple(replace(s, vertices_mm=vertices) if s is mesh else s for s in self.surfaces)
        return replace(self, surfaces=changed)

    def read_from(self, origin: SceneOrigin) -> Scene:
        """Copy of the scene with the origin that it was read from.

        Parameters
        ----------
        origin
            Name or file that states exactly this scene.

        Returns
        -------
        Scene
            The copy.
        """
        scene = replace(self)
        object.__setattr__(scene, "origin", origin)
        return scene

    def write(self, path: str | Path) -> Path:
        """Write the scene as a scene file that ``cboxlab.load_scene`` reads back.

        The format is described in docs/scene-format.md.

        Parameters
        ----------
        path
            A file that ends in .toml: a new one, or a scene file, which is replaced. Meshes and textures are written
            next to it, named after it.

        Returns
        -------
        Path
            The scene file.

        Raises
        ------
        InputError
            If the path does not end in .toml, a file of another kind would be replaced, or the scene has a property
            that scene files cannot state.
        """
        from .scene_writer import write_scene

        return write_scene(required_path("path", path, "a scene file to write"), self)

    def _facts(self) -> list[tuple[str, str]]:
        """Label and text of the five lines that describe the scene."""
        corners = np.concatenate([surface.vertices_mm for surface in self.all_surfaces])
        size = " x ".join(f"{length:.0f}" for length in np.ptp(corners, axis=0))
        origin = "in memory" if self.origin is None else self.origin.reference
        lamps = ", ".join(f"{x.surface.name} ({x.surface.areas_mm2.sum():.0f} mm2)" for x in self.lamps)
        return [
            ("scene", f"{self.name} ({origin}), {size} mm"),
            ("surfaces", ", ".join(f"{x.name} ({x.material})" for x in self.surfaces)),
            ("materials", ", ".join(f"{k} {m.reflectance.at(550.0).item():.2f}" for k, m in self.materials.items())),
            ("lamps", lamps),
            ("medium", "none" if self.medium is None else f"scattering, anisotropy {self.medium.anisotropy:g}"),
        ]

    def __repr__(self) -> str:
        return "\n".join(f"{label + ':':<10} {text}" for label, text in self._facts())

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><th>{escaped(label)}</th><td>{escaped(text)}</td></tr>" for label, text in self._facts())
        return f"<table>{rows}</table>"

    def with_lamps(self, change: Callable[[Lamp], Lamp]) -> Scene:
        """Copy of the scene with every lamp changed.

        Parameters
        ----------
        change
            Function of a lamp to the changed lamp.

        Returns
        -------
        Scene
            The changed copy.
        """
        return replace(self, lamp=change(self.lamp), further_lamps=tuple(map(change, self.further_lamps)))
