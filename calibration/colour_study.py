"""Filter weights three ways, each with its colour error, and which of them is used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes import Scene
from numpy.typing import ArrayLike, NDArray

from .capture import Capture
from .colorimetry import FilterWeights, fit_filter_weights, train_filter_weights
from .colour_error import ColourError, FilterChoice, choose_filters, colour_error
from .radiance_ensemble import general_lamps, judging_radiances, training_radiances
from .sensor_equation import WAVELENGTH_NM, BandResponse

__all__ = ["ColourStudy", "study_colour"]


@dataclass(frozen=True, eq=False)
class ColourStudy:
    """weights, errors : by method. choices : the best subsets of the capture's own bands, by size.

    ensemble : what the trained weights were trained on. spectra : over what the errors were taken.
    """

    weights: Mapping[str, FilterWeights]
    errors: Mapping[str, ColourError]
    choices: tuple[FilterChoice, ...]
    ensemble: str
    spectra: str

    @property
    def recommended(self) -> str:
        """The method with the least mean CIEDE2000 over the judging spectra."""
        return min(self.errors, key=lambda method: float(self.errors[method].delta_e_2000.mean()))

    @property
    def reason(self) -> str:
        """One sentence: which weights are used and why."""
        best = self.recommended
        shown = ", ".join(
            f"{method} {float(error.delta_e_2000.mean()):.2f} (Z rms {100 * float(error.rms[2]):.0f}%)"
            for method, error in self.errors.items()
        )
        return (
            f"XYZ by {best} filter weights, whose mean CIEDE2000 over {self.spectra} is the least: {shown}; "
            f"trained on {self.ensemble}"
        )


def _paints(scene: Scene | None) -> NDArray[np.float64] | None:
    """(n, wavelength) reflectances that the scene is known to have."""
    if scene is None:
        return None
    return np.stack([material.reflectance.at(WAVELENGTH_NM) for material in scene.materials.values()])


def study_colour(
    capture: Capture, responses: Sequence[BandResponse], relative_noise: ArrayLike
) -> ColourStudy:
    """Least squares, regularised and trained weights of a capture's bands.

    relative_noise : (band,) of a single pixel's signal. Lamp and paints are the capture's own where it
    states them, else usual lamps and objects.
    """
    lamp = capture.manifest.lamp
    own = None if lamp is None else capture.light(lamp.radiance).at(WAVELENGTH_NM)
    lamps = general_lamps() if own is None or own.min() < 0 or own.mean() <= 0 else {"lamp": own}
    paints = _paints(capture.known_scene())
    training, judging = training_radiances(lamps, paints), judging_radiances(lamps)
    weights = {
        found.method: found
        for found in (
            fit_filter_weights(responses),
            fit_filter_weights(responses, relative_noise),
            train_filter_weights(responses, training, relative_noise),
        )
    }
    light = "the capture's lamp" if "lamp" in lamps else f"{len(lamps)} usual lamps"
    return ColourStudy(
        weights,
        {method: colour_error(found, responses, judging) for method, found in weights.items()},
        choose_filters(responses, training, judging, range(1, len(responses) + 1)),
        f"{light} times {'objects' if paints is None else 'objects and the scene paints'}",
        f"{len(judging.names)} spectra ({light} times ColorChecker and box paints, once or twice reflected)",
    )
