"""The camera, and the lamp, through which a model is seen: of a camera file or of a capture."""

from __future__ import annotations

from pathlib import Path

from cboxlab.calibration.capture import Capture, load_capture
from cboxlab.calibration.geometry import calibrate_camera
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError

from ..export import read_camera

__all__ = ["view_of"]


def view_of(camera: Camera | Capture | str | Path) -> tuple[Camera, Spectrum | None]:
    """A camera, that of a camera file (.json), or that of a capture or its folder, with the lamp that this states.

    Raises InputError.
    """
    if isinstance(camera, Camera):
        return camera, None
    if isinstance(camera, Capture):
        return _camera_and_lamp(camera)
    if Path(camera).suffix.lower() == ".json":
        return read_camera(Path(camera)), None
    return _camera_and_lamp(load_capture(Path(camera)))


def _camera_and_lamp(capture: Capture) -> tuple[Camera, Spectrum | None]:
    """As calibrated; the lamp as measured, None where the capture does not state it."""
    fit, target, _ = calibrate_camera(capture)
    stated = capture.manifest.lamp
    lamp = None if stated is None else capture.light(stated.radiance)
    if target is not None and target.survey_camera is not None:
        return target.survey_camera, lamp
    if fit is None:
        raise InputError(
            capture.folder / "capture.toml", "no [geometry] with points", "surveyed points, for the camera"
        )
    return fit.camera, lamp
