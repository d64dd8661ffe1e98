"""What the catalogue leaves, as the families of ``explain`` need it, and whether one of them beats the catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from cboxlab.calibration.capture import Capture
from cboxlab.rendering.chain import after_stage
from cboxlab.rendering.device import mi
from cboxlab.rendering.effects import catalogue
from cboxlab.rendering.perturbation import Coat, PatchTransport, Reflection, changed_reflection
from cboxlab.rendering.radiosity import solve
from cboxlab.scenes.camera import PARAMETER_NAMES
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from .evidence import INDISTINGUISHABLE, SHAPE_ERROR, SMALLEST_GAIN, least_gain_of, price_of, square
from .explain import NONE, Explanation
from .field_fit import ResidualData, Transport
from .linear_model import LinearModel
from .linearised_fit import LinearisedFit
from .search import Candidate

__all__ = ["excess_of", "explanation_to_report", "family_beats_effects", "is_significant_pattern"]

#: Probability that a family stands out of noise alone, all families and their forms together.
_FALSE_ALARM = 0.005

#: Part of its gain in the pixels of a trial fit that a family must have in those held out from it. Pixels that scatter
#: in deep shadow, as those of a simulated photograph may, have 0.2 at most; grains of nine pixels or more at least 0.4.
_LEAST_HELDOUT = 0.3

#: A pattern fixed on the sensor has at least this part of its size where the picture shows no edges. Errors of edges
#: along rows or columns, as those of a ceiling, look like rows or columns and have none there.
_LEAST_INSIDE = 0.5

#: Roughnesses (GGX alpha) of the coats that a surface may have: mirror-like, glossy, silky. Rays of a pixel for each.
_COATS, _COAT_SAMPLES = (0.03, 0.12, 0.35), 64

#: A sharp form is reported in place of another one of its family that explains more, if it explains this part of that.
_NEARLY_ALL = 0.75


def family_beats_effects(
    explanation: Explanation,
    model: LinearModel,
    chosen: Sequence[Candidate],
    fitted: LinearModel,
    left: NDArray[np.float64],
    beside: Explanation | None = None,
) -> bool:
    """Whether a family alone explains more of the excess of the model as given than the effects chosen.

    fitted, left : the model in which these were fitted, and the residual (n + 11,) that they leave. The family must
    leave less by more than the errors of the effects' shapes, and of the picture; errors that bands and faces share are
    adjusted beside either. Levels of bands have no shape in the picture: there both pay for their free numbers, and
    effects for being chosen from the catalogue. beside : what explains what the effects leave. A smear has a round
    part: one effect that looks like a blur, and a smear beside it, are one cause.
    """
    if explanation.family == NONE:
        return False
    if beside is not None and beside.smear and len(chosen) == 1 and explanation.family == beside.family:
        return True
    by_effects, complexity = model.chi2 - square(left), explanation.gain - explanation.evidence
    if explanation.levels:
        numbers = sum(len(candidate.hypothesis.free) for candidate in chosen)
        paid = price_of(numbers) + 2 * len(chosen) * float(np.log(len(catalogue())))
        own = _gain(explanation, model, model.residual) - complexity
        return own > (1 + SHAPE_ERROR) * by_effects - paid + INDISTINGUISHABLE
    by_family = model.residual - model.whiten(explanation.change)
    of_effects, of_family = (
        square(one.without_shared_errors(residual)) for one, residual in ((fitted, left), (model, by_family))
    )
    more = max(SHAPE_ERROR * by_effects, SMALLEST_GAIN * model.count)
    return of_effects - of_family - complexity > more


def is_significant_pattern(
    explanation: Explanation, model: LinearModel, residual: NDArray[np.float64], by_effects: float
) -> bool:
    """Whether a pattern is left in a residual (n + 11,) that is neither noise nor an error of the picture.

    Smooth patterns in all bands, and blurs, are judged by ``something_remains``: the picture has such errors itself.
    Noise alone lets evidence exceed a factor k with a probability of 1 / k at most; a family must exceed that for all
    forms together, must gain as much chi2 as an effect must, and hold where it was not fitted. by_effects : chi2 that
    effects explain already.
    """
    family = explanation.family_record
    if family is None or not explanation.sharp or explanation.heldout < _LEAST_HELDOUT:
        return False
    change = model.whiten(explanation.change)
    everywhere = family.acts_on == "sensor" and explanation.centre_px is None
    if everywhere and not _holds_inside(change, model, residual):
        return False
    least = max(least_gain_of(change, model), explanation.effects_leave * by_effects)
    seen = explanation.evidence > 2 * np.log(explanation.num_forms / _FALSE_ALARM)
    return seen and min(_gain(explanation, model, residual), explanation.gain) > least


def _holds_inside(change: NDArray[np.float64], model: LinearModel, residual: NDArray[np.float64]) -> bool:
    """Whether a change (n + 11,) has its size in a residual well inside flat faces, too."""
    own = change[: model.count] * model.interior
    return float(own @ residual[: model.count]) > _LEAST_INSIDE * square(own)


def explanation_to_report(
    explained: Sequence[Explanation],
    model: LinearModel,
    residual: NDArray[np.float64],
    by_effects: float,
    left: bool,
) -> Explanation | None:
    """Which explanation of a residual (n + 11,) is reported; None where nothing is left to explain.

    explained : the best one of all, then those that errors of the picture may hide. by_effects : see
    ``is_significant_pattern``.
    left : whether something is left whatever they say. Rivals of a sharp form are those of its family.
    """
    best = explained[0]
    sharp = next((one for one in explained if is_significant_pattern(one, model, residual, by_effects)), None)
    if sharp and sharp.family == best.family:
        sharp = replace(sharp, told_apart=best.told_apart, rivals=(sharp.rivals[0], *best.rivals[1:]))
        left = left and sharp.share < _NEARLY_ALL * best.share
    return best if left else sharp


def _gain(explanation: Explanation, model: LinearModel, residual: NDArray[np.float64]) -> float:
    """Chi2 that an explanation takes off a residual (n + 11,), errors shared by bands or faces not adjusted."""
    change = model.whiten(explanation.change)
    return 2 * float(change @ residual) - square(change)


def excess_of(linearised: LinearisedFit, residual: NDArray[np.float64], capture: Capture) -> ResidualData:
    """What a residual (n + 11,), projected, over sigma, gives the families to explain."""
    model, predictor, rendered = linearised.model, linearised.predictor, linearised.rendered
    nuisances, left = _nuisance_columns(model, residual)
    used, image = model.used, rendered.image
    first = PARAMETER_NAMES.index("principal_u_px")
    levels, sigma = _repeats(capture)
    draw = np.random.default_rng(predictor.settings.seed).standard_normal(used.shape)
    return ResidualData(
        residual=_filled(residual[: model.count], used).astype(np.float32),
        marginal_residual=_filled(left, used),
        used=used,
        sigma=_filled(model.sigma, used),
        signal=linearised.scale * rendered.signal,
        noise=linearised.scale * np.sqrt(rendered.variance) * draw,
        nuisances=nuisances,
        num_free_nuisances=model.basis.shape[1],
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
        transport=_transport(linearised),
    )


def _flat_exposure(capture: Capture, band: str) -> float:
    """Seconds; infinite without a flat, which then brings no error of the shutter."""
    flats = capture.flats(band)
    return flats[0].exposure_s if flats else np.inf


def _nuisance_columns(
    model: LinearModel, residual: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """(band, y, x, m) columns W of the ``ResidualData``, and the residual (n,) less what shared errors explain of it.

    Camera and lamp are projected out already; errors shared by bands or faces have unit variance, which the Woodbury
    identity takes off the information.
    """
    shared = model.projected_shared_errors()
    factor = np.linalg.cholesky(np.eye(shared.shape[1]) + shared.T @ shared)
    shared = solve_triangular(factor, shared.T, lower=True, overwrite_b=True).T
    left = residual - shared @ (shared.T @ residual)
    known = model.basis.shape[1]
    columns = np.zeros((*model.used.shape, known + shared.shape[1]), np.float32)
    columns[model.used, :known] = model.basis[: model.count]
    columns[model.used, known:] = shared[: model.count]
    return columns, left[: model.count]


def _repeats(capture: Capture) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(band, repeat) relative differences of frames' levels from their band's mean, NaN beyond a band's last frame,
    and (band,) their standard deviations by noise.

    A level is the regression of a frame on the mean of its band's frames above dark.
    """
    tables = [capture.band(band) for band in capture.band_ids]
    found = np.full((len(tables), max(len(table.frames) for table in tables)), np.nan)
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
        found[index, : len(frames)] = levels
        sigma[index] = np.sqrt(float(np.mean(noise))) / power
    return found, sigma


