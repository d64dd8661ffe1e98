"""What is in the box: named surfaces, paints and the lamp. Immutable; effects return changed copies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .spectra import Spectrum

__all__ = ["Lamp", "Material", "Medium", "Scene", "Surface"]


@dataclass(frozen=True, eq=False)
class Material:
    """A Lambertian paint, or any surface that Mitsuba knows.

    reflectance : 0 to 1, held constant beyond its table. bsdf : Mitsuba's description of the surface in place
    of Lambert's law (keys and plain values, nested); the string "reflectance" in it stands for the reflectance.
    """

    name: str
    reflectance: Spectrum
    bsdf: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class Surface:
    """A named triangle mesh.

    vertices_mm : (n, 3). faces : (m, 3) indices, counter-clockwise seen from the lit side.
    """

    name: str
    material: str
    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int64]

    @property
    def areas_mm2(self) -> NDArray[np.float64]:
        """(m,) triangle areas."""
        a, b, c = (self.vertices_mm[self.faces[:, i]] for i in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


@dataclass(frozen=True, eq=False)
class Lamp:
    """The light: a surface of its own that emits and reflects nothing.

    radiance : W m^-2 sr^-1 nm^-1, mean over the lamp, along its normal; zero beyond its table.
    edge_ratio : 0 to 1, radiance at the corners over that at the centre: the radiance goes as
        e + (1 - e) (1 - X^2) (1 - Z^2), X and Z from -1 to 1 across the lamp, mean kept; 1 is uniform.
    exponent : radiance goes as cos^n of the angle from the normal; 0 is Lambert's law.
    pattern : (rows, columns) radiance of equal cells over the mean, or None. Columns go along the first edge of
        the lamp's first quad, rows along its last, both from its first corner.
    """

    surface: Surface
    radiance: Spectrum
    edge_ratio: float = 1.0
    exponent: float = 0.0
    pattern: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class Medium:
    """What fills all space between the surfaces, the same everywhere.

    scattering_per_mm, absorption_per_mm : coefficients, held constant beyond their tables.
    anisotropy : mean cosine of the scattering angle, -1 to 1 (Henyey and Greenstein 1941); 0 is isotropic.
    """

    scattering_per_mm: Spectrum
    absorption_per_mm: Spectrum
    anisotropy: float = 0.0


@dataclass(frozen=True, eq=False)
class Scene:
    """One box. Lengths in mm; surfaces do not contain the lamp's own surface."""

    name: str
    surfaces: tuple[Surface, ...]
    materials: dict[str, Material]
    lamp: Lamp
    source: str = field(default="")
    medium: Medium | None = None

    @property
    def diffuse(self) -> bool:
        """Whether all surfaces in use follow Lambert's law and nothing lies between them."""
        used = {surface.material for surface in self.surfaces}
        return self.medium is None and all(self.materials[name].bsdf is None for name in used)

    def surface(self, name: str) -> Surface:
        """The surface of that name; KeyError with the known names otherwise."""
        for surface in self.surfaces:
            if surface.name == name:
                return surface
        raise KeyError(f"no surface '{name}'; there are {', '.join(s.name for s in self.surfaces)}")

    def with_lamp(self, radiance: Spectrum) -> Scene:
        """The same box under another lamp spectrum."""
        return replace(self, lamp=replace(self.lamp, radiance=radiance))
