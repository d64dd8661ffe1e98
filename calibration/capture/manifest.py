"""The tables and keys of capture.toml (capture format, version 1) and their ranges.

Units are in the names of the keys. Unknown keys are errors.
"""

from __future__ import annotations

from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal

from cboxlab.scenes import NAMED_CAMERA, camera_columns, camera_names, named_camera_channel, within_limits
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
)

__all__ = [
    "BandTable",
    "BracketTable",
    "CameraTable",
    "CropTable",
    "DarkTable",
    "DefaultsTable",
    "FlatTable",
    "GeometryTable",
    "LabelsTable",
    "LampTable",
    "LensTable",
    "MosaicTable",
    "NoiseTable",
    "ReferenceTable",
    "TargetTable",
    "channel_letters",
    "checked_pattern",
    "example_of",
    "is_channel",
    "pattern_rows",
    "split_channel",
]


#: Rows and columns of a mosaic's repeat, at most; X-Trans has 6 x 6.
_MAX_REPEAT = 16


def _inside(path: str) -> str:
    """The path itself; ValueError for one that leaves the folder or is not portable."""
    parts = PurePosixPath(path).parts
    if not path or "\\" in path or path.startswith("/") or ".." in parts or PureWindowsPath(path).drive:
        raise ValueError("a relative path with forward slashes that stays in the folder")
    return path


def _column(reference: str) -> str:
    """The column reference itself; ValueError for one that is not ``file.csv:column``."""
    name, _, column = reference.rpartition(":")
    if reference.startswith(NAMED_CAMERA):
        if named_camera_channel(reference) is None:
            raise ValueError(f"a channel of a known camera, such as '{NAMED_CAMERA}{camera_names()[0]}:R'")
        return reference
    if not name or not column:
        raise ValueError("a column of a file, 'file.csv:column'")
    return f"{_inside(name)}:{column}"


def _of_camera(value: Any) -> Any:
    """The table of a named camera's channels; any other value itself."""
    if not isinstance(value, str) or not value.startswith(NAMED_CAMERA):
        return value
    columns = camera_columns(value.removeprefix(NAMED_CAMERA))
    if columns is None:
        raise ValueError(f"a known camera: {', '.join(NAMED_CAMERA + name for name in camera_names())}")
    return columns


def _distinct(paths: tuple[str, ...]) -> tuple[str, ...]:
    """The paths themselves; ValueError if one occurs twice."""
    if len(set(paths)) != len(paths):
        raise ValueError("different files, each frame listed once")
    return paths


def pattern_rows(pattern: str) -> tuple[str, ...]:
    """Rows of one repeat of a mosaic.

    Parameters
    ----------
    pattern
        Letters row by row: four letters for 2 x 2 pixels, or rows separated by a space.

    Returns
    -------
    tuple
        One string per row, from the upper left pixel of the frame on.
    """
    return tuple(pattern.split(" ")) if " " in pattern else (pattern[:2], pattern[2:])


def channel_letters(pattern: str) -> tuple[str, ...]:
    """Letters of a mosaic's channels.

    Parameters
    ----------
    pattern
        Letters of one repeat, see ``pattern_rows``.

    Returns
    -------
    tuple
        R, G, B first where the pattern has them, then the others in reading order.
    """
    letters = dict.fromkeys(pattern.replace(" ", ""))
    return (*(letter for letter in "RGB" if letter in letters), *(letter for letter in letters if letter not in "RGB"))


def split_channel(channel: str) -> tuple[str, int | None]:
    """Letter of a channel, and which of its pixels in one repeat.

    Parameters
    ----------
    channel
        A letter, or a letter and a number: "G", "G2".

    Returns
    -------
    tuple
        Letter, and the number from 1 on in reading order; None for all pixels of the letter.
    """
    return channel[:1], int(channel[1:]) if channel[1:].isdecimal() else None


def is_channel(pattern: str, channel: str) -> bool:
    """Whether a mosaic has a channel.

    Parameters
    ----------
    pattern
        Letters of one repeat, see ``pattern_rows``.
    channel
        A letter, or a letter and a number: "G", "G2".

    Returns
    -------
    bool
        True if the pattern has the letter, and as many pixels of it as the number says.
    """
    letter, number = split_channel(channel)
    if letter not in channel_letters(pattern):
        return False
    return channel == letter if number is None else 1 <= number <= pattern.count(letter)


