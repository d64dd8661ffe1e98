"""From light to the expected counts of a capture, and from those to its corrected signals.

The last step is the laboratory's correction: S = (O - D) mean(F - D) / (F - D) with frames that went through the
same effects (Pattanaik et al. 1997, eq. 1), and C measured again from reference frames that did too. The
responses hold the measured C, so the prediction is divided by what the effects did to that measurement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from ..image import RenderedImage
from .band_curves import BandCurves, field_shares
from .counts import Counts
from .light import Light
from .projection import Projection, band_signals, scene_light, uniform_light
from .sensing import Sensing
from .stages import ActsAtStage, after_stage

__all__ = ["expected_counts", "expected_signal"]

#: The correction takes no smaller response of the flat than this.
SMALLEST_RESPONSE = 1e-3


def _frames(light: Light, curves: BandCurves, sensing: Sensing, camera: Camera) -> Counts:
    """The raw frames of light behind the optics, through ``curves``, before the counts' effects."""
    shares = field_shares(curves, camera)
    before = _uniform(sensing.curves, sensing.flat_radiance)
    uneven = band_signals(uniform_light(sensing.flat_radiance), curves, shares)
    uneven = uneven / np.where(before > 0, before, np.inf)
    has_flat = (sensing.flat_level > 0) & (uneven > 0).all(axis=(1, 2))
    # The measured flat has seen the altered filters; what is left of it is the same at all wavelengths.
    response = sensing.flat / np.where(has_flat[:, None, None], uneven, 1.0)
    mean = [r[u].mean() if has else 1.0 for r, u, has in zip(response, sensing.usable, has_flat, strict=True)]
    response = response / np.array(mean)[:, None, None]
    reference = _reference_gain(sensing) * band_signals(uniform_light(sensing.reference_radiance), curves, shares)
    scene = light.signal
    if sensing.mosaic is not None:
        scene, reference = sensing.mosaic.light(scene), sensing.mosaic.light(reference)
        response = sensing.mosaic.response(response)
    return Counts(
        bands=sensing.curves.bands,
        scene=scene * response + sensing.dark_scene[:, None, None],
        flat=sensing.flat_level[:, None, None] * sensing.flat + sensing.dark_flat[:, None, None],
        reference=reference * response + sensing.dark_reference[:, None, None],
        dark_scene=sensing.dark_scene,
        dark_flat=sensing.dark_flat,
        dark_reference=sensing.dark_reference,
        exposure_scene=sensing.exposure_scene,
        exposure_flat=sensing.exposure_flat,
        exposure_reference=sensing.exposure_reference,
        minutes=sensing.minutes,
        full_scale=sensing.full_scale,
    )


def _uniform(curves: BandCurves, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """(band, 1, 1) signals of uniform fields (band, 301) on the axis."""
    return band_signals(uniform_light(radiance), curves, np.ones((1, 1, 1)))


def _reference_gain(sensing: Sensing) -> NDArray[np.float64]:
    """(band, 1, 1) the reference frames' K over that of the scene's."""
    return np.asarray((sensing.reference_factor / sensing.curves.factor)[:, None, None])


def expected_counts(light: Light, sensing: Sensing, effects: Sequence[ActsAtStage], camera: Camera) -> Counts:
    """Expected raw frames of light behind the filters, under the effects from there on.

    Parameters
    ----------
    light
        Light through the same filters' effects, see ``scene_light``. Effects of earlier stages are in it.
    sensing
        The capture's constants.
    effects
        Effects; those of earlier stages are passed over.
    camera
        Camera, for the field angles.

    Returns
    -------
    Counts
        Frames without noise and rounding.
    """
    return _counted(after_stage(light, effects, "optics"), sensing, effects, camera)


def _counted(light: Light, sensing: Sensing, effects: Sequence[ActsAtStage], camera: Camera) -> Counts:
    """Expected raw frames of light behind the optics."""
    curves = after_stage(sensing.curves, effects, "filter")
    return after_stage(_frames(light, curves, sensing, camera), effects, "counts")


def _corrected(counts: Counts, sensing: Sensing) -> NDArray[np.float64]:
    """(band, y, x) DN: the laboratory's correction of the frames."""
    reference_level = (_reference_gain(sensing) * _uniform(sensing.curves, sensing.reference_radiance))[:, 0, 0]
    scene, flat, reference = (
        frame - dark[:, None, None]
        for frame, dark in (
            (counts.scene, counts.dark_scene),
            (counts.flat, counts.dark_flat),
            (counts.reference, counts.dark_reference),
        )
    )
    ratios = np.ones(len(counts.bands))
    response = np.maximum(sensing.flat, SMALLEST_RESPONSE)  # nominal where no flat was taken, 1 without any
    for band, good in enumerate(sensing.good):
        if sensing.flat_level[band] > 0:
            relative = flat[band] / flat[band][sensing.usable[band]].mean()
            response[band] = np.maximum(relative, SMALLEST_RESPONSE)
        if sensing.reference_weight[band] > 0:
            level = reference[band][good].sum() / response[band][good].sum()
            ratios[band] = level / reference_level[band]
    changed = np.average(ratios, weights=sensing.reference_weight) if sensing.reference_weight.any() else 1.0
    return scene / response / changed


def expected_signal(
    source: RenderedImage | Projection | Light,
    sensing: Sensing,
    effects: Sequence[ActsAtStage],
    camera: Camera,
) -> NDArray[np.float64]:
    """Expected corrected signals under filter, optics and counts effects, in their order.

    Effects of the stages before the filter must be in the image already and are passed over. The lamp is not clipped.
    Without effects the result is that of ``render_bands``. Where exposures were merged, so are the predictions.
    Behind a mosaic the counts are those of the raw frames. The pixels that a band does not see have its light behind
    the optics, as if they had its channel.

    Parameters
    ----------
    source
        A rendered image, a projection of one (see ``scene_light``), or the light that ``scene_light`` gave for the same
        filter effects, which saves the projection.
    sensing
        The capture's constants.
    effects
        Effects.
    camera
        Camera, for the field angles.

    Returns
    -------
    NDArray
        (band, y, x) signals, DN.
    """
    if not isinstance(source, Light):
        source = scene_light(source, after_stage(sensing.curves, effects, "filter"), camera)
    signal = _expected(source, sensing, effects, camera)
    if sensing.mosaic is None:
        return signal
    return np.where(sensing.mosaic.pixels, signal, after_stage(source, effects, "optics").signal)


def _expected(source: Light, sensing: Sensing, effects: Sequence[ActsAtStage], camera: Camera) -> NDArray[np.float64]:
    """(band, y, x) DN: corrected signals, behind a mosaic those of the raw frames."""
    if not sensing.merged or not any(effect.stage == "counts" for effect in effects):
        return _corrected(expected_counts(source, sensing, effects, camera), sensing)
    # effects of the counts depend on the exposure: each one is predicted and corrected, then merged as in calibration
    light = after_stage(source, effects, "optics")
    merged = np.zeros_like(light.signal)
    for exposure in sensing.merged:
        alone = sensing.during(exposure)
        during = light.with_signal(light.signal * exposure.ratio[:, None, None])
        merged += exposure.weight * _corrected(_counted(during, alone, effects, camera), alone)
    return merged
