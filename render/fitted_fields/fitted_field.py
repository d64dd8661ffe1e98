"""Fitted fields: their action, their maps and their strength in each band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import validated
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, Strict

from .exchange import IN_PLACE, PictureCopy, number_of_exchanges
from .image_maps import ImageMaps
from .levels import LEVELS
from .surface_maps import PointMap, SurfaceMap, WaveMap

__all__ = ["ON_SENSOR", "Acts", "FittedField", "field_of_record", "field_record", "number_of_uses"]

#: Quantity that a field changes.
#:
#: - offset: DN added to counts; levels: DN added to counts by the count above dark
#: - gain: relative change of counts above dark
#: - previous: parts of the counts above dark of the bands' frames, one after the other as in the fitted capture
#: - displacement: px to the right, then px down
#: - neighbours: light exchanged with pixels on opposite sides; moments: the second moments of a small blur
#: - halo: light exchanged in round Gaussians; streak: light exchanged in Gaussians along a line
#: - trail: light that lags behind along rows or columns; copy: light that makes another picture, mirrored or turned
#: - leak: charge that pixels of the raw frames give to the next one to the right, down, to the left, and up
#: - register: charge that lags behind along rows or columns of the raw frames
#: - lamp: relative change of the lamp's radiance
#: - reflectance: relative change of surfaces' reflectance
#: - irradiance: irradiance over pi on surfaces, relative to the lamp's radiance
#: - radiance: radiance of surfaces, relative to the lamp's, that lights nothing else
#: - front: part of the surfaces hidden by an object, whose radiance is relative to the lamp's
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
    "trail",
    "copy",
    "leak",
    "register",
    "lamp",
    "reflectance",
    "irradiance",
    "radiance",
    "front",
]

#: Actions on the picture or on counts, by maps over the picture.
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
    "trail",
    "copy",
    "leak",
    "register",
)

#: Significant digits of numbers in records: a relative rounding of 1e-6, far below the noise of a fit.
_DIGITS = 6


@dataclass(frozen=True, eq=False)
class FittedField:
    """Linear field: maps over the picture with coefficients, or maps on surfaces and a spectrum."""

    #: Quantity that the field changes.
    acts: Acts
    #: Names of the bands in which it was fitted.
    bands: tuple[str, ...]
    #: (band,) mean wavelengths of the bands, nm.
    nm: NDArray[np.float64]
    #: Rows and columns of the picture.
    size: tuple[int, int]
    #: Maps over the picture; None for a field of the scene.
    image: ImageMaps | None = None
    #: Largest distance of "neighbours" along rows and columns, px.
    radius: int = 1
    #: Angle of a "streak", a "trail" or a "register" from the rows downwards, degrees.
    angle_deg: float = 0.0
    #: Highest count above dark of "levels", DN.
    most_dn: float = 1.0
    #: (band, uses x maps) coefficients of the image maps, uses outermost; see ``number_of_uses``. None without maps.
    coefficients: NDArray[np.float64] | None = None
    #: The picture of a "copy", with its place.
    picture_copy: PictureCopy = IN_PLACE
    #: Maps on surfaces; empty for a field on the sensor or on a lamp.
    surfaces: tuple[SurfaceMap, ...] = ()
    #: (band,) factor of the maps on surfaces, relative change of a lamp, or radiance of an object in front.
    spectrum: NDArray[np.float64] | None = None


#: Lists of numbers of a fixed length.
_Two = Annotated[tuple[float, float], Strict(False)]
_Three = Annotated[tuple[float, float, float], Strict(False)]
_Pair = Annotated[tuple[int, int], Strict(False)]


class _Strict(BaseModel):
    """Table without unknown keys and without infinite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Image(_Strict):
    """Image maps of a record, see ``ImageMaps``."""

    kind: Literal["rows", "columns", "pixels", "repeat", "quarters", "cosines", "wave", "bells"]
    order: int = Field(0, ge=0, le=40)
    per_px: _Two = (0.0, 0.0)
    curvature: float = 0.0
    centres: list[_Two] = Field(default_factory=list)
    pitch: float = Field(1.0, gt=0)
    nm: float = Field(0.0, ge=0)
    repeat: _Pair = (1, 1)


class _Surface(_Strict):
    """Map on a surface of a record: waves with ``low`` and ``extent``, or points."""

    surface: str
    low: _Three | None = None
    extent: _Three | None = None
    waves: list[_Three] | None = None
    points: list[_Three] | None = None
    values: list[float] = Field(min_length=1)
    spectrum: list[float] | None = None


class _Field(_Strict):
    """Record of a field, see ``FittedField``."""

    acts: Acts
    bands: list[str] = Field(min_length=1)
    nm: list[float] = Field(min_length=1)
    size: _Pair
    image: _Image | None = None
    radius: int = Field(1, ge=1, le=8)
    angle_deg: float = Field(0.0, ge=0, lt=360)
    turns: int = Field(0, ge=0, le=3)
    mirrored: bool = False
    shift_px: _Pair = (0, 0)
    blur_px: Annotated[float, Strict(False)] = 0.0
    most_dn: float = Field(1.0, gt=0)
    coefficients: list[list[float]] | None = None
    surfaces: list[_Surface] = Field(default_factory=list)
    spectrum: list[float] | None = None


class _Holder(_Strict):
    """Table around the record, so that messages name keys as ``field.KEY``."""

    field: _Field


