"""Pictures of any scene from files: R, G, B as stored, errors, map of surfaces.

R, G, B as stored have no unit and no wavelengths, and their primaries need not be stated. Two such pictures can be
compared all the same, since both are in the same numbers.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.rendering.files import (
    AS_STATED,
    READABLE,
    Declared,
    ExrChannels,
    negative_pixels,
    picture_of_colours,
    radiance_as_stored,
    read_layers,
    read_picture,
    require_light,
    require_numbers,
    spectral_channels,
    stated_space,
    with_declarations,
    with_notes,
    with_window,
)
from cboxlab.utils.errors import InputError

from .guides import GUIDES, Regions, cryptomatte, regions_of
from .layers import guide_layers, picture_layer
from .pfm import PFM_ENDING, read_pfm

__all__ = ["AS_STORED", "cube_paths", "read_scene_picture"]

#: Names of the planes of a picture as stored.
AS_STORED = ("R", "G", "B")
#: Note on their numbers.
_AS_STORED = "R, G, B as stored, without unit and wavelengths"
#: Declarations by which a picture becomes one in X, Y, Z.
_CONVERTING = frozenset(("units", "scale", "colour_space"))
#: Entries of headers on the number of samples of a pixel (pbrt).
_SAMPLES = "samplesPerPixel"
#: Endings of files of pictures.
_ENDINGS = (*READABLE, PFM_ENDING)


def cube_paths(text: str) -> tuple[Path, ...]:
    """Cubes that an argument names.

    Parameters
    ----------
    text
        One file, files joined by commas, or a folder of cubes.

    Returns
    -------
    tuple of Path
        The files, those of a folder in alphabetical order.

    Raises
    ------
    InputError
        If a folder holds no cube.
    """
    path = Path(text)
    try:
        exists = path.exists()
    except OSError:  # a list of many files is too long for the name of one
        exists = False
    if exists and path.is_dir():
        cubes = tuple(sorted(p for p in path.iterdir() if p.suffix.lower() in _ENDINGS))
        if not cubes:
            raise InputError(path, "a folder without spectral cubes", f"files {', '.join(_ENDINGS)} in it")
        return cubes
    return (path,) if exists else tuple(Path(part) for part in text.split(","))


def read_scene_picture(path: Path, declared: Declared = AS_STATED) -> xr.Dataset:
    """Cube or picture in colour of a file.

    Parameters
    ----------
    path
        File, as of ``read_picture``, or OpenEXR with layers of any names.
    declared
        Properties that the file does not state.

    Returns
    -------
    xr.Dataset
        As ``read_picture``. Where neither file nor user state unit and colour space, ``rgb`` (y, x, component) in the
        file's numbers. ``surface`` (y, x), ``standard_error`` and guides such as ``guide_albedo`` where the file has
        layers for them. Values need not be finite.

    Raises
    ------
    InputError
        As of ``read_picture``, and where several layers may be the picture.
    """
    path = Path(path)
    stored = None if declared.declared_fields() else radiance_as_stored(path)
    if stored is not None:
        require_light(stored, path)
        return with_notes(stored, [_AS_STORED])
    if path.suffix.lower() not in (".exr", PFM_ENDING) or not path.is_file():
        return read_picture(path, declared, finite=False)
    channels = _channels(path)
    names = sorted(channels.planes)
    layer = None if spectral_channels(names) else picture_layer(path, names, declared.layer)
    if layer is None:
        return read_picture(path, declared, finite=False)
    dot = f"{layer}." if layer else ""
    planes = {name: channels.planes[dot + name] for name in AS_STORED}
    complete = {"chromaticities", "whiteLuminance"} <= set(channels.header)
    if declared.declared_fields() & _CONVERTING or complete:
        with np.errstate(invalid="ignore"):  # a pixel that is not a number stays one
            picture = picture_of_colours(path, replace(channels, planes=planes), replace(declared, layer=None))
        if declared.layer is not None:
            picture = with_declarations(picture, declared, ("layer",))
    else:
        picture = _as_stored(channels, planes, layer, declared)
    picture = _with_surfaces(picture, channels, layer)
    picture = with_window(with_notes(picture, channels.notes), channels.window)
    require_numbers(picture, path, finite=False)
    require_light(picture, path)
    negative = negative_pixels(picture)
    return with_notes(picture, [f"pixels of negative radiance: {negative}"] if negative else [])


def _channels(path: Path) -> ExrChannels:
    """Channels of an OpenEXR file, or R, G, B of a PFM."""
    if path.suffix.lower() != PFM_ENDING:
        return read_layers(path)
    planes = read_pfm(path)
    if len(planes) != len(AS_STORED):
        raise InputError(path, "a PFM of grey (Pf)", "a PFM in colour (PF)")
    return ExrChannels(dict(zip(AS_STORED, planes, strict=True)), {})


def _as_stored(channels: ExrChannels, planes: dict[str, np.ndarray], layer: str, declared: Declared) -> xr.Dataset:
    """Dataset of R, G, B in the file's numbers, with the errors that it states."""
    dims = ("y", "x", "component")
    values = np.stack([planes[name] for name in AS_STORED], axis=-1).astype(np.float64)
    picture = xr.Dataset({"rgb": (dims, values)}, coords={"component": list(AS_STORED)})
    primaries = channels.header.get("chromaticities")
    if primaries is not None:
        picture.attrs["colour_space"] = stated_space(np.concatenate(primaries, axis=None))
    errors = [channels.planes.get(f"Variance.{name}") for name in AS_STORED]
    samples = int(channels.header.get(_SAMPLES, 0))
    notes = [_AS_STORED]
    if layer:
        notes.append(f"the layer {layer} is compared")
    if samples > 1 and all(error is not None for error in errors):
        variance = np.stack([np.asarray(error, float) for error in errors], axis=-1) / samples
        picture["standard_error"] = (dims, np.sqrt(np.maximum(variance, 0.0)), {"batches": samples})
        notes.append(f"errors from the layer Variance and {samples} samples per pixel")
    return with_declarations(picture, declared, ("layer",) if declared.layer is not None else (), notes)


def _with_surfaces(picture: xr.Dataset, channels: ExrChannels, layer: str) -> xr.Dataset:
    """Picture with guides and the map of surfaces of a file's other layers."""
    kinds = guide_layers(sorted(channels.planes), layer)
    guides = {
        kind: np.stack([channels.planes[name] for name in names], axis=-1).astype(np.float64)
        for kind, names in kinds.items()
    }
    regions: Regions | None = regions_of(guides, cryptomatte(channels.header, channels.planes))
    variables = {f"guide_{k}": (("y", "x", f"{k}_component"), guides[k]) for k in GUIDES if k in guides}
    if regions is None:
        return picture.assign(variables)
    statements = {"names": ",".join(regions.names), "lamp": "unknown", "of_objects": int(regions.of_objects)}
    surface = (("y", "x"), regions.index, statements)
    notes = [f"surfaces are taken from {regions.source}"]
    return with_notes(picture.assign(variables | {"surface": surface}), notes)
