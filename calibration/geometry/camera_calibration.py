"""The camera of a capture, from its surveyed points and its flat targets."""

from __future__ import annotations

from cboxlab.utils.errors import InputError

from ..capture import Capture, channel_lattice
from .camera_fit import CameraFit, fit_camera, read_points
from .distortion_choice import choose_distortion
from .surveyed_points import SurveyedPoints
from .target_camera import TargetFit, fit_camera_targets
from .targets import TargetView, detect_target

__all__ = ["calibrate_camera"]


def _commonest(pattern: str) -> str:
    """Letter with the most pixels in a mosaic's repeat."""
    letters = pattern.replace(" ", "")
    return max(letters, key=letters.count)


def _views(capture: Capture) -> tuple[list[TargetView], list[str], list[str]]:
    """Points detected in target frames, px of the whole frame, the frames, and notes."""
    views, names, notes = [], [], []
    pattern = None if capture.manifest.mosaic is None else capture.manifest.mosaic.pattern
    for target in capture.manifest.target:
        for name in target.frames:
            image, row, column, step = capture.frame(name), 0, 0, 1
            if pattern is not None:
                # Use one green pixel of each 2 x 2 (X-Trans: 3 x 3) pixels: an image of lower resolution. Without green
                # the most frequent channel has the densest lattice.
                row, column, step = channel_lattice(pattern, "G" if "G" in pattern else _commonest(pattern))
                image = image[row::step, column::step]
            try:
                world, corners = detect_target(image, target.kind, target.rows, target.columns, target.pitch_mm, name)
            except InputError as fault:
                notes.append(f"target not used: {fault}")
                continue
            views.append((world, step * corners + [column, row]))
            names.append(name)
    return views, names, notes


def _survey(capture: Capture) -> tuple[SurveyedPoints, CameraFit] | None:
    """Surveyed points of the capture and the camera fitted to them; None without [geometry]."""
    geometry, camera = capture.manifest.geometry, capture.manifest.camera
    if geometry is None:
        return None
    focal, pitch = capture.manifest.lens.focal_length_mm, camera.pixel_pitch_um
    points = read_points(capture.folder / geometry.points)
    fit = fit_camera(
        points,
        width_px=camera.width_px,
        height_px=camera.height_px,
        point_sigma_px=geometry.point_sigma_px,
        focal_length_px=None if focal is None or pitch is None else focal / (pitch * 1e-3),
    )
    return points, fit


def calibrate_camera(capture: Capture) -> tuple[CameraFit | None, TargetFit | None, list[str]]:
    """Camera of a capture and the intrinsics from its flat targets.

    Image coordinates refer to the stored frames, also for a crop. Targets that cannot be detected or do not determine
    the intrinsics are noted and not used.

    Parameters
    ----------
    capture
        Capture with `[geometry]` (surveyed points), `[[target]]` tables, both or neither.

    Returns
    -------
    CameraFit | None
        Camera fitted to the surveyed points; None without `[geometry]`.
    TargetFit | None
        Fit of the target views, jointly with the survey if there is one; None without usable targets.
    list[str]
        Notes: targets not used (file, scatter and limit), outliers, scatter beyond the stated sigma, a better
        distortion model.

    Raises
    ------
    InputError
        If the surveyed points are faulty or cannot determine a camera.
    """
    survey = _survey(capture)
    views, names, notes = _views(capture)
    targets = None
    if views:
        try:
            targets = fit_camera_targets(
                views,
                width_px=capture.shape[1],
                height_px=capture.shape[0],
                survey=survey,
                source=f"{capture.folder / 'capture.toml'}: target",
                names=names,
            )
            notes += targets.notes
        except InputError as fault:
            notes.append(f"targets not used: {fault}")
    if survey is None:
        notes.append("no [geometry]: the camera's pose in the box cannot be computed")
        return None, targets, notes
    fit = survey[1]
    choice = choose_distortion(*survey)
    if choice is not None and choice.note is not None:
        notes.append(choice.note)
    if fit.outliers:
        notes.append(f"surveyed points left out as outliers: {', '.join(fit.outliers)}")
    if fit.p_value is not None and fit.p_value < 1e-3:
        notes.append(
            f"surveyed points scatter by {fit.reprojection_rms_px:.3f} px, the manifest states "
            f"{fit.point_sigma_px:.3f} px (probability {fit.p_value:.1e})"
        )
    return fit, targets, notes
