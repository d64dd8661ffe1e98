"""Effects of the camera and of what follows it: filters, optics, counts."""

from dataclasses import replace

import numpy as np
from cboxlab.rendering.effects import Effect, Parameter

FOCUS_BREATHING = Effect(
    id="focus-breathing",
    stage="camera",
    summary="The focal length changed when the lens was focused again after the survey.",
    parameters=(Parameter("stretch", null=0.0, low=-0.1, high=0.1, step=1e-3),),
    apply=lambda camera, stretch: replace(camera, focal_length_px=camera.focal_length_px * (1 + stretch)),
    confirm="Photograph the surveyed points again at the focus of the capture.",
)


def _decentred(camera, p1):
    def shift(image_px):
        x, y = ((image_px - camera.principal_point_px) / camera.focal_length_px).T
        return camera.focal_length_px * p1 * np.stack([2 * x * y, x**2 + 3 * y**2], axis=-1)

    return camera.distorted_further(shift)


DECENTRED_LENS = Effect(
    id="decentred-lens",
    stage="camera",
    summary="The lens' elements are not on one axis: tangential distortion, OpenCV's p1, which the camera lacks.",
    parameters=(Parameter("p1", null=0.0, low=-0.05, high=0.05, step=2e-3),),
    apply=_decentred,
    confirm="Photograph a chessboard over the whole field.",
    sources=("Brown 1966, Decentering distortion of lenses",),
)


def _warmed(curves, shift_nm):
    grid = curves.wavelength_nm
    shifted = [[np.interp(grid - shift_nm, grid, t, left=0.0, right=0.0) for t in at] for at in curves.transmittance]
    return replace(curves, transmittance=np.array(shifted))


WARM_FILTERS = Effect(
    id="warm-filters",
    stage="filter",
    summary="The filters are warmer than when they were measured: all pass bands lie at longer wavelengths.",
    parameters=(Parameter("shift_nm", "nm", null=0.0, low=-20.0, high=20.0, step=0.5),),
    apply=_warmed,
    confirm="Let the camera cool down and take one band again.",
)


def _shaded(light, slope):
    across = np.linspace(-1.0, 1.0, light.signal.shape[2])
    return light.scaled(1 + slope * across[None, None, :])


HOOD_SHADE = Effect(
    id="hood-shade",
    stage="optics",
    summary="The hood sits askew and shades one side of the picture more than the other.",
    parameters=(Parameter("slope", null=0.0, low=-0.5, high=0.5, step=5e-3),),
    apply=_shaded,
    confirm="Take the flat field with the hood as it was.",
)


def _ramped(counts, dn):
    ramp = dn * np.linspace(0.0, 1.0, counts.scene.shape[1])[:, None]
    return replace(counts, scene=counts.scene + ramp, flat=counts.flat + ramp, reference=counts.reference + ramp)


ROW_RAMP = Effect(
    id="row-ramp",
    stage="counts",
    summary="The amplifier warms up while rows are read: an offset that grows towards the last one.",
    parameters=(Parameter("dn", "DN", null=0.0, low=-200.0, high=200.0, step=1.0),),
    apply=_ramped,
    confirm="Read an exposure of no light at the same speed as the scene's frames.",
    acts_on_charge=False,
)
