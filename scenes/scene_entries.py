"""Tables of a scene file as pydantic models, and the triangles that they describe."""

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
    front_uv,
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

#: Coordinate, mm; beyond 1 km a scene file is in another unit.
Length = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
#: Length above 0, mm.
Positive = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
#: Point x, y, z, mm.
Point = Annotated[list[Length], Field(min_length=3, max_length=3)]
#: Four corners of a quad, counter-clockwise from the lit side.
Quad = Annotated[list[Point], Field(min_length=4, max_length=4)]
#: Name of a surface or lamp; it may become a part of a file name.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=80)]


class _Table(BaseModel):
    """Table without unknown keys and without conversion of types."""

    model_config = ConfigDict(extra="forbid", strict=True)


class SpectrumTable(_Table):
    """Spectrum in the scene file itself, linear between its wavelengths."""

    wavelength_nm: list[float]
    values: list[float]


class BoxEntry(_Table):
    """Block of a size about a centre, turned about +y, right-handed."""

    center_mm: Point
    size_mm: Annotated[list[Positive], Field(min_length=3, max_length=3)]
    yaw_deg: Annotated[float, Field(allow_inf_nan=False)] = 0.0


class SphereEntry(_Table):
    """Sphere of a radius about a centre."""

    center_mm: Point
    radius_mm: Positive


class MediumEntry(_Table):
    """Medium: its coefficients are spectra as `_spectrum` of scene_file reads them."""

    scattering_per_mm: Any = 0.0
    absorption_per_mm: Any = 0.0
    anisotropy: Annotated[float, Field(gt=-1, lt=1, allow_inf_nan=False)] = 0.0


class SurfaceEntry(_Table):
    """Surface with exactly one shape: quads, a box, a sphere or a mesh file."""

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
    """Texture: an image, and a spectrum for each channel."""

    image: str
    spectra: Annotated[list[Any], Field(min_length=1, max_length=64)]


class MaterialEntry(_Table):
    """Material: a reflectance, with or without a BSDF, or a texture."""

    reflectance: Any = None
    bsdf: dict[str, Any] | None = None
    texture: TextureEntry | None = None


class LampEntry(_Table):
    """Lamp of one or more quads."""

    name: Name = "light"
    quads_mm: Annotated[list[Quad], Field(min_length=1)]
    radiance: Any
    reflectance: Any = 0.0
    pattern: list[list[Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]]] | None = None


class SceneFile(_Table):
    """Content of a scene file of format "scene/1", described in docs/scene-format.md."""

    format: Literal["scene/1"]
    name: Annotated[str, Field(min_length=1)]
    source: str = ""
    surface: Annotated[list[SurfaceEntry], Field(min_length=1)]
    material: dict[str, MaterialEntry]
    lamp: Annotated[list[LampEntry], Field(min_length=1)]
    medium: MediumEntry | None = None

    @field_validator("lamp", mode="before")
    @classmethod
    def _several(cls, value: Any) -> Any:
        """List of one lamp for the single table ``[lamp]``."""
        return value if isinstance(value, list) else [value]


def lamp_mesh(entry: LampEntry, where: str) -> Mesh:
    """Triangles of a lamp.

    Parameters
    ----------
    entry
        The lamp's table.
    where
        File and key for errors.

    Returns
    -------
    Mesh
        Vertices (n, 3), mm, and faces (m, 3).

    Raises
    ------
    InputError
        If a quad crosses itself.
    """
    return _quads(entry.quads_mm, where)


