"""Judgement of each effect next to flaws of the base: evidence, certainty, stability."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from cboxlab.rendering.chain import after_stage, expected_signal
from cboxlab.rendering.effects import blurred
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..compare import Validation
from .alternatives import (
    SelectedEffect,
    confirmed_where_held_out,
    tested_without_errors,
    with_alternatives,
    with_better_alternatives,
)
from .base_flaws import CORNER_PX, LENS, FittedFlaws, Flaw, FlawModel, PartAmplitudes, build_flaw_model, flaw_columns
from .evidence import beyond_tolerance, gain_of_shape_errors, least_gain_of, price_of, relief_of, relieves, square
from .hypotheses import CERTAIN_SIGMA, MIN_HELDOUT_GAIN, SIGNIFICANT_SIGMA
from .linear_model import LinearModel
from .linearised_fit import (
    LinearisedFit,
    refitted_together,
    residual_with,
    residual_with_exact,
    residual_with_rendered,
)
from .search import Candidate, Problem, Signature, by_signature, column_batches, screen
from .stepwise import MAX_EFFECTS, refitted

__all__ = [
    "BaseFlaws",
    "FlawsWithEffects",
    "SelectionWithFlaws",
    "Verdict",
    "best_with_flaws",
    "confirmed_with_flaws",
    "cost_in_power",
    "flaws_of",
    "flaws_without",
    "scores_with_flaws",
    "selected_with_flaws",
    "settled_with_flaws",
    "verdict_of",
]

#: Largest relative change of an amplitude by fitting flaws with it, if three standard deviations do not allow more.
_MAX_INSTABILITY = 0.4

#: Chi2 per sample by which a base may be off; more is a cause to be found.
_MAX_FLAWED = 0.6

#: Minimum chi2 per sample of a flaw that is reported.
_MIN_FLAW = 0.01

#: Number of effects with which the widths of flaws are fitted again, best ones at the widths before.
_MAX_REFITTED = 4

#: Numerics: number of hypotheses that stand for all where the cost in power is computed.
_NUM_SAMPLED = 25

#: Reflectance by which light is divided, at least.
_DARK = 0.01


@dataclass(frozen=True, eq=False)
class Verdict:
    """Judgement of one effect next to the flaws of the base."""

    #: Identifier of the effect.
    effect: str
    #: Chi2 per sample that it explains, all other effects in place.
    gain: float
    #: 2 ln evidence of effect and flaws over flaws alone, the price of the effect's numbers paid.
    evidence: float
    #: Amplitude with flaws fitted as well, in its standard deviations.
    certainty: float
    #: The same amplitude over that without flaws.
    stability: float
    #: Whether it holds.
    holds: bool
    #: Its amplitudes by place or by level of the signal.
    by_part: PartAmplitudes = field(default_factory=PartAmplitudes)

    @property
    def needed(self) -> bool:
        """Whether flaws alone explain the picture clearly less well."""
        return self.evidence > CERTAIN_SIGMA**2

    @property
    def holds_next_to_flaws(self) -> bool:
        """Whether evidence, certainty and stability suffice, before samples held out are asked.

        An effect with which the picture itself fits less well does not hold, whatever flaws could make of it.
        """
        if not (self.needed and self.certainty > CERTAIN_SIGMA and self.gain > 0):
            return False
        sigma = self.stability / self.certainty
        return bool(abs(self.stability - 1) < max(_MAX_INSTABILITY, SIGNIFICANT_SIGMA * sigma))


@dataclass(frozen=True, eq=False)
class FlawsWithEffects:
    """Flaws of the base in a residual with effects."""

    #: Columns of the flaws in the capture's linear model.
    model: FlawModel[LinearModel]
    #: Their widths and amounts.
    fitted: FittedFlaws
    #: 2 ln evidence of the flaws over none.
    evidence: float
    #: (n + 11,) whitened residual with the effects.
    residual: NDArray[np.float64]
    #: (n,) change of the used samples by all flaws, DN.
    change_dn: NDArray[np.float64]
    #: Every kind's size, the largest first.
    flaws: tuple[Flaw, ...]

    @property
    def score(self) -> float:
        """-2 ln(evidence) of the residual next to the flaws."""
        return self.fitted.score

    @property
    def evident(self) -> bool:
        """Whether the base has flaws larger than chance makes."""
        return self.evidence > CERTAIN_SIGMA**2

    @property
    def small(self) -> bool:
        """Whether flaws of the sizes expected explain it, also where they were not fitted."""
        size = sum(flaw.chi2_per_dof for flaw in self.flaws)
        return self.evident and size < _MAX_FLAWED and not self.model.beyond_flaws

    @property
    def errors(self) -> csr_array:
        """(n, k) over sigma, errors that samples share, as of `FlawModel.errors_of`."""
        return self.model.errors_of(self.fitted)

    @property
    def base_flaws(self) -> BaseFlaws:
        """The flaws without their columns."""
        return BaseFlaws(self.reported, self.small, self.change_dn, self.model.kind_dn(self.fitted, LENS))

    @property
    def reported(self) -> tuple[Flaw, ...]:
        """Flaws worth a sentence, the largest first."""
        if not self.evident:
            return ()
        return tuple(f for f in self.flaws if f.chi2_per_dof > _MIN_FLAW and f.heldout > MIN_HELDOUT_GAIN)


@dataclass(frozen=True, eq=False)
class BaseFlaws:
    """Flaws of the base without their columns, whose size is that of many pictures."""

    #: Flaws worth a sentence, the largest first.
    reported: tuple[Flaw, ...]
    #: Whether flaws of the sizes expected explain it, see `FlawsWithEffects.small`.
    small: bool
    #: (n,) change of the used samples by all flaws, DN.
    change_dn: NDArray[np.float64]
    #: (n,) change by the blur of the lens alone, DN.
    by_lens_dn: NDArray[np.float64]

    @property
    def imitated(self) -> bool:
        """Whether an effect may imitate the flaws: single pixels deviate otherwise."""
        return any(not flaw.of_single_pixels for flaw in self.reported)


def _flaw_model(linearised: LinearisedFit, residual: NDArray[np.float64]) -> FlawModel[LinearModel]:
    """Columns of the base's flaws in a capture's picture.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    residual
        (n + 11,) residual with the effects in question.

    Returns
    -------
    FlawModel
        With the deviations of single pixels estimated.
    """
    signal, predictor = linearised.scale * linearised.rendered.signal, linearised.predictor
    transport, included = predictor.transport, predictor.included
    scene = after_stage(predictor.scene, included, "scene")
    of_fragments = scene.reflectances(predictor.effective_nm)[transport.material]
    reflectance = transport.pixels(of_fragments) / np.maximum(transport.covered, 1e-9)
    once = predictor.with_settings(replace(predictor.settings, max_bounces=1))
    direct, total = (each.patch_picture(included) for each in (once, predictor))
    effects = linearised.model_effects
    light = blurred(predictor.before_optics(effects), np.full(len(signal), CORNER_PX))
    softer = expected_signal(light, predictor.sensing, effects, predictor.camera) / predictor.lamp_scale
    columns = flaw_columns(
        signal,
        linearised.rendered.image.coverage,
        linearised.model.used,
        linearised.model.sigma,
        predictor.warp,
        transport,
        indirect=_arriving_indirectly(signal, reflectance, direct / np.maximum(total, 1e-30)),
        reflectance=reflectance,
        light=predictor.patch_light_of(scene, included),
        blurred=linearised.scale * (softer - linearised.base),
    )
    return build_flaw_model(linearised.model, columns, signal, residual)


def _arriving_indirectly(signal: NDArray, reflectance: NDArray, direct_share: NDArray) -> NDArray[np.float64]:
    """Signal of light from other surfaces as of white ones; 0 where nothing is reflected."""
    part = np.clip(1 - direct_share, 0.0, 1.0)
    return np.where(reflectance > 0, part * signal / np.maximum(reflectance, _DARK), 0.0)


def confirmed_with_flaws(
    linearised: LinearisedFit, selected: Sequence[Candidate], flaws: FlawsWithEffects | None = None
) -> tuple[list[Candidate], FlawsWithEffects, tuple[Verdict, ...]]:
    """Effects that hold next to the flaws of the base.

    Of those that do not hold, the weakest leaves, and the others are judged again.

    Parameters
    ----------
    linearised
        The capture's linearised fit, without errors in its covariance.
    selected
        Effects fitted together.
    flaws
        Flaws of the base next to them; None computes them.

    Returns
    -------
    confirmed : list of Candidate
        The effects that hold, fitted together again where one left.
    flaws : FlawsWithEffects
        Flaws of the base next to these effects.
    verdicts : tuple of Verdict
        Verdict on every effect, removed ones included.
    """
    confirmed, rejected = list(selected), list[Verdict]()
    while True:
        residual = residual_with(linearised, confirmed)
        flaws = flaws or flaws_of(linearised, residual)
        verdicts = [_verdict(linearised, confirmed, index, flaws, residual) for index in range(len(confirmed))]
        failing = [index for index, verdict in enumerate(verdicts) if not verdict.holds]
        if not failing:
            return confirmed, flaws, (*verdicts, *rejected)
        flaws = None  # the next one is as large
        worst = min(failing, key=lambda index: verdicts[index].evidence)
        rejected.append(verdicts[worst])
        del confirmed[worst]
        confirmed = refitted_together(linearised, confirmed) if confirmed else []


def _verdict(
    linearised: LinearisedFit,
    selected: Sequence[Candidate],
    index: int,
    flaws: FlawsWithEffects,
    residual: NDArray[np.float64],
) -> Verdict:
    others = [c for i, c in enumerate(selected) if i != index]
    others = refitted_together(linearised, others) if others else []
    return verdict_of(selected[index], residual_with(linearised, others), residual, flaws)


def verdict_of(
    candidate: Candidate, without: NDArray[np.float64], residual: NDArray[np.float64], flaws: FlawsWithEffects
) -> Verdict:
    """Judgement of an effect next to flaws of the base.

    Parameters
    ----------
    candidate
        The effect.
    without
        (n + 11,) residual without it.
    residual
        (n + 11,) residual with it.
    flaws
        Flaws in the latter.

    Returns
    -------
    Verdict
        An effect that priors judge holds if it still relieves them. One whose numbers are null changes nothing.
    """
    name, model = candidate.hypothesis.effect.id, flaws.model
    gain = (square(without) - square(residual)) / model.model.count
    if candidate.by_priors:
        relief = relief_of(without, residual)
        return Verdict(name, gain, relief, np.inf, 1.0, gain > 0 and relieves(relief, candidate))
    whitened = model.whitened(without)
    alone = model.fit(whitened)
    shape = (whitened - flaws.residual)[:, None]
    (amplitude,), fitted = model.fit_with(shape, whitened, np.ones(1))
    information = float(np.sum(model.weighted(fitted, shape) * shape))
    evidence = alone.score - fitted.score - price_of(len(candidate.numbers))
    certainty = amplitude * np.sqrt(max(information, 0.0))
    by_part = model.amplitudes_by_part(fitted, shape[:, 0], whitened)
    verdict = Verdict(name, gain, evidence, certainty, amplitude, False, by_part)
    return replace(verdict, holds=verdict.holds_next_to_flaws)


@dataclass(frozen=True, eq=False)
class SelectionWithFlaws:
    """Effects that hold next to the flaws of the base, their numbers fitted with the flaws free."""

    #: The picture with the effects, without errors in its covariance.
    linearised: LinearisedFit
    #: The effects.
    selected: list[Candidate]
    #: The same with their alternatives and tests.
    assessed: list[SelectedEffect]
    #: Flaws of the base that remain with them.
    flaws: FlawsWithEffects
    #: Judgement of every effect, those that left included.
    verdicts: tuple[Verdict, ...]


def selected_with_flaws(
    validation: Validation,
    linearised: LinearisedFit,
    confirmed: Sequence[Candidate],
    signatures: Sequence[Signature],
    flaws: FlawsWithEffects | None,
) -> SelectionWithFlaws:
    """Add effects to those that hold, as long as the evidence grows.

    Parameters
    ----------
    validation
        Validation of the capture.
    linearised
        Its linearised fit, with those effects.
    confirmed
        Effects that hold already.
    signatures
        Signatures of the hypotheses.
    flaws
        Flaws of the base next to those effects; None computes them. They are freed once another effect enters, if no
        caller keeps them.

    Returns
    -------
    SelectionWithFlaws
        The effects that hold in the end.
    """
    selected, flaws = list(confirmed), flaws or flaws_of(linearised, residual_with(linearised, confirmed))
    while len(selected) < MAX_EFFECTS:
        present = _names(selected)
        rest = [s for s in signatures if s.hypothesis.effect.id not in present and not s.by_priors]
        residual = residual_with(linearised, selected)
        exact, rendered = (each(linearised, selected) for each in (residual_with_exact, residual_with_rendered))
        least = gain_of_shape_errors(residual, exact, rendered)
        best = best_with_flaws(linearised.problem(selected), rest, flaws, residual, least)
        if best is None:
            break
        linearised = refitted(validation, linearised, [*selected, best])
        judged = _judged(linearised, flaws)
        del flaws  # the next one is as large
        selected = refitted_together(judged, [*selected, best])
        del judged
        flaws = flaws_of(linearised, residual_with(linearised, selected))
    last = [flaws]
    del flaws
    return settled_with_flaws(linearised, *confirmed_with_flaws(linearised, selected, last.pop()), signatures)


def settled_with_flaws(
    linearised: LinearisedFit,
    selected: Sequence[Candidate],
    flaws: FlawsWithEffects,
    verdicts: tuple[Verdict, ...],
    signatures: Sequence[Signature],
) -> SelectionWithFlaws:
    """Effects that hold next to the flaws of the base, against rivals that meet the same flaws.

    Without flaws the best rival imitates these as well.

    Parameters
    ----------
    linearised
        The capture's linearised fit with those effects, without errors in its covariance.
    selected
        Effects that hold.
    flaws
        Flaws of the base next to them.
    verdicts
        Judgement of every effect.
    signatures
        Signatures of the hypotheses.

    Returns
    -------
    SelectionWithFlaws
        The effects that hold in the end.
    """
    if not selected:
        return SelectionWithFlaws(linearised, [], [], flaws, verdicts)
    judged = _judged(linearised, flaws)
    better, assessed = with_better_alternatives(judged, refitted_together(judged, selected), signatures)
    if _names(better) != _names(selected):
        better, flaws, verdicts = confirmed_with_flaws(linearised, better)
        judged = _judged(linearised, flaws)
        better = refitted_together(judged, better) if better else []
        assessed = with_alternatives(judged, better, signatures)
    assessed = tested_without_errors(linearised, assessed)
    confirmed, assessed = confirmed_where_held_out(linearised, better, assessed, signatures)
    if len(confirmed) < len(better):
        flaws = flaws_of(linearised, residual_with(linearised, confirmed))
        rivals = with_alternatives(_judged(linearised, flaws), confirmed, signatures)
        assessed = tested_without_errors(linearised, rivals)
    verdicts = tuple(replace(verdict, holds=verdict.effect in _names(confirmed)) for verdict in verdicts)
    return SelectionWithFlaws(linearised, confirmed, assessed, flaws, verdicts)


def _names(selected: Sequence[Candidate]) -> set[str]:
    return {c.hypothesis.effect.id for c in selected}


def flaws_of(linearised: LinearisedFit, residual: NDArray[np.float64]) -> FlawsWithEffects:
    """Flaws of the base in a residual.

    Parameters
    ----------
    linearised
        The capture's linearised fit, without errors in its covariance.
    residual
        (n + 11,) residual with the effects in question.

    Returns
    -------
    FlawsWithEffects
        Their widths, amounts and evidence.
    """
    model = _flaw_model(linearised, residual)
    whitened = model.whitened(residual)
    fitted = model.fit(whitened)
    return FlawsWithEffects(
        model,
        fitted,
        model.nothing - fitted.score,
        whitened,
        model.change_dn(fitted, residual),
        tuple(model.flaws(fitted, whitened)),
    )


def flaws_without(
    linearised: LinearisedFit, residual: NDArray[np.float64], change: NDArray[np.float64]
) -> FlawsWithEffects:
    """Flaws of the base in what a cause leaves.

    Parameters
    ----------
    linearised
        The capture's linearised fit, without errors in its covariance.
    residual
        (n + 11,) residual with the effects in question.
    change
        (band, y, x) change by the cause, DN.

    Returns
    -------
    FlawsWithEffects
        As `flaws_of`.
    """
    return flaws_of(linearised, residual - linearised.model.whiten(change))


def scores_with_flaws(*fits: tuple[LinearisedFit, NDArray[np.float64]]) -> list[float]:
    """Score of each of several residuals of one capture next to flaws of the base.

    Parameters
    ----------
    *fits
        Linearised fit without errors in its covariance, and (n + 11,) its residual. The first one decides how much
        single pixels deviate.

    Returns
    -------
    list of float
        -2 ln(evidence), the flaws' widths fitted to each.
    """
    model = _flaw_model(*fits[0])
    return [model.fit(model.whitened(residual)).score for _, residual in fits]


def _judged(linearised: LinearisedFit, flaws: FlawsWithEffects) -> LinearisedFit:
    """The same fit with the flaws in its covariance."""
    return replace(linearised, model=flaws.model.counted_in(linearised.model, flaws.fitted))


def best_with_flaws(
    problem: Problem,
    signatures: Sequence[Signature],
    flaws: FlawsWithEffects,
    residual: NDArray[np.float64],
    least: float,
) -> Candidate | None:
    """The effect with the largest evidence to first order; None where none is needed.

    The widths of the flaws are fitted again with each of the best few in place, so that flaws no longer stand for it.
    Its change must be as large as that of an effect that is selected by size.

    Parameters
    ----------
    problem
        The capture with the effects already in its model.
    signatures
        Signatures of the hypotheses.
    flaws
        Flaws in the residual.
    residual
        (n + 11,) residual with those effects.
    least
        Chi2 that errors of their shapes may let a further effect gain.

    Returns
    -------
    Candidate or None
        With its numbers to first order.
    """
    model, whitened = flaws.model, flaws.model.whitened(residual)
    gains = []
    for signature, columns, next_to_flaws in _columns_next_to_flaws(problem, signatures, flaws):
        for weighted in (columns, next_to_flaws):
            amount = model.amounts(weighted, columns, whitened)
            gains.append((float(weighted.T @ whitened @ amount) - price_of(len(amount)), signature, amount))
    first = sorted(gains[::2], key=lambda gain: -gain[0])[:_MAX_REFITTED]
    second = sorted(gains[1::2], key=lambda gain: -gain[0])[:_MAX_REFITTED]
    best: tuple[float, Candidate | None] = (CERTAIN_SIGMA**2, None)
    for _, signature, start in (*first, *second):
        ((_, plain),) = column_batches(problem, [signature])
        columns = model.whitened(plain).T
        amount, fitted = model.fit_with(columns, whitened, start)
        evidence = flaws.score - fitted.score - price_of(len(amount))
        (screened,) = screen(problem, [signature], residual)
        candidate = _started(screened, signature, amount)
        change = amount @ plain
        large = square(change) > max(least, least_gain_of(change, problem.model))
        if evidence > best[0] and large and beyond_tolerance(candidate):
            best = evidence, candidate
    return best[1]


def cost_in_power(problem: Problem, signatures: Sequence[Signature], flaws: FlawsWithEffects) -> float:
    """Factor by which flaws raise the size that an effect must have to be seen.

    Parameters
    ----------
    problem
        The capture without effects.
    signatures
        Signatures of the hypotheses; a few stand for all.
    flaws
        Flaws of the base.

    Returns
    -------
    float
        Median over effects of standard deviations with flaws free over those without, at least 1.
    """
    ratios = [1.0]
    usable = [signature for signature in signatures if not signature.by_priors]
    sampled = usable[:: max(len(usable) // _NUM_SAMPLED, 1)]
    for _, columns, weighted in _columns_next_to_flaws(problem, sampled, flaws):
        plain, with_flaws = (float(np.sum(each * columns)) for each in (columns, weighted))
        ratios.append(float(np.sqrt(plain / max(with_flaws, 1e-12 * plain))) if plain > 0 else 1.0)
    return max(float(np.median(ratios)), 1.0)


def _columns_next_to_flaws(
    problem: Problem, signatures: Sequence[Signature], flaws: FlawsWithEffects
) -> Iterator[tuple[Signature, NDArray[np.float64], NDArray[np.float64]]]:
    """Each signature with its columns (n + 11, p), whitened, and weighted by noise and flaws."""
    for some, columns in column_batches(problem, signatures):
        whitened = flaws.model.whitened(columns)
        weighted = flaws.model.weighted(flaws.fitted, whitened.T).T
        yield from zip(some, by_signature(some, whitened), by_signature(some, weighted), strict=True)


def _started(candidate: Candidate, signature: Signature, amount: NDArray[np.float64]) -> Candidate:
    """A screened candidate at multiples of its steps, clipped to the bounds of its numbers."""
    if not signature.hypothesis.free:
        return candidate
    return replace(candidate, numbers=signature.numbers(np.clip(amount, *signature.bounds.T)))
