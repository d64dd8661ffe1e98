"""The tables of a scene file as pydantic models, and the triangles that they describe."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside, referred
from cboxlab.utils.input_files import read_channels
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator

from .shapes import (
    Mesh,
    box_mesh,
    file_mesh,
    file_uv,
    joined,
    plate_mesh,
    quad_mesh,
    ring_mesh,
    sphere_mesh,
    vector_area,
)

__all__ = [
    "LampEntry",
    "MaterialEntry",
    "MediumEntry",
    "SceneFile",
    "SpectrumTable",
    "SurfaceEntry",
    "lamp_mesh",
    "lamp_pattern",
    "surface_mesh",
    "surface_uv",
    "texture_weights",
]

Length = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
Point = Annotated[list[Length], Field(min_length=3, max_length=3)]
Quad = Annotated[list[Point], Field(min_length=4, max_length=4)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=80)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class SpectrumTable(_Table):
    wavelength_nm: list[float]
    values: list[float]


class BoxEntry(_Table):
    center_mm: Point
    size_mm: Annotated[list[Positive], Field(min_length=3, max_length=3)]
    yaw_deg: Annotated[float, Field(allow_inf_nan=False)] = 0.0


class SphereEntry(_Table):
    center_mm: Point
    radius_mm: Positive


class MediumEntry(_Table):
    scattering_per_mm: Any = 0.0
    absorption_per_mm: Any = 0.0
    anisotropy: Annotated[float, Field(gt=-1, lt=1, allow_inf_nan=False)] = 0.0


class SurfaceEntry(_Table):
    name: Name
    material: str
    quads_mm: Annotated[list[Quad], Field(min_length=1)] | None = None
    box: BoxEntry | None = None
    sphere: SphereEntry | None = None
    mesh: str | None = None
    unit_mm: Positive = 1.0
    hole: str | list[str] | None = None
    inside: MediumEntry | None = None


class TextureEntry(_Table):
    image: str
    spectra: Annotated[list[Any], Field(min_length=1, max_length=64)]


class MaterialEntry(_Table):
    reflectance: Any = None
    bsdf: dict[str, Any] | None = None
    texture: TextureEntry | None = None


class LampEntry(_Table):
    name: Name = "light"
    quads_mm: Annotated[list[Quad], Field(min_length=1)]
    radiance: Any
    reflectance: Any = 0.0
    pattern: list[list[Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]]] | None = None


class SceneFile(_Table):
    format: Literal["scene/1"]
    name: Annotated[str, Field(min_length=1)]
    source: str = ""
    surface: Annotated[list[SurfaceEntry], Field(min_length=1)]
    material: dict[str, MaterialEntry]
    lamp: Annotated[list[LampEntry], Field(min_length=1)]
    medium: MediumEntry | None = None

    @field_validator("lamp", mode="before")
    @classmethod
    def _several(cls, given: Any) -> Any:
        """``[lamp]``, one table, as a list of it."""
        return given if isinstance(given, list) else [given]


def lamp_mesh(entry: LampEntry, where: str) -> Mesh:
    """The triangles of the lamp. Raises InputError (at ``where``) for a quad that crosses itself."""
    return _quads(entry.quads_mm, where)


def lamp_pattern(entry: LampEntry, where: str) -> NDArray[np.float64] | None:
    """The lamp's pattern (rows, columns), scaled to mean 1, or None. Raises InputError for an invalid table."""
    if entry.pattern is None:
        return None
    table = f"{where}.pattern"
    if len(entry.quads_mm) != 1:
        raise InputError(table, f"a lamp of {len(entry.quads_mm)} quads", "a lamp of one quad")
    if not entry.pattern or len({len(row) for row in entry.pattern}) != 1 or not entry.pattern[0]:
        raise InputError(table, "rows of different lengths, or none", "rows of the same length")
    values = np.array(entry.pattern, float)
    if values.max() == 0:
        raise InputError(table, "only zeros", "a cell above 0")
    return values / values.mean()


def texture_weights(entry: TextureEntry, folder: Path, where: str) -> NDArray[np.float64]:
    """(rows, columns, spectra) of a texture: the picture's channels, and what they leave of 1 for one spectrum more.

    Raises InputError (at ``where``) for a picture that cannot be read, and another number of spectra.
    """
    path = path_inside(folder, entry.image, f"{where}.image")
    try:
        channels = read_channels(path)
    except InputError as error:
        raise referred(error, f"{where}.image") from None
    count = channels.shape[2]
    if len(entry.spectra) == count:
        return channels
    if len(entry.spectra) != count + 1:
        expected = f"{count}, or {count + 1} where the last one takes what the channels leave of 1"
        found = f"{len(entry.spectra)} spectra for {count} channel{'s' if count > 1 else ''}"
        raise InputError(f"{where}.spectra", found, expected)
    return np.concatenate([channels, 1 - channels.sum(axis=2, keepdims=True)], axis=2)


