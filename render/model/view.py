"""Camera and lamp of a rendering, read from a camera file or a capture."""

from __future__ import annotations

from pathlib import Path

from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.arguments import required_path
from cboxlab.utils.errors import InputError

from ..export import read_camera

__all__ = ["view_of"]


def view_of(camera: Camera | Capture | str | Path) -> tuple[Camera, Spectrum | None]:
    """Camera, and lamp where there is one, of a camera, a camera file or a capture.

    Parameters
    ----------
    camera
        A camera, a camera file (.json), a capture, or the folder of a capture.

    Returns
    -------
    camera : Camera
        The camera; that of a capture is calibrated.
    lamp : Spectrum or None
        Spectral radiance of the lamp that the capture states, W m^-2 sr^-1 nm^-1; None without a stated lamp.

    Raises
    ------
    InputError
        If a file cannot be read, or the capture has no surveyed points.
    """
    if isinstance(camera, Camera):
        return camera, None
    if isinstance(camera, Capture):
        return _camera_and_lamp(camera)
    path = required_path("camera", camera, "a camera, a camera file (.json), a capture, or its folder")
    if path.suffix.lower() == ".json":
        return read_camera(path), None
    return _camera_and_lamp(load_capture(path))


def _camera_and_lamp(capture: Capture) -> tuple[Camera, Spectrum | None]:
    """Calibrated camera and measured lamp of a capture; None for a lamp that it does not state."""
    from cboxlab.calibration.geometry import calibrate_camera  # slow to import, and only needed here

    fit, target, _ = calibrate_camera(capture)
    entry = capture.manifest.lamp
    lamp = None if entry is None else capture.light(entry.radiance)
    if target is not None and target.survey_camera is not None:
        return target.survey_camera, lamp
    if fit is None:
        raise InputError(
            capture.folder / "capture.toml", "no [geometry] with points", "surveyed points, for the camera"
        )
    return fit.camera, lamp
