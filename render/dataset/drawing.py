"""Boxes drawn from a recipe: scene, cameras, effects, and a record of every value.

Box n depends on the recipe, its seed and n alone. Boxes of one geometry share rooms, blocks, lamps' places, cameras and
the seed of the rendering.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Lamp, Material, Scene, Surface
from cboxlab.scenes.shapes import front_uv, plate_mesh, quad_mesh
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..chain import RenderSettings
from ..effects import catalogue, names_in
from ..model import Model, checked_effects
from .cameras import Rejected, drawn_cameras
from .distributions import Choice, numbers
from .paints import light_source, planck_light, reflectance_source
from .patterns import drawn_tiles, image_tiles, tiled
from .recipe import ANY, WALLS, BlockTable, PatternTable, Recipe, TextureTable
from .solids import Solid, any_meet, blocked_share, closed_mesh
from .textures import image_shares, noise_shares, side_surface, textured, wall_uv

__all__ = ["Box", "draw_box", "part_of"]

#: Draws of a geometry after which the recipe is refused.
ATTEMPTS = 500

#: Stream of random numbers of rooms, blocks, lamps' places and cameras; streams differ in this number alone.
_GEOMETRY = 0
#: Stream of paints, spectra, powers and effects.
_SPECTRA = 1
#: Stream of the seed of the rendering.
_RENDER = 2
#: Stream of the part of the data set.
_PART = 3

#: Square metres in a square millimetre.
_M2_PER_MM2 = 1e-6


@dataclass(frozen=True, eq=False)
class Box(FrozenMappings):
    """One drawn box."""

    #: Number of the box, from 0.
    number: int
    #: Scene and effects.
    model: Model
    #: Cameras by name, without the effects.
    cameras: dict[str, Camera]
    #: Seed of the rendering, the same for all boxes of one geometry.
    seed: int
    #: Part of the data set: train, validation or test.
    part: str
    #: Values that were drawn, ready for JSON.
    record: dict[str, Any]


class _Rectangle(NamedTuple):
    """Rectangle in the ceiling, mm."""

    x: float
    z: float
    width: float
    depth: float

    def apart(self, other: _Rectangle, gap: float) -> bool:
        """Whether another rectangle is at least a gap away along x or z."""
        dx = max(other.x - self.x - self.width, self.x - other.x - other.width)
        dz = max(other.z - self.z - self.depth, self.z - other.z - other.depth)
        return max(dx, dz) >= gap


@dataclass(frozen=True, eq=False)
class _Geometry(FrozenMappings):
    """Everything of a box but spectra, powers and effects."""

    #: (3,) width, height and depth of the room, mm.
    room: NDArray[np.float64]
    #: Paint, pattern or texture of each wall.
    walls: dict[str, str]
    #: (rows, columns) names of the tiles' paints, of each wall with a pattern.
    tiles: dict[str, NDArray[np.str_]]
    #: Solids with the paint, pattern or texture of each.
    solids: list[tuple[Solid, str]]
    #: (rows, columns) names of the tiles' paints by side, of each solid with a pattern by its index.
    solid_tiles: dict[int, dict[str, NDArray[np.str_]]]
    #: (rows, columns) shares of the second paint of each texture in use.
    textures: dict[str, NDArray[np.float64]]
    #: Lamps' rectangles, with the index of each one's table.
    lamps: list[tuple[_Rectangle, int]]
    #: Cameras by name.
    cameras: dict[str, Camera]


def _generator(recipe: Recipe, geometry: int, *purpose: int) -> np.random.Generator:
    """Random numbers of a geometry for one purpose."""
    return np.random.default_rng(np.random.SeedSequence(recipe.seed, spawn_key=(geometry, *purpose)))


def part_of(recipe: Recipe, number: int) -> str:
    """Part of the data set to which a box belongs, the same for all boxes of one geometry.

    Parameters
    ----------
    recipe
        The recipe.
    number
        Number of the box.

    Returns
    -------
    str
        "train", "validation" or "test".
    """
    u = _generator(recipe, number // recipe.boxes_per_geometry, _PART).random()
    if u < recipe.parts.train:
        return "train"
    return "validation" if u < recipe.parts.train + recipe.parts.validation else "test"


def draw_box(recipe: Recipe, number: int, folder: Path) -> Box:
    """Box of a number.

    Parameters
    ----------
    recipe
        The recipe.
    number
        Number of the box, from 0.
    folder
        Folder of the recipe, to which its files are relative.

    Returns
    -------
    Box
        The box.

    Raises
    ------
    InputError
        If every draw is rejected, or an effect does not fit its box.
    """
    index, variant = divmod(number, recipe.boxes_per_geometry)
    geometry, rejected = _accepted(recipe, index, folder)
    generator = _generator(recipe, index, _SPECTRA, variant)
    materials, paints = _materials(recipe, geometry, generator, folder)
    lamps, lights = _lamps(recipe, geometry, generator, folder)
    name = f"{recipe.name}, box {number}"
    surfaces = (*_walls(geometry), *_blocks(geometry))
    scene = Scene(name, surfaces, materials, lamps[0], f"drawn by seed {recipe.seed}", further_lamps=tuple(lamps[1:]))
    entries = _effects(recipe, scene, generator)
    effects = checked_effects(entries, scene, "recipe: effect", folder)
    seed = int(np.random.SeedSequence(recipe.seed, spawn_key=(index, _RENDER)).generate_state(1)[0])
    record = {
        "box": number,
        "geometry": index,
        "part": part_of(recipe, number),
        "rejected": dict(rejected),
        "room_mm": geometry.room.tolist(),
        "walls": geometry.walls,
        "tiles": {wall: tiles.tolist() for wall, tiles in geometry.tiles.items()},
        "blocks": [
            {
                "shape": "sphere" if solid.ball else "box" if solid.shape is None else "mesh",
                "center_mm": solid.centre_mm.tolist(),
                "size_mm": (2 * solid.half_mm).tolist(),
                "yaw_deg": solid.yaw_deg,
                "paint": paint,
                **_tile_record(geometry.solid_tiles.get(index)),
            }
            for index, (solid, paint) in enumerate(geometry.solids)
        ],
        "paints": paints,
        "lamps": lights,
        "cameras": {key: camera.parameters.tolist() for key, camera in geometry.cameras.items()},
        "effects": entries,
        "seed": seed,
    }
    model = Model(scene, effects, RenderSettings(seed=seed), name)
    return Box(number, model, geometry.cameras, seed, record["part"], record)


def _accepted(recipe: Recipe, index: int, folder: Path) -> tuple[_Geometry, Counter[str]]:
    """First draw of a geometry that is not rejected, and how often others were by reason."""
    generator, rejected = _generator(recipe, index, _GEOMETRY), Counter[str]()
    for _ in range(ATTEMPTS):
        try:
            return _geometry(recipe, generator, folder), rejected
        except Rejected as reason:
            rejected[str(reason)] += 1
    reasons = ", ".join(f"{count} times {reason}" for reason, count in rejected.most_common())
    raise InputError(
        "recipe",
        f"a distribution that cannot be drawn: all {ATTEMPTS} draws of geometry {index} were rejected ({reasons})",
        "boxes in which blocks and lamps fit",
        "Draw fewer or smaller blocks, or a larger room.",
    )


def _solid(
    table: BlockTable, recipe: Recipe, room: NDArray[np.float64], generator: np.random.Generator, folder: Path
) -> Solid:
    """One block on the floor of a room (3,), mm. Raises Rejected for one that does not fit."""
    shape = None
    if table.shape == "sphere":
        half = np.full(3, table.radius_mm.draw(generator))
    elif table.mesh is not None:
        shape = closed_mesh(table.mesh, folder, "recipe: block.mesh")
        half = np.ptp(shape[0], axis=0) * table.height_mm.draw(generator) / 2
    else:
        edges = (table.width_mm, table.height_mm, table.depth_mm)
        half = np.array([d.draw(generator) for d in edges]) / 2
    yaw = table.yaw_deg.draw(generator) if table.shape != "sphere" else 0.0
    solid = Solid(np.array([0.0, half[1], 0.0]), half, yaw, table.shape == "sphere", shape)
    low = solid.reach_mm + recipe.gap_mm
    free = room[[0, 2]] - 2 * low
    if free.min() < 0 or 2 * half[1] > room[1] - recipe.gap_mm:
        raise Rejected("a block is larger than the room")
    x, z = low + free * np.array([table.x.draw(generator), table.z.draw(generator)])
    return replace(solid, centre_mm=np.array([x, half[1], z]))


def _lamp_places(
    recipe: Recipe, room: NDArray[np.float64], generator: np.random.Generator
) -> list[tuple[_Rectangle, int]]:
    """Lamps in the ceiling, each with the index of its table.

    Raises Rejected for those that do not fit.
    """
    lamps: list[tuple[_Rectangle, int]] = []
    for index, lamp in enumerate(recipe.lamp):
        for _ in range(int(lamp.count.draw(generator))):
            size = np.array([lamp.width_mm.draw(generator), lamp.depth_mm.draw(generator)])
            free = room[[0, 2]] - 2 * recipe.gap_mm - size
            if free.min() < 0:
                raise Rejected("a lamp is larger than the ceiling")
            corner = recipe.gap_mm + free * np.array([lamp.x.draw(generator), lamp.z.draw(generator)])
            lamps.append((_Rectangle(*map(float, (*corner, *size))), index))
    if len(lamps) > 1 and not all(a.apart(b, 1.0) for i, (a, _) in enumerate(lamps) for b, _ in lamps[:i]):
        raise Rejected("lamps overlap")
    return lamps


def _require_room(
    recipe: Recipe, room: NDArray[np.float64], solids: list[Solid], lamps: list[tuple[_Rectangle, int]]
) -> None:
    """Raise Rejected for blocks that meet, and for lamps that blocks hide."""
    if any_meet(solids, recipe.gap_mm):
        raise Rejected("a block stands in another")
    for rectangle, _ in lamps:
        corner = np.array([rectangle.x, room[1], rectangle.z])
        if blocked_share(corner, np.array([rectangle.width, rectangle.depth]), solids) > recipe.most_blocked:
            raise Rejected("a lamp is hidden")


def _geometry(recipe: Recipe, generator: np.random.Generator, folder: Path) -> _Geometry:
    """One draw. Raises Rejected for one that does not fit."""
    sizes = recipe.room
    room = np.array([d.draw(generator) for d in (sizes.width_mm, sizes.height_mm, sizes.depth_mm)])
    walls = {wall: recipe.walls[wall].draw(generator) for wall in WALLS}  # type: ignore[index]
    patterns = {wall: recipe.pattern[name] for wall, name in walls.items() if name in recipe.pattern}
    tiles = {wall: _tiles(pattern, generator, folder) for wall, pattern in patterns.items()}
    solids: list[tuple[Solid, str]] = []
    solid_tiles = {}
    for table in recipe.block:
        for _ in range(int(table.count.draw(generator))):
            solid = _solid(table, recipe, room, generator, folder)
            paint = table.paint.draw(generator)
            if paint in recipe.pattern:
                solid_tiles[len(solids)] = _side_tiles(recipe.pattern[paint], generator, folder)
            solids.append((solid, paint))
    lamps = _lamp_places(recipe, room, generator)
    _require_room(recipe, room, [solid for solid, _ in solids], lamps)
    cameras: dict[str, Camera] = {}
    for camera in recipe.camera:
        cameras.update(drawn_cameras(camera, room, generator))
    used = {*walls.values(), *(paint for _, paint in solids)}
    textures = {name: _shares(table, generator, folder) for name, table in recipe.texture.items() if name in used}
    return _Geometry(room, walls, tiles, solids, solid_tiles, textures, lamps, cameras)


def _tiles(pattern: PatternTable, generator: np.random.Generator, folder: Path) -> NDArray[np.str_]:
    """(rows, columns) names of the paints of a pattern's tiles."""
    if pattern.image is not None:
        index = image_tiles(pattern.image, len(pattern.paints), folder, "recipe: pattern.image")
    else:
        size = int(pattern.rows.draw(generator)), int(pattern.columns.draw(generator))
        index = drawn_tiles(pattern.kind, size, len(pattern.paints), generator)
    return np.array(pattern.paints)[index]