def checked_pattern(pattern: str) -> str:
    """A mosaic pattern, unchanged.

    Parameters
    ----------
    pattern
        Letters of one repeat, see ``pattern_rows``.

    Returns
    -------
    str
        The pattern itself.

    Raises
    ------
    ValueError
        If it is no repeat of two letters or more.
    """
    rows = pattern_rows(pattern)
    letters = "".join(rows)
    one_length = len({len(row) for row in rows}) == 1 and (" " in pattern or len(pattern) == 4)
    is_channels = letters.isalpha() and len(set(letters)) > 1
    if not one_length or not is_channels or max(len(rows), len(rows[0])) > _MAX_REPEAT:
        raise ValueError(
            "four letters, one a pixel, of two channels or more, such as 'GBRG', or rows of the same length, separated "
            f"by a space, for another repeat of at most {_MAX_REPEAT} x {_MAX_REPEAT} pixels"
        )
    return pattern


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


# Angle brackets distinguish these tags from keys in the location of a validation error.
def _kind(value: Any) -> str:
    return "<text>" if isinstance(value, str) else "<list>"


def _kind_or_table(value: Any) -> str:
    return "<table>" if isinstance(value, dict) else _kind(value)


def _number_or_table(value: Any) -> str:
    return "<table>" if isinstance(value, dict) else "<number>"


RelativePath = Annotated[str, AfterValidator(_inside)]
ColumnReference = Annotated[str, AfterValidator(_column)]
Frames = Annotated[tuple[RelativePath, ...], BeforeValidator(_tuple), Field(min_length=1), AfterValidator(_distinct)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(gt=0)]
Name = Annotated[str, Field(min_length=1)]
Triple = Annotated[tuple[float, float, float], BeforeValidator(_tuple)]
Window = Annotated[tuple[int, int, int, int], BeforeValidator(_tuple)]
Coefficients = Annotated[tuple[float, ...], BeforeValidator(_tuple)]
QuantumEfficiency = Annotated[
    Annotated[ColumnReference, Tag("<text>")]
    | Annotated[tuple[ColumnReference, ColumnReference, ColumnReference], BeforeValidator(_tuple), Tag("<list>")]
    | Annotated[dict[Name, ColumnReference], Tag("<table>")],
    Discriminator(_kind_or_table),
    BeforeValidator(_of_camera),
]
BlackLevel = Annotated[
    Annotated[NotNegative, Tag("<number>")] | Annotated[dict[Name, NotNegative], Tag("<table>")],
    Discriminator(_number_or_table),
]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _possible(cls, value: Any, key: ValidationInfo) -> Any:
        """The value itself; ValueError for a number that no laboratory has, see ``PHYSICAL_LIMITS``."""
        return within_limits(key.field_name or "", value)


def _key(description: str, example: str, default: Any = ...) -> Any:
    """A key of a table with its description and an example in TOML; required without a default."""
    return Field(default, description=description, examples=[example])


_FRAMES = (
    "repeats of one exposure, averaged: files of linear counts, one channel (TIFF, FITS, camera raw); a file with "
    "several pictures counts as that many repeats, and 'file.fits[2]' is its third one"
)
_EXPOSURE = "exposure time, s"
_F_NUMBER = "f-number of the lens"
_DISTANCE = "distance from the lens to the image, mm; the focal length for an object far away"
_START = "when the first repeat began, s since the capture's first frame; for drifts and their order"
_BAND = "id of the band"


class CameraTable(_Table):
    """The sensor."""

    width_px: Count = _key("columns of every frame", "256")
    height_px: Count = _key("rows of every frame", "256")
    bit_depth: Annotated[int, Field(ge=1, le=16)] = _key(
        "bits of a count, which runs from 0 to 2^bit_depth - 1; the largest one means saturated", "12"
    )
    model: str | None = _key("the camera's name", '"PXL 1300L"', None)
    pixel_pitch_um: Positive | None = _key(
        "distance of neighbouring pixels, um, square pixels; for the absolute scale and the first guess of the camera",
        "9.0",
        None,
    )
    gain_e_per_dn: Positive | None = _key(
        "electrons per count; measured from repeats where there are any", "12.0", None
    )
    read_noise_e: NotNegative | None = _key(
        "rms of the read noise, electrons; measured from repeats where there are any", "10.0", None
    )
    binning: Count | None = _key(
        "side of the square blocks whose counts are summed; where left out, frames above 4 megapixels have about 256 "
        "sums across the surveyed points; behind a [mosaic] of c x c pixels 2 k c + 1, such as 5, 9 or 13 for c = 2",
        "8",
        None,
    )
    window_px: Window | None = _key(
        "first column, first row, columns and rows in use; as binning, half their extent around the surveyed points",
        "[1200, 300, 3600, 3400]",
        None,
    )
    readout_s: NotNegative = _key("time between the end of a repeat and the start of the next, s", "1.2", 1.2)
    quantum_efficiency: QuantumEfficiency | None = _key(
        "electrons per photon, 0 to 1; with a [mosaic] a table, a column for each letter, a list for R, G, B, or a "
        "camera that colour-science knows, 'camera:NAME'",
        '"spectra/camera.csv:quantum_efficiency"',
        None,
    )
    black_level_dn: BlackLevel | None = _key(
        "counts of no light and no exposure, where no darks say it, or a table with one for each channel; that of the "
        "raw files where left out",
        "512",
        None,
    )
    white_level_dn: Positive | None = _key(
        "counts from which a pixel is saturated, below the largest count; that of the raw files where left out",
        "16000",
        None,
    )


