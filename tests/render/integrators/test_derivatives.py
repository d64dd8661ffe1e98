"""Derivatives by paints and lamp against differences of pictures that share their paths."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.bounces import render_bounces
from cboxlab.rendering.integrators.derivatives import render_derivatives
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.scenes import Spectrum, cornell_box, cornell_camera
from cboxlab.utils.errors import InputError
from helpers.scenes.boxes import BANDS, box_with_lamp, camera_inside

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")


def with_paint(scene, name, factor):
    paint = replace(scene.materials[name], reflectance=scene.materials[name].reflectance.scaled(factor))
    return replace(scene, materials={**scene.materials, name: paint})


@pytest.mark.parametrize("paint", ["white", "green"])
def test_paints_against_differences(paint):
    """Central differences over +-1% of a reflectance, cut after three reflections (so that roulette, which goes by
    reflectance, does not act): the same to the difference's own error, third order over six."""
    scene, camera = cornell_box(), cornell_camera(16)
    arguments = {"samples": 32, "batches": 2, "seed": 3, "max_bounces": 3}
    derivatives = render_derivatives(RenderJob(scene, camera, BANDS, **arguments))
    step = 0.01
    more, less = (
        render_path_tracer(RenderJob(with_paint(scene, paint, 1 + s), camera, BANDS, **arguments))
        for s in (step, -step)
    )
    rho = scene.materials[paint].reflectance.at(BANDS)
    difference = (more.coefficients - less.coefficients) @ more.spectra / (2 * step * rho)
    exact = derivatives.reflectance[:, derivatives.material_names.index(paint)]
    # at most three factors rho: the third derivative is 6 / rho^3 of what the first is 3 / rho
    assert np.abs(difference - exact).max() < 1e-3 * np.abs(exact).max()
    assert np.array_equal(
        derivatives.image.coefficients, render_path_tracer(RenderJob(scene, camera, BANDS, **arguments)).coefficients
    )


def test_a_grey_box_has_the_derivative_of_its_series():
    """Without a cut: in a closed grey box where all is lit alike, L = E / (1 - rho) and dL / d rho = E / (1 - rho)^2.

    Here the light falls unevenly, so the sum over the box is compared with a picture of rho + 5%, other paths: the
    mean slope between the two within five standard errors, which chance exceeds once in a million.
    """
    camera = camera_inside(12)
    low, middle, high = (box_with_lamp(r) for r in (0.57, 0.6, 0.63))
    arguments = {"samples": 128, "batches": 16}
    slope = render_derivatives(RenderJob(middle, camera, BANDS[:1], seed=1, **arguments)).reflectance[:, 0]
    ends = [render_path_tracer(RenderJob(s, camera, BANDS[:1], seed=n, **arguments)) for n, s in ((2, low), (3, high))]
    means = [(e.coefficients[..., 1:] @ e.spectra[1:]).mean(axis=(1, 2, 3)) for e in ends]
    rise, fall = (means[1] - means[0]) / 0.06, slope.mean(axis=(1, 2, 3))
    error = np.sqrt((rise.var(ddof=1) + fall.var(ddof=1)) / 16)
    # the mean slope over +-0.03 exceeds the slope in the middle by the third derivative: 1e-3 / (1 - rho)^2
    allowed = 0.03**2 / 0.4**2 * fall.mean()
    assert error < 0.01 * fall.mean()
    assert abs(rise.mean() - fall.mean()) < 6.5 * error + allowed


def test_the_lamps_spectrum_and_power():
    """Light is linear in the lamp's: derivative times its radiance is the picture."""
    scene, camera = cornell_box(), cornell_camera(8)
    derivatives = render_derivatives(RenderJob(scene, camera, BANDS, samples=8, batches=2))
    radiance = derivatives.image.coefficients @ derivatives.image.spectra
    assert derivatives.lamp * scene.lamp.radiance.at(BANDS) == pytest.approx(radiance, rel=1e-5, abs=1e-12)


def test_a_black_paint_has_no_derivative_to_show():
    scene = with_paint(cornell_box(), "red", 0.0)
    with pytest.raises(InputError, match=r"material red: found reflectance 0 at 450 nm"):
        render_derivatives(RenderJob(scene, cornell_camera(8), BANDS))
    assert isinstance(scene.materials["red"].reflectance, Spectrum)


def test_bounces_share_their_paths_and_add_up():
    """Each part is the difference of pictures cut one reflection later and sooner; all of them make the picture."""
    arguments = {"samples": 16, "batches": 2, "seed": 3}
    parts = render_bounces(RenderJob(cornell_box(), cornell_camera(12), BANDS, **arguments), bounces=3)
    complete = render_path_tracer(RenderJob(cornell_box(), cornell_camera(12), BANDS, **arguments))
    radiance = complete.coefficients @ complete.spectra
    assert parts.sum("part").values == pytest.approx(radiance, rel=1e-5, abs=1e-6 * radiance.max())
    cut = [
        render_path_tracer(RenderJob(cornell_box(), cornell_camera(12), BANDS, max_bounces=n, **arguments))
        for n in (1, 2)
    ]
    shorter, two = (image.coefficients @ image.spectra for image in cut)
    assert parts.sel(part="2").values == pytest.approx(two - shorter, rel=1e-3, abs=1e-6 * shorter.max())
    assert set(parts.surface.values.ravel()) >= {"floor", "left", "ceiling"}
