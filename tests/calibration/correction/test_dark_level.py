"""Dark levels of a capture without darks, by a rendering."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from cboxlab.calibration.correction.black_level import dark_level_sigmas
from cboxlab.calibration.correction.corrected_bands import CorrectedBands
from cboxlab.calibration.correction.defects import lone_bright_pixels
from cboxlab.calibration.instrument import Mask

SHAPE = (2, 40, 40)
RESPONSE = np.linspace(0.6, 1.4, 1600).reshape(40, 40)
SIGMAS = np.array([0.5, 2.0])


def bands_of(signal):
    images = xr.Dataset({"signal": (("band", "y", "x"), signal)}, {"band": ["a", "b"]})
    images["variance"], images["mask"] = images["signal"] * 0 + 1.0, images["signal"].astype(np.uint8) * 0
    flats = dict.fromkeys("ab", SimpleNamespace(response=RESPONSE))
    return CorrectedBands(images, np.zeros((2, 3, 40, 40)), flats, (), dark_sigma_dn=SIGMAS)


@pytest.mark.parametrize("levels", [(0.3, -1.4), (0.0, 0.0)])
def test_the_levels_are_found_next_to_factors_of_the_bands(levels):
    """Next to a lamp 3 % too strong; the levels are those of raw counts, before the division by the flat."""
    rng = np.random.default_rng(4)
    rendered = rng.uniform(2, 200, SHAPE)
    added = np.array(levels)[:, None, None] / RESPONSE
    measured = 1.03 * rendered + added + 0.5 * rng.standard_normal(SHAPE)
    measured[0, 3, 4] += 500.0
    arguments = rendered, np.full(SHAPE, 0.25), np.ones(SHAPE, bool)
    corrected = bands_of(measured).with_dark_levels_of(*arguments)
    fitted = corrected.further_dark_dn
    unlike_light = 1 / RESPONSE - (rendered * np.sum(rendered / RESPONSE, (1, 2), keepdims=True)) / np.sum(
        rendered**2, (1, 2), keepdims=True
    )
    sigmas = (np.sum(unlike_light**2, (1, 2)) / 0.25 + SIGMAS**-2) ** -0.5
    np.testing.assert_allclose(corrected.further_dark_sigma_dn, sigmas, rtol=0.02)
    np.testing.assert_allclose(fitted, levels, atol=0.07)
    assert (corrected.images.mask[:, 3, 4] == Mask.HOT).all()
    np.testing.assert_allclose(corrected.images.signal.values, measured - fitted[:, None, None] / RESPONSE)
    again = corrected.with_dark_levels_of(*arguments)
    np.testing.assert_allclose(again.images.signal.values, corrected.images.signal, atol=1e-9)


def test_a_level_beyond_what_was_stated_stays_in_the_photograph():
    rendered = np.random.default_rng(5).uniform(2, 200, SHAPE)
    measured = rendered + np.array([12.0, 0.0])[:, None, None] / RESPONSE
    corrected = bands_of(measured).with_dark_levels_of(rendered, np.full(SHAPE, 0.25), np.ones(SHAPE, bool))
    np.testing.assert_allclose(corrected.further_dark_dn, [2 * SIGMAS[0], 0.0], atol=1e-3)


def test_hot_pixels_are_bright_alone():
    """A stain of two pixels, a dark one and a step of six standard deviations are none; noise is once in 500,000."""
    pull = np.random.default_rng(6).standard_normal((60, 60))
    pull[:, 30:] += 6.0
    pull[[10, 20, 40], [10, 0, 50]] = 9.0, 9.0, 15.0
    pull[40, 9:11], pull[50, 10], pull[0] = 15.0, -15.0, np.nan
    assert list(zip(*np.nonzero(lone_bright_pixels(pull)), strict=True)) == [(10, 10), (20, 0), (40, 50)]


def test_dark_current_of_long_exposures_adds_to_the_rounding_of_a_stated_level():
    """10 e-/s over 6 s at 12 electrons a count are 5 counts; darks measure them."""
    bands = [SimpleNamespace(exposure_s=0.01), SimpleNamespace(exposure_s=6.0)]
    manifest = SimpleNamespace(band=bands, darks=(), dark=())
    capture = SimpleNamespace(manifest=manifest, is_merged=False)
    np.testing.assert_allclose(dark_level_sigmas(capture, bands, 1 / 12), [0.2888, 5.0083], rtol=1e-3)
    manifest.darks = (None,)
    assert not dark_level_sigmas(capture, bands, 1 / 12).any()
