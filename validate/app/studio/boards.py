"""Boards in a capture's target frames, for the page that shows and drops views."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.calibration.geometry import BoardViews, detect_boards, fit_camera_targets
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.input_files import inputs_below

from ...report.viewer import encoded
from .photographs import CaptureInView
from .places import path_of_name

__all__ = ["Boards"]

#: Percentile of a frame's counts that is shown white.
_WHITE_PERCENTILE = 99.5


@dataclass(frozen=True, eq=False)
class _Detected:
    """Boards of a capture."""

    folder: Path
    capture: Capture
    views: BoardViews

    @property
    def frames(self) -> list[str]:
        """All target frames, in the manifest's order."""
        return [name for target in self.capture.manifest.target for name in target.frames]


class Boards:
    """Boards of captures below a folder.

    Parameters
    ----------
    root
        Folder below which captures are opened.
    """

    def __init__(self, root: Path) -> None:
        self._detected = CaptureInView(root, partial(_load, root))

    def views(self, capture: str) -> dict[str, Any]:
        """Corners or disks found in each target frame.

        Parameters
        ----------
        capture
            Folder of the capture, below the root folder.

        Returns
        -------
        dict
            Ready for JSON: size, and for each frame its ``corners``, null where no board is found.

        Raises
        ------
        InputError
            If the capture is faulty, outside the root folder, or has no target.
        """
        boards = self._detected.of(capture, again=True)
        corners = dict(zip(boards.views.names, (image.tolist() for _, image in boards.views.points), strict=True))
        height, width = boards.capture.shape
        return {
            "width": width,
            "height": height,
            "frames": [{"frame": name, "corners": corners.get(name)} for name in boards.frames],
            "notes": boards.views.notes,
        }

    def frame(self, capture: str, frame: str) -> dict[str, Any]:
        """One target frame.

        Parameters
        ----------
        capture
            Folder of the capture.
        frame
            Name of the frame in the manifest.

        Returns
        -------
        dict
            Ready for JSON.

        Raises
        ------
        InputError
            If no target names the frame.
        """
        boards = self._detected.of(capture)
        _require_frames(boards, [frame])
        values = np.asarray(boards.capture.stored_frame(frame), float)
        low, white = np.percentile(values, [0, _WHITE_PERCENTILE])
        return {"photograph": encoded((values - low) / max(white - low, 1e-9))}

    def fit(self, capture: str, dropped: Sequence[str]) -> dict[str, Any]:
        """Lens fitted to the boards without some views, and the residuals of all used ones.

        Parameters
        ----------
        capture
            Folder of the capture.
        dropped
            Frames that are left out.

        Returns
        -------
        dict
            Ready for JSON: focal length and its standard deviation, rms, residuals by frame, views that do not agree
            with the others, and the reason where there is no fit.

        Raises
        ------
        InputError
            For frames that no target names.
        """
        boards = self._detected.of(capture)
        _require_frames(boards, dropped)
        used = [index for index, name in enumerate(boards.views.names) if name not in dropped]
        names = [boards.views.names[index] for index in used]
        points = [boards.views.points[index] for index in used]
        height, width = boards.capture.shape
        try:
            fit = fit_camera_targets(points, width_px=width, height_px=height, source="the boards in use", names=names)
        except InputError as error:
            return {"views": {}, "discordant": {}, "rms_px": None, "focal_length_px": None, "reason": str(error)}
        discordant = {view.name: view.reason for view in fit.discordant}
        in_use = [pair for pair in zip(names, points, strict=True) if pair[0] not in discordant]
        residuals = {
            name: (image - camera.project(world)).tolist()
            for (name, (world, image)), camera in zip(in_use, fit.cameras, strict=True)
        }
        return {
            "views": {
                name: {"rms_px": rms, "residuals_px": residuals[name]}
                for (name, _), rms in zip(in_use, fit.view_rms_px, strict=True)
            },
            "discordant": discordant,
            "rms_px": fit.reprojection_rms_px,
            "focal_length_px": [float(fit.intrinsics[0]), float(np.sqrt(fit.intrinsics_covariance[0, 0]))],
            "reason": "",
        }

    def write(self, capture: str, dropped: Sequence[str]) -> dict[str, Any]:
        """Remove frames from the targets of capture.toml; nothing else in it changes.

        Parameters
        ----------
        capture
            Folder of the capture.
        dropped
            Frames to remove; their files stay.

        Returns
        -------
        dict
            Path of the file.

        Raises
        ------
        InputError
            For frames that no target names, if a target had no frame left, and where the lines cannot be found.
        """
        boards = self._detected.of(capture)
        _require_frames(boards, dropped)
        if not dropped:
            raise InputError("dropped", "no frame", "at least one frame to remove")
        path = boards.folder / "capture.toml"
        before = path.read_text(encoding="utf-8")
        expected = tomllib.loads(before)
        for target in expected["target"]:
            target["frames"] = [name for name in target["frames"] if name not in dropped]
            if not target["frames"]:
                raise InputError(path, "a target without frames", "one frame or more", "Remove its table [[target]].")
        after = _without_frames(before, dropped)
        if tomllib.loads(after) != expected:
            names = ", ".join(dropped)
            raise InputError(path, "frames in an unusual form", "lists of frames", f"Remove by hand: {names}")
        with replacing(path) as temporary:
            temporary.write_text(after, encoding="utf-8")
        self._detected.forget()
        return {"path": str(path)}


def _load(root: Path, name: str) -> _Detected:
    """Boards of a capture; InputError if it has none."""
    folder = path_of_name(root, name, "capture")
    with inputs_below(root):
        capture = load_capture(folder)
        if not capture.manifest.target:
            raise InputError(folder / "capture.toml", "no [[target]]", "frames of a board")
        if capture.reduction is not None:
            raise InputError(folder / "capture.toml", "frames that are reduced", "frames in their full size")
        return _Detected(folder, capture, detect_boards(capture))


def _require_frames(boards: _Detected, frames: Sequence[str]) -> None:
    """Raise InputError for a name that no target has."""
    for name in frames:
        if name not in boards.frames:
            raise InputError("frame", repr(name)[:80], "a frame of a target")


def _without_frames(text: str, frames: Sequence[str]) -> str:
    """Manifest whose tables of targets lack some names."""
    parts = re.split(r"(?m)^(?=[ \t]*\[\[?\w)", text)
    names = "|".join(re.escape(name) for name in frames)
    return "".join(
        re.sub(rf"""(["'])(?:{names})\1\s*,?\s*""", "", part) if part.lstrip().startswith("[[target]]") else part
        for part in parts
    )
