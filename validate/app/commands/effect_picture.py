"""Signature of an effect: relative change of the bundled capture's picture by band."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain import RenderSettings
from cboxlab.rendering.device import variant
from cboxlab.rendering.effects import AppliedEffect, Effect, Parameter
from cboxlab.rendering.model import Model, seen_through
from cboxlab.rendering.perturbation import warp_change
from cboxlab.utils.files import replacing
from matplotlib.figure import Figure

from ...compare import prepare, rendered_from, solved_light
from ...predict import Predictor
from ...report import STYLE
from .demo_chain import DEMO_CAPTURE

__all__ = ["example_of", "pictured_light", "write_effect_picture"]

#: Distance from the null value in the picture, in small steps of a parameter.
_STEPS = 4.0


def example_of(effect: Effect) -> AppliedEffect:
    """Effect with the parameters of its picture.

    Parameters
    ----------
    effect
        The effect.

    Returns
    -------
    AppliedEffect
        Effect with the example of each parameter. A parameter without an example has its first choice, or a value a few
        small steps from null.
    """

    def value(p: Parameter) -> str | float:
        """Value of a parameter."""
        if p.example is not None:
            return p.example
        if p.choices:
            return p.choices[0]
        if p.null is None:
            return p.default if p.default is not None else 0.5 * (p.low + p.high)
        return p.from_coordinate(p.null_coordinate + _STEPS * p.coordinate_step)

    return AppliedEffect(effect, {p.name: value(p) for p in effect.parameters})


def pictured_light() -> Predictor:
    """Predictor of the bundled capture in the published box, whose changes the pictures show.

    Returns
    -------
    Predictor
        The predictor.

    Raises
    ------
    InputError
        Without a compiled variant.
    """
    variant.require_compiled("--picture")
    prepared = prepare(load_capture(DEMO_CAPTURE), Model())
    settings = RenderSettings(noise=1.0)
    light = solved_light(prepared, settings, ())
    return rendered_from(prepared, light, prepared.calibrated_camera, settings, ()).predictor


def write_effect_picture(path: Path, effect: Effect, predictor: Predictor, dpi: int = 110) -> str:
    """Write the picture of an effect.

    Parameters
    ----------
    path
        File (PNG).
    effect
        The effect.
    predictor
        Predictor of ``pictured_light``.
    dpi
        Resolution of the picture, dots per inch.

    Returns
    -------
    str
        Values of the effect's parameters.
    """
    bands = predictor.sensing.curves.bands
    applied = example_of(effect)
    base = predictor.signal(())
    dark = base <= 0
    # distortion beyond the ten parameters is in the signal already
    distorted_camera = replace(seen_through(predictor.camera, (applied,)), further_distortion=None)
    altered = predictor.signal((applied,)) + warp_change(predictor.warp, distorted_camera)
    change = 100 * (altered / np.where(dark, 1.0, base) - 1)
    change[dark] = np.nan
    order = np.argsort(predictor.effective_nm)
    values = ", ".join(f"{k} = {v if isinstance(v, str) else format(v, 'g')}" for k, v in applied.values.items())
    reach = max(float(np.nanpercentile(np.abs(change), 98)), 1e-6)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(2.0 * len(bands), 2.9), layout="constrained")
        axes = figure.subplots(1, len(bands))
        for axis, index in zip(axes, order, strict=True):
            image = axis.imshow(change[index], cmap="RdBu_r", vmin=-reach, vmax=reach)
            axis.set(xticks=[], yticks=[])
            axis.set_title(bands[index])
        figure.colorbar(image, ax=axes, label="change, %", shrink=0.8)
        figure.suptitle(f"{effect.id}: {values}")
        with replacing(path) as temporary:
            figure.savefig(temporary, format="png", dpi=dpi)
    return values
