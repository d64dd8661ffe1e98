"""Patterns of lamps by their mean, and weights of textures."""

import numpy as np
from cboxlab.scenes.scene_entries import LampEntry, TextureEntry, lamp_pattern, texture_weights
from PIL import Image

QUAD = [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]


def test_a_pattern_is_scaled_to_mean_1():
    """The lamp's radiance stays the mean over its face, whatever the numbers of the pattern are."""
    rows = [[1.0, 3.0], [0.0, 12.0]]
    pattern = lamp_pattern(LampEntry(quads_mm=[QUAD], radiance="light", pattern=rows), "lamp")
    np.testing.assert_allclose(pattern, np.array(rows) / 4)


def test_the_last_spectrum_takes_what_the_channels_leave_of_1(tmp_path):
    """An image of three columns and one row: of each pixel's 1 the channels have their share."""
    shares = np.array([[[0, 0, 0], [255, 0, 0], [51, 102, 51]]], np.uint8)
    Image.fromarray(shares).save(tmp_path / "texture.png")
    entry = TextureEntry(image="texture.png", spectra=["red", "green", "blue", "black"])
    weights = texture_weights(entry, tmp_path, "texture")
    np.testing.assert_allclose(weights, np.concatenate([shares / 255, [[[1], [0], [0.2]]]], axis=2), atol=1e-12)
