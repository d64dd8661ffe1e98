"""The steps of Radiance's pictures: eight bits a channel with one exponent for all three, and the error they make."""

import numpy as np
import pytest
from cboxlab.rendering.files import Declared, read_picture
from cboxlab.rendering.files.colour_pictures import COLOUR_SPACES, primaries_matrix
from helpers.files.rgbe import write_rgbe

DECLARED = Declared("cd m^-2", 179.0, colour_space="radiance")
MATRIX = 179 * primaries_matrix(COLOUR_SPACES["radiance"])


def read(tmp_path, rgb, header=""):
    """The picture, and by how much it is off."""
    picture = read_picture(write_rgbe(tmp_path / "a.hdr", rgb, header), DECLARED)
    return picture, picture["xyz"].values - rgb @ MATRIX.T


def test_the_stated_error_is_that_of_the_steps(tmp_path):
    """20,000 pixels of any colour whose weakest channel is 2 to 5 % of the strongest: the root mean square of errors
    over the stated ones is 1 within 2 %, and their mean 0 within 0.03."""
    rng = np.random.default_rng(1)
    rgb = rng.uniform(0.5, 8.0, (100, 200, 1)) * rng.uniform([0.5, 0.1, 0.02], [1.0, 0.4, 0.05], (100, 200, 3))
    picture, error = read(tmp_path, rgb)
    over = error / picture["rounding"].values
    np.testing.assert_allclose(np.sqrt((over**2).mean(axis=(0, 1))), 1.0, rtol=0.02)
    np.testing.assert_allclose(over.mean(axis=(0, 1)), 0.0, atol=0.03)
    assert "of its largest channel and more of the others" in picture.attrs["reading_notes"]


def test_an_exposure_and_a_correction_of_colours_act_on_the_error_too(tmp_path):
    rgb = np.random.default_rng(2).uniform(0.1, 0.4, (9, 9, 3))
    plain, _ = read(tmp_path, rgb)
    halved, _ = read(tmp_path, rgb, "EXPOSURE=0.5\nCOLORCORR=0.5 0.5 0.5\n")
    for name in ("xyz", "rounding", "rounding_shared"):
        np.testing.assert_allclose(halved[name].values, 4 * plain[name].values)


def test_even_surfaces_share_their_error(tmp_path):
    """400 even surfaces: the mean of each is off by the stated shared part, whose root mean square is 1 within 8 %."""
    rng = np.random.default_rng(3)
    over = []
    for _ in range(400):
        picture, error = read(tmp_path, np.ones((9, 9, 1)) * rng.uniform([0.5, 0.1, 0.02], [1.0, 0.4, 0.05]))
        over.append(error.mean(axis=(0, 1)) / picture["rounding_shared"].values.mean(axis=(0, 1)))
    np.testing.assert_allclose(np.sqrt(np.square(over).mean(axis=0)), 1.0, rtol=0.08)


@pytest.mark.parametrize("spread", [0.05, 0.15, 0.25, 0.35, 0.5])
def test_what_is_shared_covers_means_of_noisy_surfaces(tmp_path, spread):
    """Means of 300 surfaces of 17 x 17 pixels, whose noise is that many steps: off by no more than is stated, together
    with independent errors of the pixels: root mean square at most 1.1."""
    rng, step, over = np.random.default_rng(4), 2.0**-8, []
    for _ in range(300):
        level = rng.uniform([0.6, 0.1, 0.02], [0.9, 0.4, 0.05])
        rgb = level + spread * step * rng.standard_normal((17, 17, 3))
        picture, error = read(tmp_path, rgb)
        pooled_error = np.sqrt((picture["rounding"].values ** 2).sum(axis=(0, 1))) / 17**2
        over.append(
            error.mean(axis=(0, 1)) / np.hypot(pooled_error, picture["rounding_shared"].values.mean(axis=(0, 1)))
        )
    assert np.all(np.sqrt(np.square(over).mean(axis=0)) < 1.1)


def test_noise_of_two_steps_leaves_nothing_shared(tmp_path):
    rng = np.random.default_rng(5)
    rgb = np.array([0.9, 0.3, 0.05]) + 2 * 2.0**-8 * rng.standard_normal((40, 40, 3))
    picture, _ = read(tmp_path, rgb)
    assert picture["rounding_shared"].values.mean() < 0.02 * picture["rounding"].values.mean()


def test_what_is_cut_off_outside_the_primaries_is_uncertain(tmp_path):
    """A red of negative blue: Z of the file is 29 to 62 % too large, within its error; a note says so."""
    rgb = np.linspace(1.0, 2.0, 100).reshape(10, 10, 1) * np.array([1.0, 0.02, -0.006])
    picture, error = read(tmp_path, rgb)
    exact = rgb @ MATRIX.T
    assert np.all(error[..., 2] > 0.25 * exact[..., 2])
    assert np.all(np.abs(error) < 2 * picture["rounding"].values)
    assert np.all(picture["rounding_shared"].values[..., 2] > 0.9 * picture["rounding"].values[..., 2])
    assert np.all(picture["rounding"].values[..., 2] < picture["xyz"].values[..., 2])
    assert "pixels with a channel at 0: 100;" in picture.attrs["reading_notes"]


def test_black_is_exact(tmp_path):
    (tmp_path / "a.hdr").write_bytes(
        b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 2\n" + bytes(4) + b"\x80\x80\x80\x80"
    )
    picture = read_picture(tmp_path / "a.hdr", Declared("cd m^-2"))
    assert np.all(picture["rounding"].values[0, 0] == 0)
    assert np.all(picture["rounding"].values[0, 1] > 0)
    assert "a channel at 0" not in picture.attrs["reading_notes"]
