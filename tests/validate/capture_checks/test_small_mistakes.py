"""Mistakes of a few per cent, half a pixel or ten nanometres are named, with size and place."""

import re

import numpy as np
import pytest
from capture_mistakes import Draft
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import read_darks
from cboxlab.calibration.quality.frame_checks.dark_light import check_light_in_darks
from cboxlab.calibration.quality.frame_checks.fields import check_fields
from cboxlab.calibration.quality.frame_checks.stacks import read_stacks
from cboxlab.rendering.device.variant import compiled
from cboxlab.validation.capture_checks import with_scene_checks
from cboxlab.validation.capture_checks.band_registration import SMALLEST_STEP_PX, _check_step
from helpers.captures.calibrations import quick_calibration
from helpers.places import ROOT
from scipy import ndimage

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

DEMO = ROOT / "validate" / "data" / "demo-capture"


def draft(tmp_path):
    return Draft(DEMO, tmp_path / "capture")


def change(d, tables, function):
    """Every frame of some tables through a function of its counts (y, x)."""
    for table in tables:
        for path in table["frames"]:
            d.put(path, function(d.image(path).astype(float)))
    d.save()


def suspicions(d):
    return with_scene_checks(quick_calibration(d.folder)).suspicions


def dark_level(d):
    return float(np.median(d.image(d.tables("dark")[0]["frames"][0])))


def test_one_binned_band_is_named(tmp_path):
    d = draft(tmp_path)

    def binned(y):
        small = y.reshape(y.shape[0] // 2, 2, y.shape[1] // 2, 2).mean(axis=(1, 3))
        return np.kron(small, np.ones((2, 2)))

    change(d, d.tables("band")[3:4], binned)
    (suspicion,) = (s for s in suspicions(d) if "resampled" in s.what)
    assert suspicion.where == f"band[3] ({d.tables('band')[3]['id']}).frames"


@pytest.mark.parametrize(("axis", "brightest"), [(1, "at the left"), (0, "at the top")])
def test_uneven_flats_are_one_suspicion_with_size_and_place(tmp_path, axis, brightest):
    """4 % from side to side, which is 3.5 % between the middles of the outer blocks."""
    d = draft(tmp_path)
    level = dark_level(d)

    def tilted(y):
        ramp = np.linspace(-0.5, 0.5, y.shape[axis])
        return level + (y - level) * (1 + 0.04 * (ramp if axis else ramp[:, None]))

    change(d, d.tables("flat"), tilted)
    (suspicion,) = suspicions(d)
    assert "different shape" in suspicion.what
    size = [float(x) for x in re.findall(r"([\d.]+)%", suspicion.why)]
    assert size[0] == pytest.approx(3.5, abs=0.3) and size[1] == pytest.approx(3.5, abs=0.3)
    assert f" {brightest} than" in suspicion.why


def test_flats_at_another_aperture_have_another_shape_and_are_not_compared(tmp_path):
    d = draft(tmp_path)
    level = dark_level(d)
    for table in d.tables("flat"):
        table["f_number"] = 11.0
    change(d, d.tables("flat"), lambda y: level + (y - level) * np.linspace(0.97, 1.03, y.shape[1]))
    capture = load_capture(d.folder)
    assert not [*check_fields(capture, read_stacks(capture), read_darks(capture))]


@pytest.mark.parametrize("shift_nm", [10, -10])
def test_a_shifted_filter_table_is_named_with_its_shift(tmp_path, shift_nm):
    d = draft(tmp_path)
    table = d.tables("band")[2]
    path, _ = d.columns(table["transmittance"])
    grid = np.loadtxt(path, delimiter=",", skiprows=1)[:, 0]
    d.spectrum(table["transmittance"], lambda values: np.interp(grid - shift_nm, grid, values))
    d.save()
    (suspicion,) = (s for s in suspicions(d) if "shifted by" in s.what)
    assert f"{shift_nm:+d} nm" in suspicion.what and suspicion.where == f"band[2] ({table['id']}).transmittance"


def test_a_camera_moved_by_half_a_pixel_is_named_with_the_band(tmp_path):
    d = draft(tmp_path)
    bands = d.tables("band")
    change(d, bands[4:], lambda y: ndimage.shift(y, (0, 0.5), order=1, mode="nearest"))
    (suspicion,) = (s for s in suspicions(d) if "moved between" in s.what)
    assert suspicion.what.endswith(f"between {bands[3]['id']} and {bands[4]['id']}")
    moved, sigma = (float(x) for x in re.search(r"\(([+-][\d.]+), .*?\+- ([\d.]+) px", suspicion.why).groups())
    assert moved == pytest.approx(0.5, abs=3 * sigma) and sigma < 0.07


@pytest.mark.parametrize("scatter_px", [0.03, 0.15])
def test_shifts_that_scatter_are_no_movement(scatter_px):
    """1000 captures without a movement raise none; bands of a lens differ by up to 0.19 px."""
    capture = load_capture(DEMO)
    rng = np.random.default_rng(1)
    shifts = scatter_px * rng.standard_normal((1000, len(capture.band_ids), 2))
    assert not [s for shift in shifts for s in _check_step(capture, shift)]
    moved = shifts[0] * 0.03 / scatter_px + np.where(np.arange(7) > 2, 2 * SMALLEST_STEP_PX, 0.0)[:, None]
    assert len([*_check_step(capture, moved)]) == 1


def leaking(d, rate_dn_s, pattern):
    """Light that falls on the sensor in the dark frames too, with its shot noise."""
    rng, gain = np.random.default_rng(3), d.manifest["camera"]["gain_e_per_dn"]
    for table in d.tables("dark"):
        light = gain * rate_dn_s * table["exposure_s"] * pattern
        for path in table["frames"]:
            d.put(path, d.image(path) + rng.poisson(light) / gain)
    d.save()


def sensitivities(d):
    """(y, x) of the pixels, from the mean of all flats."""
    level = dark_level(d)
    mean = np.mean([d.image(path) - level for table in d.tables("flat") for path in table["frames"]], axis=0)
    return mean / ndimage.uniform_filter(mean, 9)


def light_suspicions(d):
    capture = load_capture(d.folder)
    return [*check_light_in_darks(read_stacks(capture), read_darks(capture))]


def test_a_light_leak_in_all_darks_is_named_with_its_size(tmp_path):
    """A sixth of the dimmest band's light, 48 DN in the longest dark; the level follows the trend."""
    d = draft(tmp_path)
    leaking(d, 1.9, sensitivities(d))
    (suspicion,) = light_suspicions(d)
    longest = max(table["exposure_s"] for table in d.tables("dark"))
    size = float(re.search(r"it is ([\d.]+) DN", suspicion.why)[1])
    assert size == pytest.approx(1.9 * longest, rel=0.1)
    assert f"({longest:g} s)" in suspicion.where


def test_dark_current_is_no_light(tmp_path):
    """As much charge as in the test above, which does not follow the pixels' sensitivities."""
    d = draft(tmp_path)
    pattern = sensitivities(d)
    leaking(d, 1.9, np.random.default_rng(4).permutation(pattern.ravel()).reshape(pattern.shape))
    assert light_suspicions(d) == []
