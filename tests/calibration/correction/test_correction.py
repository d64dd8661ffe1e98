"""Dark and flat correction: unbiased, with a variance that covers, and masks that find what is broken."""

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.capture.mosaic import channel_mask
from cboxlab.calibration.correction.corrected_bands import correct_bands
from cboxlab.calibration.correction.correction import (
    _mean_of_all_places,
    correct,
    evaluate_variance,
    read_flat,
    uniform_flat,
)
from cboxlab.calibration.correction.dark import DarkLibrary, _fit_line, read_darks
from cboxlab.calibration.correction.defects import dead_pixels, hot_pixels
from cboxlab.calibration.correction.noise import NoiseModel, measure_noise
from cboxlab.calibration.correction.noise_line import VarianceSamples, fit_noise_line
from cboxlab.calibration.instrument.band_images import Mask
from helpers.fakes.capture import GAIN, READ_NOISE, FakeCapture
from PIL import Image

HOT, DEAD, SATURATED = (5, 7), (20, 30), (10, 40)


def reduce(folder):
    capture = load_capture(folder)
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    return capture, dark, noise, correct_bands(capture, dark, noise)


@pytest.fixture(scope="module")
def fake(tmp_path_factory):
    fake = FakeCapture(
        tmp_path_factory.mktemp("correction") / "capture",
        seed=3,
        height=96,
        width=96,
        hot={HOT: 2000.0},
        dead=(DEAD,),
        saturated=(SATURATED,),
    )
    fake.write()
    return fake


@pytest.fixture(scope="module")
def reduced(fake):
    return reduce(fake.folder)


def test_signal_is_unbiased_and_its_variance_covers(fake, reduced):
    """Against the truth, chi2 per pixel is 1 with the variance at the expected signal.

    64,000 pixels: standard error of chi2 0.0056, of the gain 0.5%; limits at 4.5 of both together, once
    in 150,000 seeds.
    """
    bands = reduced[3]
    expected = np.stack([fake.expected(band) for band in bands.images.band.values])
    used = bands.images["mask"].values == 0
    residual = (bands.images["signal"].values - expected)[used]
    variance = bands.predicted_variance(expected)[used]
    z = residual / np.sqrt(variance)
    assert used.mean() > 0.99
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.035)
    # A flat of noise s relative biases 1 / flat by s^2 = 2e-5: far below this mean's own error.
    assert abs(np.mean(z)) < 4.5 / np.sqrt(z.size)


def test_pixels_of_the_label_excluded_are_left_out_of_every_band(tmp_path):
    """Whatever else they show."""
    fake = FakeCapture(tmp_path / "capture", seed=4, height=48, width=48)
    fake.write()
    labels = np.zeros((48, 48), np.uint8)
    labels[3:8, 10:20], labels[20:30, 20:30] = 7, 1
    Image.fromarray(labels).save(fake.folder / "labels.png")
    (fake.folder / "labels.csv").write_text("label,name,column\n1,wall,\n7, Excluded,\n")
    with (fake.folder / "capture.toml").open("a") as manifest:
        manifest.write('\n[labels]\nimage = "labels.png"\nnames = "labels.csv"\n')
    flags = reduce(fake.folder)[3].images["mask"].values & np.uint8(Mask.EXCLUDED)
    assert all(np.array_equal(flag > 0, labels == 7) for flag in flags)


def test_weights_from_the_measured_signal_would_favour_low_counts(reduced, fake):
    """Why predicted_variance exists: with the measured variance the weighted mean comes out low."""
    bands = reduced[3]
    index = 0
    used = bands.images["mask"].values[index] == 0
    expected = fake.expected(bands.images.band.values[index])
    ratio = (bands.images["signal"].values[index] / expected)[used]
    own_variance = (bands.images["variance"].values[index] / expected**2)[used]
    fair = (bands.predicted_variance(np.stack([expected] * 7))[index] / expected**2)[used]
    assert np.average(ratio, weights=1 / own_variance) < np.average(ratio, weights=1 / fair)


