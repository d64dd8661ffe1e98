"""Sound boxes that are not quite as surveyed: soft corners, leaning things, uneven or other paint, old flats.

The last six flaws are those of renderers by others: light that is wrong at contacts, in shadows, by patches.

A flaw changes the real box, or the light that its sensor counts. None of them uses the formulas with which a
diagnosis describes flaws: things are meshes in the rendered scene, fields are sums of waves at random.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.scenes.scene import Scene, Surface
from cboxlab.scenes.shapes import box_mesh
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.spatial.transform import Rotation

__all__ = ["BY_OTHERS", "FLAWS", "KEPT_BACK", "Flaw", "Picture"]

Stack = NDArray[np.float64]
Draw = np.random.Generator

#: Surfaces of a room.
_ROOM = ("floor", "ceiling", "back", "left", "right")

#: Flaws of renderers by others.
BY_OTHERS = ("contact", "foot", "penumbra", "indirect", "patches", "lamp-falloff")

#: Flaws that no decision constant was set with.
KEPT_BACK = ("caulk", "bulging-walls", "astigmatism", "old-flats", "sizes")


@dataclass(frozen=True)
class Picture:
    """A rendered picture, and the same with direct light alone.

    reflectance : (band, y, x) of what a pixel shows, 0 on the lamp. room : (y, x) whether it shows walls alone.
    """

    signal: Stack
    direct: Stack
    reflectance: Stack
    room: NDArray[np.bool_]
    image: RenderedImage


@dataclass(frozen=True)
class Flaw:
    """scene : a change of the box; light : factor (band, y, x) on the light at full size; either may do nothing.

    as_drawn : whether its size is the drawn one, not one between the limits.
    """

    scene: Callable[[Draw, Scene], Scene] | None = None
    light: Callable[[Draw, Picture], Stack] | None = None
    as_drawn: bool = False


def _with(scene: Scene, changed: Mapping[str, NDArray[np.float64]]) -> Scene:
    """The scene with other vertices of some surfaces."""
    surfaces = (replace(s, vertices_mm=changed.get(s.name, s.vertices_mm)) for s in scene.surfaces)
    return replace(scene, surfaces=tuple(surfaces))


def _blocks(scene: Scene) -> list[Surface]:
    return [s for s in scene.surfaces if s.name not in _ROOM]


def leaning_blocks(draw: Draw, scene: Scene) -> Scene:
    """Blocks that stand on uneven feet and are turned a little."""
    changed = {}
    for block in _blocks(scene):
        vertices = block.vertices_mm
        foot = np.append(vertices.mean(axis=0)[[0]], [vertices[:, 1].min(), vertices.mean(axis=0)[2]])
        turn = Rotation.from_euler("xyz", draw.normal(0, [0.2, 0.1, 0.2]), degrees=True)
        leant = turn.apply(vertices - foot) + foot
        changed[block.name] = leant + np.array([0, vertices[:, 1].min() - leant[:, 1].min(), 0])
    return _with(scene, changed)


def sizes(draw: Draw, scene: Scene) -> Scene:
    """Blocks half a millimetre larger or smaller than surveyed."""
    changed = {}
    for block in _blocks(scene):
        low, high = block.vertices_mm.min(axis=0), block.vertices_mm.max(axis=0)
        about = (low + high) / 2 * [1, 0, 1]
        changed[block.name] = about + (block.vertices_mm - about) * (1 + draw.normal(0, 0.7, 3) / (high - low))
    return _with(scene, changed)


def _moved_walls(scene: Scene, by: Callable[[str, NDArray[np.float64]], NDArray[np.float64]]) -> Scene:
    """Every wall's plane moved along its normal by what ``by`` says of its points, corners staying closed."""
    high = scene.surface("ceiling").vertices_mm.max(axis=0)
    axis = {"left": 0, "right": 0, "ceiling": 1, "back": 2}
    walls = {name: scene.surface(name).vertices_mm for name in axis}

    def moved(points: NDArray[np.float64]) -> NDArray[np.float64]:
        result = points.copy()
        for name, corners in walls.items():
            nearest = np.linalg.norm(points[:, None] - corners, axis=2).min(axis=1) < 1.0
            result[nearest, axis[name]] += by(name, points[nearest] / high)
        return result

    room = {s.name: moved(s.vertices_mm) for s in scene.surfaces if s.name in _ROOM}
    lamp = scene.lamp.surface
    hung = lamp.vertices_mm + [0, 1, 0] * by("ceiling", lamp.vertices_mm / high)[:, None]
    return replace(_with(scene, room), lamp=replace(scene.lamp, surface=replace(lamp, vertices_mm=hung)))


