"""Pixels that are full below the converter's largest count, and what they would do to gain and linearity."""

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import with_full_well
from cboxlab.calibration.correction.full_well import _saturated_count
from cboxlab.calibration.instrument import Mask
from cboxlab.calibration.result.calibrate import calibrate_capture
from helpers.fakes.capture import BIAS, DEPTH, F_NUMBER, GAIN, READ_NOISE, FakeCapture
from helpers.places import ROOT

WELL_E = 30000.0
#: A level of the flat of one band and of the brackets, relative to the full well.
LEVELS = (0.3, 0.6, 0.9, 1.0, 1.1, 1.5)


class _Full(FakeCapture):
    """Pixels hold at most WELL_E electrons; the read noise comes after."""

    def counts(self, signal, exposure_s):
        electrons = np.minimum(self.rng.poisson(GAIN * (signal + self.rate * exposure_s)), WELL_E)
        counted = electrons + READ_NOISE * self.rng.standard_normal(signal.shape)
        return np.clip(np.rint(counted / GAIN + self.bias), 0, 2**DEPTH - 1).astype(np.uint16)


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """A capture with flats and brackets up to one and a half times the full well."""
    folder = tmp_path_factory.mktemp("full") / "capture"
    fake = _Full(folder, seed=6, centres=(550, 600))
    extra, base = "", fake.exposure["f550"]
    fake.write()
    # the brackets have more light than the band's own frames, by their aperture
    aperture = F_NUMBER * (fake.scene_per_s["f550"] / (WELL_E / GAIN / base)) ** 0.5
    for level in LEVELS:
        seconds = float(f"{base * level:.4g}")
        light = WELL_E / GAIN / base * fake.flat
        for kind, signal in (("flat", light), ("bracket", light * fake.light), ("dark", 0 * light)):
            names = [f"frames/{kind}-at-{level}-{repeat}.tif" for repeat in (0, 1)]
            for name in names:
                tifffile.imwrite(folder / name, fake.counts(signal * seconds, seconds))
            band = "" if kind == "dark" else 'band = "f550"\n'
            band += f"f_number = {aperture}\n" if kind == "bracket" else ""
            if kind != "dark" or seconds != base:
                extra += f"[[{kind}]]\n{band}exposure_s = {seconds}\nframes = {names!r}\n".replace("'", '"')
    path = folder / "capture.toml"
    path.write_text(path.read_text() + extra)
    return calibrate_capture(load_capture(folder))


def test_the_full_well_is_found_below_full_scale(full):
    """No lower than partly full pixels, which four standard deviations of shot noise separate from the well."""
    well = WELL_E / GAIN + BIAS
    assert well - 4 * np.sqrt(WELL_E) / GAIN < full.capture.full_well_dn < well
    assert any(f"saturate at {full.capture.full_well_dn} DN" in note for note in full.notes)
    assert full.sensor.transfer.saturation_e == pytest.approx(WELL_E, rel=0.02)


def test_full_pixels_do_not_change_the_gain(full):
    assert full.noise.gain_e_per_dn == pytest.approx(GAIN, abs=4.5 * full.noise.gain_sigma)
    assert full.noise.gain_sigma < 0.02 * GAIN
    assert full.noise.read_noise_e == pytest.approx(READ_NOISE, abs=4.5 * full.noise.read_noise_sigma)


def test_full_pixels_are_no_nonlinearity(full):
    """Brackets reach one and a half times the full well; where all pixels are full, no signal is compared."""
    assert not [text for text in full.sensor.verdicts if "does not hold" in text and "f550" in text]


def test_full_pixels_are_no_copied_or_encoded_frames(full):
    assert {s.what for s in full.suspicions} <= {"the flat frames are overexposed"}


def test_full_pixels_are_masked(tmp_path):
    fake = _Full(tmp_path / "capture", seed=7, centres=(550,))
    fake.gains["f550"] = 1.1 * WELL_E / GAIN / float(np.max(fake.expected("f550") * fake.flat))
    bands = calibrate_capture(load_capture(fake.write(flats=False, references=False))).bands
    signal = fake.expected("f550") * fake.flat * fake.gains["f550"]
    masked = (bands.images["mask"].values[0] & Mask.SATURATED) > 0
    assert masked[signal > WELL_E / GAIN].all()
    assert not masked[signal < 0.95 * WELL_E / GAIN].any()


@pytest.mark.parametrize("lacking", [{}, {"flats": False}, {"references": False}], ids=str)
def test_a_sound_capture_has_no_full_well(tmp_path, lacking):
    capture = load_capture(FakeCapture(tmp_path / "capture", seed=8).write(**lacking))
    assert with_full_well(capture).full_well_dn is None


def test_the_bundled_capture_has_no_full_well():
    capture = load_capture(ROOT / "validate" / "data" / "demo-capture")
    assert with_full_well(capture).full_well_dn is None


def test_saturation_of_the_converter_is_no_full_well(tmp_path):
    fake = FakeCapture(tmp_path / "capture", seed=9, centres=(550,))
    fake.gains["f550"] = 2.0**DEPTH / float(np.median(fake.expected("f550") * fake.flat))
    capture = with_full_well(load_capture(fake.write()))
    assert capture.saturation_dn == capture.full_scale_dn == 2**DEPTH - 1


def test_the_full_count_lies_four_read_noises_below_the_full_pixels():
    """Pairs of frames with a read noise of 3 DN, half of the pixels full at 2000 DN."""
    rng = np.random.default_rng(9)
    light = np.concatenate([rng.uniform(200, 1600, 4000), np.full(4000, 2000.0)])
    shot = np.where(light < 2000, np.sqrt(light / 2), 0.0)
    stack = np.rint(light + np.hypot(shot, 3.0) * rng.standard_normal((2, light.size))).astype(np.uint16)
    count = _saturated_count(stack[:, None], 4095)
    assert count == pytest.approx(2000 - 1.645 * 3 / np.sqrt(2) - 4 * 3, abs=0.5)
