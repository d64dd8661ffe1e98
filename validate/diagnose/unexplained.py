"""Remainder of the catalogue: its data for `explain`, and the judgement of explanations."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.rendering.effects import catalogue
from cboxlab.scenes.camera import PARAMETER_NAMES
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..predict import charge_exchange
from .evidence import (
    MIN_GAIN_PER_SAMPLE,
    least_gain_of,
    price_of,
    shape_error_of,
    square,
)
from .explain import (
    NONE,
    Explanation,
    Lead,
    explain_masked_families,
    flicker_of,
    frame_amplitudes,
    lead_of_forms,
    lead_of_frames,
)
from .field_fit import ChargeExchange, ResidualData, light_exchange
from .hypotheses import FALSE_ALARM, INDISTINGUISHABLE_CHI2, MIN_HELDOUT_GAIN, SHAPE_ERROR
from .judgement import Verdict
from .linear_model import LinearModel, NuisanceColumns, nuisance_columns
from .linearised_fit import LinearisedFit, refitted_together, residual_with
from .search import Candidate

__all__ = [
    "at_full_size",
    "close_leads",
    "explanation_to_report",
    "family_beats_effects",
    "frames_note",
    "is_significant_pattern",
    "lead_of_single_frames",
    "leads_of_forms",
    "parts_notes",
    "residual_data_of",
]

#: Minimum size of a pattern fixed on the sensor inside faces, over its size everywhere. Errors of edges along rows or
#: columns, as those of a ceiling, look like rows or columns and have none there.
_MIN_INTERIOR_AMPLITUDE = 0.5

#: Minimum share explained by a sharp form, over that of another form of its family, to be reported in its place.
_MIN_SHARE_OF_SHARP_FORM = 0.75


def family_beats_effects(
    explanation: Explanation,
    model: LinearModel,
    effects: Sequence[Candidate],
    fitted: LinearModel,
    residual: NDArray[np.float64],
    remainder_explanation: Explanation | None = None,
    scores: Callable[[NDArray[np.float64]], tuple[float, float]] | None = None,
) -> bool:
    """Whether one family explains more of the excess of the given model than selected effects.

    The family must leave less by more than the errors of the effects' shapes, and of the rendering; errors that bands
    and faces share are adjusted with either. Levels of bands have no shape in the picture. There both pay for their
    free numbers, and effects also for being selected from the catalogue.

    Parameters
    ----------
    explanation
        Best explanation of the model as given.
    model
        Linear model of the model as given.
    effects
        The selected effects.
    fitted
        Linear model in which they were fitted.
    residual
        (n + 11,) residual that they leave.
    remainder_explanation
        Explanation of what the effects leave; None where nothing remains. A smear has a round part: one effect that
        looks like a blur, with a smear in the remainder, are one cause.
    scores
        From the residual that the family leaves to the scores of effects and of family, each next to flaws of the base.
        None: the base is sound. A free field explains flaws, too, which no effect does.

    Returns
    -------
    bool
        False for no family.
    """
    if explanation.family == NONE:
        return False
    if (
        remainder_explanation is not None
        and remainder_explanation.smear
        and len(effects) == 1
        and explanation.family == remainder_explanation.family
    ):
        return True
    by_effects, complexity = model.chi2 - square(residual), explanation.gain - explanation.evidence
    if explanation.levels:
        numbers = sum(len(candidate.hypothesis.free) for candidate in effects)
        effects_price = price_of(numbers) + 2 * len(effects) * float(np.log(len(catalogue())))
        family_gain = _gain(explanation, model, model.residual) - complexity
        shape_error = max((shape_error_of(candidate.hypothesis.effect.stage) for candidate in effects), default=0.0)
        return family_gain > (1 + shape_error) * by_effects - effects_price + INDISTINGUISHABLE_CHI2
    by_family = model.residual - model.whiten(explanation.change)
    if scores is not None:
        of_effects, of_family = scores(by_family)
    else:
        of_effects, of_family = (
            square(linear_model.without_shared_errors(vector))
            for linear_model, vector in ((fitted, residual), (model, by_family))
        )
    margin = max(SHAPE_ERROR * by_effects, MIN_GAIN_PER_SAMPLE * model.count)
    return of_effects - of_family - complexity > margin


def leads_of_forms(
    linearised: LinearisedFit, selected: Sequence[Candidate], errors: csr_array, capture: Capture
) -> dict[str, Lead]:
    """Lead of the best form of an unlisted cause, or of events in frames, over each effect.

    Flaws of the base are errors of both. What errors of the effect's shape may lack is forgiven. Several effects may
    be the imitation of one cause together: the form in place of all of them counts for each, too.

    Parameters
    ----------
    linearised
        The capture's linearised fit, without errors in its covariance.
    selected
        Effects fitted together.
    errors
        (n, k) over sigma, errors that samples share and flaws of the base, see `FlawModel.errors_of`.
    capture
        The capture.

    Returns
    -------
    dict
        By effect, the lead of the form; none for effects that priors judge.
    """
    together = residual_with(linearised, selected)
    nuisances = nuisance_columns(linearised.model, errors)

    def over(some: Sequence[Candidate], others: Sequence[Candidate]) -> Lead:
        data = residual_data_of(linearised, residual_with(linearised, others), capture, nuisances)
        averaging = linearised.problem(others).noise_averaging_gain(*(c.applied for c in some))
        price = price_of(sum(len(c.numbers) for c in some))
        shape_error = max(shape_error_of(c.hypothesis.effect.stage) for c in some)
        on_things = all(c.hypothesis.effect.acts_on_things for c in some)
        return lead_of_forms(data, together[: data.count], price, averaging, shape_error, on_things)

    leads = dict[str, Lead]()
    by_picture = [candidate for candidate in selected if not candidate.by_priors]
    for candidate in by_picture:
        others = [other for other in selected if other is not candidate]
        others = refitted_together(linearised, others) if others else []
        name = candidate.hypothesis.effect.id
        leads[name] = over([candidate], others)
        change, price = _changed(linearised, candidate, others), price_of(len(candidate.numbers))
        in_frames = lead_of_single_frames(linearised, change, price, capture)
        if in_frames is not None:
            leads[name] = replace(leads[name], frames=in_frames.lead)
            if in_frames.lead > leads[name].lead:
                leads[name] = replace(in_frames, frames=in_frames.lead)
    if len(by_picture) > 1:
        others = [candidate for candidate in selected if candidate.by_priors]
        together_lead = over(by_picture, refitted_together(linearised, others) if others else [])
        leads = {
            name: replace(max(lead, together_lead, key=lambda each: each.lead), frames=lead.frames)
            for name, lead in leads.items()
        }
    return leads


def _changed(linearised: LinearisedFit, candidate: Candidate, others: Sequence[Candidate]) -> NDArray[np.float64]:
    """(band, y, x) change of the signal by an effect, others in place, DN; camera and lamp stay."""
    before = (*linearised.model_effects, *(c.applied for c in others))
    signal, changed = (linearised.predictor.signal(each) for each in (before, (*before, candidate.applied)))
    return np.asarray(linearised.scale * (changed - signal))


def lead_of_single_frames(
    linearised: LinearisedFit, change: NDArray[np.float64], price: float, capture: Capture
) -> Lead | None:
    """Lead of events in single frames over a cause that acts in all frames of a band.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    change
        (band, y, x) change by the cause, DN.
    price
        Chi2 that the cause's numbers must gain.
    capture
        The capture.

    Returns
    -------
    Lead or None
        None where the frames of every band are alike.
    """
    used, flat = linearised.model.used, linearised.predictor.sensing.flat
    signal, weight = linearised.scale * linearised.rendered.signal, np.zeros(used.shape)
    weight[used] = 1 / linearised.model.sigma
    flicker, each = flicker_of(_repeats(capture)[0]), []
    for index, band in enumerate(capture.band_ids):
        frames = capture.frames(capture.band(band))
        if len(frames) > 1 and frames.shape[1:] == used.shape[1:]:
            net = frames / np.where(used[index], flat[index], 1.0)
            each.append(frame_amplitudes(band, net, change[index], signal[index], weight[index], flicker))
    return lead_of_frames(each, price)


def frames_note(linearised: LinearisedFit, explanation: Explanation | None, capture: Capture) -> tuple[str, ...]:
    """Sentence on what remains where only one frame of a band shows it.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    explanation
        Explanation of what remains; None without any.
    capture
        The capture.

    Returns
    -------
    tuple of str
        Empty where all frames show it, or none was compared.
    """
    if explanation is None or not explanation.change.any():
        return ()
    lead = lead_of_single_frames(linearised, explanation.change, 0.0, capture)
    if lead is None or lead.lead <= 0 or lead.advice is None:
        return ()
    return (f"What remains is an event in {lead.form}. {lead.advice.experiment}",)


def parts_notes(verdicts: Sequence[Verdict], judged: Container[str]) -> tuple[str, ...]:
    """Sentences on effects whose amplitude is not the same in all parts of their pattern.

    Parameters
    ----------
    verdicts
        Judgement of every effect.
    judged
        Identifiers of the effects to speak of: selected ones, and those that left for an unlisted cause.

    Returns
    -------
    tuple of str
        One for each effect, with two of its amplitudes.
    """
    return tuple(
        f"{verdict.effect}: relative to the fitted size, it is {unlike}. A true effect has one size in all parts: "
        "photograph again from another place, and give both captures."
        for verdict in verdicts
        if verdict.effect in judged and (unlike := verdict.by_part.unlike)
    )


def close_leads(leads: Mapping[str, Lead]) -> dict[str, Lead]:
    """Forms of unlisted causes that explain as much as an effect.

    Parameters
    ----------
    leads
        Leads of the best forms, by effect.

    Returns
    -------
    dict
        The leads of forms that a capture does not distinguish from the effect, or that explain more.
    """
    return {name: lead for name, lead in leads.items() if lead.form and lead.lead > -INDISTINGUISHABLE_CHI2}


def is_significant_pattern(
    explanation: Explanation, model: LinearModel, residual: NDArray[np.float64], by_effects: float
) -> bool:
    """Whether a residual holds a pattern that is neither noise nor an error of the rendering.

    Smooth patterns, single pixels alike in all bands, and blurs are judged by `something_remains`: renderings have
    such errors. Noise alone lets evidence exceed a factor k with a probability of 1 / k at most. A family must exceed
    that for all forms together, gain as much chi2 as an effect must, and hold where it was not fitted.

    Parameters
    ----------
    explanation
        Explanation of the residual.
    model
        Linear model of the capture.
    residual
        (n + 11,) residual over sigma.
    by_effects
        Chi2 that effects explain already.

    Returns
    -------
    bool
        False for no family, and for families that renderings' errors resemble.
    """
    family = explanation.family_record
    if family is None or not explanation.sharp or explanation.heldout < MIN_HELDOUT_GAIN:
        return False
    change = model.whiten(explanation.change)
    everywhere = family.acts_on == "sensor" and explanation.centre_px is None
    if everywhere and not _holds_inside(change, model, residual):
        return False
    least = max(least_gain_of(change, model), explanation.effects_leave * by_effects)
    evident = explanation.evidence > 2 * np.log(explanation.num_forms / FALSE_ALARM)
    return evident and min(_gain(explanation, model, residual), explanation.gain) > least


def _holds_inside(change: NDArray[np.float64], model: LinearModel, residual: NDArray[np.float64]) -> bool:
    """Whether a change (n + 11,) has its size in a residual also well inside flat faces."""
    interior_change = change[: model.count] * model.interior
    return float(interior_change @ residual[: model.count]) > _MIN_INTERIOR_AMPLITUDE * square(interior_change)


def explanation_to_report(
    explanations: Sequence[Explanation],
    model: LinearModel,
    residual: NDArray[np.float64],
    by_effects: float,
    remains: bool,
) -> Explanation | None:
    """The explanation of a residual that is reported.

    A significant pattern of the best family comes before those of others, and takes over its rivals. It replaces the
    best explanation where it explains three quarters of what that does.

    Parameters
    ----------
    explanations
        The best explanation, then those that errors of the rendering may mask.
    model
        Linear model of the capture.
    residual
        (n + 11,) residual over sigma.
    by_effects
        Chi2 that effects explain already.
    remains
        Whether something remains, whatever the explanations.

    Returns
    -------
    Explanation or None
        None where nothing remains to be explained.
    """
    best = explanations[0]
    significant = [each for each in explanations if is_significant_pattern(each, model, residual, by_effects)]
    confirming = [each for each in significant if each.separate and each.family == best.family]
    sharp = next(iter([*confirming, *significant]), None)
    if sharp:
        sharp = replace(sharp, odds=best.odds)
    if sharp and sharp.family == best.family:
        sharp = replace(sharp, told_apart=best.told_apart, rivals=(sharp.rivals[0], *best.rivals[1:]))
        remains = remains and sharp.share < _MIN_SHARE_OF_SHARP_FORM * best.share
    return best if remains else sharp


def at_full_size(explanation: Explanation, excess: ResidualData, flaws_dn: NDArray[np.float64]) -> Explanation:
    """A pattern that is fitted separately, at its size before flaws of the base were taken off.

    Their fit contains a part of it, such as deviations of single pixels that few bands see behind a mosaic.

    Parameters
    ----------
    explanation
        Explanation of what remains without the flaws.
    excess
        Residual without them.
    flaws_dn
        (n,) change of the used samples by the flaws, DN.

    Returns
    -------
    Explanation
        The same with the form and size in the whole residual; unchanged where that does not show it.
    """
    for pattern in explain_masked_families(excess.with_change(_filled(flaws_dn, excess.used))):
        acts = [each.field and each.field.acts for each in (pattern, explanation)]
        if acts[0] == acts[1] and pattern.bands == explanation.bands:
            return replace(
                explanation, form=pattern.form, change=pattern.change, field=pattern.field, gain=pattern.gain
            )
    return explanation


def _gain(explanation: Explanation, model: LinearModel, residual: NDArray[np.float64]) -> float:
    """Chi2 that an explanation takes off a residual (n + 11,), shared errors not adjusted."""
    change = model.whiten(explanation.change)
    return 2 * float(change @ residual) - square(change)


def residual_data_of(
    linearised: LinearisedFit,
    residual: NDArray[np.float64],
    capture: Capture,
    nuisances: NuisanceColumns | None = None,
) -> ResidualData:
    """Data of a residual for the explanation families.

    Parameters
    ----------
    linearised
        The capture's linearised fit.
    residual
        (n + 11,) projected residual, over sigma.
    capture
        The capture, for exposures and repeated frames.
    nuisances
        Columns of the nuisances; None: those of the linearised fit.

    Returns
    -------
    ResidualData
        Residual, signals, nuisances, frames and light transport.
    """
    model, predictor, rendered = linearised.model, linearised.predictor, linearised.rendered
    nuisances = nuisances or nuisance_columns(model)
    used, image = model.used, rendered.image
    first = PARAMETER_NAMES.index("principal_u_px")
    levels, sigma = _repeats(capture)
    draw = np.random.default_rng(predictor.settings.seed).standard_normal(used.shape)
    return ResidualData(
        residual=_filled(residual[: model.count], used).astype(np.float32),
        marginal_residual=_filled(nuisances.marginalised(model, residual), used),
        used=used,
        sigma=_filled(model.sigma, used),
        signal=linearised.scale * rendered.signal,
        noise=linearised.scale * np.sqrt(rendered.variance) * draw,
        nuisances=nuisances.picture,
        num_free_nuisances=nuisances.num_free,
        moved=(linearised.scale * linearised.derivative[first : first + 2]).astype(np.float32),
        flat=predictor.sensing.flat,
        surface=np.where(image.surface < 0, -1, image.surface),
        names=tuple(image.surface_names),
        materials=tuple(predictor.scene.materials),
        bands=tuple(predictor.sensing.curves.bands),
        nm=predictor.effective_nm,
        minutes=predictor.sensing.minutes,
        exposure_s=np.array([capture.band(band).exposure_s for band in capture.band_ids]),
        flat_exposure_s=np.array([_flat_exposure(capture, band) for band in capture.band_ids]),
        repeats=levels,
        repeat_sigma=sigma,
        transport=light_exchange(linearised.predictor),
        cell=capture.cell,
        charge=None if capture.cell is None else _charge_exchange(linearised),
    )


def _charge_exchange(linearised: LinearisedFit) -> ChargeExchange:
    """Exchange of charge in the raw frames, at the fitted lamp power."""
    change = charge_exchange(linearised.predictor)
    return lambda exchange: linearised.scale * change(exchange)


def _flat_exposure(capture: Capture, band: str) -> float:
    """Exposure of a band's flat, s; infinite without one, which then brings no shutter error."""
    flats = capture.flats(band)
    return flats[0].exposure_s if flats else np.inf