def tilted_walls(draw: Draw, scene: Scene) -> Scene:
    """Walls out of plumb by a millimetre or two."""
    slopes = {name: draw.normal(0, 1.0, 3) for name in ("left", "right", "ceiling", "back")}
    return _moved_walls(scene, lambda name, at: slopes[name] @ (at - 0.5).T)


def bulging_walls(draw: Draw, scene: Scene) -> Scene:
    """The upright walls bulge: a pyramid of one or two millimetres with its apex in the middle."""
    changed = []
    for surface in scene.surfaces:
        if surface.name in ("back", "left", "right"):
            corners = surface.vertices_mm
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            apex = corners.mean(axis=0) + draw.uniform(1.5, 3.0) * normal / np.linalg.norm(normal)
            faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int64)
            changed.append(replace(surface, vertices_mm=np.vstack([corners, apex]), faces=faces, texture_uv=None))
        else:
            changed.append(surface)
    return replace(scene, surfaces=tuple(changed))


def lamp_frame(draw: Draw, scene: Scene) -> Scene:
    """The lamp has a frame that hangs a few millimetres from the ceiling."""
    corners, deep = scene.lamp.surface.vertices_mm, draw.uniform(3.0, 6.0)
    (low_x, high, low_z), (high_x, _, high_z) = corners.min(axis=0), corners.max(axis=0)
    bars = []
    for name, centre, size in (
        ("near", [(low_x + high_x) / 2, 0, low_z - 1.2], [high_x - low_x, deep, 2.0]),
        ("far", [(low_x + high_x) / 2, 0, high_z + 1.2], [high_x - low_x, deep, 2.0]),
        ("one", [low_x - 1.2, 0, (low_z + high_z) / 2], [2.0, deep, high_z - low_z]),
        ("other", [high_x + 1.2, 0, (low_z + high_z) / 2], [2.0, deep, high_z - low_z]),
    ):
        middle = np.add(centre, [0, high - deep / 2 - 0.1, 0])
        bars.append(Surface(f"frame-{name}", "white", *box_mesh(middle, np.array(size), 0.0)))
    return replace(scene, surfaces=(*scene.surfaces, *bars))


def caulk(draw: Draw, scene: Scene) -> Scene:
    """Strips of white caulk bevel the corners of the room and the feet of the blocks' walls."""
    x, y, z = scene.surface("ceiling").vertices_mm.max(axis=0)
    strips, wide = [], draw.uniform(4.0, 7.0)
    low_x = 0.0
    edges = (
        ([low_x, 0, z], [low_x, y, z], [1, 0, 0], [0, 0, -1]),
        ([549.6, 0, z], [x, y, z], [-1, 0, 0], [0, 0, -1]),
        ([low_x, 0, z], [549.6, 0, z], [0, 1, 0], [0, 0, -1]),
        ([low_x, y, z], [x, y, z], [0, -1, 0], [0, 0, -1]),
    )
    for number, (start, end, first_face, other) in enumerate(edges):
        first, last = np.array(start, float), np.array(end, float)
        along = (last - first) / np.linalg.norm(last - first)
        first, last = first + 8 * along, last - 8 * along
        quad = np.array([first + wide * np.array(first_face), last + wide * np.array(first_face)])
        quad = np.vstack([quad, last + wide * np.array(other), first + wide * np.array(other)])
        normal = np.cross(quad[1] - quad[0], quad[2] - quad[0])
        if normal @ np.add(first_face, other) < 0:
            quad = quad[::-1]
        strips.append(Surface(f"caulk-{number}", "white", quad, np.array([[0, 1, 2], [0, 2, 3]], np.int64)))
    return replace(scene, surfaces=(*scene.surfaces, *strips))


