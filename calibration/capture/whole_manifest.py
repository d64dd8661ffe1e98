"""The whole of capture.toml, with the values of [defaults] in its tables."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from .manifest import (
    BandTable,
    BracketTable,
    CameraTable,
    CropTable,
    DarkTable,
    DefaultsTable,
    FlatTable,
    GeometryTable,
    LabelsTable,
    LampTable,
    LensTable,
    MosaicTable,
    NoiseTable,
    ReferenceTable,
    TargetTable,
    _key,
    _kind,
    _Table,
    _tuple,
)

__all__ = ["Manifest"]

#: By key of [defaults], the tables that it fills. The others take f-number and image distance from their band.
DEFAULTS_FILL = {
    "f_number": ("band",),
    "image_distance_mm": ("band",),
    "exposure_s": ("band", "bracket", "dark", "flat", "reference"),
    "radiance": ("flat", "reference"),
}


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
    """The content of capture.toml. Absent tables are None or empty."""

    format: Literal["capture/1"] = _key("the format and its version", '"capture/1"')
    camera: CameraTable
    band: Annotated[tuple[BandTable, ...], BeforeValidator(_tuple), Field(min_length=1)]
    name: str = _key("a title, for reports", '"white box, second lamp"', "")
    scene: str | None = _key("packaged scene, or scene file (.toml) of the folder", '"cornell-box"', None)
    scale: Literal["free", "free-by-band"] | None = _key(
        "claims no absolute scale: 'free' is one unknown factor of all bands, 'free-by-band' one of each; absolute "
        "where left out",
        '"free"',
        None,
    )
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
    noise: NoiseTable | None = None
    defaults: DefaultsTable | None = None

    @model_validator(mode="before")
    @classmethod
    def _with_defaults(cls, data: Any) -> Any:
        """The tables of frames with the values of [defaults] that they do not state."""
        defaults = data.get("defaults") if isinstance(data, dict) else None
        if not isinstance(defaults, dict):
            return data
        filled = dict(data)
        for key, tables in DEFAULTS_FILL.items():
            for table in tables if key in defaults else ():
                rows = filled.get(table)
                if isinstance(rows, list | tuple):
                    filled[table] = [{key: defaults[key], **row} if isinstance(row, dict) else row for row in rows]
        return filled

    @model_validator(mode="before")
    @classmethod
    def _with_the_mosaics_efficiency(cls, data: Any) -> Any:
        """The table with the quantum efficiencies of [mosaic] in [camera], where [camera] has none."""
        mosaic, camera = (data.get("mosaic"), data.get("camera")) if isinstance(data, dict) else (None, None)
        if not isinstance(mosaic, dict) or not isinstance(camera, dict):
            return data
        if "quantum_efficiency" not in mosaic or "quantum_efficiency" in camera:
            return data
        pattern = {key: value for key, value in mosaic.items() if key != "quantum_efficiency"}
        return data | {"mosaic": pattern, "camera": camera | {"quantum_efficiency": mosaic["quantum_efficiency"]}}

    @property
    def is_absolute(self) -> bool:
        """Whether the capture claims an absolute scale."""
        return self.scale is None

    @property
    def is_free_by_band(self) -> bool:
        """Whether each band has a free factor.

        It has where the capture claims so, and where it does not state the colour of the lens.
        """
        return self.scale == "free-by-band" or (self.scale == "free" and self.lens.transmittance is None)

    @property
    def darks(self) -> tuple[DarkTable, ...]:
        """The dark tables; empty if the dark was subtracted before the frames were stored."""
        return self.dark if isinstance(self.dark, tuple) else ()

    @property
    def flats(self) -> tuple[FlatTable, ...]:
        """The flat tables; empty if the frames were divided by their flat before they were stored."""
        return self.flat if isinstance(self.flat, tuple) else ()
