"""Lamp power: the lamp is brighter or dimmer than its table, at all wavelengths alike.

L' = scale L. Causes are another voltage or age of the lamp, and the scale of the radiometer that measured the table.

Parameters: scale, without unit, null value 1.
Source: linearity of light; no publication.
"""

from __future__ import annotations

from dataclasses import replace

from cboxlab.scenes.scene import Scene

from .effect import Effect, Parameter

__all__ = ["EFFECT"]


def _apply(scene: Scene, scale: float) -> Scene:
    return scene.with_lamps(lambda lamp: replace(lamp, radiance=lamp.radiance.scaled(scale)))


EFFECT = Effect(
    id="lamp-power",
    stage="scene",
    title="the lamp is brighter or dimmer than its table",
    in_words="the lamp has {scale:.2%} of the power of its table",
    summary="The lamp is brighter or dimmer than its table: its radiance is multiplied by scale at all wavelengths.",
    parameters=(Parameter("scale", "1", null=1.0, low=0.05, high=20.0, step=1e-2),),
    apply=_apply,
    own_to_capture=True,
    imitates_lamp_power=True,
    confirm="Measure the warm lamp again with the spectroradiometer, at the voltage of the capture. Compare the "
    "radiometer's scale with the reference source. The effect shows only beyond the lamp's stated uncertainty.",
)
