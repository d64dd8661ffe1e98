"""The cheapest further capture that distinguishes two effects, by their predictions for it.

This capture and the further one are fitted together. Two effects are distinguished by the chi2 between their
predictions, minimised over camera, lamp and the numbers of one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.chain import expected_signal
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.model import displacement
from numpy.typing import NDArray

from ..compare import CalibratedCapture
from .alternatives import SelectedEffect
from .hypotheses import CERTAIN_SIGMA
from .linear_model import model_variance
from .linearised_fit import LinearisedFit
from .search import Candidate, steps_of

__all__ = ["FurtherCapture", "Separation", "distance", "further_captures", "separations"]

#: Time that a frame takes in addition to its exposure, s: filter, focus, file. An estimate.
_HANDLING_S = 5.0

#: Brightest pixel of a frame exposed for the lamp, as a share of full scale: leaves room for noise.
_LAMP_LEVEL = 0.8

#: Factor on the number of frames of the capture that repeats this one: halves the noise.
_REPEAT_FACTOR = 4


@dataclass(frozen=True, eq=False)
class FurtherCapture:
    """A capture that could be taken next."""

    #: Description for the photographer.
    description: str
    #: Time that it takes, s.
    seconds: float
    #: (band,) factor on the exposure times.
    exposure: NDArray[np.float64]
    #: (band,) time of the frames since the first one, min.
    minutes: NDArray[np.float64]
    #: (band, y, x) whether a sample is used.
    used: NDArray[np.bool_]
    #: Factor on the aperture's diameter.
    aperture: float = 1.0
    #: Whether light is kept out while the lamp stays on.
    capped: bool = False
    #: Factor on the number of frames.
    frames: int = 1


@dataclass(frozen=True)
class Separation:
    """The capture that distinguishes an alternative from a selected effect."""

    #: Identifier of the selected effect.
    effect: str
    #: Identifier of the alternative.
    alternative: str
    #: Chi2 between the two in this capture alone.
    now: float
    #: Description of the cheapest capture that is expected to be enough, or else of the best one.
    description: str
    #: Time that it takes, s.
    seconds: float
    #: Chi2 between the two in this capture and the further one.
    chi2: float
    #: Whether this is expected to distinguish them.
    enough: bool


def further_captures(prepared: CalibratedCapture, linearised: LinearisedFit) -> list[FurtherCapture]:
    """Captures that a laboratory could take next with the same camera, filters and box.

    Parameters
    ----------
    prepared
        The calibrated capture.
    linearised
        Its linearised fit.

    Returns
    -------
    list of FurtherCapture
        Six, not ordered by time.
    """
    sensing, used = linearised.predictor.sensing, linearised.model.used
    frames = np.array([len(b.frames) for b in prepared.calibration.capture.manifest.band])
    unchanged, time = np.ones(len(frames)), sensing.exposure_scene

    def seconds(exposure: NDArray, bands: NDArray, count: int = 1) -> float:
        return float(np.sum((count * frames * (time * exposure + _HANDLING_S))[bands]))

    all_bands, later = np.arange(len(frames)), sensing.minutes.max() + 1.0
    in_first_band = sensing.minutes == sensing.minutes.min()
    first = used & in_first_band[:, None, None]
    peak = np.max(linearised.scale * linearised.base, axis=(1, 2))
    short = np.minimum(_LAMP_LEVEL * sensing.full_scale / np.maximum(peak, 1e-9), 1.0)
    finite = np.broadcast_to(np.isfinite(linearised.base).all(axis=0), used.shape)
    return [
        FurtherCapture(
            "the first band once more, after the last one",
            seconds(unchanged, all_bands[in_first_band]),
            unchanged,
            np.full(len(frames), later),
            first,
        ),
        FurtherCapture(
            "frames with the lens capped and the lamp on, at the same exposures",
            seconds(unchanged, all_bands),
            unchanged,
            sensing.minutes,
            used,
            capped=True,
        ),
        FurtherCapture(
            "all bands with exposures so short that the lamp itself is not clipped",
            seconds(short, all_bands),
            short,
            sensing.minutes + later,
            finite,
        ),
        FurtherCapture(
            "all bands at half the exposure",
            seconds(0.5 * unchanged, all_bands),
            0.5 * unchanged,
            sensing.minutes + later,
            used,
        ),
        FurtherCapture(
            "all bands at half the aperture's diameter and four times the exposure",
            seconds(4 * unchanged, all_bands),
            4 * unchanged,
            sensing.minutes + later,
            used,
            aperture=0.5,
        ),
        FurtherCapture(
            f"all bands again, {_REPEAT_FACTOR} times as many frames",
            seconds(unchanged, all_bands, _REPEAT_FACTOR),
            unchanged,
            sensing.minutes,
            used,
            frames=_REPEAT_FACTOR,
        ),
    ]


def _signal(
    linearised: LinearisedFit, effects: Sequence[AppliedEffect], capture: FurtherCapture
) -> NDArray[np.float64]:
    """(band, y, x) DN that a further capture would show."""
    altered = [effect.at_aperture(capture.aperture) for effect in effects]
    predictor, sensing = linearised.predictor, linearised.predictor.sensing
    light = predictor.before_optics(altered)
    factor = capture.exposure * capture.aperture**2
    changed_sensing = replace(
        sensing,
        curves=replace(sensing.curves, factor=sensing.curves.factor * factor),
        exposure_scene=sensing.exposure_scene * capture.exposure,
        minutes=capture.minutes,
    )
    arriving = np.zeros((1, 1, 1)) if capture.capped else factor[:, None, None]
    scene = light.scaled(arriving)
    return expected_signal(scene, changed_sensing, altered, predictor.camera)


def _whitened(
    prepared: CalibratedCapture,
    linearised: LinearisedFit,
    capture: FurtherCapture | None,
    others: Sequence[AppliedEffect],
    candidate: Candidate,
    alternative: Candidate,
) -> tuple[NDArray, NDArray]:
    """Difference (n,) of two effects' predictions over sigma, and its derivatives (n, k)."""
    model_effects = (*linearised.model_effects, *others)

    def signal(effect: AppliedEffect) -> NDArray[np.float64]:
        if capture is None:
            return linearised.scale * linearised.predictor.signal((*model_effects, effect))
        return _signal(linearised, (*model_effects, effect), capture)

    alternative_signal = signal(alternative.applied)
    moved = [(signal(step.after.applied) - alternative_signal) / step.size for step in steps_of(alternative)]
    used = linearised.model.used if capture is None else capture.used
    factor = np.ones(len(used)) if capture is None else capture.exposure * capture.aperture**2
    light = 0.0 if capture is not None and capture.capped else factor[:, None, None]
    frames = 1 if capture is None else capture.frames
    positive_signal = np.maximum(alternative_signal, 0.0)
    variance = prepared.calibration.predicted_variance(positive_signal) / frames + model_variance(positive_signal)
    sigma = np.sqrt(variance[used])
    nuisances = [light * picture for picture in (*linearised.scale * linearised.derivative, linearised.base)]
    columns = [picture[used] / sigma for picture in (*nuisances, *moved)]
    return (signal(candidate.applied) - alternative_signal)[used] / sigma, np.array(columns).T


