"""Gain, read noise and the constant C: right within their own stated uncertainty."""

import numpy as np
import pytest
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.correction.corrected_bands import correct_bands
from cboxlab.calibration.correction.dark import read_darks
from cboxlab.calibration.correction.noise import NoiseModel, measure_noise
from cboxlab.calibration.instrument.band_response import sensor_matrix
from cboxlab.calibration.radiometry.radiometry import BandConstant, join_constants, measure_constant
from cboxlab.calibration.radiometry.sensor_equation import (
    band_responses,
    capture_factors,
    missing_keys,
    nominal_constant,
)
from cboxlab.scenes.wavelength_grid import FILTER_GRID, INTEGRAL_GRID, WAVELENGTH_NM, trapezoidal_weights
from cboxlab.utils.errors import InputError
from helpers.fakes.capture import CONSTANT, GAIN, READ_NOISE, FakeCapture, sphere

SEEDS = range(24)


def radiometry(folder):
    capture = load_capture(folder)
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    bands = correct_bands(capture, dark, noise)
    return noise, measure_constant(capture, bands, dark, noise)


@pytest.fixture(scope="module")
def ensemble(tmp_path_factory):
    """(noise, radiometry) of 24 captures that differ by their noise only."""
    root = tmp_path_factory.mktemp("ensemble")
    return [radiometry(FakeCapture(root / str(s), seed=s, centres=(450, 550, 650)).write()) for s in SEEDS]


@pytest.mark.parametrize("quantity", ["gain", "read noise", "C"])
def test_stated_sigmas_cover_the_truth(ensemble, quantity):
    """24 pulls: mean 0 within 4 standard errors (once in 16,000), chi2 of 24 within 1e-4 a side."""
    if quantity == "gain":
        pulls = [(n.gain_e_per_dn - GAIN) / n.gain_sigma for n, _ in ensemble]
    elif quantity == "read noise":
        pulls = [(n.read_noise_e - READ_NOISE) / n.read_noise_sigma for n, _ in ensemble]
    else:
        pulls = [(r.constant - CONSTANT) / r.sigma for _, r in ensemble]
    assert abs(np.mean(pulls)) < 4 / np.sqrt(len(pulls))
    assert 6.4 < np.sum(np.square(pulls)) < 60.0


def test_without_darks_the_constant_has_the_error_of_the_stated_level(ensemble, tmp_path):
    """A level stated 2 counts lower changes it by two of what 1 count does; the levels of all bands err alike."""
    constants = []
    for level in (100, 98):
        fake = FakeCapture(tmp_path / str(level), seed=0, centres=(450, 550, 650))
        folder = fake.write(darks=False)
        manifest = folder / "capture.toml"
        manifest.write_text(manifest.read_text().replace("[camera]\n", f"[camera]\nblack_level_dn = {level}\n"))
        constants.append(radiometry(folder)[1])
    lower, noise = constants[1], ensemble[0][1]
    exposures = [fake.exposure[band.band] for band in lower.by_band]
    by_count = [b.dark_sigma / np.hypot(12**-0.5, 10 / GAIN * t) for b, t in zip(lower.by_band, exposures, strict=True)]
    assert (lower.constant - constants[0].constant) == pytest.approx(2 * lower.weights @ by_count, rel=0.02)
    assert lower.dark_sigma * lower.constant == pytest.approx(lower.weights @ [b.dark_sigma for b in lower.by_band])
    assert lower.sigma**2 == pytest.approx(noise.sigma**2 + (lower.dark_sigma * lower.constant) ** 2, rel=0.1)


def test_bands_agree_on_one_constant(ensemble):
    """chi2 over bands summed over captures: 48 degrees, 1e-4 a side."""
    assert 18.0 < sum(r.chi2 for _, r in ensemble) < 95.0
    assert all(r.chi2_degrees == 2 and not r.notes for _, r in ensemble)


def test_a_band_with_another_throughput_is_named(tmp_path):
    """2% more throughput in one band than its tables say, references included, against a sigma of 1e-4."""
    folder = FakeCapture(tmp_path / "c", seed=1, centres=(450, 550, 650), gains={"f550": 1.02}).write()
    _, result = radiometry(folder)
    assert result.probability < 1e-6
    assert any("most in f550" in note for note in result.notes)
    by_band = {c.band: c.constant for c in result.by_band}
    assert by_band["f550"] / by_band["f450"] == pytest.approx(1.02, abs=2e-3)


@pytest.mark.parametrize("name", ["baseline", "mystery-1", "mystery-2", "mystery-3"])
def test_shared_captures_show_their_stated_sensor(shared, name):
    """Gain 12, read noise 10, the nominal C within 4 of their sigmas (5 for C: rounded tables)."""
    noise, result = radiometry(shared / "captures" / name)
    assert abs(noise.gain_e_per_dn - 12.0) < 4 * noise.gain_sigma < 0.3
    assert abs(noise.read_noise_e - 10.0) < 4 * noise.read_noise_sigma < 0.3
    assert abs(result.constant - result.nominal) < 5 * result.sigma
    assert result.sigma / result.constant < 5e-5
    assert result.probability > 1e-3


