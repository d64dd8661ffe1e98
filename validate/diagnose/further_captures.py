"""The cheapest further capture that would tell two effects apart, from what each predicts for it.

This capture and the further one are fitted together. Two effects are told apart by the chi2 between their predictions,
minimised over camera, lamp and the numbers of one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.chain import expected_signal
from cboxlab.rendering.effects import AppliedEffect
from cboxlab.rendering.model import displacement
from numpy.typing import NDArray

from ..compare import Prepared
from .alternatives import SelectedEffect
from .linear_model import model_variance
from .linearised_fit import LinearisedFit
from .search import Candidate, steps_of

__all__ = ["FurtherCapture", "Separation", "distance", "further_captures", "separations"]

#: Difference in chi2 that counts as told apart: five standard deviations.
_ENOUGH = 25.0

#: Time that a frame takes beside its exposure: filter, focus, file.
_HANDLING_S = 5.0

#: The brightest pixel of a frame of the lamp, as a part of full scale.
_LAMP_LEVEL = 0.8

#: Factor on the number of frames of the capture that repeats this one.
_AGAIN = 4


@dataclass(frozen=True, eq=False)
class FurtherCapture:
    """words : what to photograph. seconds : what it takes. exposure : (band,) factor on the exposure times.

    aperture : factor on the aperture's diameter. capped : light is kept out, the lamp stays on. minutes : (band,)
    when. frames : factor on the number of frames. used : (band, y, x).
    """

    words: str
    seconds: float
    exposure: NDArray[np.float64]
    minutes: NDArray[np.float64]
    used: NDArray[np.bool_]
    aperture: float = 1.0
    capped: bool = False
    frames: int = 1


@dataclass(frozen=True)
class Separation:
    """What tells ``alternative`` from ``effect``. now : chi2 between them in this capture. chi2 : with the further one.

    words, seconds : of the cheapest capture that is expected to be enough, or of the best one tried; enough :
    which of the two.
    """

    effect: str
    alternative: str
    now: float
    words: str
    seconds: float
    chi2: float
    enough: bool


def further_captures(prepared: Prepared, linearised: LinearisedFit) -> list[FurtherCapture]:
    """What a laboratory could photograph next with the same camera, filters and box."""
    sensing, used = linearised.predictor.sensing, linearised.model.used
    frames = np.array([len(b.frames) for b in prepared.calibration.capture.manifest.band])
    one, time = np.ones(len(frames)), sensing.exposure_scene

    def seconds(exposure: NDArray, bands: NDArray, count: int = 1) -> float:
        return float(np.sum((count * frames * (time * exposure + _HANDLING_S))[bands]))

    every, later = np.arange(len(frames)), sensing.minutes.max() + 1.0
    is_first = sensing.minutes == sensing.minutes.min()
    first = used & is_first[:, None, None]
    peak = np.max(linearised.scale * linearised.base, axis=(1, 2))
    short = np.minimum(_LAMP_LEVEL * sensing.full_scale / np.maximum(peak, 1e-9), 1.0)
    whole = np.broadcast_to(np.isfinite(linearised.base).all(axis=0), used.shape)
    return [
        FurtherCapture(
            "the first band once more, after the last one",
            seconds(one, every[is_first]),
            one,
            np.full(len(frames), later),
            first,
        ),
        FurtherCapture(
            "frames with the lens capped and the lamp on, at the same exposures",
            seconds(one, every),
            one,
            sensing.minutes,
            used,
            capped=True,
        ),
        FurtherCapture(
            "all bands with exposures so short that the lamp itself is not clipped",
            seconds(short, every),
            short,
            sensing.minutes + later,
            whole,
        ),
        FurtherCapture(
            "all bands at half the exposure", seconds(0.5 * one, every), 0.5 * one, sensing.minutes + later, used
        ),
        FurtherCapture(
            "all bands at half the aperture's diameter and four times the exposure",
            seconds(4 * one, every),
            4 * one,
            sensing.minutes + later,
            used,
            aperture=0.5,
        ),
        FurtherCapture(
            f"all bands again, {_AGAIN} times as many frames",
            seconds(one, every, _AGAIN),
            one,
            sensing.minutes,
            used,
            frames=_AGAIN,
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
    there = replace(
        sensing,
        curves=replace(sensing.curves, factor=sensing.curves.factor * factor),
        exposure_scene=sensing.exposure_scene * capture.exposure,
        minutes=capture.minutes,
    )
    arriving = np.zeros((1, 1, 1)) if capture.capped else factor[:, None, None]
    scene = light.scaled(arriving)
    return expected_signal(scene, there, altered, predictor.camera)


def _whitened(
    prepared: Prepared,
    linearised: LinearisedFit,
    capture: FurtherCapture | None,
    others: Sequence[AppliedEffect],
    one: Candidate,
    alternative: Candidate,
) -> tuple[NDArray, NDArray]:
    """Difference (n,) of two effects' predictions over sigma, and its derivatives (n, k) by what is minimised over."""
    given = (*linearised.given, *others)

    def signal(effect: AppliedEffect) -> NDArray[np.float64]:
        if capture is None:
            return linearised.scale * linearised.predictor.signal((*given, effect))
        return _signal(linearised, (*given, effect), capture)

    here = signal(alternative.applied)
    moved = [(signal(step.after.applied) - here) / step.size for step in steps_of(alternative)]
    used = linearised.model.used if capture is None else capture.used
    factor = np.ones(len(used)) if capture is None else capture.exposure * capture.aperture**2
    light = 0.0 if capture is not None and capture.capped else factor[:, None, None]
    frames = 1 if capture is None else capture.frames
    lit = np.maximum(here, 0.0)
    variance = prepared.calibration.predicted_variance(lit) / frames + model_variance(lit)
    sigma = np.sqrt(variance[used])
    nuisances = [light * picture for picture in (*linearised.scale * linearised.derivative, linearised.base)]
    columns = [picture[used] / sigma for picture in (*nuisances, *moved)]
    return (signal(one.applied) - here)[used] / sigma, np.array(columns).T


