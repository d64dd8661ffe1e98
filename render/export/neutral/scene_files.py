"""Renderer-neutral files of an export: scene, camera, meshes, spectra, rays, surface map."""

from __future__ import annotations

import csv
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.scenes.scene import Surface
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_channels, read_json_object, require_regular_file
from cboxlab.utils.limits import MAX_PACKED_BYTES, require_size
from numpy.typing import NDArray
from PIL import Image

from ...image import LAMP, NOTHING
from ...visibility import build_tracer, facet_coverage
from .camera_file import camera_entry
from .exported import Exported, ExportedLamp, ExportSettings, Layout, pixel_means, subpixel_rays

__all__ = ["has_export", "mesh_path", "rays_path", "read_layout", "read_surfaces", "read_warp", "write_neutral"]

#: Value of the surface map (8 bits) where a pixel sees the lamp: the largest but one.
_LAMP_PIXEL = 254
#: Value of the surface map where a pixel sees no surface: the largest.
_EMPTY_PIXEL = 255
#: Least covered part of a pixel for a surface: half, so that the pixel's centre lies on it in most cases.
_MIN_COVERAGE = 0.5

_CONVENTIONS = {
    "lengths": "mm; right-handed axes",
    "spectra": "linear between samples; a reflectance keeps its end values beyond its table, the lamp is zero there",
    "radiance": "W m^-2 sr^-1 nm^-1",
    "surfaces": "Lambertian on the side from which corners run counter-clockwise, black on the other",
    "balls": "a surface with a sphere is that sphere; its mesh of the same area carries the sphere's normals",
    "lamp": "emits the same radiance in all directions of its counter-clockwise side, and reflects there by Lambert's "
    "law",
    "pixels": "a pixel's value is the mean over its square (box filter); rows from the top",
    "film": "a pinhole at the camera's position without distortion: film pixel (column, row) is centred on the "
    "direction x = low_x + (column + 0.5) / scale, y = low_y + (row + 0.5) / scale, 1 in camera axes (x right, y down, "
    "z forward); where the camera has distortion, warp.npz takes film pixels to camera pixels",
    "rays": "little-endian float32, origin then unit direction, (row, column) of subpixels, one file for each batch; "
    "a pixel is the mean of its subpixels x subpixels rays",
    "surface_map": "index into surfaces; 254 the lamp, 255 nothing",
}


def mesh_path(surface: Surface) -> str:
    """Path of a surface's mesh.

    Parameters
    ----------
    surface
        Surface of the scene, or of a lamp.

    Returns
    -------
    str
        Path relative to the export.
    """
    return f"meshes/{surface.name}.ply"


def rays_path(batch: int) -> str:
    """Path of a batch's ray file.

    Parameters
    ----------
    batch
        Number of the batch, from 0.

    Returns
    -------
    str
        Path relative to the export.
    """
    return f"rays-{batch}.f32"


def write_neutral(folder: Path, exported: Exported) -> None:
    """Write the renderer-neutral files.

    Parameters
    ----------
    folder
        An empty folder.
    exported
        The export.

    Raises
    ------
    InputError
        If the scene has more surfaces than a map of 8 bits can hold, or a pixel has no ray.
    """
    scene, settings = exported.scene, exported.settings
    if len(scene.surfaces) >= _LAMP_PIXEL:
        raise InputError(f"scene {scene.name}", f"{len(scene.surfaces)} surfaces", f"fewer than {_LAMP_PIXEL}")
    for name in ("meshes", "spectra"):
        (folder / name).mkdir()
    for surface in scene.all_surfaces:
        (folder / mesh_path(surface)).write_text(_ply(surface), encoding="ascii")
    for name, material in scene.materials.items():
        _write_spectrum(folder / "spectra" / f"material-{name}.csv", material.reflectance, "reflectance")
    for lamp in exported.lamps:
        radiance, reflectance = (folder / name for name in _lamp_spectra(lamp))
        _write_spectrum(radiance, lamp.lamp.radiance, "radiance")
        _write_spectrum(reflectance, lamp.lamp.reflectance, "reflectance")
    _write_channels(folder / "spectra" / "channels.csv", exported)
    for batch in range(settings.batches):
        (folder / rays_path(batch)).write_bytes(subpixel_rays(exported, batch).tobytes())
    means = pixel_means(exported)
    if means is not None:
        np.savez_compressed(folder / "warp.npz", row=means[0], column=means[1], weight=means[2])
    Image.fromarray(_surface_map(exported)).save(folder / "surfaces.png")
    (folder / "camera.json").write_text(json.dumps(camera_entry(exported.camera), indent=1) + "\n", encoding="utf-8")
    (folder / "scene.json").write_text(json.dumps(_entry(exported), indent=1) + "\n", encoding="utf-8")


