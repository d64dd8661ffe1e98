"""Choosing effects: forward by gain, held-out pixels and size, backward by superfluity, and what is left over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from cboxlab.render.warp import warp_change
from numpy.typing import NDArray
from scipy.stats import chi2

from .effects import AppliedEffect
from .forward import displacement
from .heldout import PREDICTS, heldout_bands, heldout_pixels
from .linear_model import LinearModel, build_linear_model, model_variance, smooth_excess, smooth_part
from .nuisances import camera_jacobian
from .pipeline import Prepared, Rendered
from .predictor import Predictor
from .search import Candidate, Problem, Signature, fit, problem, screen, steps_of

__all__ = [
    "HOPELESS", "MOST_OF_IT", "PRIOR_EFFECTS", "SHAPE_FLAW", "UNKNOWN", "Bench", "Place", "best_singles",
    "build_bench", "exchanged", "explained_part", "first_worthy", "groups", "left_over", "merged", "predictive",
    "prior_strain", "refitted_together", "remains", "with_rendered", "without_idle",
]  # fmt: skip

UNKNOWN = "unknown"

#: An effect must lower chi2 per sample by this much: below it, the base picture's own flaws could do the same. They are
#: smooth; what changes edges alone is not imitated by them, and edges' own flaws are in the variance.
_SMALLEST_GAIN, _SMALLEST_AT_EDGES = 0.015, 0.004

#: Part of what an effect explains by which the error of its shape may change chi2: of a shape wrong by a tenth a
#: hundredth is left, and one wrong by a twentieth may make as much between two effects in the same place. A further
#: effect must gain more than this part of what those already in explain.
SHAPE_FLAW = 0.01

#: Stages whose effects are in the picture that is rendered anew: their shapes are as good as the picture.
_RENDERED = ("scene", "settings")

#: Effects that only the priors speak against (they imitate a nuisance), and how often chance alone may relieve the
#: priors by as much as is asked for.
PRIOR_EFFECTS = ("camera-pose", "lens-distortion", "lamp-power")
_PRIOR_CHANCE = 3e-4

#: Interior block means may exceed noise by this much of chi2 per sample before something is said to remain, all
#: pixels by the second, and by this part of what they exceeded it by at first (the error of the effects' shapes).
_REMAINS, _REMAINS_ANYWHERE, _REMAINS_PART = 0.03, 0.15, 0.03

#: Below this part of the excess over noise, what effects explain together may be a coincidence of shapes.
MOST_OF_IT = 0.9

#: Effects that together explain less than this part of the excess each are no beginning of an answer.
HOPELESS = 0.25

#: Two effects whose fits differ by less than this in chi2 cannot be told apart (odds of about 100 to 1).
_INDISTINGUISHABLE = 9.2

#: So many of the effects that could stand in another's place are fitted in full.
_RIVALS = 3

#: With fewer effects the search for the best of all single ones has had its say.
_MERGED_FROM = 3

#: A candidate whose first-order gain is below this part of the best fitted one's is not fitted in full.
_OUTDONE = 0.4

#: Prior rows at the end of every whitened vector: ten of the camera, one of the lamp.
_PRIOR_ROWS = 11


@dataclass(frozen=True, eq=False)
class Bench:
    """A rendered picture and the linear model about its camera. given : the model's own effects.

    base : (band, y, x) what the predictor says under them, which effects' changes are counted from. moved :
    what the last refit of the camera adds to it. derivative : (10, band, y, x) by the camera's parameters.
    """

    rendered: Rendered
    model: LinearModel
    given: tuple[AppliedEffect, ...]
    base: NDArray[np.float64]
    moved: NDArray[np.float64]
    derivative: NDArray[np.float64]

    @property
    def predictor(self) -> Predictor:
        """Of the rendered picture."""
        assert self.rendered.predictor is not None
        return self.rendered.predictor

    @property
    def scale(self) -> float:
        """The lamp's fitted scale."""
        return self.rendered.fit.lamp_scale

    def task(self, chosen: Sequence[Candidate]) -> Problem:
        """What a further effect is fitted to, with these in place, their numbers free to follow."""
        applied = [c.applied for c in chosen]
        changes = []
        for index, one in enumerate(chosen):
            rest = self._problem(self.model, [*applied[:index], *applied[index + 1 :]])
            here = rest.change(one.applied)
            changes += [rest.change(step.after.applied) - here for step in steps_of(one)]
        return self._problem(self.model.freed(changes), applied)

    def _problem(self, model: LinearModel, others: Sequence[AppliedEffect]) -> Problem:
        return problem(self.predictor, model, (*self.given, *others), self.scale, self.rendered.variance)


