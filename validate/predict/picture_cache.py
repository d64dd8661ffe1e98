"""Cache of rendered pictures on disk.

The key of a picture is a digest of all arguments of ``gather``, of the source code that it runs, and of the libraries
below it. A picture from the cache therefore has the same bits as one rendered again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cache
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.rendering.device import dr, mi
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.radiosity import LightField, gather
from cboxlab.scenes.camera import Camera
from cboxlab.utils.files import load_checked, store_checked
from cboxlab.utils.progress import NO_PROGRESS, Cancelled, Progress, checkpoint

__all__ = ["cached_picture", "default_cache", "digest_of", "picture_key", "sources"]

_log = logging.getLogger(__name__)

#: Largest picture that is stored, bytes: seven of them fill the folder.
_MAX_PICTURE_BYTES = 300e6

#: Largest size of the folder, bytes: beyond it the oldest pictures are deleted.
_MAX_FOLDER_BYTES = 2e9

#: Packages with code that a picture may depend on.
_PACKAGES = ("utils", "scenes", "calibration", "rendering", "validation.predict")


def default_cache() -> Path:
    """The user's cache folder by the XDG base directories.

    Returns
    -------
    Path
        The folder; it need not exist.
    """
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cboxlab" / "pictures"


def cached_picture(
    folder: Path | None,
    light: LightField,
    camera: Camera,
    samples: int,
    batches: int,
    seed: int,
    progress: Progress = NO_PROGRESS,
) -> RenderedImage:
    """Picture of ``gather`` for the same arguments, from the cache if it holds one.

    A cache that cannot be read or written is no fault, and neither is a damaged entry: the picture is rendered and
    replaces it.

    Parameters
    ----------
    folder
        Folder of the cache; None for no cache.
    light
        Radiosity solution.
    camera
        Camera of the picture.
    samples
        Samples per pixel and batch.
    batches
        Number of batches.
    seed
        Seed of the random numbers.
    progress
        Called with the completed share while rendering.

    Returns
    -------
    RenderedImage
        The picture, the same bits from the cache as rendered.
    """
    if folder is None:
        return _contiguous(gather(light, camera, samples, batches, seed, progress))
    key = picture_key(light, camera, samples, batches, seed)
    checkpoint()
    path = folder / f"{key}.picture"
    stored = _read(path, key, light, camera, batches)
    if stored is not None:
        _log.info("picture of %d x %d samples taken from the cache: %s", batches, samples, path)
        return stored
    image = _contiguous(gather(light, camera, samples, batches, seed, progress))
    checkpoint()
    _store(path, key, image)
    return image


def picture_key(light: LightField, camera: Camera, samples: int, batches: int, seed: int) -> str:
    """Digest of everything that decides the bits of a picture of ``gather``.

    Parameters
    ----------
    light
        Radiosity solution.
    camera
        Camera of the picture; its covariance does not count.
    samples
        Samples per pixel and batch.
    batches
        Number of batches.
    seed
        Seed of the random numbers.

    Returns
    -------
    str
        Hexadecimal digest of arguments, code and libraries.
    """
    solution = (
        light.tables,
        light.spectra,
        light.wavelength_nm,
        light.finer.corners,
        light.near,
        light.max_bounces,
    )
    geometry = replace(camera, covariance=None)
    return digest_of(light.tracer.scene, *solution, geometry, samples, batches, seed)


def digest_of(*values: object) -> str:
    """Digest of values, of the code that may compute with them, and of the libraries below it.

    Parameters
    ----------
    values
        Plain types, arrays, dataclasses, and collections of these.

    Returns
    -------
    str
        Hexadecimal SHA-256.

    Raises
    ------
    TypeError
        For a value of another type.
    """
    digest = hashlib.sha256(_code())
    versions = (mi.__version__, dr.__version__, np.__version__, dr.detail.llvm_version(), mi.variant())
    for value in (versions, platform.machine(), *values):
        _digest(digest, value)
    return digest.hexdigest()


def sources() -> list[Path]:
    """Source files that a picture may depend on.

    Returns
    -------
    list
        Paths in sorted order.
    """
    packages = [import_module(f"cboxlab.{name}") for name in _PACKAGES]
    return sorted(path for package in packages for path in Path(str(package.__file__)).parent.rglob("*.py"))


@cache
def _code() -> bytes:
    """Digest of the source files."""
    digest = hashlib.sha256()
    for path in sources():
        _digest(digest, (path.parent.name, path.name, path.read_bytes()))
    return digest.digest()


def _digest(digest: Any, value: object) -> None:
    """Add a value to a digest with its type and number of parts; TypeError for other types."""
    parts: list[object] = []
    if isinstance(value, np.ndarray):
        text = f"array {value.dtype.str} {value.shape} ".encode() + np.ascontiguousarray(value).tobytes()
    elif is_dataclass(value):
        parts = [getattr(value, field.name) for field in fields(value) if field.init]
        text = type(value).__name__.encode()
    elif isinstance(value, Mapping):
        parts = [part for item in value.items() for part in item]
        text = b"mapping"
    elif isinstance(value, tuple | list):
        parts, text = list(value), b"sequence"
    elif value is None or isinstance(value, str | bytes | bool | int | float | np.generic):
        text = f"{type(value).__name__} {value!r}".encode()
    else:
        raise TypeError(f"no digest of a {type(value).__name__}")
    digest.update(f"{len(parts)} {len(text)} ".encode() + text)
    for part in parts:
        _digest(digest, part)


def _contiguous(image: RenderedImage) -> RenderedImage:
    """Image with contiguous arrays, like those of a file: sums over strides round otherwise."""
    return replace(
        image,
        coefficients=np.ascontiguousarray(image.coefficients),
        coverage=np.ascontiguousarray(image.coverage),
    )


def _read(path: Path, key: str, light: LightField, camera: Camera, batches: int) -> RenderedImage | None:
    """The stored picture; None if there is none or it is damaged."""
    size = (camera.height_px, camera.width_px)
    facet_surface = light.tracer.facet_surface
    shapes = {
        "coefficients": (batches, *size, len(light.spectra)),
        "coverage": (*size, len(facet_surface)),
    }
    try:
        content = load_checked(path, key)
        if content is None:
            return None
        checkpoint()
        with np.load(BytesIO(content)) as file:
            arrays = {name: file[name] for name in shapes}
        os.utime(path)
        checkpoint()
    except Cancelled:
        raise
    except Exception:  # whatever reading a damaged file raises, the picture can be rendered again
        return None
    if any(arrays[name].shape != shape or arrays[name].dtype != np.float32 for name, shape in shapes.items()):
        return None
    names = tuple(surface.name for surface in light.tracer.scene.surfaces)
    return RenderedImage(
        **arrays,
        spectra=light.spectra,
        wavelength_nm=light.wavelength_nm,
        facet_surface=facet_surface,
        surface_names=names,
    )


def _store(path: Path, key: str, image: RenderedImage) -> None:
    """Store a picture, and delete the oldest ones beyond the size of the folder."""
    if image.coefficients.nbytes > _MAX_PICTURE_BYTES:
        return
    stream = BytesIO()
    np.savez(stream, coefficients=image.coefficients, coverage=image.coverage)
    checkpoint()
    try:
        store_checked(path, key, stream.getbuffer())
        entries = sorted(path.parent.glob("*.picture"), key=lambda entry: entry.stat().st_mtime, reverse=True)
        size = np.cumsum([entry.stat().st_size for entry in entries])
        for entry in np.array(entries)[size > _MAX_FOLDER_BYTES]:
            entry.unlink(missing_ok=True)
    except OSError:
        return
