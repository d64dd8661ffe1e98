"""Scenes whose light is known in closed form, and our integrators' errors on them.

docs/references.md derives each value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from cboxlab.rendering.integrators import RenderJob, render_image
from cboxlab.rendering.visibility import point_to_polygon
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Lamp, Material, Scene, Surface
from cboxlab.scenes.shapes import quad_mesh, ring_mesh
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.progress import NO_PROGRESS, Progress
from cboxlab.utils.table import Table
from numpy.typing import ArrayLike, NDArray

from .closed_forms import (
    disk_above,
    parallel_squares,
    perpendicular_rectangles,
    sphere_over,
)
from .enclosure import FACES, cube_radiosity

__all__ = ["CLOSED_FORM_SCENES", "ClosedFormScene", "Measured", "closed_form_table", "measure_closed_forms"]

#: Edge of the cubes and squares, mm: any value, since all closed forms are ratios of lengths.
_EDGE_MM = 1000.0
#: Pixels a side of the renderings: few, since only their mean is compared.
_SIZE_PX = 24
#: Reflectance of receivers: any value, since one reflection is linear in it.
_GREY_REFLECTANCE = 0.5
#: The one wavelength of the renderings, nm: all spectra are flat.
_WAVELENGTH_NM = np.array([550.0])
#: Flat spectrum of value 1.
_FLAT = Spectrum(np.array([300.0, 900.0]), np.ones(2))
#: Corners of the polygon of a disk's area that stands for the disk: the error of its light is far below 0.05 %.
_DISK_CORNERS = 40
#: Independent renderings of a scene, whose scatter gives the standard error.
_BATCHES = 8
#: Part of the ceiling's edge that the lamp of the furnace takes: nearly all, so that light needs few reflections.
_FURNACE_LAMP = 0.95


@dataclass(frozen=True, eq=False)
class ClosedFormScene:
    """One scene and its expected light."""

    #: Name in tables.
    name: str
    #: Part of an integrator that the scene tests.
    aspect: str
    #: The scene; its lamp has radiance 1.
    scene: Scene
    #: Camera of the rendering.
    camera: Camera
    #: Expected mean over the rendering with ``weights``, relative to the lamp's radiance.
    expected: float
    #: Most reflections between lamp and camera; None for no limit.
    max_bounces: int | None
    #: Samples per pixel and batch, of the final gather and of the path tracer.
    samples: tuple[int, int]
    #: (y, x) weights of the mean.
    weights: NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """Error of an integrator on one scene."""

    #: Name of the scene.
    name: str
    #: Part of an integrator that the scene tests.
    aspect: str
    #: Name of the integrator.
    integrator: str
    #: Expected mean, relative to the lamp's radiance.
    expected: float
    #: Measured less expected mean, relative to the expected.
    difference: float
    #: Standard deviation of ``difference``.
    sigma: float

    def to_dict(self) -> dict[str, Any]:
        """All fields.

        Returns
        -------
        dict
            Value by name of the field.
        """
        return dict(vars(self))


def closed_form_table(measured: Sequence[Measured]) -> Table:
    """Table of the errors of integrators.

    Parameters
    ----------
    measured
        Results of ``measure_closed_forms``.

    Returns
    -------
    Table
        Expected mean, and difference from it with its standard deviation.
    """
    rows = tuple(
        (
            row.name,
            row.integrator,
            f"{row.expected:.6g}",
            f"{100 * row.difference:+.4f}",
            f"{100 * row.sigma:.4f}",
        )
        for row in measured
    )
    columns = ("reference", "integrator", "expected", "difference, %", "± %")
    return Table("Our integrators against closed forms", columns, rows, text_columns=(0, 1))


def measure_closed_forms(
    names: tuple[str, ...] | None = None, effort: float = 1.0, seed: int = 0, progress: Progress = NO_PROGRESS
) -> tuple[Measured, ...]:
    """Errors of the final gather and of the path tracer on scenes of known light.

    Parameters
    ----------
    names
        Some of CLOSED_FORM_SCENES; None for all.
    effort
        Factor on the samples, which bring the error below 0.05 % at 1.
    seed
        First seed; each batch has another one.
    progress
        Receiver of the finished part.

    Returns
    -------
    tuple of Measured
        Two for each scene, the final gather first.
    """
    selected = tuple(CLOSED_FORM_SCENES) if names is None else names
    measured = []
    for finished, name in enumerate(selected):
        reference = CLOSED_FORM_SCENES[name]()
        for index, integrator in enumerate(("default", "path")):
            samples = max(2, round(reference.samples[index] * effort) // 2 * 2)
            means = []
            for batch in range(_BATCHES):  # each with another light field
                job = RenderJob(
                    reference.scene,
                    reference.camera,
                    _WAVELENGTH_NM,
                    samples,
                    1,
                    seed=seed + 101 * batch,
                    max_bounces=reference.max_bounces,
                )
                image = render_image(
                    job,
                    integrator=integrator,  # type: ignore[arg-type]
                )
                picture = (image.coefficients @ image.spectra)[0, ..., 0].astype(float)
                means.append(float((picture * reference.weights).sum()))
                progress.part((finished + (index + (batch + 1) / _BATCHES) / 2) / len(selected))
            mean, error = float(np.mean(means)), float(np.std(means, ddof=1) / np.sqrt(_BATCHES))
            measured.append(
                Measured(
                    name,
                    reference.aspect,
                    "final gather" if index == 0 else "path tracer",
                    reference.expected,
                    mean / reference.expected - 1,
                    error / reference.expected,
                )
            )
    return tuple(measured)


def _grey(value: float, name: str = "grey") -> Material:
    return Material(name, _FLAT.scaled(value))


def _quad(name: str, corners: ArrayLike, material: str = "grey") -> Surface:
    return Surface(name, material, *quad_mesh(corners))


def _scene(surfaces: list[Surface], lamp: Surface, materials: Mapping[str, Material] | None = None) -> Scene:
    return Scene("reference", tuple(surfaces), materials or {"grey": _grey(_GREY_REFLECTANCE)}, Lamp(lamp, _FLAT))


def _facing(
    position: ArrayLike, forward: ArrayLike, half_mm: float, distance_mm: float, size_px: int = _SIZE_PX
) -> Camera:
    """Camera whose image is a frontal square of 2 ``half_mm`` a side, ``distance_mm`` away."""
    z = np.asarray(forward, float)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[1]) > 0.5 else [0.0, 1.0, 0.0])
    rotation = np.stack([x, np.cross(z, x), z])
    focal, centre = size_px * distance_mm / (2 * half_mm), np.full(2, (size_px - 1) / 2)
    return Camera(size_px, size_px, focal, centre, 0.0, rotation, np.asarray(position, float))


def _even(camera: Camera) -> NDArray[np.float64]:
    """(y, x) equal weights with sum 1."""
    shape = camera.height_px, camera.width_px
    return np.full(shape, 1.0 / np.prod(shape))


def _face(axis: int, side: int) -> NDArray[np.float64]:
    """(4, 3) corners of a cube's face, lit from inside."""
    a, b = ((axis + 1) % 3, (axis + 2) % 3)
    corners = np.zeros((4, 3))
    corners[:, axis] = _EDGE_MM * side
    corners[:, a], corners[:, b] = _EDGE_MM * np.array([0, 1, 1, 0]), _EDGE_MM * np.array([0, 0, 1, 1])
    return corners if side == 0 else corners[::-1]


