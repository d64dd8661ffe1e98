"""Rendered pictures kept from run to run, found again by the content of what they were made from."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from cboxlab import render
from cboxlab.render.image import RenderedImage
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.files import replacing
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

__all__ = ["cached_picture", "content_key", "default_cache"]

#: A picture through a camera within this, px rms over the scene's corners, serves: a warp takes it the rest.
_NEAR_PX = 0.03

#: Beyond this size pictures are not kept; beyond that of the whole folder the oldest go, bytes.
_LARGEST, _ALL = 300e6, 2e9


def default_cache() -> Path:
    """The user's cache folder by the XDG base directories."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cboxlab" / "pictures"


def content_key(scene: Scene, *further: object) -> str:
    """A digest of the scene, its spectra from 380 to 720 nm, the renderer's own code and what else counts."""
    digest = hashlib.sha256()
    for source in sorted(Path(render.__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    grid = np.arange(380.0, 721.0)
    for surface in (*scene.surfaces, scene.lamp.surface):
        digest.update(surface.name.encode() + surface.material.encode())
        digest.update(surface.vertices_mm.tobytes() + surface.faces.tobytes())
    for name, material in scene.materials.items():
        digest.update(name.encode() + material.reflectance.at(grid).tobytes())
    lamp = scene.lamp
    digest.update(lamp.radiance.at(grid).tobytes() + repr((lamp.edge_ratio, lamp.exponent)).encode())
    digest.update(b"" if lamp.pattern is None else lamp.pattern.tobytes())
    for thing in further:
        digest.update(thing.tobytes() if isinstance(thing, np.ndarray) else repr(thing).encode())
    return digest.hexdigest()[:32]


def cached_picture(
    folder: Path | None, key: str, camera: Camera, points_mm: NDArray, make: Callable[[], RenderedImage]
) -> tuple[RenderedImage, Camera]:
    """A picture and the camera it was rendered through: one kept under ``key``, or made now and kept.

    points_mm : (n, 3) by which cameras are compared. folder : None keeps nothing. A cache that cannot be read or
    written is no fault: the picture is made.
    """
    if folder is None:
        return make(), camera
    for path in sorted(folder.glob(f"{key}-*.npz")):
        found = _read(path, camera, points_mm)
        if found is not None:
            return found
    image = make()
    _keep(folder, key, image, camera)
    return image, camera


def _read(path: Path, camera: Camera, points_mm: NDArray) -> tuple[RenderedImage, Camera] | None:
    try:
        with np.load(path) as kept:
            there = camera.with_parameters(kept["camera"])
            away = there.project(points_mm) - camera.project(points_mm)
            if not np.sqrt(np.nanmean(away**2)) < _NEAR_PX:
                return None
            names = tuple(str(name) for name in kept["surface_names"])
            arrays = {
                k: kept[k] for k in ("coefficients", "spectra", "wavelength_nm", "coverage", "facet_surface")
            }
        os.utime(path)
    except (OSError, ValueError, KeyError):
        return None
    return RenderedImage(**arrays, surface_names=names), there


def _keep(folder: Path, key: str, image: RenderedImage, camera: Camera) -> None:
    if image.coefficients.nbytes > _LARGEST:
        return
    name = hashlib.sha256(camera.parameters.tobytes()).hexdigest()[:12]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(folder / f"{key}-{name}.npz") as temporary, open(temporary, "wb") as stream:
            np.savez(
                stream, camera=camera.parameters, coefficients=image.coefficients, spectra=image.spectra,
                wavelength_nm=image.wavelength_nm, coverage=image.coverage, facet_surface=image.facet_surface,
                surface_names=np.array(image.surface_names),
            )  # fmt: skip
        kept = sorted(folder.glob("*.npz"), key=lambda path: path.stat().st_mtime, reverse=True)
        size = np.cumsum([path.stat().st_size for path in kept])
        for path in np.array(kept)[size > _ALL]:
            path.unlink(missing_ok=True)
    except OSError:
        return