def _repeats(capture: Capture) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(band, repeat) relative levels of frames, and (band,) their standard deviations by noise.

    A level is the regression of a frame minus its band's mean on that mean above dark; NaN after a band's last frame.
    """
    tables = [capture.band(band) for band in capture.band_ids]
    all_levels = np.full((len(tables), max(len(table.frames) for table in tables)), np.nan)
    sigma = np.full(len(tables), np.inf)
    for index, table in enumerate(tables):
        frames = capture.frames(table).astype(float)
        if len(frames) < 2:
            continue
        mean = frames.mean(axis=0)
        pattern = mean - np.percentile(mean, 0.5)
        pattern = np.where(mean < 0.98 * capture.saturation_dn, pattern, 0.0)
        power = float(np.sum(pattern**2))
        levels = np.array([float(np.sum(pattern * (frame - mean))) / power for frame in frames])
        noise = [
            np.sum(pattern**2 * (frame - mean - level * pattern) ** 2)
            for frame, level in zip(frames, levels, strict=True)
        ]
        all_levels[index, : len(frames)] = levels
        sigma[index] = np.sqrt(float(np.mean(noise))) / power
    return all_levels, sigma


def _filled(values: NDArray[Any], used: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(band, y, x) picture of values (n,) at the used samples, 0 elsewhere."""
    picture = np.zeros(used.shape)
    picture[used] = values
    return picture