def field_record(field: FittedField) -> dict[str, Any]:
    """Record of a field, ready for JSON and TOML.

    Parameters
    ----------
    field
        The field.

    Returns
    -------
    dict
        Numbers, strings, lists and dicts, numbers to 6 significant digits. Values that the field does not use are
        missing.
    """
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
        if field.acts in ("streak", "trail", "register"):
            record["angle_deg"] = field.angle_deg
        if field.acts == "copy":
            record["turns"], record["mirrored"] = field.picture_copy.turns, field.picture_copy.mirrored
            record["shift_px"] = list(field.picture_copy.shift_px)
            if field.picture_copy.blur_px:
                record["blur_px"] = field.picture_copy.blur_px
        if field.acts == "levels":
            record["most_dn"] = float(f"{field.most_dn:.{_DIGITS}g}")
        record["coefficients"] = [_rounded(row) for row in field.coefficients]
    if field.spectrum is not None:
        record["spectrum"] = _rounded(field.spectrum)
    if field.surfaces:
        record["surfaces"] = [_surface_record(surface_map) for surface_map in field.surfaces]
    return record


def _image_record(maps: ImageMaps) -> dict[str, Any]:
    """Record of image maps, with the values that their kind uses."""
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
    if maps.kind == "repeat":
        return {"kind": maps.kind, "repeat": list(maps.repeat)}
    return {"kind": maps.kind}


def _surface_record(surface_map: SurfaceMap) -> dict[str, Any]:
    """Record of a map on a surface."""
    if isinstance(surface_map, PointMap):
        record: dict[str, Any] = {"points": [_rounded(point) for point in surface_map.points]}
    else:
        waves = [_rounded(wave) for wave in surface_map.waves]
        record = {"low": _rounded(surface_map.low), "extent": _rounded(surface_map.extent), "waves": waves}
    if surface_map.spectrum is not None:
        record["spectrum"] = _rounded(surface_map.spectrum)
    return {"surface": surface_map.surface, **record, "values": _rounded(surface_map.values)}


def field_of_record(record: Any, path: Path) -> FittedField:
    """Field of a record.

    Parameters
    ----------
    record
        Table ``field`` of an effect file, see ``field_record``.
    path
        The file, for messages.

    Returns
    -------
    FittedField
        The field.

    Raises
    ------
    InputError
        If the record is not a field; all faults of its keys are named.
    """
    entry = validated(path, {"field": record}, _Holder).field
    where = f"{path}: field"
    bands = len(entry.bands)
    if len(entry.nm) != bands:
        raise InputError(f"{where}.nm", f"{len(entry.nm)} numbers", f"{bands}, one for each band")
    if entry.acts in ON_SENSOR:
        return _image_field(entry, where)
    if entry.spectrum is None or len(entry.spectrum) != bands:
        size = "nothing" if entry.spectrum is None else f"{len(entry.spectrum)} numbers"
        raise InputError(f"{where}.spectrum", size, f"{bands} numbers, one for each band")
    if not entry.surfaces and entry.acts != "lamp":
        raise InputError(f"{where}.surfaces", "nothing", "one map or more")
    surfaces = tuple(_surface_map(table, f"{where}.surfaces[{i}]", bands) for i, table in enumerate(entry.surfaces))
    return FittedField(
        entry.acts,
        tuple(entry.bands),
        np.array(entry.nm),
        entry.size,
        surfaces=surfaces,
        spectrum=np.array(entry.spectrum),
    )


def _image_field(entry: _Field, where: str) -> FittedField:
    """Field on the sensor, of a record."""
    if entry.image is None or entry.coefficients is None:
        raise InputError(where, "no image or no coefficients", f"both, as acts = '{entry.acts}' needs them")
    image = entry.image
    maps = ImageMaps(
        image.kind,
        image.order,
        image.per_px,
        image.curvature,
        tuple(image.centres),
        image.pitch,
        image.nm,
        image.repeat,
    )
    uses = number_of_uses(entry.acts, entry.radius, len(entry.bands))
    required = (len(entry.bands), uses * maps.count(entry.size))
    shape = (len(entry.coefficients), *{len(row) for row in entry.coefficients})
    if shape != required:
        expected = f"{required[0]} rows, one for each band, of {required[1]} numbers"
        raise InputError(f"{where}.coefficients", f"shape {shape}", expected)
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
        PictureCopy(entry.turns, entry.mirrored, entry.shift_px, entry.blur_px),
    )


def number_of_uses(acts: Acts, radius: int, bands: int) -> int:
    """Number of times that a field uses its image maps, each time with other coefficients.

    Parameters
    ----------
    acts
        Action of the field.
    radius
        Largest distance of neighbours along rows and columns, px.
    bands
        Number of bands.

    Returns
    -------
    int
        2 for displacements (to the right, then down), one for each exchange, level or previous frame, otherwise 1.
    """
    several = {"displacement": 2, "previous": bands, "levels": LEVELS}
    return several.get(acts, number_of_exchanges(acts, radius))


def _surface_map(entry: _Surface, where: str, bands: int) -> SurfaceMap:
    """Map on a surface, of a record."""
    values = np.array(entry.values)
    arguments = entry.points if entry.points is not None else entry.waves
    if arguments is None or len(arguments) != len(values) or (entry.points is None) == (entry.waves is None):
        raise InputError(where, "values without points or waves", "as many points or waves as values")
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
    """Numbers rounded to the significant digits of records."""
    return [float(f"{float(value):.{_DIGITS}g}") for value in values]
