"""What capture.toml may say: the tables and keys of the capture format, version 1, and their ranges.

Units are in the names of the keys. Every table refuses keys it does not know.
"""

from __future__ import annotations

from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
)

__all__ = [
    "BandTable",
    "BracketTable",
    "CameraTable",
    "CropTable",
    "DarkTable",
    "FlatTable",
    "GeometryTable",
    "LabelsTable",
    "LampTable",
    "LensTable",
    "Manifest",
    "MosaicTable",
    "ReferenceTable",
    "TargetTable",
]


def _inside(path: str) -> str:
    parts = PurePosixPath(path).parts
    if not path or "\\" in path or path.startswith("/") or ".." in parts or PureWindowsPath(path).drive:
        raise ValueError("a relative path with forward slashes that stays in the folder")
    return path


def _column(reference: str) -> str:
    name, _, column = reference.rpartition(":")
    if not name or not column:
        raise ValueError("a column of a file, 'file.csv:column'")
    return f"{_inside(name)}:{column}"


def _distinct(paths: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(paths)) != len(paths):
        raise ValueError("different files: a frame listed twice is no repeat")
    return paths


def _pattern(pattern: str) -> str:
    if len(pattern) != 4 or set(pattern) != {"R", "G", "B"}:
        raise ValueError("four letters of R, G and B, each at least once, such as 'GBRG'")
    return pattern


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


# The tags' angle brackets let fault messages tell them from keys.
def _kind(value: Any) -> str:
    return "<text>" if isinstance(value, str) else "<list>"


RelativePath = Annotated[str, AfterValidator(_inside)]
ColumnReference = Annotated[str, AfterValidator(_column)]
Frames = Annotated[
    tuple[RelativePath, ...], BeforeValidator(_tuple), Field(min_length=1), AfterValidator(_distinct)
]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(gt=0)]
Name = Annotated[str, Field(min_length=1)]


QuantumEfficiency = Annotated[
    Annotated[ColumnReference, Tag("<text>")]
    | Annotated[
        tuple[ColumnReference, ColumnReference, ColumnReference], BeforeValidator(_tuple), Tag("<list>")
    ],
    Discriminator(_kind),
]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class CameraTable(_Table):
    width_px: Count
    height_px: Count
    bit_depth: Annotated[int, Field(ge=1, le=16)]
    model: str | None = None
    pixel_pitch_um: Positive | None = None
    gain_e_per_dn: Positive | None = None
    read_noise_e: NotNegative | None = None
    readout_s: NotNegative = 1.2
    quantum_efficiency: QuantumEfficiency | None = None


class LensTable(_Table):
    focal_length_mm: Positive | None = None
    transmittance: ColumnReference | None = None


class DarkTable(_Table):
    frames: Frames
    exposure_s: Positive
    start_s: float | None = None


class BandTable(_Table):
    id: Name
    frames: Frames
    exposure_s: Positive
    transmittance: ColumnReference | None = None
    f_number: Positive | None = None
    image_distance_mm: Positive | None = None
    start_s: float | None = None


class BracketTable(_Table):
    band: Name
    frames: Frames
    exposure_s: Positive
    f_number: Positive | None = None
    image_distance_mm: Positive | None = None
    start_s: float | None = None


class FlatTable(BracketTable):
    radiance: ColumnReference | None = None


class ReferenceTable(BracketTable):
    radiance: ColumnReference


class LampTable(_Table):
    radiance: ColumnReference
    relative_uncertainty: NotNegative | None = None
    spectral_uncertainty: NotNegative | None = None


class GeometryTable(_Table):
    points: RelativePath
    point_sigma_px: Positive | None = None


class TargetTable(_Table):
    kind: Literal["chessboard", "circles", "charuco"]
    rows: Count
    columns: Count
    pitch_mm: Positive
    frames: Frames
    start_s: float | None = None


class MosaicTable(_Table):
    pattern: Annotated[str, AfterValidator(_pattern)]


class LabelsTable(_Table):
    image: RelativePath
    names: RelativePath
    reflectance: RelativePath | None = None


class CropTable(_Table):
    u0_px: Annotated[int, Field(ge=0)]
    v0_px: Annotated[int, Field(ge=0)]
    full_width_px: Count
    full_height_px: Count


DarkState = Annotated[
    Annotated[Literal["subtracted"], Tag("<text>")]
    | Annotated[tuple[DarkTable, ...], BeforeValidator(_tuple), Tag("<list>")],
    Discriminator(_kind),
]
FlatState = Annotated[
    Annotated[Literal["divided"], Tag("<text>")]
    | Annotated[tuple[FlatTable, ...], BeforeValidator(_tuple), Tag("<list>")],
    Discriminator(_kind),
]


class Manifest(_Table):
    """The whole of capture.toml. Tables that are absent are None or empty."""

    format: Literal["capture/1"]
    camera: CameraTable
    band: Annotated[tuple[BandTable, ...], BeforeValidator(_tuple), Field(min_length=1)]
    name: str = ""
    scene: str | None = None
    lens: LensTable = LensTable()
    dark: DarkState = ()
    flat: FlatState = ()
    reference: Annotated[tuple[ReferenceTable, ...], BeforeValidator(_tuple)] = ()
    bracket: Annotated[tuple[BracketTable, ...], BeforeValidator(_tuple)] = ()
    lamp: LampTable | None = None
    geometry: GeometryTable | None = None
    target: Annotated[tuple[TargetTable, ...], BeforeValidator(_tuple)] = ()
    mosaic: MosaicTable | None = None
    labels: LabelsTable | None = None
    crop: CropTable | None = None

    @property
    def darks(self) -> tuple[DarkTable, ...]:
        """The dark tables; empty where the frames' dark was subtracted before they were stored."""
        return self.dark if isinstance(self.dark, tuple) else ()

    @property
    def flats(self) -> tuple[FlatTable, ...]:
        """The flat tables; empty where the frames were divided by their flat before they were stored."""
        return self.flat if isinstance(self.flat, tuple) else ()
