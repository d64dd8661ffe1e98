"""Rendering down to a part of the sensor's noise, and what the predictor keeps."""

import numpy as np
import xarray as xr
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.predict import predictor, rendering


def test_a_known_pilot_leads_to_the_same_samples_without_another(monkeypatch):
    asked = []

    def picture(samples, batches, progress):
        asked.append((samples, batches))
        return samples, batches

    def bands(image, responses):
        samples, batches = image
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
    _, found, pilot = rendering.render_to_noise(*common, noise=0.6, convergence=0.7, progress=NO_PROGRESS)
    assert pilot == 3.0 and len(asked) == 2 and asked[0] == (64, 8)
    assert np.sqrt(found.variance.values).max() <= 0.6
    _, again, same = rendering.render_to_noise(*common, noise=0.6, convergence=0.7, pilot=pilot, progress=NO_PROGRESS)
    assert same == pilot and asked[2:] == asked[1:2]
    np.testing.assert_array_equal(again.variance, found.variance)


def test_what_was_not_used_for_longest_goes_but_never_the_base_pictures():
    store, made = predictor._Store(3), []

    def use(key):
        return store.get((key,), lambda: made.append(key) or key.upper())

    assert [use(key) for key in "abcbdadbe"] == list("ABCBDADBE")
    assert made == list("abcde")
    assert list(store.results) == [("a",), ("b",), ("e",)]


def test_pixels_without_light_do_not_count_as_rendered_well():
    """Three of four see nothing; the fourth's error is twice the sensor's."""
    layers, lit = ("band", "y", "x"), np.array([[[0.0, 0.0], [0.0, 9.0]]])
    bands = xr.Dataset({"signal": (layers, lit), "variance": (layers, 4.0 * (lit > 0))})
    assert rendering.noise_ratio(bands, np.ones_like(lit), np.ones(lit.shape, bool)) == 2.0
    assert rendering.noise_ratio(bands, np.ones_like(lit), np.zeros(lit.shape, bool)) == 0.0