def test_without_references_the_nominal_constant_is_used_and_said(tmp_path):
    _, result = radiometry(FakeCapture(tmp_path / "c", centres=(550,)).write(references=False))
    assert result.constant == pytest.approx(CONSTANT) and result.sigma is None
    assert any("no reference frames" in note for note in result.notes)


def test_without_repeats_noise_is_only_stated(tmp_path):
    noise, _ = radiometry(FakeCapture(tmp_path / "c", centres=(550,), repeats=1).write())
    assert (noise.gain_e_per_dn, noise.gain_sigma) == (GAIN, None)
    assert (noise.read_noise_e, noise.read_noise_sigma) == (READ_NOISE, None)
    assert any("gain not measured" in note for note in noise.notes)


def test_contradiction_to_the_manifest_is_noted(tmp_path):
    folder = FakeCapture(tmp_path / "c", centres=(450, 550, 650)).write()
    path = folder / "capture.toml"
    path.write_text(path.read_text().replace("gain_e_per_dn = 12.0", "gain_e_per_dn = 20.0"))
    noise, _ = radiometry(folder)
    assert noise.gain_e_per_dn == pytest.approx(GAIN, rel=0.05)
    assert any("gain: the manifest states 20" in note for note in noise.notes)


def test_noise_model_is_its_formula():
    """1000 DN of 12 e-/DN: 83.33 shot, (10/12)^2 read, 1/12 rounding."""
    assert NoiseModel(12.0, None, 10.0, None).variance(1000.0) == pytest.approx(1000 / 12 + 100 / 144 + 1 / 12)


def test_nominal_constant_by_hand(tmp_path):
    """C = (pi/4) 35^2 (97.65625e-6)^2 / 12 = 7.64619e-7 mm^2 m^2 / (e-/DN)."""
    capture = load_capture(FakeCapture(tmp_path / "c", centres=(550,)).write())
    assert nominal_constant(capture) == pytest.approx(7.64619e-7, rel=1e-5)


def test_signals_scale_as_the_sensor_equation_says(tmp_path):
    """Proportional to time and radiance, and equal to the independent forward model of the fake capture."""
    fake = FakeCapture(tmp_path / "c")
    capture = load_capture(fake.write())
    responses = band_responses(capture, CONSTANT)
    for response in responses:
        expected = fake.signal_per_s[response.band] * fake.exposure[response.band]
        assert response.signal(sphere()) == pytest.approx(expected, rel=1e-8)
    matrix = sensor_matrix(responses)
    assert matrix.shape == (7, 301)
    np.testing.assert_allclose(matrix @ (3 * sphere()), [3 * r.signal(sphere()) for r in responses])


def test_trapezoidal_weights_integrate_straight_lines_exactly():
    weights = trapezoidal_weights(WAVELENGTH_NM)
    assert weights.sum() == pytest.approx(300.0)
    assert weights @ WAVELENGTH_NM == pytest.approx((700**2 - 400**2) / 2)


def test_missing_tables_are_named(tmp_path):
    folder = FakeCapture(tmp_path / "c", centres=(550,)).write()
    path = folder / "capture.toml"
    text = path.read_text().replace('transmittance = "spectra/all.csv:lens"\n', "")
    path.write_text(text.replace("f_number = 8.0\n", "", 1))
    capture = load_capture(folder)
    assert missing_keys(capture) == ("lens.transmittance", "band[0] (f550).f_number")
    with pytest.raises(InputError, match=r"lens\.transmittance"):
        band_responses(capture, CONSTANT)


def test_responses_on_a_wider_grid_are_those_of_the_integral(tmp_path):
    """Filters are known from 380 to 800 nm; what the lens does not pass takes no part, at the ends either."""
    capture = load_capture(FakeCapture(tmp_path / "c").write())
    wide = capture_factors(capture, CONSTANT, grid=FILTER_GRID)
    assert wide.transmittance.shape == wide.rest.shape == (len(capture.band_ids), 421)
    outside = np.ones(421, bool)
    outside[FILTER_GRID.part(INTEGRAL_GRID)] = False
    assert not wide.rest[:, outside].any()
    for response, reference_response in zip(wide.responses(), band_responses(capture, CONSTANT), strict=True):
        assert response.band == reference_response.band
        np.testing.assert_array_equal(response.weights, reference_response.weights)


def test_bands_weigh_by_noise_and_scatter_together():
    """Three bands that differ by more than their noise: the constant and its sigma by hand."""
    bands = [BandConstant(n, c, s, 9) for n, c, s in (("a", 100.0, 0.1), ("b", 104.0, 0.4), ("c", 97.0, 2.0))]
    joined = join_constants(bands, None)
    noise, values = np.array([0.1, 0.4, 2.0]), np.array([100.0, 104.0, 97.0])
    first = np.sum(values / noise**2) / np.sum(noise**-2)
    variance = noise**2 + (joined.scatter * first) ** 2
    assert joined.scatter > 0.01
    np.testing.assert_allclose(joined.weights, (1 / variance) / np.sum(1 / variance), rtol=1e-9)
    assert joined.constant == pytest.approx(np.sum(values / variance) / np.sum(1 / variance), rel=1e-9)
    # the scatter is relative to the constant, which is now the joined one
    variance = noise**2 + (joined.scatter * joined.constant) ** 2
    assert joined.sigma == pytest.approx(np.sqrt(np.sum(joined.weights**2 * variance)), rel=1e-9)
