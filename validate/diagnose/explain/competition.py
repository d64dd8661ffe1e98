"""Competition of all families: scores of their forms; place, bands and share of the winner."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import takewhile
from threading import Event
from typing import Any

import numpy as np
from cboxlab.utils.progress import NO_PROGRESS, Progress
from numpy.typing import NDArray

from ..families import families
from ..field_fit import Family, FitInput, FittedExplanation, ResidualData, change_dn
from ..hypotheses import CERTAIN_SIGMA, EXACT_SHAPE_ERROR, INDISTINGUISHABLE_CHI2, MIN_HELDOUT_GAIN, SHAPE_ERROR
from .as_field import fitted_field
from .explanation import NO_FORM, NONE, Explanation, Rival
from .noise import noise_level
from .odds import probabilities
from .prior_odds import soft_outline, spot_log_odds
from .registration import Registration, registration

__all__ = ["MIN_SHARE", "explain", "explain_masked_families"]

#: Part of the largest gain by which a family may fall short without penalty: shapes are wrong by as much, for the
#: exchange between patches and first derivatives are approximate. Forms in one place are made of the same bells and
#: share the errors of an outline: ``SHAPE_ERROR`` counts there.
_SHAPE_ERROR_OF_EXCHANGE = 0.03

#: Smallest part of the excess that a family must explain, or a kind of pattern where no family holds.
MIN_SHARE = 0.2

#: Most further forms of one family that are added: several grains or scratches.
_MAX_FURTHER_FORMS = 3

#: Part of the excess that a further form must explain to be added.
_MIN_FURTHER_SHARE = 0.05

#: Cosine of the bands' chi2 of two spots above which they may be one cause.
_SAME_BANDS = 0.8

#: A band shows the cause if its chi2 is at least this part of the strongest band's.
_MIN_BAND_PART = 0.02

#: A band shows a spectral cause if its relative change is at least this part of the largest.
_MIN_SPECTRAL_PART = 0.1

#: Smallest share of a localised cause that counts as sharp: rendering errors, such as dark corners, are in several
#: places.
_MIN_SHARE_OF_SPOT = 0.75

#: Radius, over the larger side of the image, within which half of the weight of a localised change lies.
_LOCAL_RADIUS = 0.13

#: Part of the largest weight above which a pixel counts for the spectrum.
_SPECTRUM_WEIGHT = 0.25


def explain(data: ResidualData, progress: Progress = NO_PROGRESS) -> Explanation:
    """Most likely explanation of a residual, from fits of all families.

    Families that act on the scene are fitted in this thread, the others in a second one: each is half of the work.

    Parameters
    ----------
    data
        Residual to be explained.
    progress
        Reported to after each form in this thread; the number of forms is not known beforehand.

    Returns
    -------
    Explanation
        The winner; its family is ``NONE`` where no family explains enough.
    """
    fit_input, members = FitInput.of(data), list(families().values())
    in_scene = [family for family in members if family.acts_on == "scene"]
    others = [family for family in members if family.acts_on != "scene"]
    stopped, candidates = Event(), []
    with ThreadPoolExecutor(1) as executor:
        second = executor.submit(lambda: list(takewhile(lambda _: not stopped.is_set(), _forms(others, fit_input))))
        try:
            for candidate in _forms(in_scene, fit_input):
                candidates.append(candidate)
                progress.part(0.0)
            candidates += second.result()
        except BaseException:  # cancelled: the other thread ends at its next form
            stopped.set()
            raise
    position = {family.id: index for index, family in enumerate(members)}
    return _compare(data, sorted(candidates, key=lambda candidate: position[candidate.family.id]), continued=True)


def _continued(
    data: ResidualData, winner: FittedExplanation, change: NDArray[np.float64], total: float
) -> tuple[NDArray[np.float64], list[str]]:
    """Change (band, y, x) by a winner and then by further forms of its family; the forms' names.

    Several grains of dust, or rows and columns, are one cause each. A form is added while it explains more of the
    excess, and holds where it was not fitted.
    """
    further: list[str] = []
    for _ in range(_MAX_FURTHER_FORMS):
        remaining = data.with_change(-change)
        if remaining.chi2 < data.chi2 - (1 - _MIN_FURTHER_SHARE) * total:
            break
        alike = [form for form in winner.family.generate(FitInput.of(remaining)) if _alike(winner, form)]
        form = max(alike, key=lambda candidate: candidate.evidence, default=None)
        if form is None or form.evidence < CERTAIN_SIGMA**2 or not form.fit.predicts >= MIN_HELDOUT_GAIN:
            break
        if _share(remaining, form, total) < _MIN_FURTHER_SHARE:
            break
        change = change + change_dn(remaining, form)
        further.append(form.form)
    return change, further


def _alike(first: FittedExplanation, other: FittedExplanation) -> bool:
    """Whether two forms may be one cause."""
    if first.local or other.local:
        bands = np.sum(first.fit.size * other.fit.size) > _SAME_BANDS * np.linalg.norm(first.fit.size) * np.linalg.norm(
            other.fit.size
        )
        return first.local and other.local and first.form == other.form and bool(bands)
    return first.sharp and other.sharp


def _forms(members: Iterable[Family], fit_input: FitInput) -> Iterator[FittedExplanation]:
    for family in members:
        yield from family.generate(fit_input)


def explain_masked_families(data: ResidualData) -> tuple[Explanation, ...]:
    """Explanations by patterns that larger rendering errors would mask, each fitted separately.

    They are directional blur, spatially varying blur and per-band displacement, see ``Family.masked``.

    Parameters
    ----------
    data
        Residual to be explained.

    Returns
    -------
    tuple
        The best form of each pattern, whatever share of the excess it explains, by the patterns' rank.
    """
    patterns = [pattern for family in families().values() for pattern in family.masked]
    ranked = sorted(patterns, key=lambda pattern: pattern.rank)
    return tuple(_compare(data, [*pattern.generate(data)], min_share=0.0) for pattern in ranked)


def _compare(
    data: ResidualData,
    candidates: Sequence[FittedExplanation],
    min_share: float = MIN_SHARE,
    continued: bool = False,
) -> Explanation:
    """Explanation by the candidate with the largest score among those that explain enough."""
    total = max(data.chi2 - noise_level(data.residual, data.used) * data.count, 1.0)
    scores = _scores(data, candidates)
    best: dict[str, tuple[float, FittedExplanation]] = {}
    for score, candidate in sorted(zip(scores, candidates, strict=True), key=lambda pair: -pair[0]):
        best.setdefault(candidate.family.id, (score, candidate))
    each = ((_share(data, candidate, total), score, candidate) for score, candidate in best.values())
    # families that explain too little of the excess, or nothing where they were not fitted, come behind all others
    ranked = sorted(
        each, key=lambda rival: (rival[0] < min_share or not rival[2].fit.predicts >= MIN_HELDOUT_GAIN, -rival[1])
    )
    rivals = tuple(
        Rival(candidate.family.id, candidate.form, candidate.surface, share, score, candidate.fit.predicts)
        for share, score, candidate in ranked
    )
    _, score, winner = ranked[0]
    margin = max(INDISTINGUISHABLE_CHI2, EXACT_SHAPE_ERROR * winner.fit.gain)
    holds = winner.fit.predicts >= MIN_HELDOUT_GAIN
    registered = registration(data)
    odds = probabilities(rivals, registered) if continued else {}
    if winner.evidence < CERTAIN_SIGMA**2 or rivals[0].share < min_share or not holds:
        return _no_explanation(data, rivals, len(candidates), registered, odds)
    change = change_dn(data, winner)
    change, further = _continued(data, winner, change, total) if continued else (change, [])
    whitened = data.whitened(change)
    share = rivals[0].share if not further else _share_of(data, change, total)
    weight = np.sum(whitened**2, axis=0)
    spectrum = _spectrum(data, change, weight)
    visible = _visible_bands(change, whitened)
    if winner.family.spectral:
        visible &= np.abs(spectrum) >= _MIN_SPECTRAL_PART * np.abs(spectrum).max()
    return Explanation(
        family=winner.family.id,
        form="; then ".join([winner.form, *further]),
        surface=winner.surface,
        centre_px=_centre(weight) if winner.family.localised else None,
        bands=tuple(band for band, is_visible in zip(data.bands, visible, strict=True) if is_visible),
        all_bands=data.bands,
        share=share,
        told_apart=_is_distinguished(rivals, margin, min_share),
        rivals=rivals,
        change=change,
        sigma=np.where(data.used, data.sigma, np.nan),
        remaining=np.where(data.used, data.residual - whitened, np.nan),
        spectrum=spectrum,
        heldout=winner.fit.heldout,
        gain=winner.fit.gain,
        evidence=winner.evidence,
        num_forms=len(candidates),
        sharp=winner.sharp or (winner.local and rivals[0].share > _MIN_SHARE_OF_SPOT),
        effects_leave=winner.effects_leave,
        field=fitted_field(data, winner),
        family_record=winner.family,
        registration=registered,
        odds=odds,
        separate=not continued,
    )


def _is_distinguished(rivals: Sequence[Rival], margin: float, min_share: float) -> bool:
    """Whether all rivals that explain enough are clearly worse."""
    contenders = [rival for rival in rivals[1:] if rival.share >= min_share]
    worse = all(rivals[0].score - rival.score > margin for rival in contenders)
    return worse and (not contenders or contenders[0].predicts >= MIN_HELDOUT_GAIN)


def _share(data: ResidualData, candidate: FittedExplanation, total: float) -> float:
    """Part of the excess of chi2 over noise that a candidate explains."""
    return _share_of(data, change_dn(data, candidate), total)


def _share_of(data: ResidualData, change: NDArray[np.float64], total: float) -> float:
    """Part of the excess of chi2 over noise that a change (band, y, x) explains."""
    change = data.whitened(change)
    return float(np.clip((2 * np.sum(change * data.residual) - np.sum(change**2)) / total, 0, 1))


def _visible_bands(change: NDArray[np.float64], whitened: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(band,) whether a band shows a change; ``whitened`` is the change over sigma."""
    sizes = np.sum(whitened**2, axis=(1, 2))
    return np.any(change, axis=(1, 2)) & (sizes > np.maximum(_MIN_BAND_PART * sizes.max(), CERTAIN_SIGMA**2))


