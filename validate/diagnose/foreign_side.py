"""What another renderer's picture lacks by itself: light after too many reflections, or some of its energy.

Our own picture stops where the model says. Where another one stops is not known, so every depth is tried: its
picture as it is, and with what our patch transport says the missing reflections add. The effects of the settings are
then proposed like any other effect, from the depth found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cboxlab.rendering.chain import RenderSettings
from numpy.typing import NDArray

from ..compare import Predicted, Validation, fit_lamp_scale, held_lamp_scale, validate_prepared, with_picture
from ..predict import Predictor
from .hypotheses import hypotheses

__all__ = ["ForeignSide", "foreign_side"]

#: Depths tried; deeper paths carry too little light to be told.
_DEPTHS = range(1, 11)
#: A depth has to explain this part of the chi-square above noise, so that a complete picture stays complete.
_LEAST_EXPLAINED = 0.25
#: Residuals count up to this many standard deviations.
_MOST_SIGMAS = 10.0


@dataclass(frozen=True)
class ForeignSide:
    """max_bounces : where its paths end, None where no light is missing. energy : its mean over the capture's, less 1,
    with the lamp as stated. lamp_sigma : relative uncertainty of the lamp's stated power, None where none is stated.
    """

    max_bounces: int | None
    energy: float
    lamp_sigma: float | None

    @property
    def sentences(self) -> list[str]:
        """What there is to say of it, the energy first."""
        stated = "" if self.lamp_sigma is None else f", the lamp's power is stated to ± {self.lamp_sigma:.1%}"
        more = "more" if self.energy > 0 else "less"
        told = [f"The other renderer's picture has {abs(self.energy):.2%} {more} light than the capture{stated}."]
        if self.max_bounces is not None:
            told.append(f"It looks like paths that end after {self.max_bounces} reflections.")
        return told


def foreign_side(validation: Validation) -> tuple[Validation, ForeignSide | None]:
    """The validation with the depth at which another renderer's paths end, and what that is; None for our own picture.

    A model file that states a depth itself is believed.
    """
    prepared, rendered = validation.prepared, validation.rendered
    picture = prepared.picture
    if picture is None or not isinstance(rendered, Predicted):
        return validation, None
    used = rendered.used
    energy = float(rendered.signal[used].sum() / prepared.measured[used].sum()) - 1
    stated = validation.model.render.max_bounces
    depth = _depth(validation, rendered) if stated is None else stated
    found = ForeignSide(depth, energy, prepared.lamp_sigma)
    if depth == stated:
        return validation, found
    # between its wavelengths the cube follows our spectra, which have to stop at the same depth
    settings = replace(validation.model.render, max_bounces=depth)
    again = with_picture(prepared, picture.path, picture.declared, settings)
    return validate_prepared(again, replace(validation.model, render=settings)), found


def _depth(validation: Validation, rendered: Predicted) -> int | None:
    """The number of reflections after which light is missing; None where that explains too little."""
    whole, count = _chi2(validation, rendered, np.ones_like(rendered.signal))
    found = {depth: _chi2(validation, rendered, ratio)[0] for depth, ratio in _ratios(validation, rendered).items()}
    if not found:
        return None
    best = min(found, key=lambda depth: found[depth])
    return best if whole - found[best] > _LEAST_EXPLAINED * max(whole - count, 0.1 * count) else None


def _ratios(validation: Validation, rendered: Predicted) -> dict[int, NDArray[np.float64]]:
    """(band, y, x) by depth: the complete picture over one that stops there."""
    predictor: Predictor = rendered.predictor
    bands, given = predictor.sensing.curves.bands, validation.model.effects
    found = {}
    for depth in _DEPTHS:
        settings: RenderSettings = replace(validation.model.render, max_bounces=depth)
        stopped = predictor.with_settings(settings)
        complete = [h for h in hypotheses(bands, predictor.scene, settings) if h.effect.stage == "settings"]
        if not complete:
            continue
        before, after = stopped.signal(given), stopped.signal((*given, complete[0].at({})))
        found[depth] = np.divide(after, before, out=np.ones_like(after), where=before > 0)
    return found


def _chi2(validation: Validation, rendered: Predicted, ratio: NDArray[np.float64]) -> tuple[float, int]:
    """Of the picture times a ratio, the lamp within what is stated, and how many numbers it sums."""
    prepared, used = validation.prepared, rendered.used
    signal = rendered.signal * ratio
    variance = prepared.calibration.predicted_variance(signal) + rendered.variance
    scale, _ = fit_lamp_scale(prepared.measured, signal, variance, used, prepared.lamp_sigma)
    scale = held_lamp_scale(scale, prepared.lamp_sigma)
    z = ((prepared.measured - scale * signal) / np.sqrt(variance))[used]
    return float(np.minimum(z**2, _MOST_SIGMAS**2).sum()), int(used.sum())
