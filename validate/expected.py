"""From a rendered image to the corrected signals of a capture: filters, optics, counts, correction.

The last step is the laboratory's own: S = (O - D) mean(F - D) / (F - D) with frames that went through the
same effects (Pattanaik et al. 1997, eq. 1), and C measured again from reference frames that did too. The
responses hold the measured C, so the prediction is divided by what the effects did to that measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from cboxlab.calibration.sensor_equation import WAVELENGTH_NM, BandResponse, sensor_matrix
from cboxlab.render.edge_blur import build_edge_blur
from cboxlab.render.image import RenderedImage
from cboxlab.render.warp import Warp, warp_change
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .effects import AppliedEffect, BandCurves, Counts, Light
from .sensing import Sensing, field_sine_squared, sensing

__all__ = [
    "Projection", "Sensing", "expected_signal", "integral_responses", "scene_light", "sensing", "with_scene_behind",
]  # fmt: skip

#: Radiance of every pixel times weights (301, q) on 400 to 700 nm by 1 nm: (y, x, q).
Projection = Callable[[NDArray[np.float64]], NDArray[np.float64]]

#: The correction takes no smaller response of the flat than this.
SMALLEST_RESPONSE = 1e-3


def integral_responses(curves: BandCurves, angle: int = 0) -> tuple[BandResponse, ...]:
    """The band responses at a field angle on the integral's own grid, 400 to 700 nm by 1 nm."""
    inside = np.isin(curves.wavelength_nm, WAVELENGTH_NM)
    cut = replace(
        curves,
        wavelength_nm=curves.wavelength_nm[inside],
        transmittance=curves.transmittance[..., inside],
        rest=curves.rest[:, inside],
    )
    return cut.responses(angle)


def _altered(curves: BandCurves, effects: Sequence[AppliedEffect]) -> BandCurves:
    for effect in effects:
        if effect.effect.stage == "filter":
            curves = effect.apply(curves)
    return curves


def _field(curves: BandCurves, camera: Camera) -> NDArray[np.float64]:
    """(angle, y, x) shares of the field angles in each pixel's signal; (1, 1, 1) where they are alike.

    A cubic spline in the sine squared, in which a pass band's shift is nearly linear.
    """
    if np.ptp(curves.transmittance, axis=0).max() == 0:
        return np.ones((1, 1, 1))
    knots = curves.sine_squared
    place = np.nan_to_num(np.minimum(field_sine_squared(camera), knots[-1]), nan=knots[-1])
    return np.moveaxis(CubicSpline(knots, np.eye(knots.size))(place), -1, 0)


def _uniform(
    curves: BandCurves, field: NDArray[np.float64], radiance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(band, y or 1, x or 1) signal of uniform fields of radiance (band, 301), at the scene's own K."""
    levels = [
        np.einsum("bw,bw->b", sensor_matrix(integral_responses(curves, angle)), radiance)
        for angle in range(len(field))
    ]
    return np.einsum("ab,ayx->byx", np.array(levels), field)


def with_scene_behind(light: Light, warp: Warp) -> Light:
    """The light with what its pixels do not tell: where in them the edges of the picture taken apart lie."""
    edges = cache(lambda: build_edge_blur(warp))
    return replace(
        light,
        moved=lambda there: warp_change(warp, there),
        beyond_pixels=lambda sigma_px: edges().beyond_pixels(sigma_px),
    )


def scene_light(
    project: RenderedImage | Projection, sensing: Sensing, effects: Sequence[AppliedEffect], camera: Camera
) -> Light:
    """The scene through the filters, before optics and counts: one projection of the spectra per field angle.

    project : a rendered image on 400 to 700 nm by 1 nm, or a function that gives the radiance of its pixels
    times weights. Effects of other stages than "filter" are passed over. Raises ValueError for other grids.
    """
    if isinstance(project, RenderedImage):
        image = project
        if not np.array_equal(image.wavelength_nm, WAVELENGTH_NM):
            raise ValueError("the image's wavelengths are not 400 to 700 nm by 1 nm")

        def project(weights: NDArray[np.float64]) -> NDArray[np.float64]:
            return image.project(weights)[0]

    curves = _altered(sensing.curves, effects)
    field = _field(curves, camera)
    signal = np.zeros(())
    for angle, share in enumerate(field):
        weights = sensor_matrix(integral_responses(curves, angle)).T
        signal = signal + share * np.moveaxis(project(weights), -1, 0)
    axial = sensor_matrix(integral_responses(curves)).T
    moments = project(np.concatenate([axial, WAVELENGTH_NM[:, None] * axial], axis=1))
    bands = len(curves.bands)
    level, first = moments[..., :bands], moments[..., bands:]
    # The median pixel's: the lamp, brighter than all the rest together, must not decide.
    with np.errstate(divide="ignore", invalid="ignore"):
        effective = np.nanmedian(np.where(level > 0, first / level, np.nan), axis=(0, 1))
    return Light(signal, effective, camera)


def _frames(
    light: Light, curves: BandCurves, field: NDArray[np.float64], sensing: Sensing
) -> tuple[Counts, NDArray[np.float64]]:
    """The raw frames before the counts' effects, and (band,) the reference's level without any effect."""
    null, alike = sensing.curves, np.ones((1, 1, 1))
    has_flat = sensing.flat_level > 0
    before = _uniform(null, alike, sensing.flat_radiance)
    uneven = _uniform(curves, field, sensing.flat_radiance) / np.where(before > 0, before, np.inf)
    has_flat = has_flat & (uneven > 0).all(axis=(1, 2))
    # The measured flat has seen the altered filters; what is left of it is the same at all wavelengths.
    response = sensing.flat / np.where(has_flat[:, None, None], uneven, 1.0)
    mean = [r[u].mean() if has else 1.0 for r, u, has in zip(response, sensing.usable, has_flat, strict=True)]
    response = response / np.array(mean)[:, None, None]
    gain = (sensing.reference_factor / null.factor)[:, None, None]
    reference = gain * _uniform(curves, field, sensing.reference_radiance)
    counts = Counts(
        bands=null.bands,
        scene=light.signal * response + sensing.dark_scene[:, None, None],
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
    return counts, (gain * _uniform(null, alike, sensing.reference_radiance))[:, 0, 0]


def _corrected(counts: Counts, sensing: Sensing, reference_level: NDArray[np.float64]) -> NDArray[np.float64]:
    scene, flat, reference = (
        frame - dark[:, None, None]
        for frame, dark in (
            (counts.scene, counts.dark_scene),
            (counts.flat, counts.dark_flat),
            (counts.reference, counts.dark_reference),
        )
    )
    ratios = np.ones(len(counts.bands))
    response = np.ones_like(flat)
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
    effects: Sequence[AppliedEffect],
    camera: Camera,
) -> NDArray[np.float64]:
    """Expected corrected signals (band, y, x) in DN under filter, optics and counts effects, in their order.

    source : a rendered image, a projection of one (see ``scene_light``), or the light that ``scene_light``
    gave for the same filter effects, which saves the projection. Effects of the stages before the filter
    must be in the image already and are passed over. The lamp is not clipped. Without effects the result is
    that of ``render_bands``.
    """
    curves = _altered(sensing.curves, effects)
    light = source if isinstance(source, Light) else scene_light(source, sensing, effects, camera)
    for effect in effects:
        if effect.effect.stage == "optics":
            light = effect.apply(light)
    counts, reference_level = _frames(light, curves, _field(curves, camera), sensing)
    for effect in effects:
        if effect.effect.stage == "counts":
            counts = effect.apply(counts)
    return _corrected(counts, sensing, reference_level)
