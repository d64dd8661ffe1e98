"""Sides of a regression: spectral cubes of one picture, and their noise."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.calibration.instrument import LUMINOUS_EFFICACY, OBSERVER_RANGE_NM
from cboxlab.rendering.files import (
    AS_STATED,
    NOTES,
    Declared,
    Window,
    camera_of_attribute,
    common_pixels,
    declared_for,
    negative_pixels,
    require_light,
    stated_in,
    window_of,
    xyz_weights,
)
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..scene_pictures import (
    AS_STORED,
    GUIDES,
    NotNumbers,
    lost_tiles,
    nearest_numbers,
    not_numbers,
    of_any,
    read_scene_picture,
)

__all__ = [
    "Side",
    "SurfaceIndices",
    "cut_camera",
    "cut_side",
    "filled_side",
    "in_common_quantity",
    "on_common_pixels",
    "read_side",
    "side_of",
    "sound_side",
]

#: Batches assumed behind a standard error whose cube does not state them: few, for cautious tests.
_ASSUMED_BATCHES = 4
#: Largest and, where there is light, smallest maximum of a picture: fourth powers of it are finite numbers.
_MAXIMA = (1e-70, 1e70)


@dataclass(frozen=True, eq=False)
class SurfaceIndices:
    """Surface that each pixel shows."""

    #: (y, x) index into ``names``; negative for the lamp and outside of the scene.
    index: NDArray[np.int64]
    #: Names of the surfaces.
    names: tuple[str, ...]
    #: (y, x) pixels that see the lamp; None where the map does not say so.
    lamp: NDArray[np.bool_] | None
    #: Whether the names are those of objects, which pictures of other noise have too.
    of_objects: bool = True


@dataclass(frozen=True, eq=False)
class Side(FrozenMappings):
    """One picture of a regression."""

    #: Name for messages: files, or a command.
    source: str
    #: (w,) wavelengths, nm; NaN in colour.
    wavelength_nm: NDArray[np.float64]
    #: (y, x, w) radiance, W m^-2 sr^-1 nm^-1; in colour X, Y, Z, cd m^-2, or R, G, B in a file's numbers.
    radiance: NDArray[np.float64]
    #: (y, x, w) variance of the radiance; None where unknown.
    variance: NDArray[np.float64] | None
    #: Degrees of freedom behind each variance.
    degrees: float
    #: Map of surfaces of the cube; None without one.
    surfaces: SurfaceIndices | None
    #: Remarks for the reader of a verdict.
    notes: tuple[str, ...] = ()
    #: Whether the three planes are colours, without wavelengths.
    in_colour: bool = False
    #: Fields of ``Declared`` that the user declared and that were used.
    declared: tuple[str, ...] = ()
    #: Camera that the file states; None without one.
    camera: Camera | None = None
    #: (2, y, x, w) standard deviations from the steps in which a file stores values: of each pixel, and of the part
    #: that neighbouring pixels share. None for fine steps.
    rounding: NDArray[np.float64] | None = None
    #: Statements of the file by field of ``Declared``, where they overrule the user's.
    file_statements: Mapping[str, str] = field(default_factory=dict)
    #: Place of the pixels in a larger picture; None for a complete picture.
    window: Window | None = None
    #: (b, y, x, w) radiance of the independent cubes whose mean the side is; None for a single cube.
    batches: NDArray[np.float64] | None = None
    #: Names of the three planes in colour.
    colours: tuple[str, ...] = ("X", "Y", "Z")
    #: (y, x, c) albedo, normal, depth by kind, where a file has them.
    guides: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    #: Name of the primaries of R, G, B as stored; empty where not stated.
    colour_space: str = ""
    #: Whether the user says that the other side's cubes have the same random numbers, in the same order.
    same_seeds: bool = False
    #: Pixels that are not numbers, in whose place the nearest ones stand; None without any.
    not_numbers: NotNumbers | None = None

    @property
    def as_stored(self) -> bool:
        """Whether the planes are R, G, B in a file's numbers."""
        return self.in_colour and self.colours == AS_STORED

    @property
    def pixels(self) -> Window:
        """The window, that of a complete picture included."""
        height, width = self.shape
        return self.window or Window(0, 0, width, height, (0, 0, width, height))

    @property
    def bands(self) -> tuple[str, ...]:
        """Name of each plane: wavelength in nm, X, Y, Z, or R, G, B."""
        return self.colours if self.in_colour else tuple(f"{w:.10g}" for w in self.wavelength_nm)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.radiance.shape[0], self.radiance.shape[1]

    def at(self, index: NDArray) -> Side:
        """Side at some of its wavelengths.

        Parameters
        ----------
        index
            Indices of the wavelengths.

        Returns
        -------
        Side
            The side; itself, without a copy, where ``index`` lists all wavelengths in order.
        """
        if np.array_equal(index, np.arange(self.wavelength_nm.size)):
            return self
        variance = None if self.variance is None else self.variance[..., index]
        return replace(
            self,
            wavelength_nm=self.wavelength_nm[index],
            radiance=self.radiance[..., index],
            variance=variance,
            batches=None if self.batches is None else self.batches[..., index],
        )


