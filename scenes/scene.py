"""What is in the box: named surfaces, paints and the lamp. Immutable; effects return changed copies."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .spectra import Spectrum

__all__ = ["Lamp", "Material", "Scene", "Surface"]


@dataclass(frozen=True, eq=False)
class Material:
    """A Lambertian paint. reflectance : 0 to 1, held constant beyond its table."""

    name: str
    reflectance: Spectrum


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
    """

    surface: Surface
    radiance: Spectrum
    edge_ratio: float = 1.0
    exponent: float = 0.0


@dataclass(frozen=True, eq=False)
class Scene:
    """One box. Lengths in mm; surfaces do not contain the lamp's own surface."""

    name: str
    surfaces: tuple[Surface, ...]
    materials: dict[str, Material]
    lamp: Lamp
    source: str = field(default="")

    def surface(self, name: str) -> Surface:
        """The surface of that name; KeyError with the known names otherwise."""
        for surface in self.surfaces:
            if surface.name == name:
                return surface
        raise KeyError(f"no surface '{name}'; there are {', '.join(s.name for s in self.surfaces)}")

    def with_lamp(self, radiance: Spectrum) -> Scene:
        """The same box under another lamp spectrum."""
        return replace(self, lamp=replace(self.lamp, radiance=radiance))
