"""The fallback without a compiled variant: Mitsuba's own path integrator.

Mitsuba's RGB variants treat red, green and blue as three independent numbers. With reflectances at three wavelengths
instead, each render is exact at three wavelengths. All renders use the same paths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Lamp, Medium, Scene, Surface, Texture
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from ..device import mi
from ..device import variant as _variant
from ..image import BATCH_SEED_STEP, RenderedImage, RenderJob
from ..materials import bsdf_dict
from ..visibility import Film, facets, film_for, resampling

__all__ = ["render_stock", "scene_dict", "sensor_dict"]

#: Film pixels per pixel and axis, for images with distortion.
DISTORTED_OVERSAMPLING = 4

#: Film pixels per pixel and axis, for coverage.
COVERAGE_OVERSAMPLING = 8


def render_stock(
    job: RenderJob,
    *,
    progress: Progress = NO_PROGRESS,
    variant: str = "scalar_rgb",
) -> RenderedImage:
    """Image by Mitsuba's ``path`` integrator, or by ``volpath`` for a scene with media.

    Without distortion every camera pixel is a pixel of Mitsuba's film. With distortion a pinhole image of 4 x 4 finer
    pixels is rendered and resampled by area. This blurs the image by less than 0.1 pixel (standard deviation), without
    a shift. Where samples differ by pixel, all pixels have the largest number.

    Parameters
    ----------
    job
        The image to render.
    progress
        Receives the completed share after each render.
    variant
        Any RGB variant of Mitsuba.

    Returns
    -------
    RenderedImage
        Image with one coefficient per wavelength.

    Raises
    ------
    InputError
        For a lamp with an edge ratio or an exponent, which Mitsuba's emitters do not support.
    """
    scene, camera, wavelengths = job.scene, job.camera, job.wavelength_nm
    for lamp in scene.lamps:
        _check(lamp)
    oversampling = 1 if camera.is_pinhole else DISTORTED_OVERSAMPLING
    film = film_for(camera, oversampling)
    matrix = resampling(film, camera)
    groups = np.array_split(np.arange(len(wavelengths)), -(-len(wavelengths) // 3))
    values = np.zeros((job.batches, camera.height_px * camera.width_px, len(wavelengths)), np.float32)
    with mi.scoped_set_variant(variant):
        clear = scene.medium is None and all(surface.inside is None for surface in scene.surfaces)
        kind = "path" if clear else "volpath"
        integrator = mi.load_dict({"type": kind, "max_depth": -1 if job.max_bounces is None else job.max_bounces + 1})
        for number, group in enumerate(groups):
            triple = wavelengths[np.resize(group, 3)]
            rgb_reflectances = [_rgb(row) for row in scene.reflectances(triple)]
            paints = {
                name: rgb if material.texture is None else _bitmap(material.texture, triple)
                for (name, material), rgb in zip(scene.materials.items(), rgb_reflectances, strict=False)
            }
            shares = scene.lamp_shares(triple)
            radiances = [_radiance(source, share) for source, share in zip(scene.lamps, shares, strict=True)]
            built = scene_dict(scene, paints, rgb_reflectances[len(paints) :], radiances, _insides(scene, triple))
            loaded = mi.load_dict(built, optimize=False)
            view = sensor_dict(film, camera, {"pixel_format": "rgb"}) | _medium("medium", scene.medium, triple)
            sensor = mi.load_dict(view)
            for batch in range(job.batches):
                picture = mi.render(
                    loaded,
                    sensor=sensor,
                    integrator=integrator,
                    spp=-(-int(np.max(job.samples)) // oversampling**2),
                    seed=(job.batch_seed + BATCH_SEED_STEP * (batch + 1)) & 0xFFFFFFFF,
                )
                fine = np.array(picture).reshape(film.pixels, 3)
                values[batch][:, group] = (matrix @ fine)[:, : len(group)]
                progress.part((number + (batch + 1) / job.batches) / len(groups))
    coverage, facet_surface = _coverage(scene, camera, film)
    return RenderedImage(
        coefficients=values.reshape(job.batches, camera.height_px, camera.width_px, -1),
        spectra=np.diag(scene.lamp_radiance(wavelengths)),
        wavelength_nm=wavelengths,
        coverage=coverage,
        facet_surface=facet_surface,
        surface_names=tuple(s.name for s in scene.surfaces),
    )


def scene_dict(
    scene: Scene,
    reflectances: Mapping[str, Any],
    lamp_reflectances: Sequence[Any],
    radiances: Sequence[Any],
    insides: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> dict[str, Any]:
    """Description of a scene for `mi.load_dict` and the active variant.

    Each surface is one mesh, flat shaded and one-sided; balls are spheres.

    Parameters
    ----------
    scene
        The scene.
    reflectances
        By material, Mitsuba's description of its reflectance.
    lamp_reflectances
        Description of each lamp's reflectance.
    radiances
        Description of each lamp's radiance.
    insides
        By surface, further entries of its shape, as media.

    Returns
    -------
    dict[str, Any]
        The description.
    """
    used = dict.fromkeys(surface.material for surface in scene.surfaces)
    bsdfs = {name: mi.load_dict(bsdf_dict(scene.materials[name], reflectances[name])) for name in used}
    shapes = {
        s.name: (_sphere if scene.meets_sphere(s) else _mesh)(s, {"bsdf": bsdfs[s.material], **insides.get(s.name, {})})
        for s in scene.surfaces
    }
    for lamp, reflectance, radiance in zip(scene.lamps, lamp_reflectances, radiances, strict=True):
        parts = {
            "bsdf": {"type": "diffuse", "reflectance": reflectance},
            "emitter": {"type": "area", "radiance": radiance},
        }
        shapes[lamp.surface.name] = _mesh(lamp.surface, parts)
    return {"type": "scene", **shapes}


def sensor_dict(film: Film, camera: Camera, film_options: Mapping[str, Any]) -> dict[str, Any]:
    """Description of a pinhole camera with a box reconstruction filter.

    Parameters
    ----------
    film
        Size and position of the film.
    camera
        Pose of the camera.
    film_options
        Further entries of Mitsuba's film.

    Returns
    -------
    dict[str, Any]
        The description.
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
            "type": "hdrfilm",
            "width": int(film.size[0]),
            "height": int(film.size[1]),
            "component_format": "float32",
            "rfilter": {"type": "box"},
            **film_options,
        },
    }


