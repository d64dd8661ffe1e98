"""Image stacks: the planes of a spectral cube, a map, or a capture, for `cbox compare`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.rendering.files import (
    AS_STATED,
    NOTES,
    RADIANCE_UNIT,
    READABLE,
    UNIT_AS_STORED,
    Declared,
    DeclaredPair,
    Window,
    camera_of_attribute,
    common_pixels,
    declared_for,
    radiance_as_stored,
    read_picture,
    stated_in,
    window_in_file,
    window_of,
)
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.input_files import require_regular_file
from numpy.typing import NDArray

from ..compare import read_map
from .cameras import Instrument, instrument_of
from .plain_pictures import PLAIN_ENDINGS, read_plain
from .regress import Side, cut_camera, cut_side, side_of

__all__ = ["ImageStack", "on_common_pixels", "read_compared", "read_stack", "stack_of_side"]

#: Unit where a file states none.
_OWN_UNIT = "the file's own unit"


@dataclass(frozen=True, eq=False)
class ImageStack(FrozenMappings):
    """Planes of one picture."""

    #: File or folder.
    source: Path
    #: Name of each plane.
    names: tuple[str, ...]
    #: (plane, y, x) values, NaN where unknown.
    values: NDArray[np.float64]
    #: (plane, y, x) variance of the values; None where unknown.
    variance: NDArray[np.float64] | None
    #: Unit of the values.
    unit: str
    #: Number of batches whose scatter gave the variance; 0 where it is known otherwise.
    batches: int = 0
    #: The same cube as a side of a regression; None for pictures that are no cubes.
    side: Side | None = None
    #: Camera and sensor of the picture.
    instrument: Instrument = field(default_factory=lambda: Instrument(None, {}))
    #: Place of the pixels in a larger picture; None for a complete picture.
    window: Window | None = None
    #: Notes of the file's reader.
    notes: tuple[str, ...] = ()
    #: Fields that the user declared and that were used.
    declared: tuple[str, ...] = ()
    #: Statements of the file by field, where they overrule the user's.
    file_statements: Mapping[str, str] = field(default_factory=dict)

    @property
    def pixels(self) -> Window:
        """Window of the pixels; the whole picture where ``window`` is None."""
        height, width = self.values.shape[1:]
        return self.window or Window(0, 0, width, height, (0, 0, width, height))

    def with_planes(self, names: Sequence[str]) -> ImageStack:
        """Planes with these names, in this order.

        Parameters
        ----------
        names
            Some of the stack's names.

        Returns
        -------
        ImageStack
            The planes, without ``side``. Values are not copied where all planes stay.
        """
        if tuple(names) == self.names:
            return replace(self, side=None)
        index = [self.names.index(name) for name in names]
        variance = None if self.variance is None else self.variance[index]
        return replace(self, names=tuple(names), values=self.values[index], variance=variance, side=None)


def read_compared(paths: tuple[Path, Path], declared: DeclaredPair) -> tuple[ImageStack, ImageStack]:
    """Two pictures that are compared.

    Where neither states a unit, their numbers are compared as they are. Planes of a layer, and planes without names,
    take the names of the other picture's planes.

    Parameters
    ----------
    paths
        Files or folders.
    declared
        Properties that the files do not state.

    Returns
    -------
    tuple of ImageStack
        The planes of both, with notes on units and names.

    Raises
    ------
    InputError
        As ``read_stack``.
    """
    each = [declared.of(index) for index in range(2)]
    first, second = (
        read_stack(path, properties)
        if properties.units
        else _read(path, replace(properties, units=UNIT_AS_STORED), properties)
        for path, properties in zip(paths, each, strict=True)
    )
    units = first.unit, second.unit
    if _OWN_UNIT in units and units[0] != units[1]:
        first, second = (read_stack(path, properties) for path, properties in zip(paths, each, strict=True))
    elif first.unit == _OWN_UNIT and {path.suffix.lower() for path in paths} != {".exr"}:
        first = replace(first, notes=(*first.notes, "no unit is stated: the numbers are compared as stored"))
    return _named_as(first, second), _named_as(second, first)


def _named_as(stack: ImageStack, other: ImageStack) -> ImageStack:
    """The stack with the other one's names, where its own are numbers or those of one layer."""
    if set(stack.names) & set(other.names):
        return stack
    if stack.names == tuple(map(str, range(len(other.names)))):
        note = f"{stack.source} has no names of planes: they are compared in their order"
        return replace(stack, names=other.names, notes=(*stack.notes, note))
    layers = {name.rpartition(".")[0] for name in stack.names}
    fitting = [layer for layer in layers if {f"{layer}.{name}" for name in other.names} <= set(stack.names)]
    if len(fitting) != 1:
        return stack
    note = f"{stack.source}: the layer {fitting[0]} is compared"
    names = tuple(name.removeprefix(f"{fitting[0]}.") for name in stack.names)
    return replace(stack, names=names, notes=(*stack.notes, note))