def _furnace() -> ClosedFormScene:
    """Closed white cube with a lamp: every radiance is the lamp's."""
    faces = [_quad(name, _face(*where)) for name, where in FACES.items() if name != "ceiling"]
    ceiling = _face(*FACES["ceiling"])
    hole = ceiling.mean(axis=0) + _FURNACE_LAMP * (ceiling - ceiling.mean(axis=0))
    faces.append(Surface("ceiling", "grey", *ring_mesh(ceiling, hole)))
    camera = _facing([500.0, 500.0, 50.0], [0.0, 0.0, 1.0], 500.0, 500.0)
    # pixels that see the lamp itself have its radiance, also 1
    return ClosedFormScene(
        "furnace",
        "no light is lost or added",
        _scene(faces, _quad("light", hole), {"grey": _grey(1.0)}),
        camera,
        1.0,
        None,
        (256, 8192),
        _even(camera),
    )


def _polygon() -> ClosedFormScene:
    """Tilted lamp of four corners over a floor; the mean is integrated by Gauss and Legendre."""
    lamp = np.array([[-300.0, 700, -200], [100, 800, -250], [250, 900, 300], [-150, 800, 350]])
    lamp = lamp - np.outer((lamp - lamp[0]) @ (n := _normal(lamp[:3])), n)  # flat
    if _normal(lamp[:3])[1] > 0:
        lamp = lamp[::-1]
    floor = _quad("floor", np.array([[2000.0, 0, -2000], [-2000, 0, -2000], [-2000, 0, 2000], [2000, 0, 2000]]))
    camera = _facing([150.0, 600.0, 100.0], [0.0, -1.0, 0.0], 500.0, 600.0)
    nodes, shares = np.polynomial.legendre.leggauss(4)
    u, v = (np.arange(_SIZE_PX)[:, None] + nodes / 2).ravel(), np.tile(shares / 2, _SIZE_PX) / _SIZE_PX
    rays = camera.directions(u[None, :], u[:, None])
    points = camera.position_mm - rays * (camera.position_mm[1] / rays[..., 1:2])
    expected = float(v @ point_to_polygon(points, [0.0, 1.0, 0.0], lamp) @ v)
    return ClosedFormScene(
        "polygon lamp",
        "Lambert's formula, camera and reflection",
        _scene([floor], _quad("light", lamp)),
        camera,
        _GREY_REFLECTANCE * expected,
        1,
        (16, 16),
        _even(camera),
    )


