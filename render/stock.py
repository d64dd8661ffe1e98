"""The fallback where nothing can be compiled: Mitsuba's own path integrator, three wavelengths a render.

Mitsuba's colour variants treat red, green and blue as three numbers that never mix. With reflectances at
three wavelengths in their place, each render is exact at three wavelengths, and all share their paths.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mitsuba as mi
import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.scene import Lamp, Medium, Scene, Surface
from numpy.typing import NDArray

from . import variant as _variant
from .bsdf import bsdf_dict
from .image import RenderedImage
from .pinhole import Film, film_for, resampling
from .tracer import facets

__all__ = ["render_stock", "scene_dict", "sensor_dict"]

#: Film pixels per pixel and axis: of images through a lens with distortion, and of what a pixel covers.
DISTORTED_OVERSAMPLING = 4
COVERAGE_OVERSAMPLING = 8


def render_stock(
    scene: Scene,
    camera: Camera,
    wavelength_nm: np.ndarray,
    samples: int = 256,
    batches: int = 4,
    seed: int = 0,
    max_bounces: int | None = None,
    progress: Callable[[float], None] | None = None,
    variant: str = "scalar_rgb",
) -> RenderedImage:
    """Render the scene through the camera with Mitsuba's ``path`` integrator.

    Arguments and result are those of the path tracer; ``variant`` is any RGB variant of Mitsuba. Without
    distortion every calibrated pixel is a pixel of Mitsuba's film. With it a pinhole image of 4 x 4 finer
    pixels is rendered and shared out by area: its pixels count as uniform, which blurs the picture by less
    than 0.1 pixel (standard deviation) and moves nothing.

    Raises InputError for a lamp that is not uniform and Lambertian, which no stock emitter is.
    """
    _check(scene.lamp)
    wavelengths = np.asarray(wavelength_nm, float)
    oversampling = 1 if camera.k1 == 0 else DISTORTED_OVERSAMPLING
    film = film_for(camera, oversampling)
    matrix = resampling(film, camera)
    groups = np.array_split(np.arange(len(wavelengths)), -(-len(wavelengths) // 3))
    values = np.zeros((batches, camera.height_px * camera.width_px, len(wavelengths)), np.float32)
    with mi.scoped_set_variant(variant):
        kind = "path" if scene.medium is None else "volpath"
        integrator = mi.load_dict({"type": kind, "max_depth": -1 if max_bounces is None else max_bounces + 1})
        for done, group in enumerate(groups):
            three = wavelengths[np.resize(group, 3)]
            paints = {name: _rgb(m.reflectance.at(three)) for name, m in scene.materials.items()}
            loaded = mi.load_dict(scene_dict(scene, paints, _radiance(scene.lamp)), optimize=False)
            view = sensor_dict(film, camera, {"pixel_format": "rgb"}) | _medium(scene.medium, three)
            sensor = mi.load_dict(view)
            for batch in range(batches):
                picture = mi.render(
                    loaded, sensor=sensor, integrator=integrator, spp=-(-samples // oversampling**2),
                    seed=(seed + 7919 * (batch + 1)) & 0xFFFFFFFF,
                )  # fmt: skip
                fine = np.array(picture).reshape(film.pixels, 3)
                values[batch][:, group] = (matrix @ fine)[:, : len(group)]
                if progress:
                    progress((done + (batch + 1) / batches) / len(groups))
    coverage, facet_surface = _coverage(scene, camera, film)
    return RenderedImage(
        coefficients=values.reshape(batches, camera.height_px, camera.width_px, -1),
        spectra=np.diag(scene.lamp.radiance.at(wavelengths)),
        wavelength_nm=wavelengths,
        coverage=coverage,
        facet_surface=facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )


def scene_dict(scene: Scene, paints: Mapping[str, Any], radiance: Any) -> dict[str, Any]:
    """The scene for mi.load_dict, for the active variant: one mesh per surface, flat, lit from one side.

    paints : Mitsuba's description of each material's reflectance. radiance : of the lamp's radiance.
    """
    bsdfs = {name: bsdf_dict(scene.materials[name], value) for name, value in paints.items()}
    black = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}}
    shapes = {s.name: _mesh(s, {"bsdf": bsdfs[s.material]}) for s in scene.surfaces}
    lamp = {"bsdf": black, "emitter": {"type": "area", "radiance": radiance}}
    return {"type": "scene", **shapes, scene.lamp.surface.name: _mesh(scene.lamp.surface, lamp)}


def sensor_dict(film: Film, camera: Camera, film_options: Mapping[str, Any]) -> dict[str, Any]:
    """A pinhole at the camera's place whose film is ``film``, pixels with sharp edges.

    film_options : further entries of Mitsuba's film.
    """
    axes = np.eye(4)
    axes[:3, :3] = camera.rotation.T @ np.diag([-1.0, -1.0, 1.0])  # Mitsuba: x to the left, y up
    axes[:3, 3] = camera.position_mm
    centre = film.low + film.size / (2 * film.scale)
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(axes.tolist()),
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(film.size[0] / (2 * film.scale)))),
        "principal_point_offset_x": float(centre[0] * film.scale / film.size[0]),
        "principal_point_offset_y": float(centre[1] * film.scale / film.size[1]),
        "near_clip": 0.1,
        "far_clip": 1e7,
        "sampler": {"type": "independent"},
        "film": {
            "type": "hdrfilm", "width": int(film.size[0]), "height": int(film.size[1]),
            "component_format": "float32", "rfilter": {"type": "box"}, **film_options,
        },
    }  # fmt: skip


def _check(lamp: Lamp) -> None:
    for key, value, plain in (("edge_ratio", lamp.edge_ratio, 1.0), ("exponent", lamp.exponent, 0.0)):
        if value != plain:
            raise InputError(
                f"lamp.{key}", f"{value:g}", f"{plain:g} without a compiled variant", _variant.HINT
            )


def _radiance(lamp: Lamp) -> dict[str, Any]:
    """Of the lamp, over its mean: 1, or its pattern as a texture."""
    if lamp.pattern is None:
        return _rgb(np.ones(3))
    cells = mi.TensorXf(np.repeat(lamp.pattern[..., None], 3, axis=-1).astype(np.float32))
    return {"type": "bitmap", "data": cells, "raw": True, "filter_type": "nearest", "wrap_mode": "clamp"}


def _medium(medium: Medium | None, wavelengths: NDArray) -> dict[str, Any]:
    """The sensor's entry for a medium that fills all space."""
    if medium is None:
        return {}
    scattering = medium.scattering_per_mm.at(wavelengths)
    extinction = scattering + medium.absorption_per_mm.at(wavelengths)
    entry = {
        "type": "homogeneous",
        "sigma_t": _rgb(extinction),
        "albedo": _rgb(scattering / np.maximum(extinction, 1e-12)),
        "phase": {"type": "hg", "g": float(medium.anisotropy)},
    }
    return {"medium": entry}


