"""The gain from the repeats of the scene together with those of the flats: unbiased, as certain as it states."""

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import correct_bands, measure_noise, read_darks
from cboxlab.calibration.correction.noise_line import fit_noise_line, samples_of_repeats
from helpers.fakes.capture import GAIN, FakeCapture

#: One band, as behind a mosaic one frame serves all.
BANDS = (550,)


def noise_of(folder):
    capture = load_capture(folder)
    return measure_noise(capture, read_darks(capture))


def write(folder, seed, **changes):
    return FakeCapture(folder, seed=seed, width=40, height=40, centres=BANDS, **changes).write()


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return [write(tmp_path_factory.mktemp("gain") / "capture", seed) for seed in range(20)]


def without_scene(folder, monkeypatch):
    """Noise of flats and darks alone."""
    with monkeypatch.context() as patch:
        patch.setattr("cboxlab.calibration.correction.noise._samples_of_scene", lambda *_: ([], []))
        return noise_of(folder)


def test_the_scene_makes_the_gain_more_certain_and_stays_right(folders, monkeypatch):
    """Twenty captures: the pulls have mean 0 and scatter 1 within four standard errors."""
    noises = [noise_of(folder) for folder in folders]
    alone = without_scene(folders[0], monkeypatch)
    pulls = np.array([(noise.gain_e_per_dn - GAIN) / noise.gain_sigma for noise in noises])
    assert abs(pulls.mean()) < 4 / np.sqrt(20)
    assert np.mean(pulls**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 20))
    assert noises[0].gain_sigma < 0.85 * alone.gain_sigma
    assert not any("vary between repeats" in note for noise in noises for note in noise.notes)


def test_repeats_of_a_scene_that_moved_do_not_touch_the_gain(folders, monkeypatch):
    """Every second repeat is shifted by a pixel: its differences are no noise, and a note says so."""
    alone = without_scene(folders[1], monkeypatch)
    for path in sorted((folders[1] / "frames").glob("*-1.tif")):
        if not path.name.startswith(("dark", "flat", "sphere")):
            image = tifffile.imread(path)
            scene = 300 + 250 * np.sin(np.arange(image.shape[1]) / 2) ** 2
            other = path.with_name(path.name.replace("-1.tif", "-0.tif"))
            tifffile.imwrite(other, (image + scene).astype(image.dtype))
            tifffile.imwrite(path, (image + np.roll(scene, 1)).astype(image.dtype))
    moved = noise_of(folders[1])
    assert moved.gain_e_per_dn == pytest.approx(alone.gain_e_per_dn, rel=1e-9)
    assert any("vary between repeats" in note for note in moved.notes)


def test_pixels_at_both_ends_of_the_counts_leave_the_line_unbiased():
    """A picture from below 0 to beyond saturation, cut off there: 60 slopes scatter about the truth by their sigma.

    A choice by single counts would favour pixels with little noise.
    """
    rng = np.random.default_rng(2)
    charge = np.linspace(0, 4300, 1600).reshape(40, 40)
    truth = np.array([1.0, 0.1])
    pulls = []
    for _ in range(60):
        noise = np.sqrt(truth[0] + truth[1] * charge) * rng.standard_normal((2, 40, 40))
        stack = np.clip(np.rint(charge + noise), 0, 4095).astype(np.uint16)
        samples = samples_of_repeats(stack, np.zeros((40, 40)), 4095, line=truth)
        (_, slope), covariance = fit_noise_line([samples])
        pulls.append((slope - truth[1]) / np.sqrt(covariance[1, 1]))
    assert abs(np.mean(pulls)) < 4 / np.sqrt(60)


def test_the_common_error_of_the_variances_is_that_of_captures(folders):
    """Variances of twenty captures at one signal scatter by the relative error that each of them states.

    A standard deviation of twenty has a standard error of 16 %.
    """
    means, relative_errors = [], []
    for folder in folders[2:]:
        capture = load_capture(folder)
        dark = read_darks(capture)
        noise = measure_noise(capture, dark)
        bands = correct_bands(capture, dark, noise)
        signal = np.full(bands.images["signal"].shape, 800.0)
        variance, used = bands.predicted_variance(signal), bands.images["mask"].values == 0
        means.append(float(np.median(variance[used])))
        relative_errors.append(bands.variance_sigma(signal, variance, used, noise))
    assert np.std(means) / np.mean(means) == pytest.approx(np.mean(relative_errors), rel=0.6)