def _normal(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normal of a polygon from its first three corners."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return np.asarray(normal / np.linalg.norm(normal))


def _opposed() -> ClosedFormScene:
    """Floor under a lamp of the same size."""
    camera = _facing([500.0, 990.0, 500.0], [0.0, -1.0, 0.0], 500.0, 990.0)
    scene = _scene([_quad("floor", _face(1, 0))], _quad("light", _face(1, 1)))
    return ClosedFormScene(
        "parallel squares",
        "form factor of facing squares",
        scene,
        camera,
        _GREY_REFLECTANCE * parallel_squares(1.0),
        1,
        (16, 16),
        _even(camera),
    )


def _touching() -> ClosedFormScene:
    """Wall that shares an edge with the lamp."""
    camera = _facing([990.0, 500.0, 500.0], [-1.0, 0.0, 0.0], 500.0, 990.0)
    scene = _scene([_quad("wall", _face(0, 0))], _quad("light", _face(1, 1)))
    return ClosedFormScene(
        "perpendicular squares",
        "a wall that the lamp touches",
        scene,
        camera,
        _GREY_REFLECTANCE * perpendicular_rectangles(1.0, 1.0),
        1,
        (1024, 1024),
        _even(camera),
    )


def _disk_lamp(centre: NDArray[np.float64], towards: NDArray[np.float64], radius: float) -> Surface:
    """Regular polygon with the area of a disk, which emits along ``towards``."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    angle = 2 * np.pi * np.arange(_DISK_CORNERS) / _DISK_CORNERS
    size = radius * np.sqrt(2 * np.pi / (_DISK_CORNERS * np.sin(2 * np.pi / _DISK_CORNERS)))
    ring = centre + size * (np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * np.cross(z, x))
    faces = [(0, i, i + 1) for i in range(1, _DISK_CORNERS - 1)]
    return Surface("light", "", ring, np.array(faces))


def _spot_below(lamp: Surface, name: str, aspect: str, factor: float) -> ClosedFormScene:
    """Light on 2 mm of floor around the origin, seen from 100 mm above."""
    floor = _quad("floor", np.array([[50.0, 0, -50], [-50, 0, -50], [-50, 0, 50], [50, 0, 50]]))
    camera = _facing([0.0, 100.0, 0.0], [0.0, -1.0, 0.0], 1.0, 100.0, 8)
    return ClosedFormScene(
        name, aspect, _scene([floor], lamp), camera, _GREY_REFLECTANCE * factor, 1, (64, 64), _even(camera)
    )


def _disk() -> ClosedFormScene:
    """Round lamp straight above a point."""
    lamp = _disk_lamp(np.array([0.0, 600.0, 0.0]), np.array([0.0, -1.0, 0.0]), 400.0)
    return _spot_below(lamp, "disk", "a round lamp, point straight below", disk_above(400.0, 600.0))


def _sphere() -> ClosedFormScene:
    """Sphere, as the tilted disk that has the same outline from the point."""
    radius, distance, angle = 300.0, 1000.0, np.radians(50.0)
    towards = np.array([np.sin(angle), np.cos(angle), 0.0])
    share = radius / distance
    centre = towards * distance * (1 - share**2)
    lamp = _disk_lamp(centre, -towards, radius * np.sqrt(1 - share**2))
    return _spot_below(lamp, "sphere", "its outline as a tilted disk", sphere_over(radius, distance, np.cos(angle)))


def _enclosure() -> ClosedFormScene:
    """Closed cube of five paints with a luminous ceiling, against a radiosity solution."""
    values = {"left": 0.3, "right": 0.5, "floor": 0.7, "back": 0.6, "front": 0.2}
    faces = [_quad(name, _face(*FACES[name]), name) for name in values]
    camera = _facing([500.0, 500.0, 10.0], [0.0, 0.0, 1.0], 500.0, 990.0)
    scene = _scene(faces, _quad("light", _face(1, 1)), {name: _grey(v, name) for name, v in values.items()})
    return ClosedFormScene(
        "enclosure",
        "all reflections, against a refined radiosity solution",
        scene,
        camera,
        cube_radiosity(values, "ceiling")["back"],
        None,
        (256, 2048),
        _even(camera),
    )


def _geometry() -> ClosedFormScene:
    """Lamp alone through a distorting lens: its image has the area of its projected outline."""
    corners = np.array([[400.0, 300, 900], [250, 100, 900], [-200, 150, 700], [-250, 400, 640]])
    corners = corners - np.outer((corners - corners[0]) @ (n := _normal(corners[:3])), n)
    camera = Camera(96, 80, 90.0, np.array([50.3, 36.1]), -0.12, np.diag([-1.0, -1.0, 1.0]), np.array([20.0, 250, -50]))
    if _normal(corners[:3]) @ (corners[0] - camera.position_mm) > 0:
        corners = corners[::-1]
    edges = [np.linspace(a, b, 400, endpoint=False) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    outline = camera.project(np.concatenate(edges))
    after = np.roll(outline, -1, axis=0)
    area = abs(float((outline[:, 0] * after[:, 1] - outline[:, 1] * after[:, 0]).sum())) / 2
    floor = _quad("floor", np.array([[1.0, -9999, 0], [0, -9999, 0], [0, -9999, 1], [1, -9999, 1]]))
    scene = _scene([floor], _quad("light", corners))
    camera_scene = ClosedFormScene(
        "camera", "area of a projected outline, with distortion", scene, camera, area, 0, (1024, 1024), _even(camera)
    )
    return replace(camera_scene, weights=np.ones((camera.height_px, camera.width_px)))


#: Builders of the scenes by name, in the order of docs/references.md.
CLOSED_FORM_SCENES: Mapping[str, Callable[[], ClosedFormScene]] = MappingProxyType(
    {
        "furnace": _furnace,
        "polygon lamp": _polygon,
        "parallel squares": _opposed,
        "perpendicular squares": _touching,
        "disk": _disk,
        "sphere": _sphere,
        "enclosure": _enclosure,
        "camera": _geometry,
    }
)