def read_stack(path: Path, declared: Declared = AS_STATED) -> ImageStack:
    """Planes of a spectral cube, a picture in colour, a map or a capture.

    Channels of an EXR file that is no spectral cube are taken as they are, unless anything is declared.

    Parameters
    ----------
    path
        File, or folder of a capture.
    declared
        Properties that the file does not state.

    Returns
    -------
    ImageStack
        The planes.

    Raises
    ------
    InputError
        If there is no such file, or if it is none of these or cannot be read.
    """
    return _read(path, declared, declared)


def _read(path: Path, declared: Declared, by_user: Declared) -> ImageStack:
    """Planes of a file or capture; ``by_user`` has the user's declarations alone."""
    if path.is_dir():
        return _capture_stack(path)
    if not path.exists():
        raise InputError(path, "no such file or folder", f"a capture folder, or a file {', '.join(READABLE)}")
    require_regular_file(path, f"a capture folder, or a file {', '.join(READABLE)}")
    if path.suffix.lower() in PLAIN_ENDINGS:
        names, values, notes = read_plain(path)
        return ImageStack(path, names, values, None, _OWN_UNIT, notes=tuple(notes))
    if declared.units == UNIT_AS_STORED and by_user == AS_STATED and (picture := radiance_as_stored(path)) is not None:
        values = np.moveaxis(picture["rgb"].values, -1, 0)
        return _as_read(ImageStack(path, tuple("RGB"), values, None, _OWN_UNIT), picture)
    if path.suffix.lower() == ".exr" and by_user == AS_STATED:
        channels, units = read_map(path)
        names = tuple(str(name) for name in channels["channel"].values)
        if not any(name.startswith("S0.") for name in names):
            unit = ", ".join(sorted(set(units.values()))) or _OWN_UNIT
            values = channels.values.astype(np.float64)
            return ImageStack(path, names, values, None, unit, window=window_in_file(path))
    picture = read_picture(path, declared)
    if "xyz" in picture:
        side = side_of([picture], [str(path)])
        return stack_of_side(_as_read(ImageStack(path, (), np.zeros(0), None, "", window=side.window), picture), side)
    stack = _cube_stack(path, picture)
    if declared.units != UNIT_AS_STORED or "units" not in stack.declared:
        return stack
    used = tuple(name for name in stack.declared if name != "units")
    return replace(stack, unit=_OWN_UNIT, side=None, declared=used)


def _cube_stack(path: Path, cube: xr.Dataset) -> ImageStack:
    """Stack of a spectral cube; a cube with unknown pixels has no ``side``."""
    names = tuple(f"{w:.10g} nm" for w in cube["wavelength"].values)
    instrument = Instrument(camera_of_attribute(cube.attrs.get("camera")), {})
    batches = int(cube["standard_error"].attrs.get("batches", 0)) if "standard_error" in cube else 0
    side = side_of([cube], [str(path)]) if np.isfinite(cube["radiance"].values).all() else None
    order = "wavelength", "y", "x"
    variance = None
    if "standard_error" in cube:
        if side is not None and side.variance is not None:
            variance = np.moveaxis(side.variance, -1, 0)
        else:
            variance = cube["standard_error"].transpose(*order).values.astype(np.float64) ** 2
    if side is not None:
        values = np.moveaxis(side.radiance, -1, 0)
    else:
        values = cube["radiance"].transpose(*order).values.astype(np.float64)
    stack = ImageStack(path, names, values, variance, RADIANCE_UNIT, batches, side, instrument, window_of(cube))
    return _as_read(stack, cube)


