"""What raw files state themselves: a manifest may leave it out, and may say otherwise.

The files are DNGs of a simulated colour camera whose frames lie in no darkness: the black level of the metadata has to
bring the true signal.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from cboxlab.calibration.capture import band_channels, channel_mask, load_capture
from cboxlab.calibration.correction.black_level import black_level
from cboxlab.calibration.correction.corrected_bands import correct_bands
from cboxlab.calibration.correction.dark import read_darks
from cboxlab.calibration.correction.noise import measure_noise
from cboxlab.calibration.radiometry.sensor_equation import band_responses, nominal_constant
from cboxlab.rendering.sensor import load_camera
from cboxlab.rendering.synthetic import write_cube_capture
from cboxlab.scenes.spectra import planck
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError

SIZE = 64
NM = np.arange(400.0, 701.0, 10.0)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    folder = tmp_path_factory.mktemp("raw") / "capture"
    light = np.broadcast_to(1e-4 * planck(NM, 3000.0), (SIZE, SIZE, NM.size))
    cube = xr.Dataset({"radiance": (("y", "x", "wavelength"), light)}, coords={"wavelength": NM})
    camera = replace(load_camera("sony-a7r2"), pattern=("GB", "RG"))
    write_cube_capture(folder, cube, camera, None, 5, "field", "dng")
    return folder


@pytest.fixture
def folder(original, tmp_path):
    copy = tmp_path / "capture"
    copy.mkdir()
    for part in ("frames", "spectra"):
        (copy / part).symlink_to(original / part)
    text = (original / "capture.toml").read_text()
    (copy / "capture.toml").write_text(text)
    return copy


def without(folder, *keys):
    """Remove keys, and with "[dark]" or "[mosaic]" tables."""
    path = folder / "capture.toml"
    text = path.read_text()
    for key in keys:
        table = rf"(?ms)^\[?{re.escape(key)}\]?\n.*?(?=^\[|\Z)"
        text = re.sub(table if key.startswith("[") else rf"(?m)^{key} = .*\n", "", text)
    path.write_text(text)


def copied(original, folder):
    """A folder with the frames themselves: links that leave a capture are refused."""
    for part in ("frames", "spectra"):
        (folder / part).unlink()
        (folder / part).mkdir()
        for file in (original / part).iterdir():
            (folder / part / file.name).write_bytes(file.read_bytes())


def test_a_manifest_without_them_is_the_same(original, folder):
    copied(original, folder)
    without(folder, "exposure_s", "width_px", "height_px", "bit_depth", "[mosaic]")
    before, after = load_capture(original), load_capture(folder)
    assert after.manifest.mosaic == before.manifest.mosaic
    assert (after.shape, after.full_scale_dn) == (before.shape, before.full_scale_dn)
    for band, other in zip(after.manifest.band, before.manifest.band, strict=True):
        assert band.exposure_s == pytest.approx(other.exposure_s, rel=1e-5)
    assert after.manifest.camera.white_level_dn == 16383


def test_what_the_manifest_states_counts(original, folder):
    copied(original, folder)
    path = folder / "capture.toml"
    text = path.read_text().replace("[camera]\n", "[camera]\nblack_level_dn = 500\nwhite_level_dn = 15000\n")
    path.write_text(re.sub(r"exposure_s = .*", "exposure_s = 7.0", text))
    without(folder, "[[dark]")
    capture = load_capture(folder)
    assert capture.manifest.band[0].exposure_s == 7.0
    assert capture.saturation_dn == 15000
    assert black_level(capture).level.max() == 500


def test_the_black_level_of_the_files_takes_the_place_of_darks(original, folder):
    """Every channel has the light's own signal to 0.1 %, which a level of 0 would miss by tens of percent."""
    copied(original, folder)
    without(folder, "[[dark]")
    capture = load_capture(folder)
    assert capture.manifest.darks == ()
    dark = read_darks(capture)
    corrected = correct_bands(capture, dark, measure_noise(capture, dark), channels := band_channels(capture))
    assert any("the black level of" in note and "dark current" in note for note in corrected.notes)
    light = np.interp(WAVELENGTH_NM, NM, 1e-4 * planck(NM, 3000.0))
    responses = band_responses(capture, nominal_constant(capture), channels)
    for index, response in enumerate(responses):
        mask = channel_mask("GBRG", capture.shape, channels[response.band])
        mean = corrected.images["signal"].values[index][mask].mean()
        assert mean == pytest.approx(response.signal(light), rel=2e-3)
        assert 512 / mean > 0.02


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ("{R = 512}", "expected one with R, G, B"),
        ("{R = 512, G = 511, B = 512, X = 3}", "expected one with R, G, B"),
        ("20000", "less than the white level"),
        ("-3", "black_level_dn"),
        ('"512"', "black_level_dn"),
    ],
)
def test_levels_that_cannot_be(original, folder, levels, message):
    copied(original, folder)
    path = folder / "capture.toml"
    if levels.startswith("{"):
        table = levels.strip("{}").replace(", ", "\n")
        path.write_text(path.read_text() + f"\n[camera.black_level_dn]\n{table}\n")
    else:
        path.write_text(path.read_text().replace("[camera]\n", f"[camera]\nblack_level_dn = {levels}\n"))
    with pytest.raises(InputError, match=message):
        load_capture(folder)


def test_one_level_a_channel(original, folder):
    copied(original, folder)
    path = folder / "capture.toml"
    levels = "R = 510\nG = 512\nG2 = 514\nB = 516\n"
    path.write_text(path.read_text() + f"\n[camera.black_level_dn]\n{levels}")
    without(folder, "[[dark]")
    np.testing.assert_array_equal(black_level(load_capture(folder)).level[:2, :2], [[512, 516], [510, 514]])
