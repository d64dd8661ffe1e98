"""Choice of the lens's formula and terms by points held out of the fit.

More terms always fit the same points better; held-out points test whether they describe the lens. The formulas are
OpenCV's: radial terms k1 to k3 and decentring terms p1, p2 of a polynomial, k1 to k4 of a fisheye; and fx unlike fy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.lens import Lens
from cboxlab.utils.distributions import fisher_tail
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from .camera_fit import FALSE_ALARM
from .camera_jacobian import inverse_information
from .lens_model import LensModel
from .target_adjustment import adjust, view_jacobian
from .targets import TargetView

__all__ = ["DistortionChoice", "choose_distortion", "model_name"]

#: Terms beyond k1 that are tried, by formula, the simplest first; each also with fx unlike fy.
_TERMS = {
    "polynomial": ((), ("k2",), ("p1", "p2"), ("k2", "k3"), ("k2", "p1", "p2"), ("k2", "k3", "p1", "p2")),
    "fisheye": ((), ("k2",), ("k2", "k3", "k4")),
}

#: Fewest points for a choice: ten parameters are fitted to nine tenths of them.
_FEWEST_POINTS = 12

#: Number of parts of the points; each is held out once.
_FOLDS = 10

#: Standard errors of the paired difference by which a more complex model must predict better.
_CLEAR_ERRORS = 2.0


@dataclass(frozen=True, eq=False)
class DistortionChoice(FrozenMappings):
    """Lens selected by its prediction of held-out points."""

    #: By name of the model, root mean square error of held-out points, per coordinate, px.
    held_out_rms_px: Mapping[str, float]
    #: Name of the simplest model that no more complex one significantly improves on.
    name: str
    #: That model.
    model: LensModel
    #: Cameras fitted with it, in the order of the views.
    cameras: tuple[Camera, ...]
    #: One sentence if the model differs from the first one; otherwise None.
    note: str | None


def model_name(model: LensModel) -> str:
    """Name of a model, such as "k1 k2" or "fisheye k1, fx fy".

    Parameters
    ----------
    model
        The model.

    Returns
    -------
    str
        Formula where it is a fisheye, then the fitted terms.
    """
    terms = " ".join(["k1", *(t for t in model.terms if t != "aspect")])
    formula = "fisheye " if model.lens.model == "fisheye" else ""
    return formula + terms + (", fx fy" if "aspect" in model.terms else "")


def _candidates(first: LensModel) -> list[LensModel]:
    """Models that agree with what the first one states, by their number of terms."""
    formulas = ["fisheye"] if first.lens.model == "fisheye" else ["polynomial", "fisheye"]
    distortions = [(formula, terms) for formula in formulas for terms in _TERMS[formula]]
    if first.k1 is not None:
        distortions = [(first.lens.model, ())]
    models = []
    for formula, terms in distortions:
        lens = first.lens if formula == first.lens.model else Lens("fisheye", aspect=first.lens.aspect)
        square = replace(first, lens=lens, terms=terms)
        models.append(square)
        if first.focal_length_px is None:
            models.append(square.with_terms((*terms, "aspect")))
    return sorted(models, key=lambda model: (model != first, len(model.terms)))


def _held_out(
    cameras: Sequence[Camera],
    measured: Sequence[TargetView],
    sigmas: Sequence[float],
    model: LensModel,
    folds: Sequence[NDArray[np.int_]],
) -> tuple[NDArray[np.float64], float]:
    """Squared errors of held-out points and the sum of squares of the fit, over the variances.

    The fit without a fold follows from the fit of all by one step of Gauss and Newton, exact for a linear model: its
    errors are (I - H)^-1 r with the fold's block H of the hat matrix and its residuals r.
    """
    jacobian = view_jacobian(cameras, measured, sigmas, model)
    inverse_information(jacobian, "points", "")  # an InputError if the points do not determine the model
    basis, _ = np.linalg.qr(jacobian)
    parts = [(i - c.project(w)) / s for c, (w, i), s in zip(cameras, measured, sigmas, strict=True)]
    residuals = np.concatenate(parts)
    squares = np.empty(len(residuals))
    for fold in folds:
        rows = np.stack([2 * fold, 2 * fold + 1], axis=1).ravel()
        block = np.eye(len(rows)) - basis[rows] @ basis[rows].T
        squares[fold] = np.sum(np.linalg.solve(block, residuals[fold].ravel()).reshape(-1, 2) ** 2, axis=1)
    return squares, float(np.sum(residuals**2))


def choose_distortion(
    cameras: Sequence[Camera],
    measured: Sequence[TargetView],
    sigmas: Sequence[float],
    first: LensModel,
    others: Sequence[LensModel] | None = None,
    seed: int = 0,
) -> DistortionChoice | None:
    """Lens by ten-fold cross-validation over the points of one or several views.

    Two models are compared by the mean paired difference of their squared errors on the same held-out points. Another
    model must be better by two standard errors of that difference, and its sum of squares must be lower than by chance:
    Fisher's F at FALSE_ALARM over the number of models.

    Parameters
    ----------
    cameras
        Cameras fitted with the first model, one for each view.
    measured
        World and image positions of the points in use of each view, mm and px.
    sigmas
        Standard deviation of the image coordinates of each view, px.
    first
        Model in use: the simplest one that agrees with what is stated.
    others
        Models to try, the simplest first; None for all that agree with what the first one states.
    seed
        Seed of the random partition of the points.

    Returns
    -------
    DistortionChoice | None
        Selected model; None for fewer than twelve points or if the points do not determine the first model.
    """
    count = sum(len(world) for world, _ in measured)
    if count < _FEWEST_POINTS:
        return None
    folds = np.array_split(np.random.default_rng(seed).permutation(count), _FOLDS)
    typical = float(np.sqrt(np.average(np.square(sigmas), weights=[len(world) for world, _ in measured])))
    models = _candidates(first) if others is None else [first, *others]
    fits: dict[LensModel, tuple[list[Camera], NDArray[np.float64], float]] = {}
    for model in models:
        freedom = 2 * count - model.shared - 6 * len(cameras)
        if freedom <= 0:
            continue
        starts = list(cameras) if model == first else [model.start(camera) for camera in cameras]
        try:
            fitted = starts if model == first else adjust(starts, measured, sigmas, model)
            squares, total = _held_out(fitted, measured, sigmas, model, folds)
        except (InputError, np.linalg.LinAlgError):
            continue
        if np.all(np.isfinite(squares)):
            fits[model] = fitted, squares, total
    if first not in fits:
        return None
    best = first
    for model, (_, squares, total) in fits.items():
        gain = fits[best][1] - squares
        freedom = 2 * count - model.shared - 6 * len(cameras)
        more = max(1, model.shared - best.shared)
        ratio = (fits[best][2] - total) / more / max(total / freedom, np.finfo(float).tiny)
        clear = gain.mean() > _CLEAR_ERRORS * gain.std(ddof=1) / np.sqrt(count)
        if clear and fisher_tail(ratio, more, freedom) < FALSE_ALARM / len(models):
            best = model
    rms = {model: typical * float(np.sqrt(squares.mean() / 2)) for model, (_, squares, _) in fits.items()}
    note = None
    if best != first:
        note = (
            f"lens '{model_name(best)}' is in use: it predicts held-out points better ({rms[best]:.3f} px) than "
            f"'{model_name(first)}' ({rms[first]:.3f} px)"
        )
    by_name = {model_name(model): value for model, value in reversed(rms.items())}
    return DistortionChoice(by_name, model_name(best), best, tuple(fits[best][0]), note)