def other_paints(draw: Draw, scene: Scene) -> Scene:
    """Tables of all paints are off by 0.1 to 0.4 % (rms), slowly over wavelength: noise that is blurred over 40 nm."""
    size, grid = draw.uniform(0.001, 0.004), np.arange(360.0, 761.0, 5.0)
    materials = {}
    for name, material in scene.materials.items():
        blurred = gaussian_filter(draw.standard_normal(len(grid) + 80), 8)[40:-40]
        table, change = material.reflectance, size * blurred / blurred.std()
        values = table.values * (1 + np.interp(table.wavelength_nm, grid, change))
        changed = Spectrum(table.wavelength_nm, np.minimum(values, 1.0), table.outside)
        materials[name] = replace(material, reflectance=changed)
    return replace(scene, materials=materials)


def soft_creases(draw: Draw, picture: Picture) -> Stack:
    """Corners of the room are rounded: light that was reflected before is blurred over 0.7 px along them."""
    inside = picture.room.astype(float)
    irradiance = np.divide(picture.signal - picture.direct, np.maximum(picture.reflectance, 1e-3))
    width = (0, 0.7, 0.7)
    even = gaussian_filter(irradiance * inside, width, mode="nearest")
    even /= np.maximum(gaussian_filter(np.broadcast_to(inside, irradiance.shape), width, mode="nearest"), 1e-3)
    blurred = picture.direct + np.where(picture.room, even, irradiance) * picture.reflectance
    return np.where(picture.room, blurred / np.maximum(picture.signal, 1e-9), 1.0)


def _waves(draw: Draw, shape: tuple[int, int], cycles: float) -> Stack:
    """(y, x) field of random smooth waves, standard deviation 1."""
    v, u = np.indices(shape) / shape[0]
    field = np.zeros(shape)
    for _ in range(12):
        k = draw.normal(0, cycles, 2)
        field += np.cos(2 * np.pi * (k[0] * v + k[1] * u) + draw.uniform(0, 2 * np.pi))
    return np.asarray((field - field.mean()) / field.std())


def uneven_paint(draw: Draw, picture: Picture) -> Stack:
    """Every face is painted a little unevenly, more so in the blue."""
    coverage = picture.image.coverage
    bands = np.linspace(1.3, 0.7, len(picture.signal))
    field = np.zeros(coverage.shape[:2])
    for face in range(coverage.shape[-1]):
        field += coverage[..., face] * _waves(draw, field.shape, 1.2)
    return 1 + bands[:, None, None] * field * 0.01


def smooth_field(draw: Draw, picture: Picture) -> Stack:
    """All bands alike are a little too bright here and too dark there."""
    return np.broadcast_to(1 + 0.01 * _waves(draw, picture.room.shape, 1.5), picture.signal.shape)


def old_flats(draw: Draw, picture: Picture) -> Stack:
    """Sensitivity of pixels and shading have changed since the flats, alike in all bands."""
    v, u = np.indices(picture.room.shape) / len(picture.room) - 0.5
    slow = np.exp(-((v - draw.uniform(-0.4, 0.4)) ** 2 + (u - draw.uniform(-0.4, 0.4)) ** 2) / 0.05)
    single = draw.standard_normal(picture.room.shape)
    return np.broadcast_to(1 + 0.01 * single + 0.006 * slow, picture.signal.shape)


def astigmatism(draw: Draw, picture: Picture) -> Stack:
    """The lens draws points as short lines towards the corners of the picture."""
    from scipy.ndimage import map_coordinates

    rows, columns = np.indices(picture.room.shape).astype(float)
    middle = (len(rows) - 1) / 2
    v, u = (rows - middle) / middle, (columns - middle) / middle
    changed = np.empty_like(picture.signal)
    for band, signal in enumerate(picture.signal):
        apart = [
            map_coordinates(signal, [rows + sign * 0.3 * v, columns + sign * 0.3 * u], order=3, mode="nearest")
            for sign in (-1, 1)
        ]
        changed[band] = np.mean(apart, axis=0)
    return changed / np.maximum(picture.signal, 1e-9)


def _floor_and_blocks(picture: Picture) -> tuple[Stack, Stack]:
    """(y, x) share of the floor and of the blocks in each pixel."""
    names, coverage = picture.image.surface_names, picture.image.coverage
    of_face = [names[i] if i < len(names) else "" for i in picture.image.facet_surface]
    return coverage @ np.array([n == "floor" for n in of_face]), coverage @ np.array(["block" in n for n in of_face])