class LensTable(_Table):
    """The lens."""

    focal_length_mm: Positive | None = _key(
        "nominal focal length, mm; for the absolute scale and the first guess of the camera", "35.0", None
    )
    transmittance: ColumnReference | None = _key("of the lens, 0 to 1", '"spectra/camera.csv:lens"', None)
    fx_px: Positive | None = _key(
        "horizontal focal length, px, where it was calibrated beforehand; then it is not fitted", "3012.4", None
    )
    fy_px: Positive | None = _key("vertical focal length, px; that of fx_px where left out", "3011.8", None)
    distortion: Coefficients | None = _key(
        "OpenCV's k1, k2, p1, p2, k3, or k1 to k4 of a fisheye, where they were calibrated beforehand; then they are "
        "not fitted",
        "[-0.12, 0.08, 0.0003, -0.0002, 0.0]",
        None,
    )
    model: Literal["fisheye"] | None = _key(
        "OpenCV's fisheye model; the points choose between it and the polynomial where left out", '"fisheye"', None
    )


class DarkTable(_Table):
    """Frames with the shutter closed; one table per exposure time in use."""

    frames: Frames = _key(_FRAMES, '["frames/dark-4s-0.tif", "frames/dark-4s-1.tif"]')
    exposure_s: Positive = _key(_EXPOSURE, "4.0")
    start_s: float | None = _key(_START, "120.0", None)


class BandTable(_Table):
    """The scene through one filter.

    One table per filter, in the order in which they were taken. A capture has at least one.
    """

    id: Name = _key("a name of your choice, by which other tables speak of the band", '"f550"')
    frames: Frames = _key(_FRAMES, '["frames/f550-0.tif", "frames/f550-1.tif"]')
    exposure_s: Positive = _key(_EXPOSURE, "4.0")
    transmittance: ColumnReference | None = _key("of the filter, 0 to 1", '"spectra/filters.csv:f550"', None)
    channel: Name | None = _key(
        "channel of the [mosaic] whose pixels the band sees; 'G2' is the second G of the pattern in reading order; "
        "chosen by the filter where left out",
        '"R"',
        None,
    )
    f_number: Positive | None = _key(_F_NUMBER, "8.0", None)
    image_distance_mm: Positive | None = _key(_DISTANCE, "36.6", None)
    start_s: float | None = _key(_START, "0.0", None)


class BracketTable(_Table):
    """A further exposure of a band, for linearity and the exposure offset."""

    band: Name = _key(_BAND, '"f550"')
    frames: Frames = _key(_FRAMES, '["frames/f550-1s-0.tif"]')
    exposure_s: Positive = _key(_EXPOSURE, "1.0")
    f_number: Positive | None = _key(f"{_F_NUMBER}; the band's where left out", "8.0", None)
    image_distance_mm: Positive | None = _key(f"{_DISTANCE}; the band's where left out", "36.6", None)
    start_s: float | None = _key(_START, "60.0", None)


class FlatTable(BracketTable):
    """A uniform field through the same lens and filter: vignetting and pixel sensitivities."""

    radiance: ColumnReference | None = _key(
        "of the field, W m^-2 sr^-1 nm^-1; that of the reference source where left out",
        '"spectra/flat.csv:radiance"',
        None,
    )


class ReferenceTable(BracketTable):
    """A source of known spectral radiance that fills the field, for the absolute scale."""

    radiance: ColumnReference = _key("of the source, W m^-2 sr^-1 nm^-1", '"spectra/sphere.csv:radiance"')


class LampTable(_Table):
    """The light of the scene."""

    radiance: ColumnReference = _key(
        "of the lamp's surface, by spectroradiometer, W m^-2 sr^-1 nm^-1", '"spectra/lamp.csv:radiance"'
    )
    relative_uncertainty: NotNegative | None = _key(
        "relative standard deviation of its scale, common to all wavelengths", "0.02", None
    )
    spectral_uncertainty: NotNegative | None = _key(
        "relative standard deviation of its spectrum, beyond the scale; its spectrum is taken as exact where left out",
        "0.01",
        None,
    )


