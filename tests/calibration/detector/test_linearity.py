"""Black level and exposure offset from exposures of several lengths."""

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.correction.dark import read_darks
from cboxlab.calibration.correction.noise import NoiseModel, measure_noise
from cboxlab.calibration.detector.linearity import measure_linearity
from helpers.fakes.capture import GAIN


def brackets(folder, bias=0.0, rate=0.0, light_dn_s=40.0):
    """A capture of four exposures: counts lose 0.7 DN below the dark's level, every exposure is 0.05 s longer."""
    rng = np.random.default_rng(8)
    (folder / "frames").mkdir(parents=True)
    light = light_dn_s * (0.3 + 0.7 * np.indices((64, 64))[1] / 64)
    tables = ""
    for index, seconds in enumerate((2.0, 4.0, 8.0, 16.0)):
        counts = rng.poisson(light * (seconds + 0.05) * GAIN) / GAIN - 0.7 + bias + rate * seconds
        tifffile.imwrite(folder / f"frames/{index}.tif", np.clip(np.rint(counts), 0, 4095).astype(np.uint16))
        head = '[[band]]\nid = "a"' if index == 0 else '[[bracket]]\nband = "a"'
        tables += f'{head}\nexposure_s = {seconds}\nframes = ["frames/{index}.tif"]\n'
        if bias:
            dark = np.full((64, 64), bias + rate * seconds, np.uint16)
            tifffile.imwrite(folder / f"frames/dark-{index}.tif", dark)
            tables += f'[[dark]]\nexposure_s = {seconds}\nframes = ["frames/dark-{index}.tif"]\n'
    camera = "[camera]\nwidth_px = 64\nheight_px = 64\nbit_depth = 12\ngain_e_per_dn = 12.0\n"
    (folder / "capture.toml").write_text('format = "capture/1"\n' + camera + tables)
    return load_capture(folder)


@pytest.mark.parametrize(("bias", "rate"), [(0.0, 0.0), (60.0, 2.0)])
def test_brackets_show_black_level_and_exposure_offset(tmp_path, bias, rate):
    """0.7 DN below the dark's level and 2.5% of the shortest exposure: both found.

    The frames are written by this test, since darks, cut off at 0, cannot show it. Dark frames, bias + rate t, are
    distinguished from the light.
    """
    capture = brackets(tmp_path / "c", bias, rate)
    dark = read_darks(capture)
    measurement = measure_linearity(capture, dark, measure_noise(capture, dark))
    assert measurement.black_level_dn == pytest.approx(0.7, abs=4 * measurement.black_level_sigma)
    assert measurement.exposure_offset_s == pytest.approx(0.05, abs=4 * measurement.exposure_offset_sigma)
    assert measurement.black_level_sigma < 0.2 and measurement.exposure_offset_sigma < 0.01
    assert measurement.rms_corrected["a"] < measurement.rms_deviation["a"]


def test_errors_come_from_the_scatter_where_the_noise_is_said_to_be_less(tmp_path):
    """A camera said to have a hundredth of its noise: the tiles' scatter says what the noise model does not.

    The stated errors stay within a fifth of those with the true noise.
    """
    capture = brackets(tmp_path / "c", light_dn_s=12.0)
    dark = read_darks(capture)
    true, less = (measure_linearity(capture, dark, NoiseModel(gain, None, 0.0, None)) for gain in (GAIN, 1e4 * GAIN))
    for name in ("black_level_sigma", "exposure_offset_sigma"):
        ratio = getattr(less, name) / getattr(true, name)
        assert 0.8 < ratio < 1.25
