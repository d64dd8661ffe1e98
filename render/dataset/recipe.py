"""Recipe of a data set: a TOML file of distributions; docs/how-to/data-set.md describes it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, Strict

from .distributions import Numbers, Texts, WholeNumbers, Within, numbers
from .patterns import MOST_TILES
from .textures import MOST_FEATURES

__all__ = [
    "ANY",
    "TRUTHS",
    "WALLS",
    "BlockTable",
    "CameraTable",
    "EffectTable",
    "LampTable",
    "PaintTable",
    "PatternTable",
    "PictureTable",
    "Recipe",
    "SensorTable",
    "TextureTable",
]

#: Most paints of a recipe: memory and time of a picture grow with the cube of their number.
MOST_PAINTS = 6

#: Name of a material, surface or block in an effect's table that stands for any of its kind.
ANY = "any"

#: Walls of a box.
WALLS = ("floor", "ceiling", "back", "right", "left")

#: Variables of a picture beyond radiance, its standard error and the labels, which every picture has.
TRUTHS = (
    "xyz",
    "coverage",
    "depth",
    "position",
    "normal",
    "albedo",
    "irradiance",
    "specular",
    "reflections",
    "shadow",
    "effects_light",
)

#: Names of paints, cameras and sensors: they become names of files and variables.
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]{0,31}$")]


class _Table(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )


def _constant(value: float) -> Numbers:
    """Distribution of one number."""
    return numbers(value)


class RoomTable(_Table):
    """Size of the box, inside, mm."""

    width_mm: Within(50, 20000) = _constant(556.0)  # type: ignore[valid-type]
    height_mm: Within(50, 20000) = _constant(548.8)  # type: ignore[valid-type]
    depth_mm: Within(50, 20000) = _constant(559.2)  # type: ignore[valid-type]


class PaintTable(_Table):
    """A paint: its reflectance is drawn for every box."""

    reflectance: Texts
    scale: Within(0, 10) = _constant(1.0)  # type: ignore[valid-type]


class PatternTable(_Table):
    """Rectangular tiles of a wall, or of each side of a block, each of one paint."""

    kind: Literal["checker", "stripes", "random", "image"] = "checker"
    #: Paints of the tiles, in the order of an image's grey levels.
    paints: Annotated[list[Name], Field(min_length=2, max_length=MOST_PAINTS)]
    #: Tiles along the wall's height (a floor's depth) and its width, unless an image has them.
    rows: WholeNumbers(1, MOST_TILES) = _constant(8)  # type: ignore[valid-type]
    columns: WholeNumbers(1, MOST_TILES) = _constant(8)  # type: ignore[valid-type]
    #: Grey image with a pixel for each tile; None for other kinds.
    image: str | None = None


class TextureTable(_Table):
    """Reflectance between those of two paints, which varies over walls and blocks without steps."""

    kind: Literal["noise", "image"] = "noise"
    #: The two paints: that of the image's black, or of shares 0, first.
    paints: Annotated[list[Name], Field(min_length=2, max_length=2)]
    #: Bright and dark places of a noise along each edge of a surface.
    features: Within(1, MOST_FEATURES) = numbers([2.0, 12.0])  # type: ignore[valid-type]
    #: Range of a noise's shares about one half.
    contrast: Within(0, 1) = _constant(1.0)  # type: ignore[valid-type]
    #: Grey image, black for the first paint and white for the second; None for other kinds.
    image: str | None = None


class BlockTable(_Table):
    """Blocks of one shape, which stand on the floor."""

    count: WholeNumbers(0, 20) = _constant(1)  # type: ignore[valid-type]
    shape: Literal["box", "sphere", "mesh"] = "box"
    #: File of a closed mesh with y upwards, scaled to the height; None for other shapes.
    mesh: str | None = None
    width_mm: Within(1, 10000) = _constant(165.0)  # type: ignore[valid-type]
    depth_mm: Within(1, 10000) = _constant(165.0)  # type: ignore[valid-type]
    height_mm: Within(1, 10000) = _constant(165.0)  # type: ignore[valid-type]
    radius_mm: Within(1, 5000) = _constant(80.0)  # type: ignore[valid-type]
    yaw_deg: Within(-360, 360) = numbers([0.0, 90.0])  # type: ignore[valid-type]
    #: Place of the centre along the room's width and depth, 0 to 1.
    x: Within(0, 1) = numbers([0.0, 1.0])  # type: ignore[valid-type]
    z: Within(0, 1) = numbers([0.0, 1.0])  # type: ignore[valid-type]
    paint: Texts


class LampTable(_Table):
    """Rectangular lamps in the ceiling, with one spectrum each."""

    count: WholeNumbers(1, 3) = _constant(1)  # type: ignore[valid-type]
    width_mm: Within(1, 10000) = _constant(130.0)  # type: ignore[valid-type]
    depth_mm: Within(1, 10000) = _constant(105.0)  # type: ignore[valid-type]
    #: Place of the centre along the room's width and depth, 0 to 1.
    x: Within(0, 1) = _constant(0.5)  # type: ignore[valid-type]
    z: Within(0, 1) = _constant(0.5)  # type: ignore[valid-type]
    spectrum: Texts
    #: Temperature of the spectrum "planck", K.
    temperature_k: Within(500, 50000) | None = None  # type: ignore[valid-type]
    #: Radiant power from 400 to 700 nm, W.
    power_w: Within(1e-9, 1e6) = _constant(1.0)  # type: ignore[valid-type]
    reflectance: Within(0, 1) = _constant(0.0)  # type: ignore[valid-type]


class CameraTable(_Table):
    """A camera before the open side of the room, or a row of them."""

    name: Name
    width_px: Annotated[int, Field(ge=8, le=4096)] = 128
    height_px: Annotated[int, Field(ge=8, le=4096)] = 128
    #: Distance of the camera from the open side, mm, and shift from its centre to the left and up.
    distance_mm: Within(1, 1e5) = _constant(800.0)  # type: ignore[valid-type]
    left_mm: Within(-1e4, 1e4) = _constant(0.0)  # type: ignore[valid-type]
    up_mm: Within(-1e4, 1e4) = _constant(0.0)  # type: ignore[valid-type]
    #: Point looked at, as shares of the room's width, height and depth.
    look_at: Annotated[tuple[Within(0, 1), Within(0, 1), Within(0, 1)], Strict(False)] = (  # type: ignore[valid-type]
        _constant(0.5),
        _constant(0.5),
        _constant(0.5),
    )
    roll_deg: Within(-180, 180) = _constant(0.0)  # type: ignore[valid-type]
    #: Full angle across the picture's width without distortion, degrees.
    field_deg: Within(1, 140) = _constant(39.31)  # type: ignore[valid-type]
    k1: Within(-0.3, 0.3) = _constant(0.0)  # type: ignore[valid-type]
    #: Cameras of one pose in a grid, at equal distances across and down.
    across: Annotated[int, Field(ge=1, le=16)] = 1
    down: Annotated[int, Field(ge=1, le=16)] = 1
    spacing_mm: Annotated[float, Field(gt=0)] = 60.0


class EffectTable(BaseModel):
    """An effect of the catalogue; its parameters are further keys."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, arbitrary_types_allowed=True)

    id: str
    probability: Annotated[float, Field(ge=0, le=1)] = 1.0

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Parameters with their distributions: numbers, or names."""
        return dict(self.__pydantic_extra__ or {})


class SensorTable(_Table):
    """Raw frames of every picture by a camera of the sensor simulation."""

    name: Name
    camera: str
    #: Exposures relative to the automatic one.
    exposures: Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=1, max_length=16)] = [1.0]


class PictureTable(_Table):
    """Wavelengths, precision and content of the pictures."""

    first_nm: Annotated[float, Field(gt=0)] = 400.0
    last_nm: Annotated[float, Field(gt=0)] = 700.0
    step_nm: Annotated[float, Field(gt=0)] = 10.0
    #: Relative standard error of the median pixel and wavelength.
    noise: Annotated[float, Field(gt=1e-5, lt=1)] = 0.01
    truths: list[str] = list(TRUTHS)
    #: Bits of the mantissa of every number that is stored, 1 to 23; 23 is lossless.
    mantissa_bits: Annotated[int, Field(ge=4, le=23)] = 23
    #: Format of a picture with its truths.
    format: Literal["netcdf", "zarr"] = "netcdf"
    #: Formats of further files of its radiance.
    copies: list[Literal["exr", "envi", "hdf5", "png"]] = []

    @property
    def wavelength_nm(self) -> NDArray[np.float64]:
        """(w,) wavelengths, nm."""
        count = int((self.last_nm - self.first_nm) / self.step_nm + 1e-9) + 1
        return np.asarray(self.first_nm + self.step_nm * np.arange(count), np.float64)


class PartsTable(_Table):
    """Shares of the boxes for training, validation and test."""

    train: Annotated[float, Field(ge=0, le=1)] = 0.8
    validation: Annotated[float, Field(ge=0, le=1)] = 0.1
    test: Annotated[float, Field(ge=0, le=1)] = 0.1


class Recipe(_Table):
    """Everything that determines a data set."""

    format: Literal["dataset/1"]
    name: Annotated[str, Field(min_length=1)]
    description: str = ""
    license: str = ""
    boxes: Annotated[int, Field(ge=1, le=10_000_000)]
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    #: Boxes of one geometry, which differ in paints and in the lamps' spectra and powers alone.
    boxes_per_geometry: Annotated[int, Field(ge=1, le=10_000)] = 1
    #: Least distance between solids, and between a solid and a wall, mm.
    gap_mm: Annotated[float, Field(ge=0)] = 5.0
    #: Largest share of the lamps' light that blocks may catch first.
    most_blocked: Annotated[float, Field(gt=0, le=1)] = 0.7
    picture: PictureTable = PictureTable()
    parts: PartsTable = PartsTable()
    room: RoomTable = RoomTable()
    paint: Annotated[dict[Name, PaintTable], Field(min_length=1, max_length=MOST_PAINTS)]
    pattern: dict[Name, PatternTable] = {}
    texture: dict[Name, TextureTable] = {}
    #: Paint, pattern or texture of each wall; the ceiling, which has holes for the lamps, takes no pattern.
    walls: dict[Literal["floor", "ceiling", "back", "right", "left"], Texts]
    block: list[BlockTable] = []
    lamp: Annotated[list[LampTable], Field(min_length=1)]
    camera: Annotated[list[CameraTable], Field(min_length=1)]
    effect: list[EffectTable] = []
    sensor: list[SensorTable] = []

    def digest(self, folder: Path) -> str:
        """SHA-256 of everything on which the pictures depend.

        The number of boxes is left out, since a larger set begins like a smaller one.

        Parameters
        ----------
        folder
            Folder of the recipe, to which its files are relative.

        Returns
        -------
        str
            Hexadecimal digits.
        """
        content = self.model_dump(mode="json", exclude={"boxes", "description", "license"})
        if not self.pattern:
            del content["pattern"]  # sets that were begun before there were patterns
        if not self.texture:
            del content["texture"]  # as above
        content["effect"] = [{**entry.parameters, "id": entry.id, "p": entry.probability} for entry in self.effect]
        result = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
        for name in self.files:
            result.update(hashlib.sha256((folder / name).read_bytes()).digest())
        return result.hexdigest()

    @property
    def files(self) -> list[str]:
        """Names of the files that it names: tables, meshes, images, effect files, sensor cameras."""
        names = [source for paint in self.paint.values() for source in paint.reflectance.names]
        names += [source for lamp in self.lamp for source in lamp.spectrum.names]
        tables = [name[: name.index(".csv") + 4] for name in names if ".csv" in name]
        parts = [block.mesh for block in self.block if block.mesh is not None]
        parts += [pattern.image for pattern in self.pattern.values() if pattern.image is not None]
        parts += [texture.image for texture in self.texture.values() if texture.image is not None]
        others = [*(entry.id for entry in self.effect), *(sensor.camera for sensor in self.sensor)]
        return sorted({*tables, *parts, *(name for name in others if name.endswith(".toml"))})
