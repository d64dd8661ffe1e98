"""Guides of a picture, such as albedo and depth, and their map of surfaces."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, maximum_filter, minimum_filter

__all__ = ["GUIDES", "Regions", "cryptomatte", "regions_of"]

#: Guides whose pixels are compared between the pictures.
GUIDES = ("albedo", "normal", "depth")
#: Largest distance of an averaged index from an integer at a pixel that shows one object.
_MIXED = 1e-3
#: Least part of a pixel that its first object of a cryptomatte covers where it shows that one alone.
_COVERED = 0.98
#: Range of the albedo in 3 x 3 pixels from which a pixel lies at an edge.
_ALBEDO_STEP = 0.08
#: The same of the components of normals: 17 degrees.
_NORMAL_STEP = 0.3
#: Range of the depth in 3 x 3 pixels over the depth, beyond three times the typical one: no tilted plane.
_DEPTH_STEP = 0.05
#: Fewest pixels of a region, and part of the picture: smaller ones are pooled.
_MIN_REGION_PX = 40
_MIN_REGION_PART = 0.01
#: Most regions, which share the rate of false alarms.
_MAX_REGIONS = 16
#: Name of the pool of small regions.
_SMALL = "small parts"
#: Kinds of mattes, best first.
_MATTES = ("object", "asset", "material")


@dataclass(frozen=True, eq=False)
class Regions:
    """Map of surfaces from a file's layers."""

    #: (y, x) index into ``names``; -1 where a pixel shows several surfaces.
    index: NDArray[np.int64]
    #: Names of the regions.
    names: tuple[str, ...]
    #: Source of the map in words.
    source: str
    #: Whether the names are those of objects, which another picture has too.
    of_objects: bool


def regions_of(guides: Mapping[str, NDArray[np.float64]], matte: Regions | None) -> Regions | None:
    """Map of surfaces, from the best layer that a file has.

    Parameters
    ----------
    guides
        (y, x, c) values by kind.
    matte
        Map of a cryptomatte; None without one.

    Returns
    -------
    Regions or None
        Objects of a cryptomatte or of an index, or connected parts between steps of albedo, normal and depth; None
        where a single region is left.
    """
    if matte is not None:
        return matte
    for kind in ("object", "material"):
        if kind in guides:
            regions = _of_index(guides[kind][..., 0], kind)
            if regions is not None:
                return regions
    used = {kind: guides[kind] for kind in GUIDES if kind in guides}
    return _of_steps(used) if used else None


def cryptomatte(header: Mapping[str, Any], planes: Mapping[str, NDArray[np.float32]]) -> Regions | None:
    """Objects of a cryptomatte: those that cover their pixels.

    Parameters
    ----------
    header
        Header of the file, with ``cryptomatte/.../name`` and ``.../manifest``.
    planes
        (y, x) channels by name.

    Returns
    -------
    Regions or None
        Map of objects, assets or materials; None without a cryptomatte.
    """
    mattes = {
        str(value): header.get(key[: -len("name")] + "manifest", "{}")
        for key, value in header.items()
        if re.fullmatch(r"cryptomatte/[^/]+/name", key)
    }
    for kind in _MATTES:
        name = next((name for name in sorted(mattes) if kind in name.lower()), None)
        if name is None:
            continue
        pair = next(
            (
                (planes[f"{name}00.{red}"], planes[f"{name}00.{green}"])
                for red, green in (("R", "G"), ("r", "g"), ("red", "green"))
                if f"{name}00.{red}" in planes
            ),
            None,
        )
        if pair is not None:
            identity = np.ascontiguousarray(pair[0], np.float32).view(np.uint32).astype(np.int64)
            return _numbered(identity, pair[1] > _COVERED, _names(mattes[name]), kind, f"the cryptomatte {name}")
    return None


def _names(manifest: object) -> dict[int, str]:
    """Names by number of a cryptomatte's manifest; none where it cannot be read."""
    try:
        content = json.loads(str(manifest) or "{}")
        return {int(code, 16): str(text) for text, code in content.items()}
    except (AttributeError, RecursionError, TypeError, ValueError):
        return {}


def _of_index(values: NDArray[np.float64], kind: str) -> Regions | None:
    """Objects of an index, which filters average at edges."""
    number = np.rint(np.nan_to_num(values)).astype(np.int64)
    regions = _numbered(number, np.abs(values - number) < _MIXED, {}, kind, f"the index of {kind}s")
    return regions if len(regions.names) > 1 else None


def _numbered(
    number: NDArray[np.int64], pure: NDArray[np.bool_], names: Mapping[int, str], kind: str, source: str
) -> Regions:
    """Regions of numbers, small ones pooled."""
    index = np.full(number.shape, -1)
    values, counts = np.unique(number[pure], return_counts=True)
    least = max(_MIN_REGION_PX, _MIN_REGION_PART * number.size)
    order = [int(v) for v, count in sorted(zip(values, counts, strict=True), key=lambda p: -p[1]) if count >= least]
    large = order[:_MAX_REGIONS]
    labels: list[str] = []
    for value in large:
        index[pure & (number == value)] = len(labels)
        name = names.get(value, "background" if value == 0 and names else f"{kind} {value}")
        labels.append(re.sub(r"[,\s]+", " ", name))
    rest = pure & (index < 0)
    if rest.any():
        index[rest] = len(labels)
        labels.append(_SMALL)
    return Regions(index, tuple(labels), source, True)


def _of_steps(guides: Mapping[str, NDArray[np.float64]]) -> Regions | None:
    """Connected parts of the picture between steps of the guides."""
    shape = next(iter(guides.values())).shape[:2]
    edges = np.zeros(shape, bool)
    if "albedo" in guides:
        edges |= _range(guides["albedo"]) > _ALBEDO_STEP
    if "normal" in guides:
        edges |= _range(guides["normal"]) > _NORMAL_STEP
    if "depth" in guides:
        depth = np.where(np.isfinite(guides["depth"]), guides["depth"], 0.0)
        relative = _range(depth) / np.maximum(np.abs(depth[..., 0]), 1e-6 * max(float(np.abs(depth).max()), 1e-30))
        edges |= relative > max(_DEPTH_STEP, 3 * float(np.median(relative)))
    parts, count = label(~edges)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
    least = max(_MIN_REGION_PX, _MIN_REGION_PART * edges.size)
    large = [int(i) + 1 for i in np.argsort(-sizes, kind="stable") if sizes[i] >= least][:_MAX_REGIONS]
    index = np.full(shape, -1)
    names: list[str] = []
    for number in large:
        inside = parts == number
        y, x = (int(np.median(axis)) for axis in np.nonzero(inside))
        index[inside] = len(names)
        names.append(f"part around x {x} y {y}")
    rest = ~edges & (index < 0)
    if rest.any():
        index[rest] = len(names)
        names.append(_SMALL)
    if len(names) < 2:
        return None
    return Regions(index, tuple(names), f"steps of {' and '.join(guides)}", False)


def _range(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) largest range of a component in 3 x 3 pixels."""
    size = (3, 3, 1)
    return np.asarray((maximum_filter(values, size) - minimum_filter(values, size)).max(axis=-1))