def _check(lamp: Lamp) -> None:
    """Raise InputError for a lamp that Mitsuba's emitters do not support."""
    for key, value, plain in (("edge_ratio", lamp.edge_ratio, 1.0), ("exponent", lamp.exponent, 0.0)):
        if value != plain:
            raise InputError(f"lamp.{key}", f"{value:g}", f"{plain:g} without a compiled variant", _variant.HINT)


def _radiance(lamp: Lamp, share: NDArray) -> dict[str, Any]:
    """Radiance of a lamp: `share` (3,), or `share` times its pattern as a texture."""
    if lamp.pattern is None:
        return _rgb(share)
    cells = mi.TensorXf((lamp.pattern[..., None] * share).astype(np.float32))
    return {"type": "bitmap", "data": cells, "raw": True, "filter_type": "nearest", "wrap_mode": "clamp"}


def _bitmap(texture: Texture, wavelengths: NDArray) -> dict[str, Any]:
    """Reflectance of a texture at three wavelengths."""
    spectra = np.array([spectrum.at(wavelengths) for spectrum in texture.spectra])
    pixels = mi.TensorXf((texture.weights @ spectra).astype(np.float32))
    return {"type": "bitmap", "data": pixels, "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}


def _insides(scene: Scene, wavelengths: NDArray) -> dict[str, dict[str, Any]]:
    """By name of the surfaces that are filled, the media on both sides."""
    return {
        s.name: _medium("interior", s.inside, wavelengths) | _medium("exterior", scene.medium, wavelengths)
        for s in scene.surfaces
        if s.inside is not None
    }


def _medium(key: str, medium: Medium | None, wavelengths: NDArray) -> dict[str, Any]:
    """Entry of a sensor or shape for a medium; no entry for clear air."""
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
    return {key: entry}


def _rgb(values: NDArray) -> dict[str, Any]:
    """Three values as Mitsuba's description of a colour."""
    return {"type": "rgb", "value": [float(v) for v in values]}


def _sphere(surface: Surface, parts: Mapping[str, Any]) -> dict[str, Any]:
    """Description of a ball, with further entries."""
    centre, radius = surface.sphere_mm
    return {"type": "sphere", "center": centre.tolist(), "radius": radius, **parts}


def _mesh(surface: Surface, parts: Mapping[str, Any]) -> mi.Mesh:
    """Triangles without shared vertices, so that Mitsuba does not interpolate normals."""
    properties = mi.Properties()
    for name, part in parts.items():
        properties[name] = part if isinstance(part, mi.Object) else mi.load_dict(part)
    corners = surface.vertices_mm[surface.faces].reshape(-1, 3).astype(np.float32)
    mesh = mi.Mesh(surface.name, len(corners), len(surface.faces), properties, has_vertex_texcoords=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = corners.ravel()
    parameters["vertex_texcoords"] = _texture_coordinates(surface, corners).ravel()
    parameters["faces"] = np.arange(len(corners), dtype=np.uint32)
    parameters.update()
    return mesh


def _texture_coordinates(surface: Surface, corners: NDArray) -> NDArray[np.float32]:
    """(n, 2) texture coordinates of the corners of triangles.

    They are the surface's own, or run along the first edge (u) and the last edge (v) of the first quad.
    """
    if surface.texture_uv is not None:
        return np.ascontiguousarray(surface.texture_uv[surface.faces].reshape(-1, 2), np.float32)
    first = surface.vertices_mm[0]
    edges = np.stack([surface.vertices_mm[i] - first for i in (1, min(3, len(surface.vertices_mm) - 1))])
    coordinates = (corners - first) @ (edges / np.maximum((edges**2).sum(axis=1, keepdims=True), 1e-12)).T
    return np.ascontiguousarray(coordinates, np.float32)


def _coverage(scene: Scene, camera: Camera, film: Film) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """(y, x, f) share of each pixel that each flat face covers, and (f,) the faces' surfaces.

    Lamps are last. One ray in each of 8 x 8 parts of a pixel finds the visible triangle. The parts are resampled like
    the image's `film`, so that pixels next to an edge have mixed coverage.
    """
    surfaces = scene.all_surfaces
    corners = np.concatenate([s.vertices_mm[s.faces] for s in surfaces])
    surface_index = np.concatenate([np.full(len(s.faces), i) for i, s in enumerate(surfaces)])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    facet, facet_surface = facets(normals, surface_index)
    facet_surface = np.minimum(facet_surface, len(scene.surfaces))
    facet[np.sum((camera.position_mm - corners[:, 0]) * normals, axis=1) <= 0] = -1  # seen from behind
    parts = COVERAGE_OVERSAMPLING // round(film.scale / camera.focal_length_px)
    fine = Film(film.low, film.scale * parts, film.size * parts)
    everything = Surface("all", "", corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    with mi.scoped_set_variant("scalar_rgb"):
        loaded = mi.load_dict({"type": "scene", "mesh": _mesh(everything, {})})
        integrator = mi.load_dict({"type": "aov", "aovs": "distance:depth,triangle:prim_index"})
        sensor = mi.load_dict(sensor_dict(fine, camera, {"pixel_format": "luminance"}))
        picture = np.array(mi.render(loaded, sensor=sensor, integrator=integrator, spp=1))
    distance, triangle = picture.reshape(fine.pixels, -1)[:, -2:].T
    visible_face = np.where(distance > 0, facet[np.rint(triangle).astype(int)], -1)
    visible_face = visible_face.reshape(film.size[1], parts, film.size[0], parts)
    matrix = resampling(film, camera)
    shares = [matrix @ (visible_face == face).mean(axis=(1, 3)).ravel() for face in range(len(facet_surface))]
    coverage = np.stack(shares, axis=-1).astype(np.float32)
    return coverage.reshape(camera.height_px, camera.width_px, -1), facet_surface