def _shares(texture: TextureTable, generator: np.random.Generator, folder: Path) -> NDArray[np.float64]:
    """(rows, columns) shares of a texture's second paint."""
    if texture.image is not None:
        return image_shares(texture.image, folder, "recipe: texture.image")
    return noise_shares(texture.features.draw(generator), texture.contrast.draw(generator), generator)


def _side_tiles(pattern: PatternTable, generator: np.random.Generator, folder: Path) -> dict[str, NDArray[np.str_]]:
    """Names of the tiles' paints of each side of a block; the hidden bottom is plain."""
    sides = {side: _tiles(pattern, generator, folder) for side in ("front", "right", "back", "left", "top")}
    return {**sides, "bottom": np.array([[pattern.paints[0]]])}


def _tile_record(sides: dict[str, NDArray[np.str_]] | None) -> dict[str, Any]:
    """Record of the tiles of a block's sides; empty for one without a pattern."""
    return {} if sides is None else {"tiles": {side: tiles.tolist() for side, tiles in sides.items()}}


def _walls(geometry: _Geometry) -> list[Surface]:
    """Walls of the room, lit from inside; the ceiling has holes for the lamps."""
    w, h, d = geometry.room
    corners = {
        "floor": [[w, 0, 0], [0, 0, 0], [0, 0, d], [w, 0, d]],
        "ceiling": [[w, h, 0], [w, h, d], [0, h, d], [0, h, 0]],
        "back": [[w, 0, d], [0, 0, d], [0, h, d], [w, h, d]],
        "right": [[0, 0, d], [0, 0, 0], [0, h, 0], [0, h, d]],
        "left": [[w, 0, 0], [w, 0, d], [w, h, d], [w, h, 0]],
    }
    holes = [_lamp_quad(rectangle, h) for rectangle, _ in geometry.lamps]
    meshes = {name: quad_mesh(quad) for name, quad in corners.items()}
    try:
        meshes["ceiling"] = plate_mesh(corners["ceiling"], holes)
    except ValueError as fault:
        raise InputError("recipe: lamp", f"lamps that no straight line separates ({fault})", "lamps apart") from None
    walls: list[Surface] = []
    for name, mesh in meshes.items():
        if (tiles := geometry.tiles.get(name)) is not None:
            walls += tiled(name, [(np.array(corners[name], float), tiles)])
        else:
            paint, at = geometry.walls[name], np.array(corners[name], float)
            uv = wall_uv(mesh[0], at) if paint in geometry.textures else None
            walls.append(Surface(name, paint, *mesh, texture_uv=uv))
    return walls


