"""What edges do within their pixels is added to every blur of the light."""

from dataclasses import replace

import numpy as np
from cboxlab.rendering.image.blur import blur
from helpers.fakes.stages import apply, light


def test_light_next_to_edges_is_added_to_the_blurred_pixels():
    before = light()
    shape = np.random.default_rng(3).standard_normal(before.signal.shape)
    light_at_edges = replace(before, beyond_pixels=lambda sigma_px: sigma_px[:, None, None] * shape)
    for identifier, values, sigma in (
        ("defocus", {"sigma_px": 0.7}, np.full(3, 0.7)),
        ("chromatic-focus", {"sigma_px_per_100nm": 0.5}, 0.005 * np.abs(before.effective_nm - 550)),
    ):
        after = apply(identifier, light_at_edges, **values).signal
        pixels = np.array([blur(band, s) for band, s in zip(before.signal, sigma, strict=True)])
        np.testing.assert_allclose(after, pixels + sigma[:, None, None] * shape, rtol=1e-12)