def _no_explanation(
    data: ResidualData,
    rivals: Sequence[Rival],
    num_forms: int,
    registered: Registration,
    odds: Mapping[str, float],
) -> Explanation:
    return Explanation(
        family=NONE,
        form=NO_FORM,
        surface=None,
        centre_px=None,
        bands=(),
        all_bands=data.bands,
        share=0.0,
        told_apart=True,
        rivals=(Rival(NONE, NO_FORM, None, 0.0, 0.0), *rivals),
        change=np.zeros(data.used.shape),
        sigma=np.where(data.used, data.sigma, np.nan),
        remaining=np.where(data.used, data.residual, np.nan),
        spectrum=np.zeros(len(data.bands)),
        heldout=0.0,
        gain=0.0,
        evidence=0.0,
        num_forms=num_forms,
        sharp=False,
        effects_leave=0.0,
        field=None,
        family_record=None,
        registration=registered,
        odds=odds,
    )


def _scores(data: ResidualData, candidates: Sequence[FittedExplanation]) -> list[float]:
    """2 ln evidence of each candidate, with prior odds.

    What a candidate lacks to the largest gain is forgiven up to the errors of shapes.
    """
    most = max(candidate.fit.gain for candidate in candidates)
    soft = soft_outline(data, candidates)
    scores = []
    for candidate in candidates:
        complexity = candidate.fit.gain - candidate.evidence
        forgiven = SHAPE_ERROR if candidate.local else _SHAPE_ERROR_OF_EXCHANGE
        lacks = max(most - candidate.fit.gain - forgiven * most, 0.0)
        scores.append(most - lacks - complexity + spot_log_odds(data, candidate, soft))
    return scores