def distance(
    prepared: CalibratedCapture,
    linearised: LinearisedFit,
    capture: FurtherCapture | None,
    others: Sequence[AppliedEffect],
    candidate: Candidate,
    alternative: Candidate,
) -> float:
    """Chi2 between the predictions of two effects, minimised over nuisances and free numbers.

    Parameters
    ----------
    prepared
        This capture.
    linearised
        The capture's linearised fit.
    capture
        Further capture, fitted together with this one; None for this one alone.
    others
        Effects in the model with either.
    candidate
        One effect, its numbers fixed.
    alternative
        The other effect, whose numbers are free to first order.

    Returns
    -------
    float
        Chi2.
    """
    parts = [_whitened(prepared, linearised, c, others, candidate, alternative) for c in dict.fromkeys([None, capture])]
    priors = linearised.model.priors

    def prior_pull(effect: AppliedEffect) -> NDArray[np.float64]:
        moved = displacement(linearised.predictor.camera, (*linearised.model_effects, *others), (effect,))
        return -priors @ np.append(moved, 0.0)

    alternative_pull = prior_pull(alternative.applied)
    moved = [(prior_pull(step.after.applied) - alternative_pull) / step.size for step in steps_of(alternative)]
    rows = [priors, *(column[:, None] for column in moved)]
    difference = np.concatenate([*(d for d, _ in parts), prior_pull(candidate.applied) - alternative_pull])
    design = np.concatenate([*(x for _, x in parts), np.hstack(rows)])
    size = np.linalg.norm(design, axis=0)
    design = design[:, size > 0] / size[size > 0]
    part = design.T @ difference
    inverse = np.linalg.pinv(design.T @ design, rcond=1e-10, hermitian=True)
    return float(difference @ difference - part @ inverse @ part)


def separations(
    prepared: CalibratedCapture, linearised: LinearisedFit, assessed: Sequence[SelectedEffect]
) -> tuple[Separation, ...]:
    """The capture that would distinguish each selected effect from each of its alternatives.

    Captures are tried from the shortest on until one is expected to be enough.

    Parameters
    ----------
    prepared
        The calibrated capture.
    linearised
        Its linearised fit.
    assessed
        Selected effects with their alternatives.

    Returns
    -------
    tuple of Separation
        One per pair that the capture does not distinguish.
    """
    captures = sorted(further_captures(prepared, linearised), key=lambda c: c.seconds)
    results: list[Separation] = []
    for effect in assessed:
        others = [p.candidate.applied for p in assessed if p is not effect]
        for alternative in effect.indistinguishable:
            distances = []
            now = distance(prepared, linearised, None, others, effect.candidate, alternative)
            # what no effect explains makes the distance of this capture unreliable: the further one is enough alone
            enough = CERTAIN_SIGMA**2 + (now if now > CERTAIN_SIGMA**2 else 0.0)
            for capture in captures:
                chi2 = distance(prepared, linearised, capture, others, effect.candidate, alternative)
                distances.append((chi2, capture))
                if chi2 > enough:
                    break
            best, capture = max(distances, key=lambda item: item[0])
            results.append(
                Separation(
                    effect=effect.candidate.hypothesis.effect.id,
                    alternative=alternative.hypothesis.effect.id,
                    now=now,
                    description=capture.description,
                    seconds=capture.seconds,
                    chi2=best,
                    enough=best > enough,
                )
            )
    return tuple(results)
