"""Rendering down to a part of the sensor's noise, and what the predictor keeps."""

import numpy as np
import xarray as xr
from cboxlab.rendering.image import BATCH_SEED_STEP, RenderedImage
from cboxlab.rendering.radiosity import gather, solve_light
from cboxlab.scenes.cornell_box import cornell_box, cornell_camera
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.predict import predictor, rendering


def test_a_known_pilot_leads_to_the_same_samples_without_another(monkeypatch):
    calls = []

    def picture(samples, first_batch, batches, progress):
        calls.append((samples, batches))
        return RenderedImage(np.full((batches, 2, 2, 1), samples), *5 * (None,))

    def bands(image, responses):
        samples, batches = image.coefficients[0, 0, 0, 0], len(image.coefficients)
        layers = ("band", "y", "x")
        variance = np.full((1, 2, 2), 9.0 * (64 / samples) ** (2 * 0.7) * 8 / batches)
        return xr.Dataset(
            {
                "signal": (layers, np.ones((1, 2, 2))),
                "variance": (layers, variance),
                "mask": (layers, np.zeros((1, 2, 2), int)),
            }
        )

    monkeypatch.setattr(rendering, "render_bands", bands)
    common = (picture, (), np.ones_like, np.ones((1, 2, 2), bool))
    _, picture_again, pilot = rendering.render_to_noise(*common, noise=0.6, convergence=0.7, progress=NO_PROGRESS)
    assert pilot == 3.0 and calls == [(64, 8), (512, 8), (512, 3)]
    assert np.sqrt(picture_again.variance.values).max() <= 0.6
    _, again, same = rendering.render_to_noise(*common, noise=0.6, convergence=0.7, pilot=pilot, progress=NO_PROGRESS)
    assert same == pilot and calls[3:] == calls[1:3]
    np.testing.assert_array_equal(again.variance, picture_again.variance)
    calls.clear()  # the noise falls faster than expected: 10 batches were, 8 suffice
    rendering.render_to_noise(*common, noise=0.7, convergence=0.5, pilot=pilot, progress=NO_PROGRESS)
    assert calls == [(1024, 8)]


def test_a_photograph_of_hardly_any_noise_takes_bounded_time(monkeypatch):
    """The pilot has 300 times the noise of the target; a lower target takes more rays than the usual one.

    A target within reach takes up to the limit, one out of reach half of it.
    """
    calls = []

    def picture(samples, first_batch, batches, progress):
        calls.append(samples * batches)
        return RenderedImage(np.full((batches, 2, 2, 1), samples), *5 * (None,))

    monkeypatch.setattr(rendering, "render_bands", lambda image, responses: None)
    monkeypatch.setattr(rendering, "_MOST_RAYS", 4 * 2**15)
    monkeypatch.setattr(rendering, "_MAX_COMPLETED_PIXELS", 0)
    common = (picture, (), np.ones_like, np.ones((1, 2, 2), bool))
    for noise in (0.3, 0.1):
        rendering.render_to_noise(*common, noise=noise, convergence=0.7, pilot=100.0)
    rendering.render_to_noise(*common, noise=0.3, convergence=0.7, pilot=0.3 * 60**0.7)
    assert 2**13 <= calls[0] <= 2**14
    assert 2**14 < calls[1] <= 2**14 * 3 ** (1 / 0.7)
    assert 2**14 < calls[2] <= 2**15


def test_a_pilot_of_enough_samples_is_completed_by_the_batches_that_a_longer_picture_has(monkeypatch):
    """Bit by bit the picture is the one rendered at once."""
    light = solve_light(cornell_box(), np.array([500.0, 600.0]), patch_edge_mm=300.0, patch_samples=32)
    camera, batches_of = cornell_camera(8), []

    def picture(samples, first_batch, batches, progress):
        batches_of.append(batches)
        return gather(light, camera, samples, batches, BATCH_SEED_STEP * first_batch)

    def bands(image, responses):
        layers, shape = ("band", "y", "x"), (1, 8, 8)
        variance = np.full(shape, 4.0 * 8 / len(image.coefficients))
        uniform = {"signal": (layers, np.ones(shape)), "mask": (layers, np.zeros(shape, int))}
        return xr.Dataset({**uniform, "variance": (layers, variance)})

    monkeypatch.setattr(rendering, "render_bands", bands)
    used = np.ones((1, 8, 8), bool)
    image, _, pilot = rendering.render_to_noise(picture, (), np.ones_like, used, noise=1.6, convergence=0.7)
    assert pilot == 2.0 and batches_of == [8, 5]
    np.testing.assert_array_equal(image.coefficients, gather(light, camera, 64, 13).coefficients)


def test_what_was_not_used_for_longest_goes_but_never_the_base_pictures():
    store, renders = predictor._Store(3), []

    def use(key):
        return store.get((key,), lambda: renders.append(key) or key.upper())

    assert [use(key) for key in "abcbdadbe"] == list("ABCBDADBE")
    assert renders == list("abcde")
    assert list(store.results) == [("a",), ("b",), ("e",)]


def test_pixels_without_light_do_not_count_as_rendered_well():
    """Three of four see nothing; the fourth's error is twice the sensor's."""
    layers, signal = ("band", "y", "x"), np.array([[[0.0, 0.0], [0.0, 9.0]]])
    bands = xr.Dataset({"signal": (layers, signal), "variance": (layers, 4.0 * (signal > 0))})
    assert rendering.noise_ratio(bands, np.ones_like(signal), np.ones(signal.shape, bool)) == 2.0
    assert rendering.noise_ratio(bands, np.ones_like(signal), np.zeros(signal.shape, bool)) == 0.0