def _centre(weight: NDArray[np.float64]) -> tuple[float, float] | None:
    """Centre (x, y) of a weight (y, x), px; None where it is spread over the image.

    Medians: for a spot with wide flanks in a corner they lie nearer to the spot than means do.
    """
    total = float(weight.sum())
    if not total > 0:
        return None
    rows, columns = np.indices(weight.shape)
    x, y = _median(weight.sum(axis=0)), _median(weight.sum(axis=1))
    near = np.hypot(columns - x, rows - y) < _LOCAL_RADIUS * max(weight.shape)
    return (x, y) if weight[near].sum() > total / 2 else None


def _median(weight: NDArray[np.float64]) -> float:
    """Position that halves a weight by pixel, px; weight is constant within a pixel."""
    total = np.concatenate([[0.0], np.cumsum(weight)])
    return float(np.interp(total[-1] / 2, total, np.arange(len(total)) - 0.5))


def _spectrum(data: ResidualData, change: NDArray[Any], weight: NDArray[Any]) -> NDArray[np.float64]:
    """(band,) mean change over the mean signal where the weight (y, x) of the change is large."""
    where = weight >= _SPECTRUM_WEIGHT * weight.max() if weight.max() > 0 else np.zeros(weight.shape, bool)
    relative = []
    for band in range(len(data.bands)):
        pixels = where & data.used[band]
        if not pixels.any():
            relative.append(0.0)
            continue
        signal = max(float(data.signal[band][pixels].mean()), data.least_signal[band])
        relative.append(float(change[band][pixels].mean()) / signal)
    return np.array(relative)