class GeometryTable(_Table):
    """Surveyed points of the box and where the image shows them."""

    points: RelativePath = _key("CSV with the columns id, x_mm, y_mm, z_mm, u_px, v_px", '"points.csv"')
    point_sigma_px: Positive | None = _key(
        "standard deviation of u and v each, px; estimated from the scatter where left out", "0.15", None
    )


class TargetTable(_Table):
    """A flat calibration target, photographed in several positions."""

    kind: Literal["chessboard", "circles", "charuco"] = _key("what is printed on it", '"chessboard"')
    rows: Count = _key("rows of circles, or of inner corners between squares", "6")
    columns: Count = _key("the same for columns", "9")
    pitch_mm: Positive = _key("distance of neighbouring corners or circles, mm; measure it on the print", "25.0")
    frames: Frames = _key("one frame for each position of the target", '["frames/target-0.tif", "frames/target-1.tif"]')
    start_s: float | None = _key(_START, "0.0", None)
    origin_mm: Triple | None = _key(
        "where the first inner corner or circle lies in the box, mm; then the board gives the camera's pose",
        "[100.0, 50.0, 0.0]",
        None,
    )
    right: Triple | None = _key(
        "unit vector along the rows of the board, in the box's axes; with origin_mm", "[-1.0, 0.0, 0.0]", None
    )
    down: Triple | None = _key(
        "unit vector along the columns of the board, in the box's axes; with origin_mm", "[0.0, -1.0, 0.0]", None
    )


class MosaicTable(_Table):
    """A colour filter array on the sensor."""

    pattern: Annotated[str, AfterValidator(checked_pattern)] = _key(
        "channels of the upper left 2 x 2 pixels, a letter each, row by row; of another repeat, its rows separated by "
        "a space",
        '"RGGB"',
    )


class LabelsTable(_Table):
    """Patches of a chart, by a label per pixel."""

    image: RelativePath | None = _key(
        "8-bit PNG of one channel, a label per pixel, 0 for none; where left out a ColorChecker is found in the "
        "picture, and its patches have the labels 1 (dark skin) to 24 (black)",
        '"labels.png"',
        None,
    )
    names: RelativePath = _key(
        "CSV: label, name, column of the reflectances; pixels of the name 'excluded' are left out", '"labels.csv"'
    )
    reflectance: RelativePath | None = _key(
        "CSV of known reflectances; a label without a column there has none", '"reflectance.csv"', None
    )


class CropTable(_Table):
    """The frames are a window of a larger one."""

    u0_px: Annotated[int, Field(ge=0)] = _key("first column of the window", "128")
    v0_px: Annotated[int, Field(ge=0)] = _key("first row of the window", "64")
    full_width_px: Count = _key("columns of the whole frame", "1280")
    full_height_px: Count = _key("rows of the whole frame", "1024")


class NoiseTable(_Table):
    """The noise of merged pictures: every frame holds floating-point values in place of counts."""

    kind: Literal["repeats", "poisson", "estimated"] = _key(
        "where it is known from: 'repeats' of the frames, 'poisson' by the two keys below, or 'estimated' from "
        "neighbouring pixels",
        '"poisson"',
    )
    gain_e_per_unit: Positive | None = _key("of 'poisson': electrons per unit of the pictures", "1.2e4", None)
    read_noise_e: NotNegative | None = _key("of 'poisson': rms noise of a dark pixel, electrons", "8.0", None)


class DefaultsTable(_Table):
    """Values for every table of frames that does not state its own."""

    f_number: Positive | None = _key(f"{_F_NUMBER} of every band that states none", "8.0", None)
    image_distance_mm: Positive | None = _key(f"{_DISTANCE}; of every band that states none", "36.6", None)
    exposure_s: Positive | None = _key(f"{_EXPOSURE} of every table of frames that states none", "0.5", None)
    radiance: ColumnReference | None = _key(
        "of every flat and reference that states none, W m^-2 sr^-1 nm^-1", '"spectra/sphere.csv:radiance"', None
    )


def example_of(table: type[BaseModel], key: str) -> str:
    """Example of a key as a line of TOML, such as ``exposure_s = 4.0``.

    Parameters
    ----------
    table
        A table of the manifest.
    key
        Name of the key.

    Returns
    -------
    str
        Empty for an unknown key or one without an example.
    """
    field = table.model_fields.get(key)
    return f"{key} = {field.examples[0]}" if field is not None and field.examples else ""
