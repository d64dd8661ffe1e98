"""Capture: one folder in the capture format, version 1. Frames are read on demand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from cboxlab.scenes import Scene, load_scene, named_camera_channel
from cboxlab.scenes.scene_file import packaged_scenes
from cboxlab.scenes.spectra import Spectrum, read_spectra, read_spectrum
from cboxlab.utils.arguments import required_path
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import path_inside
from cboxlab.utils.frozen import FrozenDict, FrozenMappings
from numpy.typing import NDArray
from PIL import Image

from .checks import TABLES_OF_FRAMES, capture_faults
from .frames import (
    UNKNOWN_VALUE,
    picture_names,
    pictures_by_file,
    read_frame,
    read_frames,
    read_merged,
    split_name,
)
from .labels import Label, read_labels
from .manifest import (
    BandTable,
    BracketTable,
    FlatTable,
    ReferenceTable,
    pattern_rows,
    split_channel,
)
from .manifest_faults import raise_faults, read_manifest
from .reduction import ReducedFrames, Reduction, reduced_manifest, reduction_of
from .whole_manifest import Manifest

__all__ = ["Capture", "FrameTable", "load_capture"]


class FrameTable(Protocol):
    """Any table of capture.toml that names the frames of one exposure."""

    @property
    def frames(self) -> tuple[str, ...]: ...
    @property
    def exposure_s(self) -> float: ...


@dataclass(frozen=True, eq=False)
class Capture(FrozenMappings):
    """One folder in the capture format, checked by ``load_capture``. Immutable."""

    #: Folder of the capture.
    folder: Path
    #: Content of its capture.toml.
    manifest: Manifest
    #: Count at which pixels saturate below full scale, DN; None if they do not. See ``with_full_well``.
    full_well_dn: int | None = None
    #: By reference to a channel of a named camera, its peak quantum efficiency over the largest one, measured from the
    #: references; empty where not measured.
    channel_levels: Mapping[str, float] = field(default_factory=FrozenDict)
    #: By letter of the mosaic, relative sensitivity from a chart in the picture; empty where not estimated.
    chart_sensitivities: Mapping[str, Spectrum] = field(default_factory=FrozenDict)
    #: Window and blocks of the stored frames that are the pixels in use; None where the stored pixels are.
    reduction: Reduction | None = None
    #: Reduced frames that were read; copies of the capture share them.
    reduced_frames: ReducedFrames = field(default_factory=ReducedFrames, repr=False)
    #: Scene with which the capture is compared in place of the stated one; None for the latter.
    compared_scene: Scene | None = field(default=None, repr=False)

    @property
    def band_ids(self) -> tuple[str, ...]:
        """Band identifiers in the order of the manifest and of every (band, ...) array."""
        return tuple(band.id for band in self.manifest.band)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of every frame, px."""
        return self.manifest.camera.height_px, self.manifest.camera.width_px

    @property
    def is_merged(self) -> bool:
        """Whether the frames are merged pictures of floating-point values."""
        return self.manifest.noise is not None

    @property
    def full_scale_dn(self) -> int:
        """The largest count that can be stored, DN; UNKNOWN_VALUE for merged pictures."""
        if self.is_merged:
            return int(UNKNOWN_VALUE)
        return 2**self.manifest.camera.bit_depth - 1

    @property
    def saturation_dn(self) -> int:
        """The count from which a pixel is saturated, DN.

        It is full scale, or a white level or full well below it.
        """
        white = self.manifest.camera.white_level_dn
        limits = (self.full_scale_dn, self.full_well_dn, None if white is None else int(white))
        return min(limit for limit in limits if limit is not None)

    @property
    def cell(self) -> tuple[int, int] | None:
        """(height, width) of one repeat of the mosaic, px; None without a mosaic."""
        if self.manifest.mosaic is None:
            return None
        rows = pattern_rows(self.manifest.mosaic.pattern)
        return len(rows), len(rows[0])

    def band(self, identifier: str) -> BandTable:
        """The table of a band.

        Parameters
        ----------
        identifier
            Identifier of the band.

        Returns
        -------
        BandTable
            Its table of the manifest.

        Raises
        ------
        KeyError
            For an unknown identifier; the message names the bands of the capture.
        """
        for band in self.manifest.band:
            if band.id == identifier:
                return band
        raise KeyError(f"no band '{identifier}'; there are {', '.join(self.band_ids)}")

    def frame(self, path: str) -> NDArray[np.uint16] | NDArray[np.uint32] | NDArray[np.float64]:
        """Counts of one frame.

        Parameters
        ----------
        path
            Path in the manifest.

        Returns
        -------
        NDArray
            (y, x) counts, DN; sums over blocks of a reduced capture; values of a merged picture.

        Raises
        ------
        InputError
            For a file that is missing, damaged or does not fit the manifest, see ``read_frame``.
        """
        if self.reduction is not None and not self.is_merged:
            return self._reduced(path, self.reduction)[0]
        file, number = split_name(self.folder, path)
        if self.is_merged:
            picture = range(number or 0, (number or 0) + 1)
            return read_merged(self.folder / file, *self.shape, picture)[0]
        return read_frame(self.folder / file, *self.shape, self.manifest.camera.bit_depth, number or 0)

    def stored_frame(self, path: str) -> NDArray[np.uint16]:
        """Counts of one frame as stored, without reduction.

        Parameters
        ----------
        path
            Path in the manifest.

        Returns
        -------
        NDArray
            (y, x) counts, uint16, DN.

        Raises
        ------
        InputError
            For a file that is missing, damaged or does not fit the manifest, see ``read_frame``.
        """
        file, number = split_name(self.folder, path)
        shape, depth, part = self.shape, self.manifest.camera.bit_depth, self.reduction
        if part is not None:
            shape, depth = (part.full_height_px, part.full_width_px), part.bit_depth
        return read_frame(self.folder / file, *shape, depth, number or 0)

    def frames(self, table: FrameTable) -> NDArray:
        """Counts of all frames of a table.

        Parameters
        ----------
        table
            A table of the manifest.

        Returns
        -------
        NDArray
            (repeat, y, x) counts, DN; sums over blocks of a reduced capture; values of merged pictures.
        """
        if self.reduction is not None and not self.is_merged:
            return np.stack([self.frame(name) for name in table.frames])
        files = pictures_by_file(self.folder, table.frames)
        if self.is_merged:
            return np.concatenate([read_merged(file, *self.shape, pictures) for file, pictures in files])
        depth = self.manifest.camera.bit_depth
        return np.concatenate([read_frames(file, *self.shape, depth, pictures) for file, pictures in files])

    def block_scatter(self, table: FrameTable) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Mean sums of blocks behind a mosaic, and the scatter of the pixels in them.

        Parameters
        ----------
        table
            A table of the manifest.

        Returns
        -------
        tuple | None
            (y, x) mean sum, DN, and (2, y, x) scatters of the pixels, DN^2, the means over repeats; None where all
            pixels count.
        """
        reduction = self.reduction
        if reduction is None or self.is_merged or reduction.step_px == 1 or reduction.summed == 1:
            return None
        sums, spreads = zip(*(self._reduced(name, reduction) for name in table.frames), strict=True)
        return np.mean(sums, axis=0), np.mean(spreads, axis=0)

    def _reduced(self, path: str, reduction: Reduction) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
        """Sums of a frame and the scatters in its blocks."""
        return self.reduced_frames.get(path, reduction, lambda: self.stored_frame(path))

    def f_number(self, table: BandTable | BracketTable) -> float | None:
        """F-number of a table, or of its band where the table states none.

        Parameters
        ----------
        table
            A table of the manifest.

        Returns
        -------
        float | None
            None if neither states it.
        """
        return self._optics(table).f_number if table.f_number is None else table.f_number

    def image_distance_mm(self, table: BandTable | BracketTable) -> float | None:
        """Image distance of a table, or of its band where the table states none.

        Parameters
        ----------
        table
            A table of the manifest.

        Returns
        -------
        float | None
            Distance from the lens to the image, mm; None if neither states it.
        """
        distance = table.image_distance_mm
        return self._optics(table).image_distance_mm if distance is None else distance

    def _optics(self, table: BandTable | BracketTable) -> BandTable:
        return table if isinstance(table, BandTable) else self.band(table.band)

    def flats(self, band: str) -> tuple[FlatTable, ...]:
        """The flat tables of a band, those at the band's f-number first.

        Parameters
        ----------
        band
            Identifier of the band.

        Returns
        -------
        tuple
            Empty if the band has no flat or the flat was divided beforehand.
        """
        flats = [flat for flat in self.manifest.flats if flat.band == band]
        return tuple(sorted(flats, key=lambda flat: self.f_number(flat) != self.band(band).f_number))

    def references(self, band: str) -> tuple[ReferenceTable, ...]:
        """The reference tables of a band.

        Parameters
        ----------
        band
            Identifier of the band.

        Returns
        -------
        tuple
            In the order of the manifest.
        """
        return tuple(reference for reference in self.manifest.reference if reference.band == band)

    def brackets(self, band: str) -> tuple[BracketTable, ...]:
        """The further exposures of a band.

        Parameters
        ----------
        band
            Identifier of the band.

        Returns
        -------
        tuple
            In the order of the manifest.
        """
        return tuple(bracket for bracket in self.manifest.bracket if bracket.band == band)

    def light(self, reference: str) -> Spectrum:
        """A spectrum of the capture: radiance, transmittance or quantum efficiency.

        Parameters
        ----------
        reference
            Column of a file, ``file.csv:column``, or a channel of a named camera, ``camera:NAME:R``.

        Returns
        -------
        Spectrum
            Zero beyond its table.
        """
        if (channel := named_camera_channel(reference)) is not None:
            return channel.scaled(self.channel_levels.get(reference, 1.0))
        return read_spectrum(self.folder, reference, "zero")

    def quantum_efficiency(self, channel: str | None = None) -> Spectrum | None:
        """Quantum efficiency of the sensor, or of one channel of its mosaic.

        Parameters
        ----------
        channel
            Channel of the mosaic, such as "R", or "G2" for one green pixel of the repeat; ignored without a mosaic.

        Returns
        -------
        Spectrum | None
            Electrons per photon, 0 to 1; None if the manifest does not state it.

        Raises
        ------
        ValueError
            If the sensor has a mosaic and no channel is given.
        """
        column = self.manifest.camera.quantum_efficiency
        if column is None and self.chart_sensitivities and channel is not None:
            return self.chart_sensitivities.get(split_channel(channel)[0])
        if isinstance(column, tuple | dict):
            if channel is None:
                raise ValueError("the sensor has a mosaic: say which channel, such as R, G or B")
            letter, _ = split_channel(channel)
            column = column[letter] if isinstance(column, dict) else column["RGB".index(letter)]
        return None if column is None else self.light(column)

    @property
    def scene_reference(self) -> str | None:
        """Name of a packaged scene, or path of a scene file, that the manifest states.

        None if the manifest states no scene or an unknown name. Raises InputError for a scene file outside the
        capture's folder.
        """
        scene = self.manifest.scene
        if scene is None or not scene.endswith(".toml"):
            return scene if scene in packaged_scenes() else None
        return str(path_inside(self.folder, scene, self.folder / "capture.toml: scene"))

    @cached_property
    def scene(self) -> Scene | None:
        """Scene of the capture, read once.

        It is the one that the manifest states, unless the capture is compared with another. None if the manifest
        states no scene, or the scene cannot be loaded.
        """
        if self.compared_scene is not None:
            return self.compared_scene
        try:
            return None if self.scene_reference is None else load_scene(self.scene_reference)
        except (InputError, OSError):
            return None

    def labels(self) -> NDArray[np.uint8]:
        """The label image of the patches.

        Returns
        -------
        NDArray
            (y, x) label of each pixel, uint8; 0 is no label.

        Raises
        ------
        ValueError
            If the capture has no [labels].
        InputError
            If [labels] states no image.
        """
        if self.manifest.labels is None:
            raise ValueError("the capture has no [labels]")
        if self.manifest.labels.image is None:
            where = self.folder / "capture.toml: labels.image"
            raise InputError(where, "no label image", "an 8-bit PNG with a label per pixel")
        with Image.open(self.folder / self.manifest.labels.image) as image:
            labels = np.asarray(image, np.uint8)
        return labels if self.reduction is None else self.reduction.labels(labels)

    def excluded_pixels(self) -> NDArray[np.bool_]:
        """Pixels whose label is named 'excluded', such as a cable or a hand in the picture.

        Returns
        -------
        NDArray
            (y, x) True for pixels that are left out; a block of a reduced frame if one of its pixels is.
        """
        labels = self.manifest.labels
        if labels is None or labels.image is None:
            return np.zeros(self.shape, np.bool_)
        numbers = [label.label for label in self.label_names() if label.excludes]
        with Image.open(self.folder / labels.image) as image:
            excluded = np.isin(np.asarray(image, np.uint8), numbers)
        return excluded if self.reduction is None else self.reduction.any_of(excluded)

    def label_names(self) -> tuple[Label, ...]:
        """The rows of the label table.

        Returns
        -------
        tuple
            One Label per row, in its order.

        Raises
        ------
        ValueError
            If the capture has no [labels].
        """
        if self.manifest.labels is None:
            raise ValueError("the capture has no [labels]")
        return read_labels(self.folder / self.manifest.labels.names)

    def label_reflectances(self) -> dict[str, Spectrum]:
        """Known reflectances of the patches.

        Returns
        -------
        dict
            By column name, reflectance 0 to 1; empty if the capture states none.
        """
        labels = self.manifest.labels
        if labels is None or labels.reflectance is None:
            return {}
        return read_spectra(self.folder / labels.reflectance, "hold")


def load_capture(folder: str | Path) -> Capture:
    """Load the capture in a folder and check it.

    Checked at once: every key, every cross-reference, the existence, type and size of every frame (by its header),
    every spectrum and label table. Checked when read: the counts of a frame.

    Parameters
    ----------
    folder
        The folder, with a capture.toml in it.

    Returns
    -------
    Capture
        Its frames are read on demand.

    Raises
    ------
    InputError
        One error that names every fault of the capture, one line each.
    """
    folder = required_path("load_capture", folder, "the folder of a capture")
    if not folder.is_dir():
        content = "a file" if folder.is_file() else "no such folder"
        raise InputError(folder, content, "the folder of a capture, with a capture.toml in it")
    path = folder / "capture.toml"
    manifest = read_manifest(path)
    raise_faults(path, capture_faults(folder, manifest))
    manifest = _with_each_picture(folder, manifest)
    reduction = reduction_of(folder, manifest)
    if reduction is None:
        return Capture(folder, manifest)
    return Capture(folder, reduced_manifest(manifest, reduction), reduction=reduction)


def _with_each_picture(folder: Path, manifest: Manifest) -> Manifest:
    """The manifest with a frame for each picture of files that hold several."""
    changes = {}
    for key in TABLES_OF_FRAMES:
        tables = getattr(manifest, key)
        if isinstance(tables, str):  # subtracted or divided beforehand
            continue
        names = [tuple(n for name in table.frames for n in picture_names(folder, name)) for table in tables]
        pairs = zip(tables, names, strict=True)
        changes[key] = tuple(t if t.frames == n else t.model_copy(update={"frames": n}) for t, n in pairs)
    return manifest.model_copy(update=changes)
