"""Scenes whose light is known in closed form, and what an integrator makes of them. docs/references.md derives each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from cboxlab.rendering.integrators import RenderJob, render
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Lamp, Material, Scene, Surface
from cboxlab.scenes.shapes import quad_mesh, ring_mesh
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import ArrayLike, NDArray

from .closed_forms import (
    disk_above,
    parallel_squares,
    perpendicular_rectangles,
    point_to_polygon,
    sphere_over,
)
from .enclosure import FACES, cube_radiosity

__all__ = ["REFERENCES", "Measured", "Reference", "measure_references"]

#: Edge of the cubes and squares, mm, pixels a side of the pictures, reflectance of receivers.
_EDGE, _SIZE, _GREY = 1000.0, 24, 0.5
_NM = np.array([550.0])
_FLAT = Spectrum(np.array([300.0, 900.0]), np.ones(2))
#: Corners of the polygon in place of a disk of the same area; what it leaves is far below the tolerance.
_CORNERS = 40
_BATCHES = 8


@dataclass(frozen=True, eq=False)
class Reference:
    """One scene. expected : the mean over the picture with ``weights`` (y, x), relative to the lamp's radiance 1.

    samples : per pixel and batch, of the final gather and of the path tracer. max_bounces : None for no limit.
    """

    name: str
    aspect: str
    scene: Scene
    camera: Camera
    expected: float
    max_bounces: int | None
    samples: tuple[int, int]
    weights: NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """What an integrator makes of a reference. difference, sigma : relative to what is expected."""

    name: str
    aspect: str
    integrator: str
    expected: float
    difference: float
    sigma: float

    def to_dict(self) -> dict[str, Any]:
        """All fields."""
        return dict(vars(self))


def measure_references(
    names: tuple[str, ...] | None = None, effort: float = 1.0, seed: int = 0, progress: Progress = NO_PROGRESS
) -> tuple[Measured, ...]:
    """Every reference by the final gather and by the path tracer.

    names : some of REFERENCES. effort : times the samples that bring the error below 0.05 %.
    """
    chosen = tuple(REFERENCES) if names is None else names
    found = []
    for done, name in enumerate(chosen):
        reference = REFERENCES[name]()
        for index, integrator in enumerate(("default", "path")):
            samples = max(2, round(reference.samples[index] * effort) // 2 * 2)
            means = []
            for batch in range(_BATCHES):  # each with a light field of its own
                image = render(
                    RenderJob(
                        reference.scene,
                        reference.camera,
                        _NM,
                        samples,
                        1,
                        seed=seed + 101 * batch,
                        max_bounces=reference.max_bounces,
                    ),
                    integrator=integrator,  # type: ignore[arg-type]
                )
                picture = (image.coefficients @ image.spectra)[0, ..., 0].astype(float)
                means.append(float((picture * reference.weights).sum()))
                progress.part((done + (index + (batch + 1) / _BATCHES) / 2) / len(chosen))
            mean, error = float(np.mean(means)), float(np.std(means, ddof=1) / np.sqrt(_BATCHES))
            found.append(
                Measured(
                    name,
                    reference.aspect,
                    "final gather" if index == 0 else "path tracer",
                    reference.expected,
                    mean / reference.expected - 1,
                    error / reference.expected,
                )
            )
    return tuple(found)


def _grey(value: float, name: str = "grey") -> Material:
    return Material(name, _FLAT.scaled(value))


def _quad(name: str, corners: ArrayLike, material: str = "grey") -> Surface:
    return Surface(name, material, *quad_mesh(corners))


def _scene(surfaces: list[Surface], lamp: Surface, materials: Mapping[str, Material] | None = None) -> Scene:
    return Scene("reference", tuple(surfaces), materials or {"grey": _grey(_GREY)}, Lamp(lamp, _FLAT))


def _facing(position: ArrayLike, forward: ArrayLike, half_mm: float, distance_mm: float, size: int = _SIZE) -> Camera:
    """Its image is exactly a square of 2 ``half_mm`` a side, frontal, at ``distance_mm`` in front of it."""
    z = np.asarray(forward, float)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[1]) > 0.5 else [0.0, 1.0, 0.0])
    rotation = np.stack([x, np.cross(z, x), z])
    focal = size * distance_mm / (2 * half_mm)
    return Camera(size, size, focal, np.full(2, (size - 1) / 2), 0.0, rotation, np.asarray(position, float))


def _even(camera: Camera) -> NDArray[np.float64]:
    shape = camera.height_px, camera.width_px
    return np.full(shape, 1.0 / np.prod(shape))


def _face(axis: int, side: int) -> NDArray[np.float64]:
    """(4, 3) corners of a cube's face, lit from inside."""
    a, b = ((axis + 1) % 3, (axis + 2) % 3)
    corners = np.zeros((4, 3))
    corners[:, axis] = _EDGE * side
    corners[:, a], corners[:, b] = _EDGE * np.array([0, 1, 1, 0]), _EDGE * np.array([0, 0, 1, 1])
    return corners if side == 0 else corners[::-1]


def _furnace() -> Reference:
    faces = [_quad(name, _face(*where)) for name, where in FACES.items() if name != "ceiling"]
    ceiling = _face(*FACES["ceiling"])
    hole = ceiling.mean(axis=0) + 0.95 * (ceiling - ceiling.mean(axis=0))
    faces.append(Surface("ceiling", "grey", *ring_mesh(ceiling, hole)))
    camera = _facing([500.0, 500.0, 50.0], [0.0, 0.0, 1.0], 500.0, 500.0)
    # where the lamp itself is seen its own radiance, also 1, counts
    return Reference(
        "furnace",
        "no light is lost or made",
        _scene(faces, _quad("light", hole), {"grey": _grey(1.0)}),
        camera,
        1.0,
        None,
        (256, 8192),
        _even(camera),
    )


