"""Effects judged one by one beside what the base may be off by: evidence, certainty and stability of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .base_flaws import FittedFlaws, Flaw, FlawModel, build_flaw_model, flaw_columns
from .evidence import price_of, square
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate

__all__ = ["BesideFlaws", "Verdict", "beside_flaws", "confirmed_beside_flaws", "flaw_model_of", "price_of_effects"]

#: Minimum 2 ln evidence of flaws over none, for them to count: odds of a hundred thousand million to one.
_MIN_FLAW_EVIDENCE = 50.0

#: Minimum 2 ln evidence of an effect beside flaws over flaws alone.
_MIN_EVIDENCE = 25.0

#: Minimum amplitude of an effect beside flaws, in its standard deviations.
_MIN_CERTAINTY = 5.0

#: Largest relative change of an amplitude when flaws are fitted with it, unless three standard deviations leave it open.
_MAX_INSTABILITY = 0.4

#: Standard deviations by which an amplitude may change.
_UNSTABLE_SIGMA = 3.0

#: Chi2 per sample by which a base may be off; more is a cause to be found.
_MAX_FLAWED = 0.6

#: Minimum chi2 per sample of a flaw that is reported.
_MIN_FLAW = 0.01

#: Minimum gain of a flaw in pixels held out, over that in the fitted ones.
_MIN_HELDOUT = 0.3


@dataclass(frozen=True, eq=False)
class Verdict:
    """Judgement of one effect beside the flaws of the base."""

    #: Identifier of the effect.
    effect: str
    #: 2 ln evidence of effect and flaws over flaws alone, the price of the effect's numbers paid.
    evidence: float
    #: Amplitude with flaws fitted as well, in its standard deviations.
    certainty: float
    #: The same amplitude over that without flaws.
    stability: float
    #: Whether it holds.
    holds: bool


@dataclass(frozen=True, eq=False)
class BesideFlaws:
    """What the base may be off by, in a residual with effects."""

    #: Columns of the flaws in the capture's linear model.
    model: FlawModel
    #: Their widths and amounts.
    fitted: FittedFlaws
    #: 2 ln evidence of the flaws over none.
    evidence: float
    #: (n + 11,) whitened residual with the effects.
    residual: NDArray[np.float64]
    #: Every kind's size, the largest first.
    flaws: tuple[Flaw, ...]

    @property
    def score(self) -> float:
        """-2 ln(evidence) of the residual beside the flaws."""
        return self.fitted.score

    @property
    def evident(self) -> bool:
        """Whether the base is off by more than chance."""
        return self.evidence > _MIN_FLAW_EVIDENCE

    @property
    def small(self) -> bool:
        """Whether flaws of the sizes expected explain it, also where they were not fitted."""
        size = sum(flaw.chi2_per_dof for flaw in self.flaws)
        return self.evident and size < _MAX_FLAWED

    @property
    def reported(self) -> tuple[Flaw, ...]:
        """Flaws worth a sentence, the largest first."""
        if not self.evident:
            return ()
        return tuple(f for f in self.flaws if f.chi2_per_dof > _MIN_FLAW and f.heldout > _MIN_HELDOUT)


def flaw_model_of(linearised: LinearisedFit, residual: NDArray[np.float64]) -> FlawModel:
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
    columns = flaw_columns(
        signal, linearised.rendered.image.coverage, linearised.model.used, predictor.warp, predictor.transport
    )
    return build_flaw_model(linearised.model, columns, signal, residual)


def beside_flaws(model: FlawModel, residual: NDArray[np.float64]) -> BesideFlaws:
    """What the base may be off by, fitted to a residual.

    Parameters
    ----------
    model
        Columns of the flaws.
    residual
        (n + 11,) residual of the plain model.

    Returns
    -------
    BesideFlaws
        Widths, amounts and sizes.
    """
    whitened = model.whitened(residual)
    fitted = model.fit(whitened)
    return BesideFlaws(
        model,
        fitted,
        model.score(model.without(fitted), whitened) - fitted.score,
        whitened,
        tuple(model.flaws(fitted, whitened)),
    )


def confirmed_beside_flaws(
    linearised: LinearisedFit, selected: Sequence[Candidate]
) -> tuple[list[Candidate], BesideFlaws, tuple[Verdict, ...]]:
    """Effects that hold beside the flaws of the base; the weakest of those that do not leaves first.

    Parameters
    ----------
    linearised
        The capture's linearised fit, without errors in its covariance.
    selected
        Effects fitted together.

    Returns
    -------
    kept : list of Candidate
        The effects that hold, fitted together again where one left.
    beside : BesideFlaws
        What the base is off by with them.
    verdicts : tuple of Verdict
        Of every effect, those that left included.
    """
    kept, left = list(selected), []
    while True:
        residual = residual_with(linearised, kept)
        model = flaw_model_of(linearised, residual)
        beside = beside_flaws(model, residual)
        verdicts = [_verdict(linearised, kept, index, beside, residual) for index in range(len(kept))]
        failing = [index for index, verdict in enumerate(verdicts) if not verdict.holds]
        if not failing:
            return kept, beside, (*verdicts, *left)
        worst = min(failing, key=lambda index: verdicts[index].evidence)
        left.append(verdicts[worst])
        del kept[worst]
        kept = refitted_together(linearised, kept) if kept else []


def _verdict(
    linearised: LinearisedFit,
    selected: Sequence[Candidate],
    index: int,
    beside: BesideFlaws,
    residual: NDArray[np.float64],
) -> Verdict:
    candidate, model = selected[index], beside.model
    others = [c for i, c in enumerate(selected) if i != index]
    others = refitted_together(linearised, others) if others else []
    without = residual_with(linearised, others)
    name = candidate.hypothesis.effect.id
    if candidate.by_priors:
        return Verdict(name, square(without) - square(residual), np.inf, 1.0, True)
    whitened = model.whitened(without)
    alone = model.fit(whitened)
    shape = whitened - beside.residual
    amplitude, sigma = model.amplitude(beside.fitted, whitened, shape)
    evidence = alone.score - beside.fitted.score - price_of(len(candidate.numbers))
    certainty = amplitude / sigma
    steady = abs(amplitude - 1) < max(_MAX_INSTABILITY, _UNSTABLE_SIGMA * sigma)
    holds = evidence > _MIN_EVIDENCE and certainty > _MIN_CERTAINTY and steady
    return Verdict(name, evidence, certainty, amplitude, holds)


def price_of_effects(selected: Sequence[Candidate]) -> float:
    """Chi2 that the numbers of effects must gain.

    Parameters
    ----------
    selected
        The effects.

    Returns
    -------
    float
        See `price_of`.
    """
    return price_of(sum(len(candidate.numbers) for candidate in selected))