def test_shared_dark_frames_are_counted_once(fake):
    """Object and flat of one exposure share the dark: at the flat's own level its error cancels.

    By Monte Carlo over the dark level alone: dS/dD = -1/f + S/(f m).
    """
    capture = load_capture(fake.folder)
    dark = read_darks(capture)
    noise = NoiseModel(GAIN, None, READ_NOISE, None)
    band = capture.manifest.band[3]
    flat = read_flat(capture, band.id, dark, noise)
    full = correct(capture, band, flat, dark, noise).coefficients
    exact = dark.weights(band.exposure_s).argmax()
    none = DarkLibrary(dark.exposure_s, dark.repeats * 10**9, dark.level, dark.bias, dark.rate, False)
    without = correct(capture, band, flat, none, noise).coefficients
    level = np.full(capture.shape, flat.mean_dn)
    share = evaluate_variance(full, level) - evaluate_variance(without, level)
    alone = noise.variance(dark.thermal(band.exposure_s)) / dark.repeats[exact] / flat.response**2
    np.testing.assert_allclose(share, 0.0, atol=1e-6 * alone.max())
    np.testing.assert_allclose(full[0] - without[0], alone, rtol=1e-6)


def test_masks_name_what_is_broken_and_little_else(reduced):
    mask = reduced[3].images["mask"].values
    assert np.all(mask[(slice(None), *HOT)] & Mask.HOT)
    assert np.all(mask[(slice(None), *DEAD)] & Mask.DEAD)
    assert np.all(mask[(slice(None), *SATURATED)] & Mask.SATURATED)
    for flag, count in ((Mask.HOT, 1), (Mask.DEAD, 1), (Mask.SATURATED, 1)):
        # The stated false alarms are 0.01 per image and test: two in seven images once in 400 captures.
        assert np.count_nonzero(mask & np.uint8(flag)) <= 7 * count + 1


def test_false_alarms_of_defect_tests_are_as_stated():
    """0.01 per image: 60 normal images show 0.6 +- 0.8 hot and as many dead pixels; 6 once in 300,000."""
    rng = np.random.default_rng(11)
    hot = dead = 0
    for _ in range(60):
        hot += np.count_nonzero(hot_pixels(100 + rng.standard_normal((64, 64)), 0.1))
        dead += np.count_nonzero(dead_pixels(1 + 0.01 * rng.standard_normal((64, 64))))
    assert hot <= 5 and dead <= 5


def test_hot_pixels_in_frames_cut_off_at_zero():
    level = np.zeros((32, 32))
    level[3, 4] = 5.0
    assert np.argwhere(hot_pixels(level, 0.3)).tolist() == [[3, 4]]


def test_dead_pixels_of_a_mosaic_are_compared_within_their_colour():
    rng = np.random.default_rng(5)
    response = np.where(np.indices((60, 60)).sum(0) % 2, 1.5, 0.4) * (1 + 0.005 * rng.standard_normal((60, 60)))
    response[30, 30] *= 0.5
    assert np.argwhere(dead_pixels(response, (2, 2))).tolist() == [[30, 30]]


@pytest.mark.parametrize("exposure", [1.0, 1.7, 4.0, 6.0, 0.5])
def test_dark_that_is_linear_in_time_is_interpolated_exactly(exposure):
    rate, bias = np.full((3, 4), 2.5), np.full((3, 4), 100.0)
    times = np.array([1.0, 2.0, 4.0])
    library = DarkLibrary(times, np.array([2, 2, 2]), bias + rate * times[:, None, None], bias, rate, False)
    np.testing.assert_allclose(library.at(exposure), bias + rate * exposure, rtol=1e-12)
    assert (library.note(exposure) is None) == (exposure in times)


def test_bias_and_dark_current_by_the_line_through_all_levels(reduced, fake):
    """14 frames of up to 0.34 s: the median rate has a standard error of 0.03 DN/s."""
    dark = reduced[1]
    assert dark.bias.mean() == pytest.approx(100.0, abs=0.05)
    assert np.median(dark.rate) == pytest.approx(1.5, abs=0.13)
    assert dark.rate[HOT] == pytest.approx(2000.0, rel=0.05)
    assert np.std(dark.bias - fake.bias) < 1.0


