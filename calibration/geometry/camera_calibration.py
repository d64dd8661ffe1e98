"""The camera of a capture, from its surveyed points and its flat targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.lens import Lens
from cboxlab.utils.distributions import chi2_tail
from cboxlab.utils.errors import InputError

from ..capture import Capture, LensTable, TargetTable, channel_lattice
from .camera_fit import CameraFit, fit_camera
from .distortion_choice import DistortionChoice, choose_distortion
from .lens_model import ONE_TERM, LensModel
from .placed_boards import BoardPlace, fit_placed, place_notes, placed_points
from .surveyed_points import SurveyedPoints, capture_points
from .target_camera import TargetFit, fit_camera_targets
from .targets import TargetView, detect_target

__all__ = ["BoardViews", "calibrate_camera", "detect_boards"]

#: Width or height of a board's picture above which it is reduced, px: a corner is found to a twentieth of a pixel.
_LARGEST_BOARD_PX = 2400

#: Choices of the lens at most: the second one has the points that agree with the first one.
_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class BoardViews:
    """Flat targets that were detected."""

    #: Points of each view, px of the whole frame.
    points: list[TargetView]
    #: Frame of each.
    names: list[str]
    #: Its place in the box; None where it is not stated.
    board_places: list[BoardPlace | None]
    #: Targets that were not detected, one sentence each.
    notes: list[str]


def _commonest(pattern: str) -> str:
    """Letter with the most pixels in a mosaic's repeat."""
    letters = pattern.replace(" ", "")
    return max(letters, key=letters.count)


def _board_place(target: TargetTable) -> BoardPlace | None:
    """Place of a board in the box; None where it is not stated."""
    if target.origin_mm is None or target.right is None or target.down is None:
        return None
    right, down = np.array(target.right), np.array(target.down)
    axes = np.linalg.qr(np.stack([right, down, np.cross(right, down)], axis=1))[0]
    axes *= np.sign(np.sum(axes * np.stack([right, down, np.cross(right, down)], axis=1), axis=0))
    return BoardPlace(np.array(target.origin_mm), axes, target.kind != "charuco")


