"""Captures in which a person marks something: photograph, manifest, the one in view."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.result import Calibration, calibrate_capture
from cboxlab.scenes.scene_file import PACKAGED
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import inputs_below
from numpy.typing import NDArray

from .places import path_of_name

__all__ = ["CaptureInView", "Photograph", "add_table", "load_photograph"]


class _InFolder(Protocol):
    @property
    def folder(self) -> Path:
        """Folder of the capture."""


Part = TypeVar("Part", bound=_InFolder)


class CaptureInView(Generic[Part]):
    """Data of the capture that a page shows, loaded once.

    Parameters
    ----------
    root
        Folder below which captures are opened.
    load
        Function that loads it, of a capture's name.
    """

    def __init__(self, root: Path, load: Callable[[str], Part]) -> None:
        self._root, self._load = root, load
        self._part: Part | None = None

    def of(self, capture: str, *, again: bool = False) -> Part:
        """Data of a capture.

        Parameters
        ----------
        capture
            Folder of the capture, below the root folder.
        again
            Whether to load it again, since its files may have changed.

        Returns
        -------
        Part
            What was loaded last, if it is of this capture.

        Raises
        ------
        InputError
            As of the function that loads it.
        """
        if again or self._part is None or self._part.folder != path_of_name(self._root, capture, "capture"):
            self._part = self._load(capture)
        return self._part

    def forget(self) -> None:
        """Load it again when it is next asked for, since its files have changed."""
        self._part = None


@dataclass(frozen=True, eq=False)
class Photograph:
    """Photograph of a capture, calibrated without its points, targets and labels."""

    #: Folder of the capture.
    folder: Path
    #: Calibration without them.
    calibration: Calibration

    @property
    def values(self) -> NDArray[np.float64]:
        """(y, x) mean of the bands."""
        return self.calibration.photograph


def load_photograph(root: Path, name: str, *, with_scene: bool) -> Photograph:
    """Photograph of a capture below a folder.

    Parameters
    ----------
    root
        Folder below which captures are opened.
    name
        Folder of the capture.
    with_scene
        Whether the capture must have a scene.

    Returns
    -------
    Photograph
        In its full size.

    Raises
    ------
    InputError
        If the capture is faulty, outside the root folder, reduced, or lacks the scene.
    """
    folder = path_of_name(root, name, "capture")
    with inputs_below(root, PACKAGED):
        capture = load_capture(folder)
        if with_scene and capture.scene is None:
            raise InputError(folder / "capture.toml", "no scene", "the scene whose corners are marked")
        if capture.reduction is not None:
            raise InputError(folder / "capture.toml", "frames that are reduced", "frames in their full size")
        without = capture.manifest.model_copy(update={"geometry": None, "target": (), "labels": None})
        return Photograph(folder, calibrate_capture(replace(capture, manifest=without)))


def add_table(manifest: Path, table: str, lines: str) -> bool:
    """Add a table to a manifest that lacks it.

    Parameters
    ----------
    manifest
        A capture.toml.
    table
        Name of the table.
    lines
        The table as text.

    Returns
    -------
    bool
        Whether it was added; False where the manifest has such a table.
    """
    text = manifest.read_text(encoding="utf-8")
    if table in tomllib.loads(text):
        return False
    with replacing(manifest) as temporary:
        temporary.write_text(f"{text.rstrip()}\n\n{lines}\n", encoding="utf-8")
    return True