def test_missing_darks_and_flats_are_said_and_not_invented(tmp_path):
    folder = FakeCapture(tmp_path / "bare", centres=(550,)).write(darks=False, flats=False, references=False)
    capture, dark, _, bands = reduce(folder)
    text = "; ".join(bands.notes)
    assert "no dark frames" in text and "no flat field for f550" in text
    raw = capture.frames(capture.manifest.band[0]).mean(axis=0)
    np.testing.assert_allclose(bands.images["signal"].values[0], raw)
    assert dark.exposure_s.size == 0


def test_frames_corrected_before_are_left_as_they_are(tmp_path):
    folder = FakeCapture(tmp_path / "c", centres=(550,)).write(darks=False, flats=False, references=False)
    path = folder / "capture.toml"
    path.write_text('dark = "subtracted"\nflat = "divided"\n' + path.read_text())
    *_, bands = reduce(folder)
    text = "; ".join(bands.notes)
    assert "dark was subtracted before" in text and "flat was divided before" in text
    assert "no flat field" not in text and "no dark frames" not in text


def test_saturation_spreads_to_neighbours_behind_a_mosaic_only(tmp_path):
    fake = FakeCapture(tmp_path / "c", centres=(550,), saturated=((10, 10),))
    folder = fake.write(references=False)
    plain = reduce(folder)[3].images["mask"].values[0] & Mask.SATURATED
    path = folder / "capture.toml"
    text = path.read_text().replace('quantum_efficiency = "spectra/all.csv:quantum_efficiency"\n', "")
    path.write_text(text + '[mosaic]\npattern = "GBRG"\n')
    capture = load_capture(folder)
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    spread = correct_bands(capture, dark, noise, {"f550": "G"}).images["mask"].values[0] & Mask.SATURATED
    assert np.count_nonzero(plain) == 1 and np.count_nonzero(spread) == 9


def test_mosaic_channels_cover_every_pixel_once():
    """GBRG: green at (0, 0) and (1, 1), blue at (0, 1), red at (1, 0)."""
    masks = {channel: channel_mask("GBRG", (5, 7), channel) for channel in "RGB"}
    assert np.all(sum(mask.astype(int) for mask in masks.values()) == 1)
    assert masks["G"][0, 0] and masks["B"][0, 1] and masks["R"][1, 0] and masks["G"][1, 1]


def test_flat_of_one_changes_nothing_but_the_dark(fake):
    capture = load_capture(fake.folder)
    dark = read_darks(capture)
    band = capture.manifest.band[0]
    frames = correct(capture, band, uniform_flat(capture.shape, dark), dark, NoiseModel(GAIN, None, READ_NOISE, None))
    expected = capture.frames(band).mean(axis=0) - dark.at(band.exposure_s)
    np.testing.assert_allclose(frames.signal, expected)
    np.testing.assert_allclose(frames.coefficients[1], 1 / (GAIN * 2))


def test_a_growing_dark_current_is_no_part_of_the_flat(tmp_path):
    """Dark current that rises to a fifth of the flat's counts across the frame: the response is the lens's own.

    Half the frame against the other: 12 x 28 pixels of 0.6% each leave 0.05%; limit at 4.5 of them.
    """
    fake = FakeCapture(tmp_path / "capture", seed=8, height=12, width=56)
    longest = max(fake.exposure, key=fake.exposure.get)
    fake.rate = np.linspace(0, 400 / fake.exposure[longest], fake.width) * np.ones((fake.height, 1))
    capture = load_capture(fake.write())
    dark = read_darks(capture)
    ratio = read_flat(capture, longest, dark, measure_noise(capture, dark)).response / fake.flat
    left, right = ratio[:, :28].mean(), ratio[:, 28:].mean()
    assert left / right == pytest.approx(1.0, abs=4.5 * 5e-4)


