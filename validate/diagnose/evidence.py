"""Evidence for an effect, its detection limit, and the test for an unexplained remainder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.rendering.chain import Stage, stages_between
from cboxlab.utils.distributions import chi2_quantile, normal_quantile
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..compare import Nuisances
from .explain import noise_level
from .hypotheses import EXACT_SHAPE_ERROR, FALSE_ALARM, INDISTINGUISHABLE_CHI2, SHAPE_ERROR, SIGNIFICANT_SIGMA
from .linear_model import LinearModel, smooth_excess, smooth_part
from .search import Candidate, Signature

__all__ = [
    "MIN_EXPLAINED_PART_EACH",
    "MIN_GAIN_PER_SAMPLE",
    "REMAINS_MIN_SMOOTH_EXCESS",
    "Limit",
    "beyond_tolerance",
    "dispersion",
    "explained_part",
    "first_significant",
    "gain_of_shape_errors",
    "largest_gain_of_errors",
    "least_gain",
    "least_gain_of",
    "least_gain_of_any",
    "limit_of",
    "penalised",
    "price_of",
    "prior_pull",
    "relief_of",
    "relieves",
    "shape_error_of",
    "something_remains",
    "square",
    "tolerance_notes",
]

#: Minimum chi2 gain per sample of an effect as smooth as rendering errors: those could gain less.
MIN_GAIN_PER_SAMPLE = 0.015

#: Minimum chi2 gain per sample of an effect that changes edges alone: smooth rendering errors do not imitate it, and
#: errors of edges are counted in the variance.
_MIN_GAIN_PER_SAMPLE_AT_EDGES = 0.004

#: Minimum (amplitude / sigma)^2 of an effect with rendering errors in the covariance. Sound captures by two simulators
#: give at most 18, of 150 hypotheses each.
_MIN_AMPLITUDE_SIGMA_SQ = 32.0

#: Minimum chi2 gain per sample with rendering errors in the covariance, set on captures of an independent simulator.
_MIN_GAIN_PER_SAMPLE_OVER_ERRORS = 0.0005

#: Minimum share of an effect's chi2 that rendering errors leave, for it to be tried with them in the covariance. Below
#: it, noise that the model's pictures share decides what is left.
_MIN_VISIBLE_PART = 0.1

#: Minimum excess of interior block means over noise for a remainder, chi2 per sample. Sound captures by an independent
#: simulator show 0.010 to 0.019.
REMAINS_MIN_SMOOTH_EXCESS = 0.03

#: Minimum excess of all samples over noise for a remainder, chi2 per sample: it also counts edges, which scatter more.
_REMAINS_MIN_EXCESS = 0.15

#: Minimum share that a remainder has of the excess without effects: errors of their shapes may leave less.
_REMAINS_MIN_SHARE = 0.03

#: Minimum share of the excess over noise that effects explain on average; the search ends where it is less.
MIN_EXPLAINED_PART_EACH = 0.25


@dataclass(frozen=True, eq=False)
class Limit(FrozenMappings):
    """Detection limit: smallest size of an effect found in nine of ten captures like this one."""

    #: Identifier of the effect.
    effect: str
    #: By parameter, the names chosen.
    choices: Mapping[str, str | float]
    #: Its first number.
    parameter: str
    #: Unit of that number.
    unit: str
    #: Distance of the number from null, in the coordinate of its scale; to first order.
    distance: float
    #: Chi2 per sample that the effect makes at this size.
    chi2_per_sample: float
    #: Share of its chi2 that rendering errors leave.
    visible: float
    #: Whether rendering errors are counted in the covariance; otherwise the effect is judged by its size.
    beside_errors: bool


def limit_of(
    signature: Signature,
    plain: LinearModel,
    counting: LinearModel,
    scale: float,
    second_signature: Signature | None = None,
    residual: NDArray | None = None,
) -> Limit | None:
    """Detection limit of an effect in one way to act, by its first number.

    Parameters
    ----------
    signature
        Changes by a step of the number.
    plain
        Linear model of a capture without the effect.
    counting
        The same with rendering errors in the covariance.
    scale
        Fitted factor on the lamp's power.
    second_signature
        The same signature traced with other random numbers. The product of the two is free of the noise that would
        count as visible change. None: the signature is free of noise.
    residual
        (n + 11,) residual of a capture without any effect. Its correlated parts stand for those of all captures like
        it. None: only noise scatters.

    Returns
    -------
    Limit or None
        None where the effect changes nothing, where only priors judge it, or where the two signatures have nothing in
        common.
    """
    if signature.changes is None or not signature.hypothesis.free:
        return None
    other = (
        signature.changes if second_signature is None or second_signature.changes is None else second_signature.changes
    )
    changes_at_scale = [scale * changes[0] for changes in (signature.changes, other)]
    change, second = (plain.whiten_used(way) for way in changes_at_scale)
    over_errors, second_over_errors = (counting.whiten_used(way) for way in changes_at_scale)
    total, visible_chi2 = float(change @ second), float(over_errors @ second_over_errors)
    if total <= 0 or visible_chi2 <= 0:
        return None
    visible, by_size = visible_chi2 / total, least_gain_of(change, plain)
    largest = largest_gain_of_errors(counting)
    counts_errors = (
        visible > _MIN_VISIBLE_PART and max(_nine_of_ten(_MIN_AMPLITUDE_SIGMA_SQ, 1.0), largest) / visible < by_size
    )
    spread = 1.0 if residual is None else dispersion(counting, over_errors, residual + over_errors) ** 0.5
    gain, parameter = _nine_of_ten(by_size * visible, spread), signature.hypothesis.free[0]
    if counts_errors:
        gain = min(gain, _nine_of_ten(max(_MIN_AMPLITUDE_SIGMA_SQ * spread**2, largest), spread))
    gain /= visible
    distance = abs(signature.steps[0]) * float(np.sqrt(gain / total))
    tolerated = parameter.tolerance * _beyond_chance(sum(p.tolerance > 0 for p in signature.hypothesis.free))
    if distance < tolerated:
        distance, gain = tolerated, gain * (tolerated / distance) ** 2
    return Limit(
        signature.hypothesis.effect.id,
        dict(signature.hypothesis.fixed),
        parameter.name,
        parameter.unit,
        distance,
        gain / plain.count,
        visible,
        counts_errors,
    )


def _nine_of_ten(least: float, spread: float) -> float:
    """The chi2 at which nine of ten gain ``least``; spread of amplitudes in standard deviations."""
    return float(least**0.5 + normal_quantile(0.1) * spread) ** 2


def first_significant(
    candidates: Sequence[Candidate], residual: NDArray, model: LinearModel, exact: NDArray, start: NDArray
) -> Candidate | None:
    """The best candidate with a significant gain.

    One that relieves the priors gains little chi2 and need not be the first.

    Parameters
    ----------
    candidates
        Candidates, best first.
    residual
        (n + 11,) residual with the effects already selected.
    model
        Linear model in which the candidates were fitted.
    exact
        (n + 11,) residual with those selected effects that are computed exactly.
    start
        (n + 11,) residual with those selected effects with which the picture is rendered again.

    Returns
    -------
    Candidate or None
        None where no gain is significant.
    """
    by_shapes = gain_of_shape_errors(residual, exact, start)
    residual = model.project(residual)
    return next((c for c in candidates if _significant(c, residual, model, by_shapes)), None)


def gain_of_shape_errors(residual: NDArray, exact: NDArray, start: NDArray) -> float:
    """Chi2 that errors of the selected effects' shapes may let a further effect gain.

    Parameters
    ----------
    residual
        (n + 11,) residual with the selected effects.
    exact, start
        (n + 11,) see `first_significant`.

    Returns
    -------
    float
        Chi2.
    """
    approximate, computed = square(exact) - square(residual), square(start) - square(exact)
    return max(SHAPE_ERROR * approximate, 0.0) + max(EXACT_SHAPE_ERROR * computed, 0.0)


def shape_error_of(stage: Stage) -> float:
    """Share of its chi2 that an effect of a wrong shape leaves, by its stage.

    Parameters
    ----------
    stage
        Stage at which the effect acts.

    Returns
    -------
    float
        A hundredth where light is traced, a thousandth for what is computed exactly.
    """
    return SHAPE_ERROR if stage in stages_between("scene", "transport") else EXACT_SHAPE_ERROR


def _significant(candidate: Candidate, residual: NDArray, model: LinearModel, by_shapes: float) -> bool:
    """Whether a gain exceeds what errors of rendering and shapes make, or relieves the priors.

    by_shapes : chi2 by errors of the selected effects' shapes.
    """
    gain = square(residual) - candidate.chi2
    if not beyond_tolerance(candidate):
        return False
    if model.errors is not None:
        certain = _MIN_AMPLITUDE_SIGMA_SQ * dispersion(model, candidate.predicted, residual)
        return gain > max(certain, least_gain(candidate, model), by_shapes)
    if candidate.hypothesis.effect.imitates_nuisance:
        relieved = gain > 0 and relieves(relief_of(residual, residual - candidate.predicted), candidate)
        if relieved or candidate.by_priors:
            return relieved
    return gain > max(least_gain(candidate, model), by_shapes)


def relief_of(without: NDArray, residual: NDArray) -> float:
    """Chi2 by which an effect relieves the survey and the stated power.

    Only the rows of the priors count. They hold 0.75 to 1 of what the whole chi2 gains in 16 stored captures; the rest
    of it is in the picture, which other causes change, too.

    Parameters
    ----------
    without
        (n + 11,) residual without the effect.
    residual
        (n + 11,) residual with it.

    Returns
    -------
    float
        Negative where the effect strains them.
    """
    return prior_pull(without) ** 2 - prior_pull(residual) ** 2


def relieves(relief: float, candidate: Candidate) -> bool:
    """Whether an effect relieves the priors by more than chance does.

    Parameters
    ----------
    relief
        Chi2 that the priors gain by it, see `relief_of`.
    candidate
        The effect.

    Returns
    -------
    bool
        By the number of its free numbers.
    """
    return bool(relief > chi2_quantile(FALSE_ALARM, len(candidate.hypothesis.free)))


def beyond_tolerance(candidate: Candidate) -> bool:
    """Whether numbers with a tolerance are further from null than chance takes them.

    Tolerances state what setting up the box leaves uncertain. Several numbers are judged by the norm of their pulls.

    Parameters
    ----------
    candidate
        Candidate with its numbers.

    Returns
    -------
    bool
        True where no free number has a tolerance.
    """
    pulls = [
        (candidate.numbers[p.name] - (p.null or 0.0)) / p.tolerance for p in candidate.hypothesis.free if p.tolerance
    ]
    return not pulls or float(np.linalg.norm(pulls)) > _beyond_chance(len(pulls))


def tolerance_notes(candidates: Sequence[Candidate], residual: NDArray, model: LinearModel) -> tuple[str, ...]:
    """Sentences on effects that the picture shows, but that setting up the box may have made.

    Parameters
    ----------
    candidates
        Effects tried alone.
    residual
        (n + 11,) residual without effects.
    model
        Linear model in which they were fitted.

    Returns
    -------
    tuple of str
        One for each effect whose gain is large and whose numbers are within their tolerances.
    """
    notes = []
    for candidate in candidates:
        if beyond_tolerance(candidate) or square(residual) - candidate.chi2 <= least_gain(candidate, model):
            continue
        free = [p for p in candidate.hypothesis.free if p.tolerance]
        least = _beyond_chance(len(free))
        fitted = ", ".join(f"{p.name} {candidate.numbers[p.name]:.3g}" for p in free)
        limits = ", ".join(f"{p.name} {least * p.tolerance:.2g}" for p in free)
        way = ", ".join(str(value) for value in candidate.hypothesis.fixed.values())
        notes.append(
            f"{candidate.hypothesis.effect.id} of about this size is not named, since setting up a box leaves as much "
            f"uncertain: {', '.join(filter(None, (way, fitted)))}. Each number by itself counts from {limits}."
        )
    return tuple(notes)


def _beyond_chance(count: int) -> float:
    """Distance from null, in tolerances, that ``count`` numbers rarely exceed by chance."""
    return float(np.sqrt(chi2_quantile(FALSE_ALARM, count))) if count else 0.0


def dispersion(model: LinearModel, predicted: NDArray, residual: NDArray) -> float:
    """Variance of an amplitude by correlated residuals, over that by noise and counted errors.

    An amplitude follows the patch of the image where most of its change lies, so that little is left there. Each patch
    counts by how much the amplitude moves where it is left out of the fit (jackknife over clusters: Bell and McCaffrey,
    "Bias reduction in standard errors for linear regression with multi-stage samples", Survey Methodology 28(2), 2002).
    See `parameter_variance`.

    Parameters
    ----------
    model
        Linear model of the capture.
    predicted
        (n + 11,) projected change by the effect.
    residual
        (n + 11,) residual without the effect.

    Returns
    -------
    float
        At least 1. Exactly 1 where the model counts no errors: then a gain is judged by its size.
    """
    if model.errors is None:
        return 1.0
    pixels, remainder = predicted[: model.count], (residual - predicted)[: model.count]
    scores, squares = (np.bincount(model.patch, weights=pixels * other) for other in (remainder, pixels))
    total = max(float(squares.sum()), 1e-300)
    return max(1.0, square(scores / np.maximum(1 - squares / total, 1e-9)) / total)


def least_gain(candidate: Candidate, model: LinearModel) -> float:
    """Chi2 that a candidate must gain over errors of rendering and of dark levels.

    Parameters
    ----------
    candidate
        Candidate with its predicted change.
    model
        Linear model of the capture.

    Returns
    -------
    float
        See `least_gain_of`.
    """
    return least_gain_of(candidate.predicted, model)


def least_gain_of(change: NDArray, model: LinearModel) -> float:
    """Chi2 that a change must gain over errors of rendering and of dark levels.

    Between 0.004 and 0.015 per sample, by the share of the change that is smooth, and at least nine times the mean gain
    by errors of the dark levels. With errors counted in the covariance: `largest_gain_of_errors`.

    Parameters
    ----------
    change
        (n + 11,) projected, over sigma.
    model
        Linear model of the capture.

    Returns
    -------
    float
        Chi2.
    """
    if model.errors is not None:
        return largest_gain_of_errors(model)
    smooth = smooth_part(model, change)
    by_picture = _MIN_GAIN_PER_SAMPLE_AT_EDGES + smooth * (MIN_GAIN_PER_SAMPLE - _MIN_GAIN_PER_SAMPLE_AT_EDGES)
    return max(model.count * by_picture, SIGNIFICANT_SIGMA**2 * model.gain_of_dark_errors(change))


def least_gain_of_any(model: LinearModel, residual: NDArray, exact: NDArray, start: NDArray) -> float:
    """Chi2 below which no effect can be significant, unless it relieves the priors.

    Parameters
    ----------
    model
        Linear model of the capture.
    residual
        (n + 11,) residual with the effects already selected.
    exact, start
        (n + 11,) see `first_significant`.

    Returns
    -------
    float
        Chi2.
    """
    least = model.count * _MIN_GAIN_PER_SAMPLE_AT_EDGES if model.errors is None else largest_gain_of_errors(model)
    return max(least, gain_of_shape_errors(residual, exact, start))


def largest_gain_of_errors(model: LinearModel) -> float:
    """Chi2 that errors of the rendering could let any effect gain.

    Parameters
    ----------
    model
        Linear model of the capture.

    Returns
    -------
    float
        Chi2; smaller where the errors are counted in the covariance.
    """
    return model.count * (MIN_GAIN_PER_SAMPLE if model.errors is None else _MIN_GAIN_PER_SAMPLE_OVER_ERRORS)


def penalised(*together: Candidate) -> float:
    """Chi2 of one effect, or of several fitted together, plus the price of their free numbers.

    Parameters
    ----------
    *together
        Candidates whose `chi2` is that of all.

    Returns
    -------
    float
        Chi2.
    """
    return together[0].chi2 + price_of(sum(len(candidate.hypothesis.free) for candidate in together))


def price_of(numbers: int) -> float:
    """Chi2 that free numbers must gain: half of the smallest distinguishable difference each.

    Parameters
    ----------
    numbers
        Their count.

    Returns
    -------
    float
        Chi2.
    """
    return INDISTINGUISHABLE_CHI2 / 2 * numbers


def prior_pull(residual: NDArray) -> float:
    """Standard deviations by which fitted camera and lamp miss the survey and the stated power.

    Parameters
    ----------
    residual
        (n + 11,) over sigma; its last eleven rows count.

    Returns
    -------
    float
        Norm of the eleven rows.
    """
    return float(np.linalg.norm(residual[-Nuisances.count :]))


def something_remains(model: LinearModel, residual: NDArray, rendered: NDArray) -> bool:
    """Whether a residual exceeds noise, errors of the rendering and of the effects' shapes.

    Errors that a band or a face shares are taken off, up to twice their standard deviation. The noise is estimated from
    neighbouring samples, since sigma may count errors that the rendering does not have.

    Parameters
    ----------
    model
        Linear model of the capture.
    residual
        (n + 11,) residual with the selected effects.
    rendered
        (n + 11,) residual with those of them with which the picture is rendered again.

    Returns
    -------
    bool
        By block means inside faces, or by all samples; see the constants.
    """
    rendered, residual = (model.without_shared_errors(vector) for vector in (rendered, residual))
    noise = noise_level(model.image(residual), model.used)
    first, excess = (square(vector) / model.count - noise for vector in (rendered, residual))
    return smooth_excess(model, residual) > max(
        REMAINS_MIN_SMOOTH_EXCESS, _REMAINS_MIN_SHARE * smooth_excess(model, rendered)
    ) or excess > max(_REMAINS_MIN_EXCESS, _REMAINS_MIN_SHARE * first)


def explained_part(model: LinearModel, residual: NDArray) -> float:
    """Share of the excess of chi2 over its expectation that effects explain.

    Parameters
    ----------
    model
        Linear model, with the residual without effects.
    residual
        (n + 11,) residual with them.

    Returns
    -------
    float
        At most 1.
    """
    remaining_chi2 = square(residual)
    return (model.chi2 - remaining_chi2) / max(model.chi2 - model.count, model.chi2 - remaining_chi2, 1e-9)


def square(vector: NDArray) -> float:
    """Sum of squares.

    Parameters
    ----------
    vector
        (n,).

    Returns
    -------
    float
        vector . vector.
    """
    return float(vector @ vector)