def _polygon() -> Reference:
    lamp = np.array([[-300.0, 700, -200], [100, 800, -250], [250, 900, 300], [-150, 800, 350]])
    lamp = lamp - np.outer((lamp - lamp[0]) @ (n := _normal(lamp[:3])), n)  # flat
    if _normal(lamp[:3])[1] > 0:
        lamp = lamp[::-1]
    floor = _quad("floor", np.array([[2000.0, 0, -2000], [-2000, 0, -2000], [-2000, 0, 2000], [2000, 0, 2000]]))
    camera = _facing([150.0, 600.0, 100.0], [0.0, -1.0, 0.0], 500.0, 600.0)
    nodes, shares = np.polynomial.legendre.leggauss(4)
    u, v = (np.arange(_SIZE)[:, None] + nodes / 2).ravel(), np.tile(shares / 2, _SIZE) / _SIZE
    rays = camera.directions(u[None, :], u[:, None])
    points = camera.position_mm - rays * (camera.position_mm[1] / rays[..., 1:2])
    expected = float(v @ point_to_polygon(points, [0.0, 1.0, 0.0], lamp) @ v)
    return Reference(
        "polygon lamp",
        "Lambert's formula, camera and reflection",
        _scene([floor], _quad("light", lamp)),
        camera,
        _GREY * expected,
        1,
        (16, 16),
        _even(camera),
    )


def _normal(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    found = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return np.asarray(found / np.linalg.norm(found))


def _opposed() -> Reference:
    camera = _facing([500.0, 990.0, 500.0], [0.0, -1.0, 0.0], 500.0, 990.0)
    scene = _scene([_quad("floor", _face(1, 0))], _quad("light", _face(1, 1)))
    return Reference(
        "parallel squares",
        "form factor of facing squares",
        scene,
        camera,
        _GREY * parallel_squares(1.0),
        1,
        (16, 16),
        _even(camera),
    )


def _touching() -> Reference:
    camera = _facing([990.0, 500.0, 500.0], [-1.0, 0.0, 0.0], 500.0, 990.0)
    scene = _scene([_quad("wall", _face(0, 0))], _quad("light", _face(1, 1)))
    return Reference(
        "perpendicular squares",
        "a wall that the lamp touches",
        scene,
        camera,
        _GREY * perpendicular_rectangles(1.0, 1.0),
        1,
        (1024, 1024),
        _even(camera),
    )


def _disk_lamp(centre: NDArray[np.float64], towards: NDArray[np.float64], radius: float) -> Surface:
    """A regular polygon of a disk's area that shines along ``towards``."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    angle = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    size = radius * np.sqrt(2 * np.pi / (_CORNERS * np.sin(2 * np.pi / _CORNERS)))
    ring = centre + size * (np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * np.cross(z, x))
    faces = [(0, i, i + 1) for i in range(1, _CORNERS - 1)]
    return Surface("light", "", ring, np.array(faces))


def _spot_below(lamp: Surface, name: str, aspect: str, factor: float) -> Reference:
    """The light on 2 mm of floor around the origin, seen from 100 mm above."""
    floor = _quad("floor", np.array([[50.0, 0, -50], [-50, 0, -50], [-50, 0, 50], [50, 0, 50]]))
    camera = _facing([0.0, 100.0, 0.0], [0.0, -1.0, 0.0], 1.0, 100.0, 8)
    return Reference(name, aspect, _scene([floor], lamp), camera, _GREY * factor, 1, (64, 64), _even(camera))


def _disk() -> Reference:
    lamp = _disk_lamp(np.array([0.0, 600.0, 0.0]), np.array([0.0, -1.0, 0.0]), 400.0)
    return _spot_below(lamp, "disk", "a round lamp, point straight below", disk_above(400.0, 600.0))


def _sphere() -> Reference:
    radius, distance, angle = 300.0, 1000.0, np.radians(50.0)
    towards = np.array([np.sin(angle), np.cos(angle), 0.0])
    share = radius / distance
    centre = towards * distance * (1 - share**2)
    lamp = _disk_lamp(centre, -towards, radius * np.sqrt(1 - share**2))
    return _spot_below(lamp, "sphere", "its outline as a tilted disk", sphere_over(radius, distance, np.cos(angle)))


def _enclosure() -> Reference:
    values = {"left": 0.3, "right": 0.5, "floor": 0.7, "back": 0.6, "front": 0.2}
    faces = [_quad(name, _face(*FACES[name]), name) for name in values]
    camera = _facing([500.0, 500.0, 10.0], [0.0, 0.0, 1.0], 500.0, 990.0)
    scene = _scene(faces, _quad("light", _face(1, 1)), {name: _grey(v, name) for name, v in values.items()})
    return Reference(
        "enclosure",
        "all reflections, against a refined radiosity solution",
        scene,
        camera,
        cube_radiosity(values, "ceiling")["back"],
        None,
        (256, 2048),
        _even(camera),
    )


def _geometry() -> Reference:
    """The lamp alone through a lens that distorts: its picture's area is that of its projected outline."""
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
    reference = Reference(
        "camera", "area of a projected outline, with distortion", scene, camera, area, 0, (1024, 1024), _even(camera)
    )
    return replace(reference, weights=np.ones((camera.height_px, camera.width_px)))


#: By name, in the order of the page.
REFERENCES: Mapping[str, Callable[[], Reference]] = MappingProxyType(
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