def filled_side(side: Side, missing: NDArray[np.bool_]) -> Side:
    """Side with the nearest other pixels in place of some.

    Parameters
    ----------
    side
        A side.
    missing
        (y, x) the pixels, not all of them.

    Returns
    -------
    Side
        The side with other radiance, errors and guides there.
    """
    index = nearest_numbers(missing)
    return replace(
        side,
        radiance=side.radiance[index],
        variance=None if side.variance is None else side.variance[index],
        rounding=None if side.rounding is None else side.rounding[:, *index],
        batches=None if side.batches is None else side.batches[:, *index],
        guides={kind: guide[index] for kind, guide in side.guides.items()},
    )


def _numbers_alone(side: Side, *, masked: bool = False) -> Side:
    """Side with its pixels that are not numbers replaced; itself without any.

    masked : whether NaN marks pixels that were not measured.
    """
    planes = side.bands if side.in_colour else [f"{band} nm" for band in side.bands]
    return _without(side, not_numbers(side.radiance, planes, side.source, masked=masked))


def _without(side: Side, absent: NotNumbers | None) -> Side:
    """Side with some pixels replaced by the nearest others; itself without any."""
    if absent is None:
        return side
    return replace(filled_side(side, absent.pixels), not_numbers=of_any([side.not_numbers, absent]))


def sound_side(side: Side) -> Side:
    """Side whose numbers can be compared.

    Sides of files have been checked before; those in memory have not. Pixels that are not numbers are replaced.

    Parameters
    ----------
    side
        A side.

    Returns
    -------
    Side
        The side, with a note on negative radiance.

    Raises
    ------
    InputError
        If the picture is empty or no pixel of it finite, or if a tenth of the light is below 0. If a variance is not
        finite, or if one is of extreme size or of another shape than stated.
    """
    shape = side.radiance.shape
    planes = len(side.bands)
    if len(shape) != 3 or 0 in shape or shape[2] != planes:
        expected = f"rows, columns and {planes} planes, at least one of each"
        raise InputError(f"{side.source}: radiance", f"shape {shape}", expected)
    if side.variance is not None and side.variance.shape != shape:
        fault = f"shape {side.variance.shape}"
        raise InputError(f"{side.source}: variance", fault, f"shape {shape}, as the radiance")
    side = _numbers_alone(side)
    if side.variance is not None:
        where = f"{side.source}: variance"
        _require_finite(side.variance, where, "a finite variance, or None where it is unknown")
        if side.variance.min() < 0:
            raise InputError(where, f"values below 0: {int((side.variance < 0).sum())}", "0 or more")
    low, high = (float(bound) for bound in (side.radiance.min(), side.radiance.max()))
    size = max(high, -low)
    if size and not _MAXIMA[0] < size < _MAXIMA[1]:
        expected = f"{_MAXIMA[0]:g} to {_MAXIMA[1]:g}, as of a lit picture in any unit"
        raise InputError(f"{side.source}: radiance", f"a largest value of {size:.3g}", expected)
    if low >= 0:
        return side
    picture = xr.Dataset({"radiance": (("y", "x", "plane"), side.radiance)})
    require_light(picture, side.source)
    negative = 0 if side.batches is not None else negative_pixels(picture)  # each file of several has its own note
    note = f"{side.source}: pixels of negative radiance: {negative}"
    return replace(side, notes=(*side.notes, note)) if negative and note not in side.notes else side