def _lamp_quad(rectangle: _Rectangle, height: float) -> NDArray[np.float64]:
    """(4, 3) corners of a lamp that shines downwards."""
    x0, z0, x1, z1 = rectangle.x, rectangle.z, rectangle.x + rectangle.width, rectangle.z + rectangle.depth
    return np.array([[x1, height, z0], [x1, height, z1], [x0, height, z1], [x0, height, z0]])


def _blocks(geometry: _Geometry) -> list[Surface]:
    """Blocks and spheres, numbered from 1."""
    surfaces: list[Surface] = []
    for index, (solid, paint) in enumerate(geometry.solids):
        name = f"{index + 1}-{_kind(solid)}"
        if index in geometry.solid_tiles:
            corners, tiles = solid.sides_mm, geometry.solid_tiles[index]
            surfaces += tiled(name, [(corners[side], tiles[side]) for side in tiles])
        elif paint not in geometry.textures:
            surfaces.append(Surface(name, paint, *solid.mesh, ball=solid.ball))
        elif solid.ball or solid.shape is not None:
            vertices, faces = solid.mesh
            uv = front_uv(solid.inside(vertices) / solid.half_mm)
            surfaces.append(Surface(name, paint, vertices, faces, texture_uv=uv, ball=solid.ball))
        else:
            surfaces.append(side_surface(name, paint, list(solid.sides_mm.values())))
    return surfaces