def build_bench(prepared: Prepared, rendered: Rendered, given: Sequence[AppliedEffect]) -> Bench:
    """Linearise about the rendered picture's camera. The predictor's base may hold more effects than ``given``."""
    fit_, predictor = rendered.fit, rendered.predictor
    assert predictor is not None
    base = predictor.signal(given)
    moved = warp_change(predictor.warp, fit_.camera)
    signal = base + moved
    # of the best picture there is: without its interreflection a box is dark, and its noise a third of the true one
    best, noise = fit_.lamp_scale * rendered.signal, fit_.lamp_scale**2 * rendered.variance
    variance = prepared.calibration.predicted_variance(best) + noise + model_variance(best)
    derivative = camera_jacobian(predictor.warp, fit_.camera)
    model = build_linear_model(
        prepared.measured, signal, variance, rendered.used, rendered.image.coverage, derivative, fit_,
        prepared.expected_camera(given), prepared.lamp_sigma,
    )  # fmt: skip
    return Bench(rendered, model, tuple(given), base, moved, derivative)


def best_singles(
    task: Problem, signatures: Sequence[Signature], residual: NDArray, refined: int, known: float = np.inf
) -> list[Candidate]:
    """Candidates, the best hypothesis of every effect, best first; the most promising fitted in full.

    known : chi2 that another effect already reaches, beside which some are not promising.
    """
    best: dict[str, Candidate] = {}
    for candidate in sorted((screen(task, s, residual) for s in signatures), key=_penalised):
        best.setdefault(candidate.hypothesis.effect.id, candidate)
    ranked = sorted(best.values(), key=_penalised)
    start = _square(task.model.project(residual))
    done: list[Candidate] = []
    for candidate in ranked[:refined]:
        lowest = min((c.chi2 for c in done), default=known)
        if np.isfinite(lowest) and start - candidate.chi2 < _OUTDONE * (start - lowest):
            break
        done.append(fit(task, candidate, residual, lowest))
    return sorted([*done, *ranked[len(done) :]], key=_penalised)


def _penalised(candidate: Candidate) -> float:
    return candidate.chi2 + _INDISTINGUISHABLE / 2 * len(candidate.hypothesis.free)


def first_worthy(
    candidates: Sequence[Candidate], residual: NDArray, model: LinearModel, rendered: NDArray
) -> Candidate | None:
    """The best candidate whose gain counts. One that relieves a prior gains little chi2, and need not be the best.

    residual, rendered : (n + 11,) with the effects already in, and with those of them that are rendered anew. model :
    what the candidates were fitted in.
    """
    explained = _square(rendered) - _square(residual)
    residual = model.project(residual)
    return next((c for c in candidates if _worth(c, residual, model, explained)), None)


def _worth(candidate: Candidate, residual: NDArray, model: LinearModel, explained: float) -> bool:
    """Whether a gain is more than flaws of the base picture or of the effects already in could give, or relieves a
    strained prior. explained : chi2, by effects whose shapes have flaws of their own."""
    gain = _square(residual) - candidate.chi2
    if candidate.hypothesis.effect.id in PRIOR_EFFECTS:
        relief = prior_strain(residual) ** 2 - prior_strain(residual - candidate.predicted) ** 2
        return gain > 0 and relief > chi2.isf(_PRIOR_CHANCE, len(candidate.hypothesis.free))
    return gain > max(_least_gain(candidate, model), SHAPE_FLAW * explained)