def _filled(values: NDArray[Any], used: NDArray[np.bool_]) -> NDArray[np.float64]:
    picture = np.zeros(used.shape)
    picture[used] = values
    return picture


def _transport(linearised: LinearisedFit) -> Transport:
    predictor = linearised.predictor
    traced = predictor.transport
    exchange, patches = traced.light.exchange, traced.light.patches
    nm = predictor.effective_nm
    reflectance = after_stage(predictor.scene, predictor.included, "scene").reflectances(nm)
    shares = predictor.lamp_shares
    first = exchange.direct @ shares
    radiance = solve(exchange, reflectance[patches.material], first).astype(np.float32)
    direct = traced.direct @ shares
    arriving = direct + traced.gather @ radiance
    lamps = [lamp.centre for lamp in traced.light.lamps]
    return Transport(
        pixel=traced.pixel,
        coverage=traced.coverage,
        surface=traced.surface,
        material=traced.material,
        position=traced.position,
        gather=traced.gather,
        patch_surface=patches.surface,
        patch_material=patches.material,
        patch_position=patches.centre,
        form_factors=exchange.form_factors,
        reflectance=reflectance,
        arriving=arriving,
        direct=direct,
        view=_cosine(traced.position, traced.normal, [traced.camera.position_mm], np.ones((len(direct), 1))),
        incidence=_cosine(traced.position, traced.normal, lamps, traced.direct),
        patch_arriving=first + exchange.form_factors @ radiance,
        patch_direct=first,
        patch_incidence=_cosine(patches.centre, patches.normal, lamps, exchange.direct),
        picture=traced.pixels(reflectance[traced.material] * arriving),
        roughness=_COATS,
        coats=np.array([_coated(traced, radiance, reflectance, shares, alpha) for alpha in _COATS], np.float32),
    )