def _kind(solid: Solid) -> str:
    """Word for a solid in the name of its surface."""
    return "ball" if solid.ball else "block" if solid.shape is None else "mesh"


def _materials(
    recipe: Recipe, geometry: _Geometry, generator: np.random.Generator, folder: Path
) -> tuple[dict[str, Material], dict[str, Any]]:
    """Materials in use by the names of their paints, and a record of them."""
    used = {*geometry.walls.values(), *(paint for _, paint in geometry.solids)}
    every = [*geometry.tiles.values(), *(tiles for each in geometry.solid_tiles.values() for tiles in each.values())]
    used |= {str(paint) for tiles in every for paint in np.unique(tiles)}
    parts = {paint for name in geometry.textures for paint in recipe.texture[name].paints}
    spectra_of, materials, record = {}, {}, {}
    for name, table in recipe.paint.items():
        source = table.reflectance.draw(generator)
        spectra = reflectance_source(source, folder, f"recipe: paint.{name}.reflectance")
        label, reflectance = spectra[int(generator.integers(len(spectra)))]
        spectrum = reflectance()
        most = float(spectrum.values.max())
        scale = min(table.scale.draw(generator), 1 / most if most > 0 else np.inf)
        spectra_of[name] = spectrum.scaled(scale)
        if name in used:
            materials[name] = Material(name, spectra_of[name])
        if name in used | parts:
            record[name] = {"reflectance": label, "scale": scale}
    for name, shares in geometry.textures.items():
        first, second = recipe.texture[name].paints
        materials[name] = textured(name, shares, (spectra_of[first], spectra_of[second]))
    return materials, record