def _as_read(stack: ImageStack, picture: xr.Dataset) -> ImageStack:
    """The stack with what reading its picture left to say."""
    notes = tuple(f"{stack.source}: {note}" for note in str(picture.attrs.get(NOTES, "")).split("\n") if note)
    return replace(stack, notes=notes, declared=declared_for(picture), file_statements=stated_in(picture))


def _capture_stack(folder: Path) -> ImageStack:
    """Corrected signals of a capture over exposure / (f_number^2 image_distance^2).

    Captures of different exposures can then be compared.
    """
    from cboxlab.calibration.capture import load_capture
    from cboxlab.calibration.radiometry import optical_factor
    from cboxlab.calibration.result import calibrate_capture

    calibration = calibrate_capture(load_capture(folder))
    capture, images = calibration.capture, calibration.images
    factors = [optical_factor(capture, band) for band in capture.manifest.band]
    optics_known = all(factor is not None for factor in factors)
    seconds = [band.exposure_s for band in capture.manifest.band]
    divisor = np.array(factors if optics_known else seconds, float)[:, None, None]
    used = images["mask"].values == 0
    values = np.where(used, images["signal"].values, np.nan) / divisor
    return ImageStack(
        folder,
        capture.band_ids,
        values,
        images["variance"].values / divisor**2,
        "DN s^-1 mm^2" if optics_known else "DN s^-1",
        instrument=instrument_of(capture, calibration.camera),
    )


def on_common_pixels(first: ImageStack, second: ImageStack) -> tuple[ImageStack, ImageStack, list[str]]:
    """Two stacks cut to the pixels that both have.

    Parameters
    ----------
    first, second
        Stacks; a crop has a ``window``.

    Returns
    -------
    first, second : ImageStack
        The cut stacks; the arguments where both are complete.
    notes : list of str
        One note if pixels were cut away, otherwise none.

    Raises
    ------
    InputError
        If the stacks have no pixel in common, or belong to pictures of different sizes.
    """
    part = common_pixels(first.pixels, second.pixels, (str(first.source), str(second.source)))
    if part is None:
        return first, second, []
    note = f"compared in the {part.width} x {part.height} pixels that both have: {part}; x and y count from the first"
    return _cut(first, part), _cut(second, part), [note]


def _cut(stack: ImageStack, part: Window) -> ImageStack:
    """Planes of some pixels."""
    rows, columns = stack.pixels.slices(part)
    camera = stack.instrument.camera
    if camera is not None and (camera.height_px, camera.width_px) == stack.values.shape[1:]:
        camera = cut_camera(camera, stack.pixels, part)
    return replace(
        stack,
        values=stack.values[:, rows, columns],
        variance=None if stack.variance is None else stack.variance[:, rows, columns],
        side=None if stack.side is None else cut_side(stack.side, part),
        instrument=replace(stack.instrument, camera=camera),
        window=part,
    )


def stack_of_side(stack: ImageStack, side: Side) -> ImageStack:
    """Stack with the planes of a side of a regression.

    Parameters
    ----------
    stack
        Stack that gives source, batches and instrument.
    side
        Side that gives planes, variance and unit.

    Returns
    -------
    ImageStack
        The stack; its planes are views of the side's.
    """
    names = side.bands if side.in_colour else tuple(f"{name} nm" for name in side.bands)
    variance = None if side.variance is None else np.moveaxis(side.variance, -1, 0)
    values, unit = np.moveaxis(side.radiance, -1, 0), "cd m^-2" if side.in_colour else RADIANCE_UNIT
    return replace(stack, names=names, values=values, variance=variance, unit=unit, side=side)