def lamp_pattern(entry: LampEntry, where: str) -> NDArray[np.float64] | None:
    """Pattern of a lamp, scaled to mean 1.

    Parameters
    ----------
    entry
        The lamp's table.
    where
        File and key for errors.

    Returns
    -------
    NDArray or None
        (rows, columns) relative radiance; None without a pattern.

    Raises
    ------
    InputError
        If the lamp has several quads, or the rows differ in length, are empty or hold only zeros.
    """
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
    """Weights of a texture's spectra, one for each channel of its image.

    With one spectrum more than channels, the last weight is 1 minus the sum of the channels.

    Parameters
    ----------
    entry
        The texture's table.
    folder
        Folder of the scene file; the image must lie inside.
    where
        File and key for errors.

    Returns
    -------
    NDArray
        (rows, columns, spectra) weights.

    Raises
    ------
    InputError
        If the image cannot be read, or the number of spectra fits neither case.
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
        actual = f"{len(entry.spectra)} spectra for {count} channel{'s' if count > 1 else ''}"
        raise InputError(f"{where}.spectra", actual, expected)
    return np.concatenate([channels, 1 - channels.sum(axis=2, keepdims=True)], axis=2)


def surface_mesh(entry: SurfaceEntry, lamps: list[LampEntry], folder: Path, where: str) -> Mesh:
    """Triangles of a surface.

    Parameters
    ----------
    entry
        The surface's table.
    lamps
        All lamps. Those in the surface's plane need a hole in it.
    folder
        Folder of the scene file; a mesh file must lie inside.
    where
        File and key for errors.

    Returns
    -------
    Mesh
        Vertices (n, 3), mm, and faces (m, 3).

    Raises
    ------
    InputError
        If the surface has no shape or several, a mesh file cannot be read, a quad crosses itself, or a hole does not
        fit its lamp.
    """
    shapes = [key for key in ("quads_mm", "box", "sphere", "mesh") if getattr(entry, key) is not None]
    if len(shapes) != 1:
        raise InputError(where, " and ".join(shapes) or "no shape", "exactly one of quads_mm, box, sphere, mesh")
    for key, shape in (("hole", "quads_mm"), ("unit_mm", "mesh")):
        if key in entry.model_fields_set and shapes != [shape]:
            raise InputError(f"{where}.{key}", f"'{key}' with '{shapes[0]}'", f"'{key}' only with '{shape}'")
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
    lamp_by_name = {lamp.name: lamp for lamp in lamps}
    for name in holes:
        if name not in lamp_by_name:
            names = ", ".join(f"'{lamp}'" for lamp in lamp_by_name)
            expected = f"the lamp's name, {names}" if len(lamps) == 1 else f"one of the lamps' names, {names}"
            raise InputError(f"{where}.hole", f"'{name}'", expected)
    for lamp in lamps:
        for quad, light in product(quads, lamp.quads_mm):
            if lamp.name not in holes and _ring_or_none(quad, light):
                required = [*holes, lamp.name]
                hint = f'add hole = "{lamp.name}"' if len(required) == 1 else f"hole = {required}".replace("'", '"')
                raise InputError(where, "the lamp in this surface's plane", "a hole for the lamp", hint)
    if not holes:
        return _quads(quads, where)
    return _with_holes(quads, [quad for name in holes for quad in lamp_by_name[name].quads_mm], where)


def surface_uv(entry: SurfaceEntry, folder: Path, where: str) -> NDArray[np.float64]:
    """Texture coordinates of the vertices of a surface.

    The corners of every quad, in their order, have (0, 0), (1, 0), (1, 1), (0, 1). A mesh file states its coordinates;
    v runs upwards there, and downwards in a texture. A sphere has those of ``front_uv``.

    Parameters
    ----------
    entry
        The surface's table.
    folder
        Folder of the scene file; a mesh file must lie inside.
    where
        File and key for errors.

    Returns
    -------
    NDArray
        (n, 2) coordinates u, v of the vertices of ``surface_mesh``.

    Raises
    ------
    InputError
        If the shape has no texture coordinates.
    """
    expected = "quads_mm without a hole, a sphere, or a mesh that has texture coordinates"
    if entry.mesh is not None:
        uv = file_uv(path_inside(folder, entry.mesh, f"{where}.mesh"))
        if uv is None:
            raise InputError(f"{where}.mesh", "a mesh without texture coordinates", expected)
        return np.column_stack([uv[:, 0], 1 - uv[:, 1]])
    if entry.sphere is not None:
        vertices, _ = sphere_mesh(entry.sphere.center_mm, entry.sphere.radius_mm)
        return front_uv(vertices - np.asarray(entry.sphere.center_mm, float))
    if entry.quads_mm is None or entry.hole is not None:
        shape = "a hole" if entry.hole is not None else "a box"
        raise InputError(f"{where}.material", f"a texture on {shape}", expected)
    return np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (len(entry.quads_mm), 1))


def _quads(quads: list[Quad], where: str) -> Mesh:
    """Triangles of several quads."""
    return joined([_quad(quad, f"{where}.quads_mm[{index}]") for index, quad in enumerate(quads)])


def _quad(quad: list[Point], where: str) -> Mesh:
    """Triangles of a quad; InputError if it crosses itself or is not convex."""
    vertices, faces = quad_mesh(quad)
    first, second = (vector_area(vertices[face]) for face in faces)
    if first @ second < 0:
        hint = "list the corners in their order around the quad"
        raise InputError(where, "a quad that crosses itself or folds back", "a convex quad", hint)
    return vertices, faces


def _with_holes(quads: list[Quad], lamp_quads: list[Quad], where: str) -> Mesh:
    """Triangles of the quads, with the lamps' quads cut out."""
    lights_by_quad: list[list[Quad]] = [[] for _ in quads]
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
            lights_by_quad[index].append(light)
            break
        else:
            expected = "each lamp quad in the plane of this surface and inside a quad of it"
            raise InputError(f"{where}.hole", f"no quad that contains the lamp ({reasons[-1]})", expected)
    meshes = []
    for index, (quad, lights) in enumerate(zip(quads, lights_by_quad, strict=True)):
        key = f"{where}.quads_mm[{index}]"
        try:
            meshes.append(plate_mesh(quad, lights) if lights else _quad(quad, key))
        except ValueError as error:
            expected, hint = (
                "lamps that straight lines along their edges separate",
                "divide the quad between them",
            )
            raise InputError(key, f"{len(lights)} lamps ({error})", expected, hint) from None
    return joined(meshes)


def _ring_or_none(quad: list[Point], light: list[Point]) -> Mesh | None:
    """Triangles of a quad with a lamp's hole; None if the lamp is not in the quad."""
    try:
        return ring_mesh(quad, light)
    except ValueError:
        return None