def _require_finite(values: NDArray[np.float64], where: str, expected: str) -> None:
    """Raise InputError for values (y, x, w) that are not finite, with their number and places."""
    if values.size == 0 or np.isfinite([values.min(), values.max()]).all():
        return
    rows, columns = np.nonzero(~np.isfinite(values).all(axis=-1))
    fault = f"pixels without a finite value: {rows.size}, the first at x {columns[0]}, y {rows[0]}"
    if rows.size > 1:
        fault += f"; all at x {columns.min()} to {columns.max()}, y {rows.min()} to {rows.max()}"
    raise InputError(where, fault, expected)


def on_common_pixels(first: Side, second: Side) -> tuple[Side, Side, tuple[str, ...]]:
    """Both sides, cut to the pixels that both have, and a note where something was cut.

    Parameters
    ----------
    first, second
        Sides of one picture; a file may hold a part of it.

    Returns
    -------
    first, second : Side
        The same sides where both are complete or hold the same pixels.
    notes : tuple of str
        One note, or none.

    Raises
    ------
    InputError
        If the sides have no pixel in common, or belong to pictures of different sizes.
    """
    part = common_pixels(first.pixels, second.pixels, (first.source, second.source))
    if part is None:
        return first, second, ()
    note = f"compared in the {part.width} x {part.height} pixels that both have: {part}; x and y count from the first"
    return cut_side(first, part), cut_side(second, part), (note,)


def cut_side(side: Side, part: Window) -> Side:
    """Side of some of its pixels.

    Parameters
    ----------
    side
        A side.
    part
        Pixels inside its window.

    Returns
    -------
    Side
        Radiance, errors, surfaces and camera of these pixels.
    """
    pixels = side.pixels
    rows, columns = pixels.slices(part)
    surfaces = side.surfaces
    if surfaces is not None:
        lamp = None if surfaces.lamp is None else surfaces.lamp[rows, columns]
        surfaces = replace(surfaces, index=surfaces.index[rows, columns], lamp=lamp)
    return replace(
        side,
        radiance=side.radiance[rows, columns],
        variance=None if side.variance is None else side.variance[rows, columns],
        rounding=None if side.rounding is None else side.rounding[:, rows, columns],
        batches=None if side.batches is None else side.batches[:, rows, columns],
        guides={kind: guide[rows, columns] for kind, guide in side.guides.items()},
        surfaces=surfaces,
        camera=None if side.camera is None else cut_camera(side.camera, pixels, part),
        window=part,
        not_numbers=None if side.not_numbers is None else side.not_numbers.at(rows, columns),
    )


def cut_camera(camera: Camera, pixels: Window, part: Window) -> Camera:
    """Camera of some pixels of a camera's picture.

    Parameters
    ----------
    camera
        Camera of the pixels ``pixels``.
    pixels
        The camera's pixels in the coordinates of ``part``.
    part
        The pixels to be seen.

    Returns
    -------
    Camera
        The same rays at the pixels of ``part``.
    """
    offset = np.array([part.left - pixels.left, part.top - pixels.top], float)
    return replace(
        camera,
        width_px=part.width,
        height_px=part.height,
        principal_point_px=camera.principal_point_px - offset,
    )


def read_side(paths: Sequence[Path], declared: Declared = AS_STATED) -> Side:
    """Mean of independent pictures of the same view, with variance from their scatter.

    Parameters
    ----------
    paths
        Cubes of the same size and wavelengths.
    declared
        Properties that the files do not state.

    Returns
    -------
    Side
        The mean.

    Raises
    ------
    InputError
        If a file cannot be read, if the pictures do not fit together or are equal, or if no pixel of one is finite.
    """
    return side_of([read_scene_picture(path, declared) for path in paths], [str(path) for path in paths])


