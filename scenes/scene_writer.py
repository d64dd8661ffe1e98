"""Scene files written from scenes in memory."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from numpy.typing import NDArray

from .scene import Lamp, Material, Medium, Scene, Surface
from .scene_file import check_scene_file, files_of_scene
from .spectra import Spectrum

__all__ = ["write_scene"]


def write_scene(path: Path, scene: Scene) -> Path:
    """Write a scene as a scene file, with its meshes and textures next to it.

    Parameters
    ----------
    path
        A file that ends in .toml: a new one, or a scene file, which is replaced. Meshes are written as
        STEM-SURFACE.obj, textures as STEM-MATERIAL.npy.
    scene
        The scene. Quads and spheres are stated as such, other surfaces as meshes, with every digit.

    Returns
    -------
    Path
        The scene file; ``load_scene`` reads the same scene from it.

    Raises
    ------
    InputError
        If the path does not end in .toml, if a file of another kind would be replaced, or if a name is not one of
        scene files. If a lamp has a property that an effect states and no scene file.
    """
    if path.suffix != ".toml":
        raise InputError(path, f"the ending '{path.suffix}'", "a scene file, '.toml'")
    neighbours: dict[Path, bytes] = {}
    content: dict[str, Any] = {"format": "scene/1", "name": scene.name, "source": scene.source}
    content["lamp"] = [_lamp_table(lamp) for lamp in scene.lamps]
    content["material"] = {name: _material_table(path, item, neighbours) for name, item in scene.materials.items()}
    content["surface"] = [_surface_table(path, surface, neighbours) for surface in scene.surfaces]
    if scene.medium is not None:
        content["medium"] = _medium_table(scene.medium)
    check_scene_file(path, content)
    _require_own(path, neighbours)
    for file, data in {**neighbours, path: tomli_w.dumps(content).encode()}.items():
        with replacing(file) as temporary:
            temporary.write_bytes(data)
    return path


def _require_own(path: Path, neighbours: dict[Path, bytes]) -> None:
    """Raise InputError if a file would be replaced that does not belong to a scene."""
    hint = "Name another file, or move it away."
    replaceable: tuple[Path, ...] = ()
    if path.exists():
        try:
            replaceable = files_of_scene(path)
        except InputError:
            raise InputError(path, "a file that is no scene file", "a new file or a scene file", hint) from None
    for file, data in neighbours.items():
        if file.exists() and file not in replaceable and not (file.is_file() and file.read_bytes() == data):
            raise InputError(file, "a file that exists already", f"no such file, for '{path.name}'", hint)


def _spectrum(spectrum: Spectrum) -> float | dict[str, list[float]]:
    """Entry of a spectrum: a number for a constant, otherwise the table."""
    if spectrum.outside == "hold" and len(spectrum.values) == 1:
        return float(spectrum.values[0])
    return {"wavelength_nm": spectrum.wavelength_nm.tolist(), "values": spectrum.values.tolist()}


def _quads(surface: Surface) -> list[list[list[float]]] | None:
    """Quads whose halves are a surface's triangles; None if the mesh is no list of quads."""
    count = len(surface.vertices_mm) // 4
    halves = (np.array([[0, 1, 2], [0, 2, 3]])[None] + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
    if len(surface.vertices_mm) % 4 or not np.array_equal(surface.faces, halves):
        return None
    return surface.vertices_mm.reshape(count, 4, 3).tolist()


def _lamp_table(lamp: Lamp) -> dict[str, Any]:
    """Entry of a lamp; InputError for a property that scene files cannot state."""
    where = f"lamp '{lamp.surface.name}'"
    quads = _quads(lamp.surface)
    if quads is None:
        raise InputError(where, "triangles", "a lamp of quads, which a scene file states")
    if lamp.edge_ratio != 1.0 or lamp.exponent != 0.0:
        hint = "Write the scene without them, and add the effects of the lamp to a model."
        raise InputError(where, "an edge ratio or an exponent", "neither", hint)
    table: dict[str, Any] = {"name": lamp.surface.name, "quads_mm": quads, "radiance": _spectrum(lamp.radiance)}
    if lamp.reflects:
        table["reflectance"] = _spectrum(lamp.reflectance)
    if lamp.pattern is not None:
        table["pattern"] = lamp.pattern.tolist()
    return table


def _material_table(path: Path, material: Material, neighbours: dict[Path, bytes]) -> dict[str, Any]:
    """Entry of a material; its texture is added to the files next to the scene file."""
    if material.texture is not None:
        image, data = path.parent / f"{path.stem}-{material.name}.npy", io.BytesIO()
        np.save(data, material.texture.weights)
        neighbours[image] = data.getvalue()
        spectra = [_spectrum(spectrum) for spectrum in material.texture.spectra]
        return {"texture": {"image": image.name, "spectra": spectra}}
    table: dict[str, Any] = {"reflectance": _spectrum(material.reflectance)}
    if material.bsdf is not None:
        table["bsdf"] = dict(material.bsdf)
    return table


def _medium_table(medium: Medium) -> dict[str, Any]:
    """Entry of a medium."""
    return {
        "scattering_per_mm": _spectrum(medium.scattering_per_mm),
        "absorption_per_mm": _spectrum(medium.absorption_per_mm),
        "anisotropy": medium.anisotropy,
    }


def _surface_table(path: Path, surface: Surface, neighbours: dict[Path, bytes]) -> dict[str, Any]:
    """Entry of a surface; a mesh is added to the files next to the scene file."""
    table: dict[str, Any] = {"name": surface.name, "material": surface.material}
    quads = _quads(surface)
    if surface.ball:
        centre, radius = surface.sphere_mm
        table["sphere"] = {"center_mm": centre.tolist(), "radius_mm": radius}
    elif quads is not None and surface.texture_uv is None:
        table["quads_mm"] = quads
    else:
        mesh = path.parent / f"{path.stem}-{surface.name}.obj"
        neighbours[mesh] = _obj(surface).encode("ascii")
        table["mesh"] = mesh.name
    if surface.inside is not None:
        table["inside"] = _medium_table(surface.inside)
    return table


def _obj(surface: Surface) -> str:
    """Wavefront OBJ with every digit of the vertices, and of their texture coordinates if any."""

    def rows(letter: str, values: NDArray[np.float64]) -> list[str]:
        return [f"{letter} {' '.join(map(repr, row))}" for row in values.tolist()]

    lines = rows("v", surface.vertices_mm)
    if surface.texture_uv is not None:
        up = surface.texture_uv * [1.0, -1.0] + [0.0, 1.0]  # a mesh file's v runs upwards, a texture's rows downwards
        lines += rows("vt", up)
    corner = "{0}/{0}" if surface.texture_uv is not None else "{0}"
    lines += ["f " + " ".join(corner.format(index + 1) for index in face) for face in surface.faces.tolist()]
    return "\n".join([*lines, ""])
