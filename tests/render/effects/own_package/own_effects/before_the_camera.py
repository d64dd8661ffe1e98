"""Effects of the scene, of the render's settings and of light transport."""

from dataclasses import replace

import numpy as np
from cboxlab.rendering.effects import Effect, Parameter
from cboxlab.scenes import Spectrum


def _washed(scene, where, factor):
    surface = scene.surface(where)
    table = scene.materials[surface.material].reflectance
    paint = Spectrum(table.wavelength_nm, np.minimum(factor * table.values, 1.0), table.outside)
    washed = f"washed {surface.material}"
    materials = {**scene.materials, washed: replace(scene.materials[surface.material], reflectance=paint)}
    surfaces = tuple(replace(s, material=washed) if s.name == where else s for s in scene.surfaces)
    return replace(scene, surfaces=surfaces, materials=materials)


WASHED_SURFACE = Effect(
    id="washed-surface",
    stage="scene",
    summary="One surface alone reflects more or less than its paint's table.",
    parameters=(
        Parameter("where", choices=("floor", "back"), kind="surface"),
        Parameter("factor", null=1.0, low=0.5, high=1.5, step=0.01),
    ),
    apply=_washed,
    confirm="Measure this surface and another of the same paint with a spectrophotometer.",
)


def _one_more(settings):
    bounces = settings.max_bounces
    return settings if bounces is None else replace(settings, max_bounces=bounces + 1)


ONE_MORE_BOUNCE = Effect(
    id="one-more-bounce",
    stage="settings",
    summary="Light is reflected once more than the model says, and then no more.",
    parameters=(),
    apply=_one_more,
    confirm="Hang black velvet where the last reflection would be.",
)


def _sooty(light, loss):
    transport, patches = light.transport, light.transport.light.patches
    top = patches.centre[:, 1].max()

    def transmission(position):
        return 1 - loss * np.clip(position[:, 1] / top, 0, 1)[:, None] ** 2

    return light.change(
        patch_reflectance=light.patch_reflectance * transmission(patches.centre),
        fragment_reflectance=light.fragment_reflectance * transmission(transport.position),
    )


SOOT = Effect(
    id="soot",
    stage="transport",
    summary="Soot has risen: every paint reflects less with the square of its height in the box.",
    parameters=(Parameter("loss", null=0.0, low=0.0, high=0.9, step=0.02),),
    apply=_sooty,
    confirm="Wipe a wall below the ceiling with a white cloth.",
    spectral_step_nm=50,
)