def surface_mesh(entry: SurfaceEntry, lamps: list[LampEntry], folder: Path, where: str) -> Mesh:
    """The triangles of a surface. Raises InputError (at ``where``) for a shape that cannot be built."""
    given = [key for key in ("quads_mm", "box", "sphere", "mesh") if getattr(entry, key) is not None]
    if len(given) != 1:
        raise InputError(where, " and ".join(given) or "no shape", "exactly one of quads_mm, box, sphere, mesh")
    for key, shape in (("hole", "quads_mm"), ("unit_mm", "mesh")):
        if key in entry.model_fields_set and given != [shape]:
            raise InputError(f"{where}.{key}", f"'{key}' with '{given[0]}'", f"'{key}' only with '{shape}'")
    if entry.box is not None:
        return box_mesh(entry.box.center_mm, entry.box.size_mm, entry.box.yaw_deg)
    if entry.sphere is not None:
        return sphere_mesh(entry.sphere.center_mm, entry.sphere.radius_mm)
    if entry.mesh is not None:
        path = path_inside(folder, entry.mesh, f"{where}.mesh")
        try:
            return file_mesh(path, entry.unit_mm)
        except InputError as error:
            raise referred(error, f"{where}.mesh") from None
    quads = entry.quads_mm or []
    holes = [entry.hole] if isinstance(entry.hole, str) else entry.hole or []
    known = {lamp.name: lamp for lamp in lamps}
    for name in holes:
        if name not in known:
            names = ", ".join(f"'{one}'" for one in known)
            expected = f"the lamp's name, {names}" if len(lamps) == 1 else f"one of the lamps' names, {names}"
            raise InputError(f"{where}.hole", f"'{name}'", expected)
    for lamp in lamps:
        for quad, light in product(quads, lamp.quads_mm):
            if lamp.name not in holes and _ring_or_none(quad, light):
                named = [*holes, lamp.name]
                hint = f'add hole = "{lamp.name}"' if len(named) == 1 else f"hole = {named}".replace("'", '"')
                raise InputError(where, "the lamp in this surface's plane", "a hole for the lamp", hint)
    if not holes:
        return _quads(quads, where)
    return _with_holes(quads, [quad for name in holes for quad in known[name].quads_mm], where)


def surface_uv(entry: SurfaceEntry, folder: Path, where: str) -> NDArray[np.float64]:
    """(n, 2) texture coordinates of the vertices of a surface that ``surface_mesh`` built.

    Those of the corners of every quad, in their order, are (0, 0), (1, 0), (1, 1), (0, 1); a mesh brings its own, whose
    v runs upwards in the image. Raises InputError (at ``where``) for a shape without any.
    """
    expected = "quads_mm without a hole, or a mesh with texture coordinates of its own"
    if entry.mesh is not None:
        found = file_uv(path_inside(folder, entry.mesh, f"{where}.mesh"))
        if found is None:
            raise InputError(f"{where}.mesh", "a mesh without texture coordinates", expected)
        return np.column_stack([found[:, 0], 1 - found[:, 1]])
    if entry.quads_mm is None or entry.hole is not None:
        shape = "a hole" if entry.hole is not None else "a box" if entry.box is not None else "a sphere"
        raise InputError(f"{where}.material", f"a texture on {shape}", expected)
    return np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (len(entry.quads_mm), 1))


def _quads(quads: list[Quad], where: str) -> Mesh:
    return joined([_quad(quad, f"{where}.quads_mm[{index}]") for index, quad in enumerate(quads)])


def _quad(quad: list[Point], where: str) -> Mesh:
    vertices, faces = quad_mesh(quad)
    first, second = (vector_area(vertices[face]) for face in faces)
    if first @ second < 0:
        hint = "list the corners in their order around the quad"
        raise InputError(where, "a quad that crosses itself or folds back", "a convex quad", hint)
    return vertices, faces


def _with_holes(quads: list[Quad], lamp_quads: list[Quad], where: str) -> Mesh:
    """The quads with the lamps' quads cut out."""
    own: list[list[Quad]] = [[] for _ in quads]
    for light in lamp_quads:
        reasons = ["there is none"]
        for index, quad in enumerate(quads):
            try:
                ring_mesh(quad, light)
            except ValueError as error:
                reasons.append(f"quads_mm[{index}]: {error}")
                continue
            if vector_area(quad) @ vector_area(light) < 0:
                hint = "reverse the order of the lamp's corners"
                expected = "a lamp facing the same way as the surface"
                raise InputError(f"{where}.hole", "a lamp facing backwards", expected, hint)
            own[index].append(light)
            break
        else:
            expected = "each lamp quad in the plane of this surface and inside a quad of it"
            raise InputError(f"{where}.hole", f"no quad that contains the lamp ({reasons[-1]})", expected)
    meshes = []
    for index, (quad, lights) in enumerate(zip(quads, own, strict=True)):
        place = f"{where}.quads_mm[{index}]"
        try:
            meshes.append(plate_mesh(quad, lights) if lights else _quad(quad, place))
        except ValueError as error:
            expected, hint = (
                "lamps that straight lines along their edges part",
                "divide the quad between them",
            )
            raise InputError(place, f"{len(lights)} lamps ({error})", expected, hint) from None
    return joined(meshes)


def _ring_or_none(quad: list[Point], light: list[Point]) -> Mesh | None:
    try:
        return ring_mesh(quad, light)
    except ValueError:
        return None
