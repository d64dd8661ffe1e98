"""Rendered pictures kept from run to run, found again by everything that they were made from.

A picture's key is a digest of all arguments of ``gather``, of the source code that it runs, and of the libraries
below it. A picture that is found therefore has the same bits as one made anew.
"""

from __future__ import annotations

import hashlib
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
from cboxlab.utils.files import keep, kept
from cboxlab.utils.progress import QUIET, Progress

__all__ = ["cached_picture", "default_cache", "digest_of", "picture_key", "sources"]

#: Beyond this size pictures are not kept; beyond that of the whole folder the oldest go, bytes.
_LARGEST, _ALL = 300e6, 2e9

#: What a picture's code may call: three whole rooms, and this package.
_PACKAGES = ("scenes", "calibration", "rendering", "validation.predict")


def default_cache() -> Path:
    """The user's cache folder by the XDG base directories."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cboxlab" / "pictures"


def cached_picture(
    folder: Path | None,
    light: LightField,
    camera: Camera,
    samples: int,
    batches: int,
    seed: int,
    progress: Progress = QUIET,
) -> RenderedImage:
    """What ``gather`` makes of the same arguments, to the bit: kept in ``folder`` from before, or made now and kept.

    folder : None keeps nothing. A cache that cannot be read or written is no fault, nor is a damaged entry: the
    picture is made, and takes the entry's place.
    """
    if folder is None:
        return _contiguous(gather(light, camera, samples, batches, seed, progress))
    key = picture_key(light, camera, samples, batches, seed)
    path = folder / f"{key}.picture"
    found = _read(path, key, light, camera, batches)
    if found is not None:
        return found
    image = _contiguous(gather(light, camera, samples, batches, seed, progress))
    _keep(path, key, image)
    return image


def picture_key(light: LightField, camera: Camera, samples: int, batches: int, seed: int) -> str:
    """A digest of all that decides the bits of ``gather``'s picture: its arguments, its code, its libraries."""
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


def digest_of(*things: object) -> str:
    """A digest of values (plain types, arrays, dataclasses and collections of such), of the code that may compute
    something of them, and of the libraries below it."""
    digest = hashlib.sha256(_code())
    versions = (mi.__version__, dr.__version__, np.__version__, dr.detail.llvm_version(), mi.variant())
    for thing in (versions, platform.machine(), *things):
        _digest(digest, thing)
    return digest.hexdigest()


def sources() -> list[Path]:
    """All source files that a picture may depend on."""
    packages = [import_module(f"cboxlab.{name}") for name in _PACKAGES]
    return sorted(path for one in packages for path in Path(str(one.__file__)).parent.rglob("*.py"))


@cache
def _code() -> bytes:
    digest = hashlib.sha256()
    for path in sources():
        _digest(digest, (path.parent.name, path.name, path.read_bytes()))
    return digest.digest()


def _digest(digest: Any, thing: object) -> None:
    """Add a value of plain types, arrays, and dataclasses and collections of such. Raises TypeError for others."""
    parts: list[object] = []
    if isinstance(thing, np.ndarray):
        text = f"array {thing.dtype.str} {thing.shape} ".encode() + np.ascontiguousarray(thing).tobytes()
    elif is_dataclass(thing):
        parts = [getattr(thing, field.name) for field in fields(thing)]
        text = type(thing).__name__.encode()
    elif isinstance(thing, Mapping):
        parts = [part for item in thing.items() for part in item]
        text = b"mapping"
    elif isinstance(thing, tuple | list):
        parts, text = list(thing), b"sequence"
    elif thing is None or isinstance(thing, str | bytes | bool | int | float | np.generic):
        text = f"{type(thing).__name__} {thing!r}".encode()
    else:
        raise TypeError(f"no digest of a {type(thing).__name__}")
    digest.update(f"{len(parts)} {len(text)} ".encode() + text)
    for part in parts:
        _digest(digest, part)


def _contiguous(image: RenderedImage) -> RenderedImage:
    """As an array comes from a file: sums over strided arrays may round differently."""
    return replace(
        image,
        coefficients=np.ascontiguousarray(image.coefficients),
        coverage=np.ascontiguousarray(image.coverage),
    )


def _read(path: Path, key: str, light: LightField, camera: Camera, batches: int) -> RenderedImage | None:
    """The kept picture; None where there is none, or one that is not whole."""
    size = (camera.height_px, camera.width_px)
    facet_surface = light.tracer.facet_surface
    shapes = {
        "coefficients": (batches, *size, len(light.spectra)),
        "coverage": (*size, len(facet_surface)),
    }
    try:
        content = kept(path, key)
        if content is None:
            return None
        with np.load(BytesIO(content)) as file:
            arrays = {name: file[name] for name in shapes}
        os.utime(path)
    except Exception:  # whatever reading a damaged file raises, the picture can be made anew
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


def _keep(path: Path, key: str, image: RenderedImage) -> None:
    if image.coefficients.nbytes > _LARGEST:
        return
    stream = BytesIO()
    np.savez(stream, coefficients=image.coefficients, coverage=image.coverage)
    try:
        keep(path, key, stream.getbuffer())
        there = sorted(path.parent.glob("*.picture"), key=lambda one: one.stat().st_mtime, reverse=True)
        size = np.cumsum([one.stat().st_size for one in there])
        for old in np.array(there)[size > _ALL]:
            old.unlink(missing_ok=True)
    except OSError:
        return
