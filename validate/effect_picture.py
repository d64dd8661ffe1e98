"""An effect's signature: what it changes in the picture of the bundled capture, band by band."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from cboxlab.render import variant
from cboxlab.render.warp import warp_change
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.files import replacing
from matplotlib.figure import Figure

from .demo import DEMO_CAPTURE
from .effects import AppliedEffect, Effect, Parameter
from .forward import after_stage
from .model import Model, RenderSettings
from .pipeline import prepare, rendered_from, solved_light
from .plots import STYLE

__all__ = ["shown_effect", "write_effect_picture"]

#: Steps from null that show an effect well.
_STEPS = 4.0


def shown_effect(effect: Effect, band: str) -> AppliedEffect:
    """The effect a few of its small steps from null, its choices the first possible, of bands ``band``."""

    def value(p: Parameter) -> str | float:
        if p.choices:
            return p.choices[0]
        if p.null is None:
            return p.default if p.default is not None else 0.5 * (p.low + p.high)
        if np.isinf(p.null):
            return 2.0
        up = p.null + _STEPS * p.step
        return up if up <= p.high else p.null - _STEPS * p.step

    values = {p.name: value(p) for p in effect.parameters}
    if "band" in values:
        values["band"] = band
    if effect.id == "interreflection":
        values = {"max_bounces": 2.0}
    return AppliedEffect(effect, values)


def write_effect_picture(path: Path, effect: Effect) -> str:
    """Write the picture and return the effect's values in words. Raises InputError without a compiled variant."""
    if not variant.compiled():
        raise InputError("--picture", "no compiled variant", "LLVM 16 or newer, or a GPU", variant.HINT)
    prepared = prepare(DEMO_CAPTURE, Model())
    settings = RenderSettings(noise=1.0)
    light = solved_light(prepared, settings, ())
    predictor = rendered_from(prepared, light, prepared.calibrated_camera, settings, ()).predictor
    assert predictor is not None
    bands = predictor.sensing.curves.bands
    applied = shown_effect(effect, bands[len(bands) // 2])
    base = predictor.signal(())
    dark = base <= 0
    there = after_stage(predictor.camera, (applied,), "camera")
    altered = predictor.signal((applied,)) + warp_change(predictor.warp, there)
    change = 100 * (altered / np.where(dark, 1.0, base) - 1)
    change[dark] = np.nan
    order = np.argsort(predictor.effective_nm)
    told = ", ".join(
        f"{k} = {v if isinstance(v, str) else format(v, 'g')}" for k, v in applied.values.items()
    )
    reach = max(float(np.nanpercentile(np.abs(change), 98)), 1e-6)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(2.0 * len(bands), 2.9), layout="constrained")
        axes = figure.subplots(1, len(bands))
        for axis, index in zip(axes, order, strict=True):
            shown = axis.imshow(change[index], cmap="RdBu_r", vmin=-reach, vmax=reach)
            axis.set(xticks=[], yticks=[])
            axis.set_title(bands[index])
        figure.colorbar(shown, ax=axes, label="change, %", shrink=0.8)
        figure.suptitle(f"{effect.id}: {told}")
        with replacing(path) as temporary:
            figure.savefig(temporary, format="png", dpi=110)
    return told
