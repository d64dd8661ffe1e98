"""Light that an external rendering lacks: interreflection after some depth, or energy.

Our own rendering stops where the model says. The depth of another renderer's paths is not known, so every depth is
tried: its picture as it is, and with what our patch transport says the missing reflections add. From the depth
fitted, the effects on the settings are proposed like any other effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.chain import RenderSettings
from numpy.typing import NDArray

from ..compare import Predicted, Validation, fit_lamp_scale, held_lamp_scale, validate_prepared, with_picture
from ..predict import Predictor
from .evidence import MIN_EXPLAINED_PART_EACH
from .hypotheses import hypotheses

__all__ = ["ExternalRender", "external_render"]

#: Depths tried, in reflections; light from deeper paths is too little to be distinguished.
_DEPTHS = range(1, 11)
#: Standard deviations to which residuals are clipped, so that single samples do not decide the depth.
_MAX_RESIDUAL_SIGMA = 10.0


@dataclass(frozen=True)
class ExternalRender:
    """Light that an external rendering lacks by itself."""

    #: Number of reflections after which its paths end; None where no light is missing.
    max_bounces: int | None
    #: Mean of the rendering over that of the capture, minus 1, with the lamp as stated.
    energy: float
    #: Relative standard deviation of the lamp's stated power; None where none is stated.
    lamp_sigma: float | None

    @property
    def sentences(self) -> list[str]:
        """Sentences for a report, the energy first."""
        uncertainty = "" if self.lamp_sigma is None else f", the lamp's power is stated to ± {self.lamp_sigma:.1%}"
        more = "more" if self.energy > 0 else "less"
        sentences = [
            f"The other renderer's picture has {abs(self.energy):.2%} {more} light than the capture{uncertainty}."
        ]
        if self.max_bounces is not None:
            sentences.append(f"It looks like paths that end after {self.max_bounces} reflections.")
        return sentences


def external_render(validation: Validation) -> tuple[Validation, ExternalRender | None]:
    """The validation with the depth at which an external rendering's paths end.

    A depth stated by the model file is taken as it is. Otherwise the capture is compared again with spectra cut at the
    depth fitted, since between its wavelengths the cube follows our spectra.

    Parameters
    ----------
    validation
        Validation of a capture, by our rendering or an external one.

    Returns
    -------
    validation : Validation
        With the depth among its model's settings.
    render : ExternalRender or None
        Light that the rendering lacks; None for our own.
    """
    prepared, rendered = validation.prepared, validation.rendered
    picture = prepared.picture
    if picture is None or not isinstance(rendered, Predicted):
        return validation, None
    used = rendered.used
    energy = float(rendered.signal[used].sum() / prepared.measured[used].sum()) - 1
    stated_depth = validation.model.render.max_bounces
    depth = _depth(validation, rendered) if stated_depth is None else stated_depth
    deficit = ExternalRender(depth, energy, prepared.lamp_sigma)
    if depth == stated_depth:
        return validation, deficit
    settings = replace(validation.model.render, max_bounces=depth)
    cut = with_picture(prepared, picture.path, picture.declared, settings)
    return validate_prepared(cut, replace(validation.model, render=settings)), deficit


def _depth(validation: Validation, rendered: Predicted) -> int | None:
    """Number of reflections after which light is missing; None where that explains too little."""
    complete_chi2, count = _chi2(validation, rendered, np.ones_like(rendered.signal))
    chi2_by_depth = {
        depth: _chi2(validation, rendered, ratio)[0] for depth, ratio in _ratios(validation, rendered).items()
    }
    if not chi2_by_depth:
        return None
    best = min(chi2_by_depth, key=lambda depth: chi2_by_depth[depth])
    return (
        best
        if complete_chi2 - chi2_by_depth[best] > MIN_EXPLAINED_PART_EACH * max(complete_chi2 - count, 0.1 * count)
        else None
    )


def _ratios(validation: Validation, rendered: Predicted) -> dict[int, NDArray[np.float64]]:
    """(band, y, x) by depth: the complete picture over one that stops at that depth."""
    predictor: Predictor = rendered.predictor
    bands, model_effects = predictor.sensing.curves.bands, validation.model.effects
    ratios = {}
    for depth in _DEPTHS:
        settings: RenderSettings = replace(validation.model.render, max_bounces=depth)
        stopped = predictor.with_settings(settings)
        complete = [h for h in hypotheses(bands, predictor.scene, settings) if h.effect.stage == "settings"]
        if not complete:
            continue
        before, after = stopped.signal(model_effects), stopped.signal((*model_effects, complete[0].at({})))
        ratios[depth] = np.divide(after, before, out=np.ones_like(after), where=before > 0)
    return ratios


def _chi2(validation: Validation, rendered: Predicted, ratio: NDArray[np.float64]) -> tuple[float, int]:
    """Chi2 and number of samples of the picture times a ratio, the lamp within its stated power."""
    prepared, used = validation.prepared, rendered.used
    signal = rendered.signal * ratio
    variance = prepared.calibration.predicted_variance(signal) + rendered.variance
    scale, _ = fit_lamp_scale(prepared.measured, signal, variance, used, prepared.lamp_sigma)
    scale = held_lamp_scale(scale, prepared.lamp_sigma)
    z = ((prepared.measured - scale * signal) / np.sqrt(variance))[used]
    return float(np.minimum(z**2, _MAX_RESIDUAL_SIGMA**2).sum()), int(used.sum())
