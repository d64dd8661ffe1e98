"""A fitted field: what it acts on, its maps, and how strong it is in each band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import combined, faults_of_validation
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .exchange import number_of_exchanges
from .image_maps import ImageMaps
from .levels import LEVELS
from .surface_maps import PointMap, SurfaceMap, WaveMap

__all__ = ["ON_SENSOR", "Acts", "FittedField", "field_of_record", "field_record"]

#: offset: DN added to counts. levels: the same by the count above dark. gain: counts above dark. previous: counts above
#: dark of the frames before, as listed in the fitted capture. displacement: px to the right, then down. neighbours:
#: light exchanged with pixels on opposite sides. moments: around, and along lines. halo: light exchanged with
#: Gaussians. streak: the same along a line. lamp: its radiance. reflectance: of surfaces, relative. irradiance: over
#: pi, relative to the lamp's radiance. radiance: of surfaces, relative to the lamp's, that lights nothing else. front:
#: the part hidden by a thing, whose radiance is relative to the lamp's.
Acts = Literal[
    "offset",
    "levels",
    "gain",
    "previous",
    "displacement",
    "neighbours",
    "moments",
    "halo",
    "streak",
    "lamp",
    "reflectance",
    "irradiance",
    "radiance",
    "front",
]

#: What acts on the picture or on counts, by maps over the picture.
ON_SENSOR: tuple[Acts, ...] = (
    "offset",
    "levels",
    "gain",
    "previous",
    "displacement",
    "neighbours",
    "moments",
    "halo",
    "streak",
)

#: Significant digits of numbers in records.
_DIGITS = 6


@dataclass(frozen=True, eq=False)
class FittedField:
    """A linear field with its coefficients.

    acts : see ``Acts``. bands, nm : names and mean wavelengths of the bands it was fitted in. size : rows and columns
    of the picture. image : maps over the picture, None for a field of the scene; radius : of "neighbours", px.
    angle_deg : of "streak", from the rows downwards. most_dn : of "levels", the highest count above dark.
    coefficients : (band, k) of image maps, where displacements have those to the right before those down, and
    exchanges all of one neighbour, moment or width before those of the next, levels and previous frames one each;
    empty for a field of the scene.
    surfaces : maps on surfaces. spectrum : (band,) by which they are multiplied, the relative change of a lamp, or the
    radiance of a thing in front.
    """

    acts: Acts
    bands: tuple[str, ...]
    nm: NDArray[np.float64]
    size: tuple[int, int]
    image: ImageMaps | None = None
    radius: int = 1
    angle_deg: float = 0.0
    most_dn: float = 1.0
    coefficients: NDArray[np.float64] | None = None
    surfaces: tuple[SurfaceMap, ...] = ()
    spectrum: NDArray[np.float64] | None = None


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Image(_Strict):
    kind: Literal["rows", "columns", "cosines", "wave", "bells"]
    order: int = Field(0, ge=0, le=40)
    per_px: tuple[float, float] = (0.0, 0.0)
    curvature: float = 0.0
    centres: list[tuple[float, float]] = Field(default_factory=list)
    pitch: float = Field(1.0, gt=0)
    nm: float = Field(0.0, ge=0)


class _Surface(_Strict):
    surface: str
    low: tuple[float, float, float] | None = None
    extent: tuple[float, float, float] | None = None
    waves: list[tuple[float, float, float]] | None = None
    points: list[tuple[float, float, float]] | None = None
    values: list[float] = Field(min_length=1)
    spectrum: list[float] | None = None


class _Field(_Strict):
    acts: Acts
    bands: list[str] = Field(min_length=1)
    nm: list[float] = Field(min_length=1)
    size: tuple[int, int]
    image: _Image | None = None
    radius: int = Field(1, ge=1, le=8)
    angle_deg: float = Field(0.0, ge=0, lt=180)
    most_dn: float = Field(1.0, gt=0)
    coefficients: list[list[float]] | None = None
    surfaces: list[_Surface] = Field(default_factory=list)
    spectrum: list[float] | None = None


class _Holder(_Strict):
    field: _Field


def field_record(field: FittedField) -> dict[str, Any]:
    """The field as numbers, strings, lists and dicts, ready for JSON and TOML; what is not used is left out."""
    record: dict[str, Any] = {
        "acts": field.acts,
        "bands": list(field.bands),
        "nm": _rounded(field.nm),
        "size": list(field.size),
    }
    if field.image is not None and field.coefficients is not None:
        record["image"] = _image_record(field.image)
        if field.acts == "neighbours":
            record["radius"] = field.radius
        if field.acts == "streak":
            record["angle_deg"] = field.angle_deg
        if field.acts == "levels":
            record["most_dn"] = float(f"{field.most_dn:.{_DIGITS}g}")
        record["coefficients"] = [_rounded(row) for row in field.coefficients]
    if field.spectrum is not None:
        record["spectrum"] = _rounded(field.spectrum)
    if field.surfaces:
        record["surfaces"] = [_surface_record(one) for one in field.surfaces]
    return record


def _image_record(maps: ImageMaps) -> dict[str, Any]:
    if maps.kind == "cosines":
        return {"kind": maps.kind, "order": maps.order}
    if maps.kind == "wave":
        return {
            "kind": maps.kind,
            "order": maps.order,
            "nm": float(maps.nm),
            "per_px": [float(f) for f in maps.per_px],
            "curvature": float(maps.curvature),
        }
    if maps.kind == "bells":
        centres = [_rounded(centre) for centre in maps.centres]
        return {"kind": maps.kind, "pitch": float(maps.pitch), "centres": centres}
    return {"kind": maps.kind}


def _surface_record(one: SurfaceMap) -> dict[str, Any]:
    if isinstance(one, PointMap):
        own: dict[str, Any] = {"points": [_rounded(point) for point in one.points]}
    else:
        waves = [_rounded(wave) for wave in one.waves]
        own = {"low": _rounded(one.low), "extent": _rounded(one.extent), "waves": waves}
    if one.spectrum is not None:
        own["spectrum"] = _rounded(one.spectrum)
    return {"surface": one.surface, **own, "values": _rounded(one.values)}


def field_of_record(record: Any, path: Path) -> FittedField:
    """The field of a record of the file ``path``. Raises InputError naming every fault."""
    try:
        entry = _Holder.model_validate({"field": record}).field
    except ValidationError as error:
        raise combined(faults_of_validation(path, error, _Holder)) from None
    where = f"{path}: field"
    bands = len(entry.bands)
    if len(entry.nm) != bands:
        raise InputError(f"{where}.nm", f"{len(entry.nm)} numbers", f"{bands}, one for each band")
    if entry.acts in ON_SENSOR:
        return _image_field(entry, where)
    if entry.spectrum is None or len(entry.spectrum) != bands:
        found = "nothing" if entry.spectrum is None else f"{len(entry.spectrum)} numbers"
        raise InputError(f"{where}.spectrum", found, f"{bands} numbers, one for each band")
    if not entry.surfaces and entry.acts != "lamp":
        raise InputError(f"{where}.surfaces", "nothing", "one map or more")
    surfaces = tuple(_surface_map(one, f"{where}.surfaces[{i}]", bands) for i, one in enumerate(entry.surfaces))
    return FittedField(
        entry.acts,
        tuple(entry.bands),
        np.array(entry.nm),
        entry.size,
        surfaces=surfaces,
        spectrum=np.array(entry.spectrum),
    )


def _image_field(entry: _Field, where: str) -> FittedField:
    if entry.image is None or entry.coefficients is None:
        raise InputError(where, "no image or no coefficients", f"both, as acts = '{entry.acts}' needs them")
    image = entry.image
    maps = ImageMaps(
        image.kind, image.order, image.per_px, image.curvature, tuple(image.centres), image.pitch, image.nm
    )
    times = _times(entry.acts, entry.radius, len(entry.bands))
    wanted = (len(entry.bands), times * maps.count(entry.size))
    found = (len(entry.coefficients), *{len(row) for row in entry.coefficients})
    if found != wanted:
        expected = f"{wanted[0]} rows, one for each band, of {wanted[1]} numbers"
        raise InputError(f"{where}.coefficients", f"shape {found}", expected)
    return FittedField(
        entry.acts,
        tuple(entry.bands),
        np.array(entry.nm),
        entry.size,
        maps,
        entry.radius,
        entry.angle_deg,
        entry.most_dn,
        np.array(entry.coefficients),
    )


def _times(acts: Acts, radius: int, bands: int) -> int:
    """How often the image maps are used: once, or for every direction, neighbour, moment, width or band."""
    several = {"displacement": 2, "previous": bands, "levels": LEVELS}
    return several.get(acts, number_of_exchanges(acts, radius))


def _surface_map(entry: _Surface, where: str, bands: int) -> SurfaceMap:
    values = np.array(entry.values)
    places = entry.points if entry.points is not None else entry.waves
    if places is None or len(places) != len(values) or (entry.points is None) == (entry.waves is None):
        raise InputError(where, "values without places", "as many points or waves as values")
    spectrum = None if entry.spectrum is None else np.array(entry.spectrum)
    if spectrum is not None and len(spectrum) != bands:
        expected = f"{bands} numbers, one for each band"
        raise InputError(f"{where}.spectrum", f"{len(spectrum)} numbers", expected)
    if entry.points is not None:
        return PointMap(entry.surface, np.array(entry.points), values, spectrum)
    if entry.low is None or entry.extent is None:
        raise InputError(where, "waves without low and extent", "both, in mm")
    low, extent, waves = (np.array(numbers) for numbers in (entry.low, entry.extent, entry.waves))
    return WaveMap(entry.surface, low, extent, waves, values, spectrum)


def _rounded(values: Sequence[float] | NDArray[np.float64]) -> list[float]:
    return [float(f"{float(value):.{_DIGITS}g}") for value in values]