def has_export(folder: Path, exported: Exported) -> bool:
    """Whether a folder is an export of the same scene, camera and settings.

    Parameters
    ----------
    folder
        Any path.
    exported
        The export that the folder may hold.

    Returns
    -------
    bool
        True where ``scene.json``, ``camera.json`` and all spectra are equal. Meshes and rays follow from these and
        are not read.
    """
    entries = [("scene.json", _entry(exported)), ("camera.json", camera_entry(exported.camera))]
    try:
        alike = all(json.loads((folder / name).read_text(encoding="utf-8")) == entry for name, entry in entries)
        table = np.loadtxt(folder / "spectra" / "channels.csv", delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError):
        return False
    return alike and np.array_equal(table, _channels(exported))


def _entry(exported: Exported) -> dict[str, Any]:
    """Content of ``scene.json``."""
    scene, settings, film = exported.scene, exported.settings, exported.film
    first, *further = map(_lamp_entry, exported.lamps)
    return {
        "format": "cboxlab-export/1",
        "name": scene.name,
        "conventions": _CONVENTIONS,
        "surfaces": list(map(_surface_entry, scene.surfaces)),
        "materials": {name: f"spectra/material-{name}.csv" for name in scene.materials},
        "lamp": first,
        **({"further_lamps": further} if further else {}),
        "max_bounces": exported.max_bounces,
        "camera": "camera.json",
        "further_distortion": exported.camera.further_distortion is not None,
        "film": {
            "width_px": int(film.size[0]),
            "height_px": int(film.size[1]),
            "scale_px": float(film.scale),
            "low": film.low.tolist(),
            "warp": None if exported.camera.is_pinhole else "warp.npz",
        },
        "rays": [rays_path(batch) for batch in range(settings.batches)],
        "surface_map": "surfaces.png",
        "channels": "spectra/channels.csv",
        "wavelength_nm": settings.wavelength_nm.tolist(),
        "width_px": exported.camera.width_px,
        "height_px": exported.camera.height_px,
        "samples": settings.samples,
        "batches": settings.batches,
        "subpixels": settings.subpixels,
    }


def _lamp_spectra(lamp: ExportedLamp) -> tuple[str, str]:
    """Files of a lamp's radiance and reflectance, relative to the export."""
    return f"spectra/{lamp.key}.csv", f"spectra/{lamp.key}_reflectance.csv"


def _surface_entry(surface: Surface) -> dict[str, Any]:
    """Entry of a surface in ``scene.json``; a ball has its sphere too."""
    entry: dict[str, Any] = {"name": surface.name, "material": surface.material, "mesh": mesh_path(surface)}
    if surface.ball:
        centre, radius = surface.sphere_mm
        entry["sphere"] = {"center_mm": centre.tolist(), "radius_mm": radius}
    return entry


def _lamp_entry(lamp: ExportedLamp) -> dict[str, Any]:
    """Entry of a lamp in ``scene.json``."""
    radiance, reflectance = _lamp_spectra(lamp)
    return {
        "name": lamp.surface.name,
        "mesh": mesh_path(lamp.surface),
        "radiance": radiance,
        "reflectance": reflectance,
        "reflects": lamp.lamp.reflects,
    }


def _ply(surface: Surface) -> str:
    """Mesh in PLY (ASCII, double precision), unchanged; a ball gets the sphere's normals."""
    columns, names = surface.vertices_mm, ["x", "y", "z"]
    if surface.ball:
        outwards = surface.vertices_mm - surface.sphere_mm[0]
        columns = np.hstack([columns, outwards / np.linalg.norm(outwards, axis=1, keepdims=True)])
        names += ["nx", "ny", "nz"]
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(columns)}",
        *(f"property double {name}" for name in names),
        f"element face {len(surface.faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    rows = [" ".join(repr(float(x)) for x in vertex) for vertex in columns]
    rows += [" ".join(["3", *(str(int(i)) for i in face)]) for face in surface.faces]
    return "\n".join([*head, *rows]) + "\n"


def _write_spectrum(path: Path, spectrum: Spectrum, name: str) -> None:
    with path.open("w", newline="", encoding="ascii") as stream:
        table = csv.writer(stream)
        table.writerow(["wavelength_nm", name])
        table.writerows(zip(spectrum.wavelength_nm.tolist(), spectrum.values.tolist(), strict=True))


def _write_channels(path: Path, exported: Exported) -> None:
    """Write all spectra at the wavelengths of the export."""
    with path.open("w", newline="", encoding="ascii") as stream:
        table = csv.writer(stream)
        table.writerow(
            [
                "wavelength_nm",
                *(f"{lamp.key}{kind}" for lamp in exported.lamps for kind in ("", "_reflectance")),
                *(f"material-{name}" for name in exported.scene.materials),
            ]
        )
        table.writerows(_channels(exported).tolist())


def _channels(exported: Exported) -> NDArray[np.float64]:
    """(w, n) wavelength, radiance and reflectance of each lamp, reflectances of the materials."""
    lamps = [values for lamp in exported.lamps for values in (lamp.radiance, lamp.reflectance)]
    return np.vstack([exported.settings.wavelength_nm, *lamps, exported.reflectances]).T