def _rgb(values: NDArray) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in values]}


def _mesh(surface: Surface, parts: Mapping[str, Any]) -> mi.Mesh:
    """Triangles without shared corners, so that Mitsuba smooths no normal.

    Texture coordinates go along the first edge (u) and the last (v) of the first quad.
    """
    properties = mi.Properties()
    for name, part in parts.items():
        properties[name] = mi.load_dict(part)
    corners = surface.vertices_mm[surface.faces].reshape(-1, 3).astype(np.float32)
    mesh = mi.Mesh(surface.name, len(corners), len(surface.faces), properties, has_vertex_texcoords=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = corners.ravel()
    parameters["vertex_texcoords"] = _texture_coordinates(surface, corners).ravel()
    parameters["faces"] = np.arange(len(corners), dtype=np.uint32)
    parameters.update()
    return mesh


def _texture_coordinates(surface: Surface, corners: NDArray) -> NDArray[np.float32]:
    first = surface.vertices_mm[0]
    edges = np.stack([surface.vertices_mm[i] - first for i in (1, min(3, len(surface.vertices_mm) - 1))])
    places = (corners - first) @ (edges / np.maximum((edges**2).sum(axis=1, keepdims=True), 1e-12)).T
    return np.ascontiguousarray(places, np.float32)


def _coverage(scene: Scene, camera: Camera, film: Film) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """(y, x, f) part of each pixel that each flat face covers, the lamp's last; the faces' surfaces.

    One ray in each of 8 x 8 parts of a pixel tells which triangle it meets. The parts are put together like
    the image's ``film``, so a pixel that a film pixel on an edge touches is no pure one.
    """
    surfaces = (*scene.surfaces, scene.lamp.surface)
    corners = np.concatenate([s.vertices_mm[s.faces] for s in surfaces])
    owner = np.concatenate([np.full(len(s.faces), i) for i, s in enumerate(surfaces)])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    facet, facet_surface = facets(normals, owner)
    facet[np.sum((camera.position_mm - corners[:, 0]) * normals, axis=1) <= 0] = -1  # only backs are seen
    parts = COVERAGE_OVERSAMPLING // round(film.scale / camera.focal_length_px)
    fine = Film(film.low, film.scale * parts, film.size * parts)
    everything = Surface("all", "", corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    with mi.scoped_set_variant("scalar_rgb"):
        loaded = mi.load_dict({"type": "scene", "mesh": _mesh(everything, {})})
        integrator = mi.load_dict({"type": "aov", "aovs": "distance:depth,triangle:prim_index"})
        sensor = mi.load_dict(sensor_dict(fine, camera, {"pixel_format": "luminance"}))
        picture = np.array(mi.render(loaded, sensor=sensor, integrator=integrator, spp=1))
    distance, triangle = picture.reshape(fine.pixels, -1)[:, -2:].T
    seen = np.where(distance > 0, facet[np.rint(triangle).astype(int)], -1)
    seen = seen.reshape(film.size[1], parts, film.size[0], parts)
    matrix = resampling(film, camera)
    shares = [matrix @ (seen == face).mean(axis=(1, 3)).ravel() for face in range(len(facet_surface))]
    coverage = np.stack(shares, axis=-1).astype(np.float32)
    return coverage.reshape(camera.height_px, camera.width_px, -1), facet_surface