def test_a_flat_has_the_dark_of_its_exposure(tmp_path):
    """A flat of the longest exposure for the band of the shortest; limit as in the test before."""
    fake = FakeCapture(tmp_path / "capture", seed=9, height=12, width=56)
    shortest, longest = sorted(fake.exposure, key=fake.exposure.get)[:: len(fake.exposure) - 1]
    seconds = fake.exposure[longest]
    fake.rate = np.linspace(0, 400 / seconds, fake.width) * np.ones((fake.height, 1))
    folder = fake.write()
    manifest = folder / "capture.toml"
    table_head = f'[[flat]]\nband = "{shortest}"\nexposure_s = '
    text = manifest.read_text(encoding="utf-8")
    assert text.count(f"{table_head}{fake.exposure[shortest]}\n") == 1
    manifest.write_text(text.replace(f"{table_head}{fake.exposure[shortest]}\n", f"{table_head}{seconds}\n"), "utf-8")
    for name in load_capture(folder).flats(shortest)[0].frames:
        tifffile.imwrite(folder / name, fake.counts(2000 * fake.flat, seconds))
    capture = load_capture(folder)
    dark = read_darks(capture)
    ratio = read_flat(capture, shortest, dark, measure_noise(capture, dark)).response / fake.flat
    assert ratio[:, :28].mean() / ratio[:, 28:].mean() == pytest.approx(1.0, abs=4.5 * 5e-4)


def with_saturated_flats(folder, bands):
    """A capture with a fall-off to a third at the left and right, the flats of some bands saturated in the middle."""
    fake = FakeCapture(folder, seed=10, height=24, width=56)
    fake.flat = 1 - 0.67 * np.linspace(-1, 1, fake.width) ** 2 * np.ones((fake.height, 1))
    fake.flat /= fake.flat.mean()
    capture = load_capture(fake.write())
    for band in bands:
        (table,) = capture.flats(band)
        for name in table.frames:
            bright = capture.saturation_dn / 1.1 * fake.flat
            tifffile.imwrite(folder / name, fake.counts(bright, table.exposure_s))
    return fake, load_capture(folder)


@pytest.mark.parametrize("saturated", [1, 7])
def test_a_flat_that_is_saturated_in_part_has_the_scale_of_the_others(tmp_path, saturated):
    """Its darker pixels alone are a fifth below the mean of all. Limit: 4.5 standard errors of 300 pixels of 1 %.
    Where all bands' flats are saturated, the scale is unknown, and a note says so."""
    bands = [*FakeCapture(tmp_path).exposure][:saturated]
    fake, capture = with_saturated_flats(tmp_path / "capture", bands)
    dark = read_darks(capture)
    corrected = correct_bands(capture, dark, measure_noise(capture, dark))
    flat = corrected.flats[bands[0]]
    usable = ~flat.saturated
    assert 0.2 < usable.mean() < 0.8
    scale = float((flat.response[usable] / fake.flat[usable]).mean())
    as_read = read_flat(capture, bands[0], dark, measure_noise(capture, dark))
    # counts and their variance are the same, whatever the scale
    scaled, read = ((f.response * f.mean_dn, f.relative_variance * f.mean_dn**2) for f in (flat, as_read))
    np.testing.assert_allclose(scaled, read)
    unknown = [note for note in corrected.notes if "the scale of the band is uncertain" in note]
    if saturated == 1:
        assert scale == pytest.approx(1.0, abs=4.5 * 0.01 / np.sqrt(300)) and not unknown
    else:
        assert scale > 1.1 and len(unknown) >= 1


def test_dark_currents_are_drawn_together_by_their_noise():
    """Rates that differ by as much as their noise: what is stated predicts the true rate without a factor.

    The slope of the true rates on those stated is 1, with a standard error of 1% by 20,000 pixels and 2% by the
    robust spread; limit at 4 of both.
    """
    rng = np.random.default_rng(3)
    time, repeats = np.array([1.0, 4.0, 10.0]), np.array([4, 2, 2])
    mean = np.average(time, weights=repeats)
    length = np.sum(repeats * (time - mean) ** 2)
    true = 5.0 + rng.standard_normal((100, 200)) * 2.0 / np.sqrt(length)
    level = 100 + true * time[:, None, None]
    level += 2.0 * rng.standard_normal(level.shape) / np.sqrt(repeats)[:, None, None]
    _, rate = _fit_line(time, repeats, level, 4.0)
    slope = np.cov(true.ravel(), rate.ravel())
    assert slope[0, 1] / slope[1, 1] == pytest.approx(1.0, abs=0.1)