def _least_gain(candidate: Candidate, model: LinearModel) -> float:
    """Chi2 that flaws of the base picture could let an effect gain, by how smooth the effect is."""
    smooth = smooth_part(model, candidate.predicted)
    return model.count * (_SMALLEST_AT_EDGES + smooth * (_SMALLEST_GAIN - _SMALLEST_AT_EDGES))


def prior_strain(residual: NDArray) -> float:
    """Standard deviations by which camera and lamp, at their best, miss what is known of them; of (n + 11,)."""
    return float(np.linalg.norm(residual[-_PRIOR_ROWS:]))


def refitted_together(bench: Bench, chosen: Sequence[Candidate], rounds: int = 2) -> list[Candidate]:
    """All chosen effects' numbers fitted in turn, each with the others in place."""
    current = list(chosen)
    for _ in range(rounds if len(current) > 1 else 1):
        for index, candidate in enumerate(current):
            others = [c for i, c in enumerate(current) if i != index]
            left = left_over(bench, others)
            current[index] = fit(bench.task(others), candidate, left)
    return current


def _square(vector: NDArray) -> float:
    return float(vector @ vector)


def left_over(bench: Bench, chosen: Sequence[Candidate]) -> NDArray[np.float64]:
    """(n + 11,) projected residual with these effects in place."""
    if not chosen:
        return bench.model.residual
    added = [c.applied for c in chosen]
    signal = bench.predictor.signal((*bench.given, *added))
    moved = bench.model.displaced(displacement(bench.predictor.camera, bench.given, added))
    return bench.model.residual - bench.model.whiten(bench.scale * (signal - bench.base)) - moved


def without_idle(bench: Bench, chosen: Sequence[Candidate]) -> list[Candidate]:
    """Backward elimination: an effect that the later ones made superfluous goes."""
    current = list(chosen)
    while len(current) > 1:
        full = left_over(bench, current)
        costs = []
        for index, candidate in enumerate(current):
            rest = refitted_together(bench, [c for c in current if c is not candidate], 1)
            left = left_over(bench, rest)
            costs.append((_square(left) - _square(full), index, rest))
        cost, index, rest = min(costs, key=lambda item: item[0])
        least = _least_gain(current[index], bench.model)
        if cost > least or current[index].hypothesis.effect.id in PRIOR_EFFECTS:
            break
        current = rest
    return current


def merged(bench: Bench, chosen: Sequence[Candidate], signatures: Sequence[Signature]) -> list[Candidate]:
    """Two of three effects replaced by one that does as well: what one effect does, two together may imitate, and the
    first of them was chosen while the others were missing. What relieves a prior gains too little to be judged so.
    """
    if len(chosen) < _MERGED_FROM or any(c.hypothesis.effect.id in PRIOR_EFFECTS for c in chosen):
        return list(chosen)
    together = left_over(bench, chosen)
    limit = _square(together) + _SMALLEST_GAIN * bench.model.count
    best = list(chosen)
    for kept in chosen:
        rest = [s for s in signatures if s.hypothesis.effect.id != kept.hypothesis.effect.id]
        found = best_singles(bench.task([kept]), rest, left_over(bench, [kept]), _RIVALS)
        trial = refitted_together(bench, [kept, found[0]])
        left = left_over(bench, trial)
        if _square(left) < limit:
            best, limit = trial, _square(left)
    return best


def with_rendered(bench: Bench, chosen: Sequence[Candidate]) -> NDArray[np.float64]:
    """(n + 11,) projected residual with those of the effects that are rendered anew in place."""
    return left_over(bench, [c for c in chosen if c.hypothesis.effect.stage in _RENDERED])


def remains(model: LinearModel, residual: NDArray, rendered: NDArray) -> bool:
    """Whether the residual that is left is more than noise, flaws of the base picture and of the effects' shapes.

    rendered : (n + 11,) the same with those of the effects only that are rendered anew.
    """
    first, excess = (_square(vector) / model.count - 1 for vector in (rendered, residual))
    return smooth_excess(model, residual) > max(
        _REMAINS, _REMAINS_PART * smooth_excess(model, rendered)
    ) or excess > max(_REMAINS_ANYWHERE, _REMAINS_PART * first)