def in_common_quantity(first: Side, second: Side) -> tuple[Side, Side]:
    """Both sides in spectral radiance, or both in X, Y, Z where one is in colour.

    Parameters
    ----------
    first, second
        The sides.

    Returns
    -------
    tuple of Side
        Both sides in one quantity.

    Raises
    ------
    InputError
        If one side alone is R, G, B as stored, or if both are of different primaries.
    """
    if first.as_stored != second.as_stored:
        stored, other = (first, second) if first.as_stored else (second, first)
        raise InputError(
            stored.source,
            "R, G, B of no stated unit and colour space",
            f"the quantity of {other.source}",
            "declare colour-space=NAME, units='cd m^-2' and scale=FACTOR to it.",
        )
    spaces = first.colour_space, second.colour_space
    if all(spaces) and spaces[0] != spaces[1]:
        raise InputError(second.source, f"R, G, B of {spaces[1]}", f"{spaces[0]}, as {first.source}")
    if first.in_colour == second.in_colour:
        return first, second
    return _in_colour(first), _in_colour(second)


def _in_colour(side: Side) -> Side:
    """X, Y, Z in cd m^-2 over the side's range of wavelengths, within the observer's table.

    The table of the CIE 1931 observer goes from 360 to 830 nm. Errors are those of fully correlated wavelengths.
    """
    if side.in_colour:
        return side
    weights = LUMINOUS_EFFICACY * xyz_weights(side.wavelength_nm)
    error = None if side.variance is None else np.sqrt(side.variance) @ np.abs(weights)
    low, high = np.clip(side.wavelength_nm[[0, -1]], *OBSERVER_RANGE_NM)
    return replace(
        side,
        wavelength_nm=np.full(3, np.nan),
        radiance=side.radiance @ weights,
        in_colour=True,
        variance=None if error is None else error**2,
        batches=None if side.batches is None else side.batches @ weights,
        notes=(*side.notes, f"{side.source}: compared in X, Y, Z over {low:g} to {high:g} nm; Y is luminance"),
    )


def side_of(cubes: Sequence[xr.Dataset], sources: Sequence[str]) -> Side:
    """Mean of independent cubes in memory; see ``read_side``.

    Parameters
    ----------
    cubes
        Cubes of the same size and wavelengths.
    sources
        Name of each, for messages.

    Returns
    -------
    Side
        The mean.

    Raises
    ------
    InputError
        If the cubes do not fit together or are equal, or if no pixel of one is finite.
    """
    sides = [_side_of_cube(cube, source) for cube, source in zip(cubes, sources, strict=True)]
    first = sides[0]
    for side in sides[1:]:
        if side.radiance.shape != first.radiance.shape or side.bands != first.bands:
            size = f"{side.shape[1]} x {side.shape[0]} px, {side.wavelength_nm.size} wavelengths"
            raise InputError(side.source, size, f"size and wavelengths of {first.source}, its companion")
        if side.pixels != first.pixels:
            raise InputError(side.source, f"the pixels {side.pixels}", f"{first.pixels}, as {first.source}")
    if len(sides) == 1:
        return first
    by_digest: dict[bytes, Side] = {}
    for side in sides:
        digest = hashlib.sha256(side.radiance.tobytes()).digest()
        if (same := by_digest.setdefault(digest, side)) is not side:
            expected = "pictures with independent random numbers, whose scatter gives their error"
            raise InputError(side.source, f"the same numbers as {same.source}", expected)
    lost = lost_tiles(np.stack([side.radiance for side in sides]), [side.source for side in sides])
    sides = [_without(side, tiles) for side, tiles in zip(sides, lost, strict=True)]
    stack, count = np.stack([side.radiance for side in sides]), len(sides)
    variances = [side.variance for side in sides if side.variance is not None]
    if len(variances) == count:
        variance, degrees = np.sum(variances, axis=0) / count**2, sum(side.degrees for side in sides)
    else:
        variance, degrees = stack.var(axis=0, ddof=1) / count, float(count - 1)
    companions = f"{first.source} and {count - 1} more"
    coarse = [side.rounding for side in sides if side.rounding is not None]
    return replace(
        first,
        source=", ".join(side.source for side in sides),
        radiance=stack.mean(axis=0),
        variance=variance,
        degrees=degrees,
        notes=(*_joined_notes(sides, companions), f"{companions}: mean of {count} independent cubes"),
        rounding=np.sum(coarse, axis=0) / count if coarse else None,
        batches=stack,
        not_numbers=of_any([side.not_numbers for side in sides]),
    )