def _lamps(
    recipe: Recipe, geometry: _Geometry, generator: np.random.Generator, folder: Path
) -> tuple[list[Lamp], list[dict[str, Any]]]:
    """Lamps, and a record of each."""
    lamps, record = [], []
    for number, (rectangle, index) in enumerate(geometry.lamps, start=1):
        table = recipe.lamp[index]
        source, power = table.spectrum.draw(generator), table.power_w.draw(generator)
        temperature = None if table.temperature_k is None else table.temperature_k.draw(generator)
        relative = light_source(source, folder, f"recipe: lamp[{index}].spectrum")
        if relative is None:
            relative = planck_light(float(temperature or 0.0))
        area_m2 = rectangle.width * rectangle.depth * _M2_PER_MM2
        total = float(np.trapezoid(relative.at(WAVELENGTH_NM), WAVELENGTH_NM))
        radiance = relative.scaled(power / (np.pi * area_m2 * total))
        quad = quad_mesh(_lamp_quad(rectangle, float(geometry.room[1])))
        name = "light" if len(geometry.lamps) == 1 else f"light-{number}"
        reflectance = Spectrum(np.array([550.0]), np.array([table.reflectance.draw(generator)]))
        lamps.append(Lamp(Surface(name, name, *quad), radiance, reflectance=reflectance))
        entry = {"spectrum": source, "power_w": power, "rectangle_mm": list(rectangle)}
        record.append(entry | ({"temperature_k": temperature} if source == "planck" else {}))
    return lamps, record


def _effects(recipe: Recipe, scene: Scene, generator: np.random.Generator) -> list[dict[str, Any]]:
    """Entries of the effects of a box, as in a model file."""
    entries = []
    for table in recipe.effect:
        present = generator.random() < table.probability
        entry: dict[str, Any] = {"id": table.id}
        for name, value in table.parameters.items():
            entry[name] = _drawn_value(table.id, name, value, scene, generator)
        if present:
            entries.append(entry)
    return entries


def _drawn_value(
    identifier: str, name: str, value: object, scene: Scene, generator: np.random.Generator
) -> str | float:
    """Value of an effect's parameter: a number, a name, or a name of the box where it is "any"."""
    texts = value if isinstance(value, list) else [value]
    if not all(isinstance(text, str) for text in texts):
        try:
            return numbers(value).draw(generator)
        except ValueError as fault:
            raise InputError(f"recipe: effect {identifier}.{name}", repr(value), str(fault)) from None
    text = Choice(tuple(map(str, texts))).draw(generator)
    effect = catalogue().get(identifier)
    kind = next((p.kind for p in effect.parameters if p.name == name), None) if effect else None
    possible = names_in(scene).get(kind, ()) if kind else ()
    if text == ANY and possible:
        return str(possible[int(generator.integers(len(possible)))])
    return text
