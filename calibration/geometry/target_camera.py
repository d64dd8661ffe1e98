"""Camera intrinsics from several views of flat targets (Zhang 2000).

All views share focal length, principal point and one radial term; each has its own pose. In a joint fit the targets
improve the intrinsics of the surveyed camera.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from .camera_fit import LARGEST_UNCERTAINTY, CameraFit
from .camera_jacobian import inverse_information
from .discordant_views import DiscordantView, discordant_views
from .lens_model import ONE_TERM, LensModel
from .surveyed_points import SurveyedPoints
from .target_adjustment import HINT, adjust, starting_cameras, view_jacobian
from .targets import TargetView

__all__ = ["TargetFit", "fit_camera_targets"]


@dataclass(frozen=True, eq=False)
class TargetFit(FrozenMappings):
    """Intrinsics and poses fitted to views of flat targets, by `fit_camera_targets`."""

    #: One camera per view in use, each with its (10, 10) covariance; they share the intrinsics and the lens.
    cameras: tuple[Camera, ...]
    #: (4,) focal length, principal point u and v, px, and k1.
    intrinsics: NDArray[np.float64]
    #: (4, 4) covariance of `intrinsics`.
    intrinsics_covariance: NDArray[np.float64]
    #: Camera of the surveyed view, from the joint fit; None without a survey.
    survey_camera: Camera | None
    #: Root mean square residual per coordinate over all views in use, px.
    reprojection_rms_px: float
    #: The same of each view in use, px.
    view_rms_px: tuple[float, ...]
    #: Standard deviation of the targets' image coordinates, px, stated or estimated.
    point_sigma_px: float
    #: Number of coordinates of all views in use, including the survey, minus parameters.
    degrees_of_freedom: int
    #: Views that are not used, since they do not agree with the camera of the others.
    discordant: tuple[DiscordantView, ...] = ()
    #: Focal length with the discordant views, px; None without such views or if the fit with them fails.
    focal_length_with_all_px: float | None = None
    #: Standard deviations of the fitted terms of the lens beyond k1, by term.
    lens_sigmas: Mapping[str, float] = field(default_factory=dict)

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence per view that is not used, and one with the change of the focal length."""
        if not self.discordant:
            return ()
        notes = [f"target view not used: {view.reason}" for view in self.discordant]
        with_all = self.focal_length_with_all_px
        if with_all is not None:
            sigma = float(np.sqrt(self.intrinsics_covariance[0, 0]))
            notes.append(
                f"focal length from the other target views {self.intrinsics[0]:.1f} +- {sigma:.1f} px; "
                f"with the views not used {with_all:.1f} px"
            )
        return tuple(notes)


def fit_camera_targets(
    views: Sequence[TargetView],
    *,
    width_px: int,
    height_px: int,
    point_sigma_px: float | None = None,
    survey: tuple[SurveyedPoints, CameraFit] | None = None,
    source: str = "target views",
    names: Sequence[str] | None = None,
    model: LensModel = ONE_TERM,
    lens: Camera | None = None,
) -> TargetFit:
    """Shared intrinsics and the pose of every view.

    Views that do not agree with the camera of the others are not used, see ``discordant_views``. The fit of the other
    views weights their points equally.

    Parameters
    ----------
    views
        Points from ``detect_target``, in pixels of the whole frame (a crop's offset added).
    width_px, height_px
        Size of the image, px.
    point_sigma_px
        Standard deviation of a target's image coordinate, px; None estimates it from the residuals.
    survey
        Surveyed points taken with the same lens and focus, and their fit. The points used in that fit are fitted
        jointly, with its sigma. None without a survey.
    source
        File or key named in messages of errors.
    names
        Name of each view, such as its file; None numbers them from 1.
    model
        Formula of the lens, the parameters that are fitted, and those that are stated.
    lens
        Camera with the initial intrinsics and lens; None takes the survey's, or finds them.

    Returns
    -------
    TargetFit
        Cameras of the views in use, intrinsics with covariance, and the views that are not used.

    Raises
    ------
    InputError
        If the views cannot determine the intrinsics: too few points, only one view, or views without tilt (which do
        not separate focal length from distance). Also if no majority of the views agrees with one camera.
    """
    if len(views) < (1 if survey or model.focal_length_px is not None else 2):
        raise InputError(source, f"{len(views)} view of a flat target", "at least two, tilted differently", HINT)
    for number, (world, _) in enumerate(views, 1):
        if len(world) < 6:
            raise InputError(f"{source}: view {number}", f"{len(world)} points", "at least 6")
    labels = [f"view {number}" for number in range(1, len(views) + 1)] if names is None else names
    discordant = discordant_views(
        views, labels, width_px, height_px, survey=survey, source=source, model=model, lens=lens
    )

    def joint(used: Sequence[TargetView]) -> TargetFit:
        return _joint_fit(
            used, width_px, height_px, point_sigma_px, survey=survey, source=source, model=model, lens=lens
        )

    if not discordant:
        return joint(views)
    excluded = {view.index for view in discordant}
    in_use = [view for index, view in enumerate(views) if index not in excluded]
    fit = joint(in_use)
    try:
        with_all = float(joint(views).intrinsics[0])
    except InputError:
        with_all = None
    return replace(fit, discordant=discordant, focal_length_with_all_px=with_all)