def wrong_contacts(draw: Draw, picture: Picture) -> Stack:
    """A renderer's light on the floor is wrong at the feet of the blocks."""
    floor, block = _floor_and_blocks(picture)
    away = distance_transform_edt(block < 0.5)
    return np.broadcast_to(1 - 0.02 * np.exp(-away / draw.uniform(0.7, 2.5)) * floor, picture.signal.shape)


def wrong_feet(draw: Draw, picture: Picture) -> Stack:
    """A renderer's reflected light is wrong on both sides of the lines where blocks meet the floor."""
    floor, block = _floor_and_blocks(picture)
    away = np.where(floor > 0.5, distance_transform_edt(block < 0.5), distance_transform_edt(floor < 0.5))
    near = np.exp(-away / draw.uniform(0.7, 2.0)) * ((floor > 0) | (block > 0))
    return 1 - 0.05 * near * _reflected(picture)


def _reflected(picture: Picture) -> Stack:
    """(band, y, x) part of the light that was reflected before."""
    return (picture.signal - picture.direct) / np.maximum(picture.signal, 1e-9)


def soft_shadows(draw: Draw, picture: Picture) -> Stack:
    """A renderer's shadows on the walls are softer than those of the box."""
    irradiance, room = picture.direct / np.maximum(picture.reflectance, 1e-3), picture.room.astype(float)
    width = (0, *(2 * [draw.uniform(0.5, 1.2)]))
    even = gaussian_filter(irradiance * room, width, mode="nearest")
    even /= np.maximum(gaussian_filter(np.broadcast_to(room, irradiance.shape), width, mode="nearest"), 1e-3)
    changed = picture.signal - picture.direct + np.where(picture.room, even, irradiance) * picture.reflectance
    return np.where(picture.room, changed / np.maximum(picture.signal, 1e-9), 1.0)


def other_indirect(draw: Draw, picture: Picture) -> Stack:
    """All reflected light is off by one factor, which rises or falls with the band."""
    tilt = np.linspace(-1, 1, len(picture.signal))[:, None, None] * draw.normal(0, 0.3)
    return 1 + 0.02 * draw.choice([-1, 1]) * (1 + tilt) * _reflected(picture)


def coarse_patches(draw: Draw, picture: Picture) -> Stack:
    """A renderer's reflected light is that of coarse patches with an error each."""
    size, side = picture.room.shape[0], int(draw.integers(4, 9))
    coarse = draw.standard_normal((size // side + 1, size // side + 1))
    field = np.kron(coarse, np.ones((side, side)))[:size, :size]
    return 1 + 0.01 * _reflected(picture) * field


def lamp_of_points(draw: Draw, picture: Picture) -> Stack:
    """Direct light of few points on the lamp is wrong near it."""
    v = np.indices(picture.room.shape)[0] / len(picture.room)
    return 1 + 0.02 * (1 - _reflected(picture)) * np.exp(-v / draw.uniform(0.1, 0.4))


FLAWS: Mapping[str, Flaw] = {
    "none": Flaw(),
    "soft-creases": Flaw(light=soft_creases),
    "leaning-blocks": Flaw(scene=leaning_blocks),
    "tilted-walls": Flaw(scene=tilted_walls),
    "lamp-frame": Flaw(scene=lamp_frame),
    "uneven-paint": Flaw(light=uneven_paint),
    "smooth-field": Flaw(light=smooth_field),
    "caulk": Flaw(scene=caulk),
    "bulging-walls": Flaw(scene=bulging_walls),
    "astigmatism": Flaw(light=astigmatism),
    "old-flats": Flaw(light=old_flats),
    "sizes": Flaw(scene=sizes),
    "other-paints": Flaw(scene=other_paints, as_drawn=True),
    "contact": Flaw(light=wrong_contacts),
    "foot": Flaw(light=wrong_feet),
    "penumbra": Flaw(light=soft_shadows),
    "indirect": Flaw(light=other_indirect),
    "patches": Flaw(light=coarse_patches),
    "lamp-falloff": Flaw(light=lamp_of_points),
}
