"""What counts as evidence for an effect, and when something unexplained is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.utils.frozen import OwnMappings
from numpy.typing import NDArray
from scipy.stats import chi2

from ..compare import Nuisances
from .explain import noise_level
from .linear_model import LinearModel, smooth_excess, smooth_part
from .search import Candidate, Signature

__all__ = [
    "INDISTINGUISHABLE",
    "LEAST_EXPLAINED",
    "LEAST_EXPLAINED_EACH",
    "SHAPE_ERROR",
    "SMALLEST_GAIN",
    "Limit",
    "beyond_tolerance",
    "dispersion",
    "explained_part",
    "first_significant",
    "largest_gain_of_errors",
    "least_gain",
    "least_gain_of",
    "least_gain_of_any",
    "limit_of",
    "penalised",
    "price_of",
    "prior_pull",
    "something_remains",
    "square",
]

#: An effect must lower chi2 per sample by at least this much. The base picture's own errors could make less: they are
#: smooth. What changes edges alone is not imitated by them, and the errors of edges are counted in the variance.
SMALLEST_GAIN, _SMALLEST_GAIN_AT_EDGES = 0.015, 0.004

#: Where the picture's own errors are part of the covariance: an effect's amplitude must be so many times its standard
#: deviation, squared, and gain so much chi2 per sample. Sound captures by two simulators give at most 18, of 150
#: hypotheses each.
_CERTAIN, _SMALLEST_GAIN_OVER_ERRORS = 32.0, 0.0005

#: An effect is tried beside the picture's own errors where they leave this part of its chi2. Of one that they imitate
#: nearly, noise that the model's pictures share decides what is left.
_LEAST_BESIDE_ERRORS = 0.1

#: Standard deviations above a threshold at which 90 % lie beyond it.
_NINE_OF_TEN = 1.2816

#: A relative error e of an effect's shape leaves e^2 of the chi2 that the effect explains. This part allows for an
#: error of a tenth; between two effects in each other's stead it allows for errors of a twentieth each. A further
#: effect must gain more than this part of what those already selected explain.
SHAPE_ERROR = 0.01

#: An effect that imitates a nuisance must relieve the priors by more than chance does with this probability, and one
#: whose numbers are known within a tolerance must exceed that likewise.
_PRIOR_CHANCE = 3e-4

#: Something unexplained is left where the squares of block means of interiors exceed what noise makes of them by more
#: than the first, or those of all pixels by more than the second, in units of chi2 per sample; either must exceed the
#: third part of the excess without effects, too, which the errors of their shapes may leave.
_REMAINS, _REMAINS_ANYWHERE, _REMAINS_PART = 0.03, 0.15, 0.03

#: Effects that explain less than this part of the excess over noise may resemble its cause by coincidence.
LEAST_EXPLAINED = 0.9

#: The search is given up where effects explain less than this part of the excess each.
LEAST_EXPLAINED_EACH = 0.25

#: Two effects whose fits differ by less than this in chi2 cannot be told apart (odds of about 100 to 1).
INDISTINGUISHABLE = 9.2

#: An effect must change more than errors of the bands' dark levels of so many standard deviations could.
_DARK_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class Limit(OwnMappings):
    """The smallest size of an effect that is found in nine of ten captures like this one, to first order.

    choices : the names among its parameters, by parameter. parameter : its first number. distance : of that from null,
    in the coordinate of its scale. chi2_per_sample : that it makes. visible : part of it that the picture's own errors
    leave. beside_errors : whether they are counted, or else the effect is judged by its size.
    """

    effect: str
    choices: Mapping[str, str | float]
    parameter: str
    unit: str
    distance: float
    chi2_per_sample: float
    visible: float
    beside_errors: bool


def limit_of(
    known: Signature,
    plain: LinearModel,
    counting: LinearModel,
    scale: float,
    again: Signature | None = None,
    residual: NDArray | None = None,
) -> Limit | None:
    """Of one way for an effect to act, by its first number; None where it changes nothing, or only what priors tell.

    plain, counting : models of a capture without the effect, without and with the picture's own errors counted.
    scale : of the lamp's power. again : the same traced with other random numbers, whose noise would else count as a
    change that is seen; None also where the two have nothing in common. residual : (n + 11,) of a capture without any
    effect, whose residuals that go together stand for those of all like it; without, only noise scatters.
    """
    if known.changes is None or not known.hypothesis.free:
        return None
    other = known.changes if again is None or again.changes is None else again.changes
    ways = [scale * changes[0] for changes in (known.changes, other)]
    change, second = (plain.whiten_used(way) for way in ways)
    first_left, second_left = (counting.whiten_used(way) for way in ways)
    whole, left = float(change @ second), float(first_left @ second_left)
    if whole <= 0 or left <= 0:
        return None
    visible, by_size = left / whole, least_gain_of(change, plain)
    largest = largest_gain_of_errors(counting)
    beside = visible > _LEAST_BESIDE_ERRORS and max(_nine_of_ten(_CERTAIN, 1.0), largest) / visible < by_size
    spread = 1.0 if residual is None else dispersion(counting, first_left, residual + first_left) ** 0.5
    gain, parameter = _nine_of_ten(by_size * visible, spread), known.hypothesis.free[0]
    if beside:
        gain = min(gain, _nine_of_ten(max(_CERTAIN * spread**2, largest), spread))
    gain /= visible
    distance = abs(known.steps[0]) * float(np.sqrt(gain / whole))
    tolerated = parameter.tolerance * _beyond_chance(sum(p.tolerance > 0 for p in known.hypothesis.free))
    if distance < tolerated:
        distance, gain = tolerated, gain * (tolerated / distance) ** 2
    return Limit(
        known.hypothesis.effect.id,
        dict(known.hypothesis.fixed),
        parameter.name,
        parameter.unit,
        distance,
        gain / plain.count,
        visible,
        beside,
    )


def _nine_of_ten(least: float, spread: float) -> float:
    """The chi2 at which nine of ten gain ``least``. spread : of amplitudes, in their standard deviations."""
    return (least**0.5 + _NINE_OF_TEN * spread) ** 2


def first_significant(
    candidates: Sequence[Candidate], residual: NDArray, model: LinearModel, rendered: NDArray
) -> Candidate | None:
    """The best candidate with a significant gain. One that relieves the priors gains little chi2, and need not be best.

    residual, rendered : (n + 11,) with the effects already selected, and with those of them with which the picture is
    rendered again. model : in which the candidates were fitted.
    """
    explained = square(rendered) - square(residual)
    residual = model.project(residual)
    return next((c for c in candidates if _significant(c, residual, model, explained)), None)


def _significant(candidate: Candidate, residual: NDArray, model: LinearModel, explained: float) -> bool:
    """Whether a gain exceeds what errors of the base picture or of the selected effects' shapes could give, or
    relieves the priors. explained : chi2 by effects whose shapes have errors."""
    gain = square(residual) - candidate.chi2
    if not beyond_tolerance(candidate):
        return False
    if model.errors is not None:
        certain = _CERTAIN * dispersion(model, candidate.predicted, residual)
        return gain > max(certain, least_gain(candidate, model), SHAPE_ERROR * explained)
    if candidate.hypothesis.effect.imitates_nuisance:
        relief = prior_pull(residual) ** 2 - prior_pull(residual - candidate.predicted) ** 2
        relieved = gain > 0 and relief > chi2.isf(_PRIOR_CHANCE, len(candidate.hypothesis.free))
        if relieved or candidate.by_priors:
            return bool(relieved)
    return gain > max(least_gain(candidate, model), SHAPE_ERROR * explained)


def beyond_tolerance(candidate: Candidate) -> bool:
    """Whether numbers that setting up the box leaves uncertain are further from null than chance takes them."""
    pulls = [
        (candidate.numbers[p.name] - (p.null or 0.0)) / p.tolerance for p in candidate.hypothesis.free if p.tolerance
    ]
    return not pulls or float(np.linalg.norm(pulls)) > _beyond_chance(len(pulls))


def _beyond_chance(count: int) -> float:
    """Distance from null, in tolerances, that so many numbers together exceed by chance in few captures; 0 for none."""
    return float(np.sqrt(chi2.isf(_PRIOR_CHANCE, count))) if count else 0.0


def dispersion(model: LinearModel, predicted: NDArray, residual: NDArray) -> float:
    """Variance of the amplitude of a change (n + 11,), by residuals that go together in a neighbourhood of the image,
    over that by noise and the errors that the model counts; at least 1. See ``parameter_variance``.

    An amplitude follows the neighbourhood where most of its change lies, so that little is left there: each one counts
    by how much the amplitude moves where it is left out of the fit (jackknife over clusters: Bell and McCaffrey, "Bias
    reduction in standard errors for linear regression with multi-stage samples", Survey Methodology 28(2), 2002).
    1 where the model counts no errors: then a gain is judged by its size.
    """
    if model.errors is None:
        return 1.0
    pixels, left = predicted[: model.count], (residual - predicted)[: model.count]
    scores, squares = (np.bincount(model.patch, weights=pixels * other) for other in (left, pixels))
    total = max(float(squares.sum()), 1e-300)
    return max(1.0, square(scores / np.maximum(1 - squares / total, 1e-9)) / total)


def least_gain(candidate: Candidate, model: LinearModel) -> float:
    """Chi2 that errors of the base picture, by how smooth the effect is, or of dark levels could let it gain."""
    return least_gain_of(candidate.predicted, model)


def least_gain_of(change: NDArray, model: LinearModel) -> float:
    """The same of a change (n + 11,) over sigma."""
    if model.errors is not None:
        return largest_gain_of_errors(model)
    smooth = smooth_part(model, change)
    by_picture = _SMALLEST_GAIN_AT_EDGES + smooth * (SMALLEST_GAIN - _SMALLEST_GAIN_AT_EDGES)
    return max(model.count * by_picture, _DARK_SIGMAS**2 * model.gain_of_dark_errors(change))


def least_gain_of_any(model: LinearModel, residual: NDArray, rendered: NDArray) -> float:
    """Chi2 that no effect can do with less of, unless it relieves the priors; see ``first_significant``."""
    least = model.count * _SMALLEST_GAIN_AT_EDGES if model.errors is None else largest_gain_of_errors(model)
    return max(least, SHAPE_ERROR * (square(rendered) - square(residual)))


def largest_gain_of_errors(model: LinearModel) -> float:
    """Chi2 that errors of the base picture could let any effect gain."""
    return model.count * (SMALLEST_GAIN if model.errors is None else _SMALLEST_GAIN_OVER_ERRORS)


def penalised(*together: Candidate) -> float:
    """Chi2 of one effect, or of several fitted together, and the price of their free numbers."""
    return together[0].chi2 + price_of(sum(len(candidate.hypothesis.free) for candidate in together))


def price_of(numbers: int) -> float:
    """Chi2 that so many free numbers must gain: half the least distinguishable difference each."""
    return INDISTINGUISHABLE / 2 * numbers


def prior_pull(residual: NDArray) -> float:
    """Standard deviations by which the fitted camera and lamp miss what is known of them, of a residual (n + 11,)."""
    return float(np.linalg.norm(residual[-Nuisances.count :]))


def something_remains(model: LinearModel, residual: NDArray, rendered: NDArray) -> bool:
    """Whether a residual (n + 11,) exceeds noise and the errors of the base picture and of the effects' shapes.

    Errors that a band or a face shares, up to twice their standard deviation, are taken off. Where sigma counts
    errors of the picture that it does not have, noise makes less than 1 of chi2 per sample.
    rendered : (n + 11,) with those of the effects only with which the picture is rendered again.
    """
    rendered, residual = (model.without_shared_errors(vector) for vector in (rendered, residual))
    noise = noise_level(model.image(residual), model.used)
    first, excess = (square(vector) / model.count - noise for vector in (rendered, residual))
    return smooth_excess(model, residual) > max(
        _REMAINS, _REMAINS_PART * smooth_excess(model, rendered)
    ) or excess > max(_REMAINS_ANYWHERE, _REMAINS_PART * first)


def explained_part(model: LinearModel, residual: NDArray) -> float:
    """The part of the excess of chi2 over its expectation that the effects explain."""
    left = square(residual)
    return (model.chi2 - left) / max(model.chi2 - model.count, model.chi2 - left, 1e-9)


def square(vector: NDArray) -> float:
    """Sum of squares of a vector (n,)."""
    return float(vector @ vector)