@dataclass(frozen=True, eq=False)
class Place:
    """One of several effects, and what else could stand in its place. rivals : best first, without itself.

    empty : chi2 with nothing there, the other effects staying. heldout_pixels, heldout_bands : what it gains where
    it was not fitted, see ``heldout``; NaN where that cannot be tried.
    """

    candidate: Candidate
    rivals: tuple[Candidate, ...]
    empty: float
    heldout_pixels: float
    heldout_bands: float

    @property
    def alike(self) -> list[Candidate]:
        """Rivals that this capture, or the accuracy of the effects' shapes, cannot tell from it."""
        allowed = max(_INDISTINGUISHABLE, SHAPE_FLAW * (self.empty - self.candidate.chi2))
        return [c for c in self.rivals if c.chi2 - self.candidate.chi2 < allowed]


def places(bench: Bench, chosen: Sequence[Candidate], signatures: Sequence[Signature]) -> list[Place]:
    """For every chosen effect the others of the catalogue in its place."""
    found = []
    together = left_over(bench, chosen)
    for index, candidate in enumerate(chosen):
        others = [c for i, c in enumerate(chosen) if i != index]
        taken = {c.hypothesis.effect.id for c in chosen}
        rest = [s for s in signatures if s.hypothesis.effect.id not in taken]
        prior = candidate.hypothesis.effect.id in PRIOR_EFFECTS
        if prior:
            # what it explains is strain in the priors: that others fit the picture's flaws better says nothing
            rest = [s for s in rest if s.hypothesis.effect.id in PRIOR_EFFECTS]
        residual, task = left_over(bench, others), bench.task(others)
        reached = _square(task.model.project(together)) + task.smoothed_away(candidate.applied)
        best = best_singles(task, rest, residual, _RIVALS, reached)
        fitted = replace(candidate, chi2=reached)
        shape = residual - together
        found.append(
            Place(
                fitted, tuple(best), _square(task.model.project(residual)),
                np.nan if prior else heldout_pixels(bench.model, residual, shape),
                np.nan if prior else heldout_bands(bench.model, residual, shape),
            )
        )  # fmt: skip
    return found


def exchanged(
    bench: Bench, chosen: Sequence[Candidate], signatures: Sequence[Signature]
) -> tuple[list[Candidate], list[Place]]:
    """Effects replaced while another does better in one's place: the first of several is chosen while the others
    are still missing, and may be a mixture of them."""
    current, known = list(chosen), places(bench, chosen, signatures)
    for _ in range(len(current)):
        better = [
            (place.candidate.chi2 - place.rivals[0].chi2, index)
            for index, place in enumerate(known)
            if place.rivals and place.rivals[0].chi2 < place.candidate.chi2 - _INDISTINGUISHABLE
        ]
        if not better:
            break
        index = max(better)[1]
        current = refitted_together(bench, [*current[:index], known[index].rivals[0], *current[index + 1 :]])
        known = places(bench, current, signatures)
    return current, known


def predictive(
    bench: Bench, chosen: Sequence[Candidate], known: Sequence[Place], signatures: Sequence[Signature]
) -> tuple[list[Candidate], list[Place]]:
    """Without effects that do not hold in pixels or bands held out: something else has merely a similar shape."""
    kept = [
        candidate
        for candidate, place in zip(chosen, known, strict=True)
        if not (place.heldout_pixels < PREDICTS or place.heldout_bands < PREDICTS)
    ]
    if len(kept) == len(chosen):
        return list(chosen), list(known)
    kept = refitted_together(bench, kept) if kept else []
    return kept, places(bench, kept, signatures)


def explained_part(model: LinearModel, residual: NDArray) -> float:
    """Part of what chi2 exceeded its expectation by that the effects have explained."""
    left = _square(residual)
    return (model.chi2 - left) / max(model.chi2 - model.count, model.chi2 - left, 1e-9)


def groups(known: Sequence[Place]) -> tuple[tuple[str, ...], ...]:
    """Each chosen effect together with those that it cannot be told from."""
    found = []
    for place in known:
        if place.alike:
            found.append(tuple(c.hypothesis.effect.id for c in (place.candidate, *place.alike)))
    return tuple(found)
