"""All checks of the photographs against each other and against the scene, in order."""

from __future__ import annotations

import re
from dataclasses import replace

from cboxlab.calibration.capture import Capture
from cboxlab.calibration.quality import Suspicion
from cboxlab.calibration.result import Calibration
from cboxlab.rendering.device import variant

from .band_registration import check_registration
from .channel_tables import check_channel_tables
from .lamp import check_lamp
from .materials import check_materials
from .placement import check_orientation, check_survey
from .scene_view import view_scene

__all__ = ["find_scene_suspicions", "with_scene_checks"]

#: A band's table in the place of a suspicion.
_BAND = re.compile(r"\bband\[(\d+)\]")

#: The end of the place of a suspicion that is about the positions of all points.
POSITIONS = "x_mm, y_mm, z_mm"

#: The place of a suspicion that is about a band's light as a whole.
_WHOLE_BAND = re.compile(r"band\[\d+\] \([^)]*\)")

#: Note of a calibration whose photographs could be compared with a rendering, but for lack of a compiled variant.
NOT_RENDERED = (
    "the photographs were not checked against a rendering of the scene: no compiled variant (LLVM 16 or newer, or a "
    "GPU)"
)


def find_scene_suspicions(calibration: Calibration) -> tuple[Suspicion, ...]:
    """Suspected errors of a capture by its photographs and a rendering of its scene.

    Without a known scene, a camera, a lamp, a complete sensor equation or a compiled variant the checks that need the
    rendering are left out. Physical effects that a model may lack are not errors.

    Parameters
    ----------
    calibration
        Calibration of the capture.

    Returns
    -------
    tuple of Suspicion
        In the order of the checks; empty for a sound capture.
    """
    capture, bands, radiometry = calibration.capture, calibration.bands, calibration.radiometry
    camera = None if calibration.camera_fit is None else calibration.camera_fit.camera
    view = view_scene(capture, bands, radiometry, camera, calibration.channels)
    suspicions = (
        *check_materials(capture, view),
        *check_orientation(capture, view),
        *check_survey(capture, bands, view),
        *check_lamp(capture, bands, radiometry, calibration.channels, view),
        *check_channel_tables(capture, bands, radiometry, calibration.channels, view),
        *check_registration(capture, bands, view),
    )
    return tuple(dict.fromkeys(suspicions))


def _frames_of(capture: Capture, suspicion: Suspicion) -> set[tuple[str, ...]]:
    """Frames of the bands that a suspicion is about; channels of a mosaic share theirs."""
    return {capture.manifest.band[int(index)].frames for index in _BAND.findall(suspicion.where)}


def _each_mistake_once(
    capture: Capture, of_calibration: tuple[Suspicion, ...], of_scene: tuple[Suspicion, ...]
) -> tuple[Suspicion, ...]:
    """Suspicions without those that another one explains.

    Frames that were exchanged explain all that is strange about them. What is known of frames explains why their light
    does not suit the scene. Without a right dark level no light suits it, and no view with points in other units.
    """
    if any(s.where.endswith(POSITIONS) for s in of_calibration):
        return of_calibration
    if any(s.where == "dark.frames" for s in of_calibration):
        of_scene = tuple(s for s in of_scene if s.where.startswith("geometry"))
    exchanged = tuple(s for s in of_scene if s.where.endswith(".frames") and len(_frames_of(capture, s)) > 1)
    wrong = {frames for s in exchanged for frames in _frames_of(capture, s)}
    remaining = [s for s in of_calibration if not (frames := _frames_of(capture, s)) or not frames <= wrong]
    suspected = {frames for s in remaining for frames in _frames_of(capture, s)} | wrong
    for suspicion in of_scene:
        frames = _frames_of(capture, suspicion)
        if not (_WHOLE_BAND.fullmatch(suspicion.where) and frames <= suspected):
            remaining.append(suspicion)
            suspected |= frames
    return tuple(dict.fromkeys(remaining))


def with_scene_checks(calibration: Calibration) -> Calibration:
    """Calibration whose suspicions include those of the photographs and the scene.

    Parameters
    ----------
    calibration
        Calibration of a capture by ``cboxlab.calibration`` alone.

    Returns
    -------
    Calibration
        The same calibration. The suspicions of ``find_scene_suspicions`` follow those that it has, each mistake once. A
        note says if a known scene was not rendered for lack of a compiled variant.
    """
    suspicions = _each_mistake_once(calibration.capture, calibration.suspicions, find_scene_suspicions(calibration))
    renderable = calibration.camera_fit is not None and calibration.capture.scene is not None
    notes = [] if variant.compiled() or not renderable else [NOT_RENDERED]
    return replace(calibration, suspicions=suspicions, notes=(*calibration.notes, *notes))
