"""Filter weights by several methods with their colour errors, and the choice among them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cboxlab.scenes import Scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import ArrayLike, NDArray

from ..capture import Capture
from ..instrument import BandResponse
from .colorimetry import FilterWeights, fit_filter_weights, train_filter_weights
from .colour_error import ColourError, FilterChoice, choose_filters, colour_error
from .perceptual_weights import perceptual_weights
from .radiance_ensemble import evaluation_radiances, general_lamps, training_radiances, training_whites

__all__ = ["ColourStudy", "study_colour"]


@dataclass(frozen=True, eq=False)
class ColourStudy(FrozenMappings):
    """Filter weights by several methods with their colour errors."""

    #: Filter weights by method.
    weights: Mapping[str, FilterWeights]
    #: Their errors over the evaluation spectra, by method.
    errors: Mapping[str, ColourError]
    #: Best subsets of the capture's bands, by size.
    choices: tuple[FilterChoice, ...]
    #: Description of the training spectra.
    ensemble: str
    #: Description of the evaluation spectra.
    spectra: str

    @property
    def recommended(self) -> str:
        """The method with the smallest mean CIEDE2000 over the evaluation spectra."""
        return min(self.errors, key=lambda method: float(self.errors[method].delta_e_2000.mean()))

    @property
    def reason(self) -> str:
        """The weights in use and the reason, in four short sentences."""
        errors = ", ".join(
            f"{method} {float(error.delta_e_2000.mean()):.2f} ({100 * float(error.rms[2]):.0f} %)"
            for method, error in self.errors.items()
        )
        return (
            f"XYZ uses {self.recommended} filter weights: they have the smallest mean CIEDE2000. "
            f"Mean CIEDE2000, with the rms error of Z in brackets: {errors}. "
            f"The means are over {self.spectra}. Trained weights are fitted to {self.ensemble}."
        )


def _reflectances(scene: Scene | None) -> NDArray[np.float64] | None:
    """(n, wavelength) reflectances of the scene's materials; None without a scene."""
    if scene is None:
        return None
    return np.stack([material.reflectance.at(WAVELENGTH_NM) for material in scene.materials.values()])


def study_colour(capture: Capture, responses: Sequence[BandResponse], relative_noise: ArrayLike) -> ColourStudy:
    """Filter weights of a capture's bands by several methods.

    The training spectra use the lamp and the materials that the capture states, otherwise common lamps and objects.
    Behind a mosaic, whose channels are few and broad, weights of least colour difference join the choice.

    Parameters
    ----------
    capture
        Capture with or without a lamp and a scene.
    responses
        Response of every band.
    relative_noise
        (band,) standard deviation over signal of a single pixel.

    Returns
    -------
    ColourStudy
        Weights and errors by method, and the best subsets of the bands.
    """
    lamp = capture.manifest.lamp
    radiance = None if lamp is None else capture.light(lamp.radiance).at(WAVELENGTH_NM)
    lamps = general_lamps() if radiance is None or radiance.min() < 0 or radiance.mean() <= 0 else {"lamp": radiance}
    reflectances = _reflectances(capture.scene)
    training, evaluation = training_radiances(lamps, reflectances), evaluation_radiances(lamps)
    weights = {
        fitted.method: fitted
        for fitted in (
            fit_filter_weights(responses),
            fit_filter_weights(responses, relative_noise),
            train_filter_weights(responses, training, relative_noise),
        )
    }
    if capture.manifest.mosaic is not None:
        weights["perceptual"] = perceptual_weights(responses, training, training_whites(lamps), relative_noise)
    light = "the capture's lamp" if "lamp" in lamps else f"{len(lamps)} common lamps"
    return ColourStudy(
        weights,
        {method: colour_error(fitted, responses, evaluation) for method, fitted in weights.items()},
        choose_filters(responses, training, evaluation, range(1, len(responses) + 1)),
        f"{light} times {'objects' if reflectances is None else 'objects and the materials of the scene'}",
        f"{len(evaluation.names)} spectra ({light}, reflected once or twice by ColorChecker patches and box materials)",
    )