def _joined_notes(sides: Sequence[Side], group: str) -> list[str]:
    """Notes of joined cubes, each shared one once; none on single standard errors."""
    every = [(s.source, n.removeprefix(f"{s.source}: ")) for s in sides for n in s.notes if "standard error" not in n]
    often = Counter(text for _, text in every)
    return list(dict.fromkeys(f"{group if often[text] == len(sides) else source}: {text}" for source, text in every))


def _side_of_cube(cube: xr.Dataset, source: str) -> Side:
    """Side of one cube, with notes on its standard error."""
    quantity = next(name for name in ("xyz", "rgb", "radiance") if name in cube)
    in_colour = quantity != "radiance"
    ordered = cube.transpose("y", "x", "component" if in_colour else "wavelength", ...)
    radiance = ordered[quantity].values.astype(np.float64)
    sound = np.isfinite(radiance).all(axis=-1)
    notes = [f"{source}: {note}" for note in str(cube.attrs.get(NOTES, "")).split("\n") if note]
    variance, degrees = None, 0.0
    if "standard_error" in cube:
        error = ordered["standard_error"].values.astype(np.float64)
        batches = int(cube["standard_error"].attrs.get("batches", 0))
        if batches < 2:
            batches = _ASSUMED_BATCHES
            notes.append(f"{source}: standard error of unknown batches, taken as {batches}")
        if np.all(np.isfinite(error[sound])) and np.any(error[sound] > 0):
            variance, degrees = error**2, batches - 1.0
        else:
            notes.append(f"{source}: its standard error is zero or not finite and is not used")
    if variance is None:
        notes.append(f"{source}: no standard error; noise is estimated inside smooth parts of the picture")
    wavelength = np.full(3, np.nan) if in_colour else ordered["wavelength"].values.astype(np.float64)
    side = Side(
        source,
        wavelength,
        radiance,
        variance,
        degrees,
        _surfaces(ordered),
        tuple(notes),
        in_colour,
        declared_for(cube),
        _camera(cube, *radiance.shape[:2]),
        _rounding(ordered),
        stated_in(cube),
        window_of(cube),
        colours=AS_STORED if quantity == "rgb" else ("X", "Y", "Z"),
        guides={kind: cube[f"guide_{kind}"].values for kind in GUIDES if f"guide_{kind}" in cube},
        colour_space=str(cube.attrs.get("colour_space", "")),
    )
    return _numbers_alone(side, masked=cube.attrs.get("missing") == "NaN")


def _camera(cube: xr.Dataset, height_px: int, width_px: int) -> Camera | None:
    """Camera that a cube states; None where it has another size."""
    camera = camera_of_attribute(cube.attrs.get("camera"))
    return camera if camera is not None and (camera.height_px, camera.width_px) == (height_px, width_px) else None


def _rounding(picture: xr.Dataset) -> NDArray[np.float64] | None:
    """(2, y, x, w) standard deviations from the steps of a file; None for fine steps."""
    if "rounding" not in picture:
        return None
    return np.stack([picture[name].values for name in ("rounding", "rounding_shared")])


def _surfaces(cube: xr.Dataset) -> SurfaceIndices | None:
    """Map of surfaces of a cube; None without one, or where it names too few."""
    if "surface" not in cube or set(cube["surface"].dims) != {"y", "x"}:
        return None
    surface = cube["surface"]
    names = tuple(name.strip() for name in str(surface.attrs.get("names", "")).split(",") if name.strip())
    index = surface.values.astype(np.int64)
    if not names:
        names = tuple(f"surface {i}" for i in range(int(index.max()) + 1))
    if index.max() >= len(names):
        return None
    if surface.attrs.get("lamp") == "unknown":
        return SurfaceIndices(index, names, None, bool(surface.attrs.get("of_objects", 0)))
    return SurfaceIndices(index, names, index == int(surface.attrs.get("lamp", -1)))