def test_darks_of_unequal_repeats_weigh_by_them():
    """Levels on no line, without noise that would draw rates together: NumPy's weighted least squares per pixel."""
    rng = np.random.default_rng(7)
    time, repeats = np.array([0.5, 3.0, 4.0, 9.0]), np.array([1, 20, 2, 6])
    level = 100 + 5 * time[:, None, None] + rng.uniform(-1, 1, (4, 3, 5))
    bias, rate = _fit_line(time, repeats, level, 0.0)
    slope, intercept = np.polyfit(time, level.reshape(4, -1), 1, w=np.sqrt(repeats))
    np.testing.assert_allclose(rate.ravel(), slope, rtol=1e-10)
    np.testing.assert_allclose(bias.ravel(), intercept, rtol=1e-10)


def test_the_line_of_variances_states_its_own_error():
    """Variances of two repeats, one degree each, dark and bright: 400 lines, whose sigma of the slope is as stated.

    A standard deviation from 400 lines has a standard error of 3.5%.
    """
    rng = np.random.default_rng(5)
    slope = 0.25
    pulls = []
    for _ in range(400):
        settings = [
            VarianceSamples(charge, (4 + slope * charge) * rng.chisquare(1, charge.size), 1)
            for charge in (np.zeros(600), rng.uniform(100, 3000, 600))
        ]
        line, covariance = fit_noise_line(settings)
        pulls.append((line[1] - slope) / np.sqrt(covariance[1, 1]))
    assert np.std(pulls) == pytest.approx(1.0, abs=0.15)


def test_the_smallest_hot_pixel_falls_with_the_number_of_dark_frames(reduced):
    """A level known to a tenth of a frame's read noise shows a pixel that is higher by all of that noise."""
    capture, dark, noise, _ = reduced
    level = np.broadcast_to(dark.level.mean(axis=(1, 2), keepdims=True), dark.level.shape).copy()
    level[:, 50, 60] += np.sqrt(noise.floor_dn2)
    library = DarkLibrary(
        dark.exposure_s, np.full_like(dark.repeats, 100), level, level[0], np.zeros_like(dark.rate), False
    )
    hot = correct_bands(capture, library, noise).images["mask"].values & Mask.HOT
    assert np.argwhere(hot.all(axis=0)).tolist() == [[50, 60]]


@pytest.mark.parametrize(
    "pattern", ["RGGB", "GGRGGB GGBGGR BRGRBG GGBGGR GGRGGB RBGBRG", "ABCDE FGHIJ KLMNO PQRST UVWXY"]
)
def test_a_channels_flat_has_the_mean_of_all_places(pattern):
    """A fall-off of a fifth whose last repeat is incomplete: channels' own means differ by up to 2 %."""
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    fall_off = 1 - 0.2 * (x**2 + y**2) + 0.03 * x
    factors = {}
    for letter in dict.fromkeys(pattern.replace(" ", "")):
        mask = channel_mask(pattern, fall_off.shape, letter)
        factors[letter] = fall_off[mask].mean() * _mean_of_all_places(fall_off, mask)
    np.testing.assert_allclose(list(factors.values()), fall_off.mean(), rtol=1e-9)


def test_few_pixels_of_a_channel_give_no_fall_off():
    """Fourteen are too few for a plane, with five for each term: their mean stands for all places."""
    usable = np.zeros((16, 16), bool)
    usable.flat[::19] = True
    above_dark = 1 + 0.1 * np.random.default_rng(1).standard_normal(usable.shape)
    assert np.count_nonzero(usable) == 14
    assert _mean_of_all_places(above_dark, usable) == pytest.approx(1.0, abs=1e-12)