def _cosine(
    position: NDArray[Any], normal: NDArray[Any], places: Sequence[NDArray[Any]], weight: NDArray[Any]
) -> NDArray[np.float64]:
    """(n,) cosine, 0 to 1, of the angles between normals (n, 3) and the ways to some places: their mean by weights (n,
    places), of all alike where they are 0."""
    way = np.array(places)[:, None] - position
    each = np.abs(np.einsum("kni,ni->kn", way, normal)) / np.maximum(np.linalg.norm(way, axis=2), 1e-9)
    parts = weight.T + np.float32(1e-9)
    return np.sum(parts * each, axis=0) / parts.sum(axis=0)


def _coated(
    traced: PatchTransport,
    radiance: NDArray[Any],
    reflectance: NDArray[Any],
    shares: NDArray[Any],
    alpha: float,
) -> NDArray[np.float64]:
    """(band, y, x) radiance relative to the lamps' that a coat on all surfaces mirrors to the camera at once."""
    coat = Reflection(lambda incoming, outgoing: mi.Float(1), Coat(1.0, alpha))
    materials = np.unique(traced.material)
    each = [
        changed_reflection(
            traced.light,
            traced.camera,
            radiance,
            reflectance,
            shares,
            coat,
            material=int(one),
            seen_in=traced.pixels_of(one),
            samples=(_COAT_SAMPLES, 0),
        )
        for one in materials
    ]
    return np.sum(each, axis=0)