def _surface_map(exported: Exported) -> NDArray[np.uint8]:
    """(y, x) index of the surface, or value of the lamp, that covers most of a pixel."""
    coverage = facet_coverage(tracer := build_tracer(exported.scene), exported.camera)
    count = len(exported.scene.surfaces)
    each = [coverage[..., tracer.facet_surface == s].sum(axis=-1) for s in range(count + 1)]
    most = np.argmax(np.stack(each, axis=-1), axis=-1)
    most[most == count] = _LAMP_PIXEL
    most[coverage.sum(axis=-1) < _MIN_COVERAGE] = _EMPTY_PIXEL
    return most.astype(np.uint8)


def read_layout(folder: Path) -> Layout:
    """Arrangement of an export's results.

    Parameters
    ----------
    folder
        The export.

    Returns
    -------
    Layout
        As its ``scene.json`` states it.

    Raises
    ------
    InputError
        If ``folder`` is no export.
    """
    path = folder / "scene.json"
    entry = read_json_object(path, "an export's scene.json")
    if entry.get("format") != "cboxlab-export/1":
        raise InputError(f"{path}: format", repr(entry.get("format")), "'cboxlab-export/1'")
    try:
        settings = ExportSettings(
            np.asarray(entry["wavelength_nm"], float),
            int(entry["samples"]),
            int(entry["batches"]),
            int(entry["subpixels"]),
        )
        film = entry["film"]
        return Layout(
            int(entry["width_px"]),
            int(entry["height_px"]),
            int(film["width_px"]),
            int(film["height_px"]),
            any(lamp["reflects"] for lamp in (entry["lamp"], *entry.get("further_lamps", ()))),
            settings,
        )
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise InputError(path, f"{type(error).__name__}: {error}", "a scene.json as an export writes it") from None


def read_surfaces(folder: Path) -> tuple[NDArray[np.int16], tuple[str, ...]]:
    """Surface that each pixel sees.

    Parameters
    ----------
    folder
        The export.

    Returns
    -------
    index
        (y, x) index into the names, or LAMP or NOTHING as in ``RenderedImage.surface``.
    names
        Names of the surfaces.

    Raises
    ------
    InputError
        If ``folder`` is no export, or the map is missing, damaged or of another picture.
    """
    layout, path = read_layout(folder), folder / "scene.json"
    surfaces = read_json_object(path, "a scene.json").get("surfaces")
    if not isinstance(surfaces, list) or not all(
        isinstance(s, dict) and isinstance(s.get("name"), str) for s in surfaces
    ):
        raise InputError(f"{path}: surfaces", "no list of surfaces with names", "a scene.json as an export writes it")
    names = tuple(str(surface["name"]) for surface in surfaces)
    picture = read_channels(folder / "surfaces.png")
    if picture.shape != (layout.height_px, layout.width_px, 1):
        expected = f"a grey picture of {layout.width_px} x {layout.height_px} px"
        raise InputError(folder / "surfaces.png", f"an array of shape {picture.shape}", expected)
    index = np.rint(_EMPTY_PIXEL * picture[..., 0]).astype(np.int16)
    unknown = index[(index >= len(names)) & (index < _LAMP_PIXEL)]
    if unknown.size:
        fault = f"the number {unknown.min()} of a surface"
        raise InputError(folder / "surfaces.png", fault, f"numbers from 0 to {len(names) - 1}")
    index[index == _LAMP_PIXEL], index[index == _EMPTY_PIXEL] = LAMP, NOTHING
    return index, names


def read_warp(folder: Path) -> tuple[NDArray, NDArray, NDArray] | None:
    """Matrix of means over camera pixels, as written by ``write_neutral``.

    Parameters
    ----------
    folder
        The export.

    Returns
    -------
    tuple of NDArray or None
        Rows, columns and weights of ``pixel_means``; None for a camera without distortion.

    Raises
    ------
    InputError
        If ``folder`` is no export, or the file is damaged or of another picture.
    """
    path = folder / "warp.npz"
    if not path.exists():
        return None
    layout, expected = read_layout(folder), "rows, columns and weights of pixels as an export writes them"
    require_regular_file(path, expected)
    try:
        with zipfile.ZipFile(path) as archive:
            require_size(path, sum(each.file_size for each in archive.infolist()), MAX_PACKED_BYTES, "unpacked bytes")
        with np.load(path) as stored:
            row, column, weight = (np.atleast_1d(stored[key]) for key in ("row", "column", "weight"))
    except InputError:
        raise
    except Exception as error:  # the reader raises exceptions of any type on damaged files
        raise InputError(path, f"{type(error).__name__}: {error}", expected) from None
    sizes = layout.height_px * layout.width_px, layout.film_height_px * layout.film_width_px
    indices = all(
        each.shape == weight.shape == (weight.size,) and each.dtype.kind in "iu" and np.all((each >= 0) & (each < size))
        for each, size in zip((row, column), sizes, strict=True)
    )
    if not indices or weight.dtype.kind != "f" or not np.isfinite(weight).all():
        raise InputError(path, "other numbers than those of its picture", expected)
    return row, column, weight