def detect_boards(capture: Capture) -> BoardViews:
    """Points of a capture's flat targets, in its frames.

    Parameters
    ----------
    capture
        Capture with or without `[[target]]` tables.

    Returns
    -------
    BoardViews
        Views in the order of the frames, without those in which no target is found.
    """
    views = BoardViews([], [], [], [])
    pattern = None if capture.manifest.mosaic is None else capture.manifest.mosaic.pattern
    faults: dict[str, list[str]] = {}
    for target in capture.manifest.target:
        for name in target.frames:
            image, row, column, step = capture.stored_frame(name), 0, 0, 1
            if pattern is not None:
                # Use one green pixel of each 2 x 2 (X-Trans: 3 x 3) pixels: an image of lower resolution. Without green
                # the most frequent channel has the densest lattice.
                row, column, step = channel_lattice(pattern, "G" if "G" in pattern else _commonest(pattern))
                image = image[row::step, column::step]
            k = -(-max(image.shape) // _LARGEST_BOARD_PX)
            if k > 1:
                height, width = image.shape[0] // k, image.shape[1] // k
                image = image[: k * height, : k * width].reshape(height, k, width, k).mean(axis=(1, 3))
            try:
                world, corners = detect_target(image, target.kind, target.rows, target.columns, target.pitch_mm, name)
            except InputError as fault:
                faults.setdefault(str(fault).removeprefix(f"{name}: "), []).append(name)
                continue
            stored = step * (k * corners + (k - 1) / 2) + [column, row]
            views.points.append((world, stored if capture.reduction is None else capture.reduction.positions(stored)))
            views.names.append(name)
            views.board_places.append(_board_place(target))
    views.notes.extend(f"target not used: {', '.join(names)}: {fault}" for fault, names in faults.items())
    return views


def _stated_model(lens: LensTable) -> LensModel:
    """Lens with the terms that the manifest states."""
    formula: Literal["polynomial", "fisheye"] = "polynomial" if lens.model is None else lens.model
    aspect = 1.0 if lens.fx_px is None or lens.fy_px is None else lens.fy_px / lens.fx_px
    if lens.distortion is None:
        return LensModel(Lens(formula, aspect=aspect), focal_length_px=lens.fx_px)
    k1, *others = lens.distortion
    names = ("k2", "k3", "k4") if formula == "fisheye" else ("k2", "p1", "p2", "k3")
    terms: dict[str, Any] = dict(zip(names, others, strict=True))
    return LensModel(Lens(formula, aspect=aspect, **terms), focal_length_px=lens.fx_px, k1=k1)


@dataclass(frozen=True, eq=False)
class _Survey:
    """Surveyed points with the camera fitted to them."""

    #: The points.
    points: SurveyedPoints
    #: Camera fitted to them.
    fit: CameraFit
    #: Its lens.
    model: LensModel
    #: The lens's choice, and points that contradict a stated lens.
    notes: list[str]


def _survey(capture: Capture, model: LensModel) -> _Survey | None:
    """Surveyed points with camera and lens fitted to them; None without [geometry]."""
    geometry, camera = capture.manifest.geometry, capture.manifest.camera
    points = capture_points(capture)
    if geometry is None or points is None:
        return None

    def fitted(model: LensModel, start: Camera | None = None) -> CameraFit:
        return fit_camera(
            points,
            width_px=camera.width_px,
            height_px=camera.height_px,
            point_sigma_px=geometry.point_sigma_px,
            focal_length_px=_nominal_px(capture),
            model=model,
            start=start,
        )

    try:
        fit = fitted(model)
    except InputError as fault:
        if model != ONE_TERM:
            raise
        # A wide fisheye is too far from the polynomial for a first pose.
        model = LensModel(Lens("fisheye"))
        try:
            fit = fitted(model)
        except InputError:
            raise fault from None
    notes = []
    for _ in range(_ROUNDS):
        choice = _choice(points, fit, model)
        if choice is None or choice.note is None:
            break
        # Points that a simpler lens took for outliers may agree with this one.
        model, fit = choice.model, fitted(choice.model, choice.cameras[0])
        notes.append(choice.note)
    if model.states_something:
        terms = () if model.k1 is None else tuple(t for t in ("k2", "k3", "k4", "p1", "p2") if getattr(model.lens, t))
        free = replace(model, focal_length_px=None, k1=None, terms=(*dict.fromkeys((*model.terms, *terms)),))
        contradicted = _choice(points, fit, model, [free])
        if contradicted is not None and contradicted.note is not None:
            free_px = contradicted.cameras[0].focal_length_px
            notes.append(
                "the surveyed points do not agree with the lens that [lens] states: fitted to them it has a focal "
                f"length of {free_px:.1f} px; the stated one is in use"
            )
    return _Survey(points, fit, model, notes[-1:])


def _choice(
    points: SurveyedPoints, fit: CameraFit, model: LensModel, others: Sequence[LensModel] | None = None
) -> DistortionChoice | None:
    """Lens by the surveyed points in use."""
    measured = [(points.points_mm[fit.in_use], points.image_px[fit.in_use])]
    return choose_distortion([fit.camera], measured, [1.0], model, others)


def _nominal_px(capture: Capture) -> float | None:
    """Nominal focal length, px; None if the manifest does not state it."""
    focal, pitch = capture.manifest.lens.focal_length_mm, capture.manifest.camera.pixel_pitch_um
    return None if focal is None or pitch is None else focal / (pitch * 1e-3)


def _fit_targets(
    capture: Capture, views: BoardViews, survey: _Survey | None, model: LensModel
) -> tuple[TargetFit, LensModel, list[str]]:
    """Fit of the targets, with the survey if there is one, and the lens that all points choose."""

    def fitted(survey: tuple[SurveyedPoints, CameraFit] | None, model: LensModel, lens: Camera | None) -> TargetFit:
        return fit_camera_targets(
            views.points,
            width_px=capture.shape[1],
            height_px=capture.shape[0],
            survey=survey,
            source=f"{capture.folder / 'capture.toml'}: target",
            names=views.names,
            model=model,
            lens=lens,
        )

    pair = None if survey is None else (survey.points, survey.fit)
    targets = fitted(pair, model, None)
    excluded = {view.index for view in targets.discordant}
    measured = [view for index, view in enumerate(views.points) if index not in excluded]
    cameras, sigmas = list(targets.cameras), [targets.point_sigma_px] * len(targets.cameras)
    if survey is not None and targets.survey_camera is not None:
        points, fit = survey.points, survey.fit
        measured.append((points.points_mm[fit.in_use], points.image_px[fit.in_use]))
        cameras.append(targets.survey_camera)
        sigmas.append(fit.point_sigma_px)
    choice = choose_distortion(cameras, measured, sigmas, model)
    if choice is None or choice.note is None:
        return targets, model, list(targets.notes)
    if survey is not None:
        pair = survey.points, replace(survey.fit, camera=choice.cameras[-1])
    targets = fitted(pair, choice.model, choice.cameras[0])
    return targets, choice.model, [choice.note, *targets.notes]


def calibrate_camera(capture: Capture) -> tuple[CameraFit | None, TargetFit | None, list[str]]:
    """Camera of a capture and the intrinsics from its flat targets.

    Image coordinates refer to the stored frames, also for a crop. Targets that cannot be detected or do not determine
    the intrinsics are noted and not used. The lens has as many terms as predict held-out points, see
    ``choose_distortion``, or those that the manifest states.

    Parameters
    ----------
    capture
        Capture with `[geometry]` (surveyed points), `[[target]]` tables, both or neither.

    Returns
    -------
    CameraFit | None
        Camera fitted to the surveyed points, or else to boards at a stated place; None without either.
    TargetFit | None
        Fit of the target views, jointly with the survey if there is one; None without usable targets.
    list[str]
        Notes: targets not used (file, scatter and limit), outliers, scatter beyond the stated sigma, a lens of more
        terms.

    Raises
    ------
    InputError
        If the surveyed points are faulty or cannot determine a camera.
    """
    model = _stated_model(capture.manifest.lens)
    survey = _survey(capture, model)
    model = model if survey is None else survey.model
    views = detect_boards(capture)
    notes, targets = views.notes, None
    if views.points:
        try:
            targets, model, target_notes = _fit_targets(capture, views, survey, model)
            notes += target_notes
        except InputError as fault:
            notes.append(f"targets not used: {fault}")
    if survey is None:
        return _without_survey(capture, views, targets, model, notes)
    fit = survey.fit
    if targets is not None and targets.survey_camera is not None:
        if not targets.survey_camera.lens.one_term:
            fit = _seen_by(fit, survey.points, targets.survey_camera, model, targets.lens_sigmas)
        notes += place_notes(views.points, views.board_places, views.names, fit.camera, targets.point_sigma_px)
    notes += survey.notes if model == survey.model else []
    if fit.outliers:
        notes.append(f"surveyed points left out as outliers: {', '.join(fit.outliers)}")
    if fit.p_value is not None and fit.p_value < 1e-3:
        notes.append(
            f"surveyed points scatter by {fit.reprojection_rms_px:.3f} px, the manifest states "
            f"{fit.point_sigma_px:.3f} px (probability {fit.p_value:.1e})"
        )
    return fit, targets, notes


def _seen_by(
    fit: CameraFit, points: SurveyedPoints, camera: Camera, model: LensModel, lens_sigmas: Mapping[str, float]
) -> CameraFit:
    """The fit of a survey with the camera of a joint fit."""
    residuals = points.image_px - camera.project(points.points_mm)
    squares, freedom = (
        float(np.sum(residuals[fit.in_use] ** 2)),
        2 * int(fit.in_use.sum()) - (model.count - model.shared),
    )
    chi2 = None if fit.chi2 is None else squares / fit.point_sigma_px**2
    return replace(
        fit,
        camera=camera,
        residuals_px=residuals,
        reprojection_rms_px=float(np.sqrt(np.mean(residuals[fit.in_use] ** 2))),
        chi2=chi2,
        p_value=None if chi2 is None else float(chi2_tail(chi2, freedom)),
        degrees_of_freedom=freedom,
        lens_sigmas=lens_sigmas,
    )


def _without_survey(
    capture: Capture, views: BoardViews, targets: TargetFit | None, model: LensModel, notes: list[str]
) -> tuple[CameraFit | None, TargetFit | None, list[str]]:
    """Camera from boards at a stated place, where there are any."""
    in_use = []
    if targets is not None:
        excluded = {view.index for view in targets.discordant}
        in_use = [index for index in range(len(views.points)) if index not in excluded]
    placed = [index for index in in_use if views.board_places[index] is not None]
    if targets is None or not placed:
        reason = (
            "no [geometry] and no board at a stated place that could be used"
            if any(views.board_places)
            else "no [geometry]"
        )
        return None, targets, [*notes, f"{reason}: the camera's pose in the box cannot be computed"]
    cameras = dict(zip(in_use, targets.cameras, strict=True))
    points, start = placed_points(
        [views.points[i] for i in placed],
        [board for i in placed if (board := views.board_places[i]) is not None],
        [cameras[i] for i in placed],
        [views.names[i] for i in placed],
    )
    others = [i for i in in_use if i not in placed]
    starts = [*(cameras[i] for i in others), start]
    measured = [*(views.points[i] for i in others), (points.points_mm, points.image_px)]
    camera, sigmas = fit_placed(starts, measured, targets.point_sigma_px, model, points.source)
    residuals = points.image_px - camera.project(points.points_mm)
    rms = float(np.sqrt(np.mean(residuals**2)))
    fit = CameraFit(
        camera=camera,
        points=None,
        residuals_px=residuals,
        in_use=np.ones(len(points.ids), bool),
        outliers=(),
        reprojection_rms_px=rms,
        point_sigma_px=targets.point_sigma_px,
        sigma_estimated=True,
        chi2=None,
        p_value=None,
        degrees_of_freedom=2 * len(points.ids) - (model.count - model.shared),
        nominal_focal_length_px=_nominal_px(capture),
        lens_sigmas=sigmas,
    )
    notes.append(
        f"the camera's pose is that before {points.source}, whose points lie {rms:.3f} px (rms) from where the stated "
        "place puts them; an error of that place moves the camera as much"
    )
    return fit, targets, notes
