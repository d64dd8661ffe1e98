"""A capture: one folder in the capture format, version 1. Frames and spectra are read on demand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from cboxlab.scenes import Scene, load_scene
from cboxlab.scenes.scene_file import packaged_scenes
from cboxlab.scenes.spectra import Spectrum, read_spectra, read_spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside
from numpy.typing import NDArray
from PIL import Image

from .checks import capture_faults
from .frames import read_frame
from .labels import Label, read_labels
from .manifest import BandTable, BracketTable, FlatTable, Manifest, ReferenceTable
from .manifest_faults import raise_faults, read_manifest

__all__ = ["Capture", "FrameTable", "load_capture"]


class FrameTable(Protocol):
    """Any table of capture.toml that names the frames of one exposure."""

    @property
    def frames(self) -> tuple[str, ...]: ...
    @property
    def exposure_s(self) -> float: ...


@dataclass(frozen=True, eq=False)
class Capture:
    """One folder in the capture format, checked. Made by ``load_capture``; immutable.

    full_well_dn : the count at which pixels saturate, if they do below full scale; see ``with_full_well``.
    """

    folder: Path
    manifest: Manifest
    full_well_dn: int | None = None

    @property
    def band_ids(self) -> tuple[str, ...]:
        """Band identifiers in the order of the manifest, which is the order of every (band, ...) array."""
        return tuple(band.id for band in self.manifest.band)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of every frame, px."""
        return self.manifest.camera.height_px, self.manifest.camera.width_px

    @property
    def full_scale_dn(self) -> int:
        """The largest count that can be stored, DN."""
        return 2**self.manifest.camera.bit_depth - 1

    @property
    def saturation_dn(self) -> int:
        """The count from which a pixel is saturated, DN: full scale, or the full well below it."""
        return self.full_scale_dn if self.full_well_dn is None else self.full_well_dn

    def band(self, identifier: str) -> BandTable:
        """The band of that identifier; KeyError with the known ones otherwise."""
        for band in self.manifest.band:
            if band.id == identifier:
                return band
        raise KeyError(f"no band '{identifier}'; there are {', '.join(self.band_ids)}")

    def frame(self, path: str) -> NDArray[np.uint16]:
        """Counts (y, x) of one frame by its path in the manifest. Raises InputError (see read_frame)."""
        return read_frame(self.folder / path, *self.shape, self.manifest.camera.bit_depth)

    def frames(self, table: FrameTable) -> NDArray[np.uint16]:
        """Counts (repeat, y, x) of all frames of a table."""
        return np.stack([self.frame(path) for path in table.frames])

    def f_number(self, table: BandTable | BracketTable) -> float | None:
        """The table's f-number, or that of its band."""
        return self._optics(table).f_number if table.f_number is None else table.f_number

    def image_distance_mm(self, table: BandTable | BracketTable) -> float | None:
        """The table's image distance in mm, or that of its band."""
        own = table.image_distance_mm
        return self._optics(table).image_distance_mm if own is None else own

    def _optics(self, table: BandTable | BracketTable) -> BandTable:
        return table if isinstance(table, BandTable) else self.band(table.band)

    def flats(self, band: str) -> tuple[FlatTable, ...]:
        """The flat tables of a band, those taken at the band's own f-number first."""
        own = [flat for flat in self.manifest.flats if flat.band == band]
        return tuple(sorted(own, key=lambda flat: self.f_number(flat) != self.band(band).f_number))

    def references(self, band: str) -> tuple[ReferenceTable, ...]:
        """The reference tables of a band."""
        return tuple(reference for reference in self.manifest.reference if reference.band == band)

    def brackets(self, band: str) -> tuple[BracketTable, ...]:
        """The further exposures of a band."""
        return tuple(bracket for bracket in self.manifest.bracket if bracket.band == band)

    def light(self, reference: str) -> Spectrum:
        """A radiance, transmittance or quantum efficiency, 'file.csv:column'; zero beyond its table."""
        return read_spectrum(self.folder, reference, "zero")

    def quantum_efficiency(self, channel: str | None = None) -> Spectrum | None:
        """Quantum efficiency (0 to 1), with a mosaic of ``channel`` "R", "G" or "B"; None if not stated.

        Raises ValueError if the sensor has a mosaic and no channel is given.
        """
        stated = self.manifest.camera.quantum_efficiency
        if isinstance(stated, tuple):
            if channel is None:
                raise ValueError("the sensor has a mosaic: say which channel, R, G or B")
            stated = stated["RGB".index(channel)]
        return None if stated is None else self.light(stated)

    @property
    def scene_reference(self) -> str | None:
        """The packaged scene's name or the scene file's path that the manifest states; None for no or another name.

        Raises InputError for a scene file outside the capture's folder.
        """
        stated = self.manifest.scene
        if stated is None or not stated.endswith(".toml"):
            return stated if stated in packaged_scenes() else None
        return str(path_inside(self.folder, stated, self.folder / "capture.toml: scene"))

    def known_scene(self) -> Scene | None:
        """The scene that the manifest states, or None if it states none or it cannot be loaded."""
        return self._scene

    @cached_property
    def _scene(self) -> Scene | None:
        try:
            return None if self.scene_reference is None else load_scene(self.scene_reference)
        except (InputError, OSError):
            return None

    def labels(self) -> NDArray[np.uint8]:
        """The label image (y, x); 0 is no label. Raises ValueError if the capture has no [labels]."""
        if self.manifest.labels is None:
            raise ValueError("the capture has no [labels]")
        with Image.open(self.folder / self.manifest.labels.image) as image:
            return np.asarray(image, np.uint8)

    def label_names(self) -> tuple[Label, ...]:
        """The rows of the label table, in its order. Raises ValueError if the capture has no [labels]."""
        if self.manifest.labels is None:
            raise ValueError("the capture has no [labels]")
        return read_labels(self.folder / self.manifest.labels.names)

    def label_reflectances(self) -> dict[str, Spectrum]:
        """Known reflectances (0 to 1) by column name; empty if the capture states none."""
        labels = self.manifest.labels
        if labels is None or labels.reflectance is None:
            return {}
        return read_spectra(self.folder / labels.reflectance, "hold")


def load_capture(folder: Path) -> Capture:
    """The capture in ``folder``.

    Checked at once: every key, every cross-reference, the existence, type and size of every frame (by its
    header), every spectrum and label table. Checked when read: the counts of a frame.

    Raises one InputError that names every fault found, one line each.
    """
    folder = Path(folder)
    if not folder.is_dir():
        found = "a file" if folder.is_file() else "no such folder"
        raise InputError(folder, found, "the folder of a capture, with a capture.toml in it")
    path = folder / "capture.toml"
    manifest = read_manifest(path)
    raise_faults(path, capture_faults(folder, manifest))
    return Capture(folder, manifest)