def distance(
    prepared: Prepared,
    linearised: LinearisedFit,
    capture: FurtherCapture | None,
    others: Sequence[AppliedEffect],
    one: Candidate,
    alternative: Candidate,
) -> float:
    """Chi2 between the predictions of two effects in this capture and a further one (None: this one alone), minimised
    over camera, lamp and the alternative's numbers. others : effects in the model with either."""
    parts = [_whitened(prepared, linearised, c, others, one, alternative) for c in dict.fromkeys([None, capture])]
    priors = linearised.model.priors

    def surveyed(effect: AppliedEffect) -> NDArray[np.float64]:
        moved = displacement(linearised.predictor.camera, (*linearised.given, *others), (effect,))
        return -priors @ np.append(moved, 0.0)

    here = surveyed(alternative.applied)
    moved = [(surveyed(step.after.applied) - here) / step.size for step in steps_of(alternative)]
    rows = [priors, *(column[:, None] for column in moved)]
    difference = np.concatenate([*(d for d, _ in parts), surveyed(one.applied) - here])
    design = np.concatenate([*(x for _, x in parts), np.hstack(rows)])
    size = np.linalg.norm(design, axis=0)
    design = design[:, size > 0] / size[size > 0]
    part = design.T @ difference
    inverse = np.linalg.pinv(design.T @ design, rcond=1e-10, hermitian=True)
    return float(difference @ difference - part @ inverse @ part)


def separations(
    prepared: Prepared, linearised: LinearisedFit, known: Sequence[SelectedEffect]
) -> tuple[Separation, ...]:
    """For each selected effect and each indistinguishable alternative, the capture that would tell them apart."""
    captures = sorted(further_captures(prepared, linearised), key=lambda c: c.seconds)
    found: list[Separation] = []
    for one in known:
        others = [p.candidate.applied for p in known if p is not one]
        for alternative in one.indistinguishable:
            tried = []
            for capture in captures:
                reached = distance(prepared, linearised, capture, others, one.candidate, alternative)
                tried.append((reached, capture))
                if reached > _ENOUGH:
                    break
            best, capture = max(tried, key=lambda item: item[0])
            found.append(
                Separation(
                    effect=one.candidate.hypothesis.effect.id,
                    alternative=alternative.hypothesis.effect.id,
                    now=distance(prepared, linearised, None, others, one.candidate, alternative),
                    words=capture.words,
                    seconds=capture.seconds,
                    chi2=best,
                    enough=best > _ENOUGH,
                )
            )
    return tuple(found)