def _joint_fit(
    views: Sequence[TargetView],
    width_px: int,
    height_px: int,
    point_sigma_px: float | None,
    *,
    survey: tuple[SurveyedPoints, CameraFit] | None,
    source: str,
    model: LensModel,
    lens: Camera | None,
) -> TargetFit:
    """Fit of all given views, their points weighted equally, and the surveyed points."""
    measured = list(views)
    if lens is None and survey is not None:
        lens = survey[1].camera
    cameras = starting_cameras(views, width_px, height_px, lens, source)
    if model != ONE_TERM:
        cameras = [camera if lens is not None else model.start(camera) for camera in cameras]
    sigmas = [point_sigma_px or 1.0] * len(views)
    if survey is not None:
        points, fit = survey
        measured.append((points.points_mm[fit.in_use], points.image_px[fit.in_use]))
        cameras.append(fit.camera)
        sigmas.append(fit.point_sigma_px)
    count = sum(2 * len(world) for world, _ in views)
    # One iteration if the sigma is stated; else iterate, since the weights depend on the estimated sigma.
    for _ in range(1 if point_sigma_px else 6):
        cameras = adjust(cameras, measured, sigmas, model)
        jacobian = view_jacobian(cameras, measured, sigmas, model)
        inverse = inverse_information(jacobian, source, HINT)
        residuals = [image - c.project(world) for c, (world, image) in zip(cameras, measured, strict=True)]
        targets = np.concatenate(residuals[: len(views)])
        if point_sigma_px is None:
            # The targets' share of the parameters is the trace of their part of the hat matrix (Foerstner 1979).
            target_parameters = float(np.einsum("ij,jk,ik->", jacobian[:count], inverse, jacobian[:count]))
            ratio = np.sqrt(np.sum(targets**2) / (count - target_parameters)) / sigmas[0]
            sigmas[: len(views)] = [sigmas[0] * ratio] * len(views)
            if survey is None:
                inverse = inverse * ratio**2
                break
    shared = model.shared
    cameras = [
        replace(c, covariance=model.covariance(c, _of_view(inverse, index, shared))) for index, c in enumerate(cameras)
    ]
    covariance = np.asarray(cameras[0].covariance)
    share = float(np.sqrt(covariance[6, 6])) / cameras[0].focal_length_px
    if share > LARGEST_UNCERTAINTY:
        raise InputError(
            source,
            f"a relative uncertainty of the focal length of {share:.0%}",
            f"at most {LARGEST_UNCERTAINTY:.0%}",
            HINT,
        )
    return TargetFit(
        cameras=tuple(cameras[: len(views)]),
        intrinsics=cameras[0].parameters[6:],
        intrinsics_covariance=covariance[6:, 6:],
        survey_camera=cameras[-1] if survey else None,
        reprojection_rms_px=float(np.sqrt(np.mean(targets**2))),
        view_rms_px=tuple(float(np.sqrt(np.mean(r**2))) for r in residuals[: len(views)]),
        point_sigma_px=sigmas[0],
        degrees_of_freedom=jacobian.shape[0] - jacobian.shape[1],
        lens_sigmas=model.term_sigmas(inverse[:shared, :shared]),
    )


def _of_view(covariance: NDArray[np.float64], index: int, shared: int) -> NDArray[np.float64]:
    """(count, count) covariance of one view's fitted parameters, the pose first."""
    order = np.r_[shared + 6 * index : shared + 6 * index + 6, 0:shared]
    return covariance[np.ix_(order, order)]
