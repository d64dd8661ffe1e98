"""Two stacks of planes whose errors are estimated from few batches each."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.files import RADIANCE_UNIT, Declared
from cboxlab.validation.compare_renders import ImageStack, compare_stacks, read_stack, stacks

SHAPE = (3, 100, 100)


def estimated(seed, batches, level=10.0):
    """The mean of a few noisy pictures, and the variance of the mean from their scatter."""
    pictures = level + np.random.default_rng(seed).standard_normal((batches, *SHAPE))
    variance = pictures.var(axis=0, ddof=1) / batches
    return ImageStack(Path(f"{seed}"), ("a", "b", "c"), pictures.mean(axis=0), variance, "DN", batches)


@pytest.mark.parametrize("batches", [3, 5, 9])
def test_chi2_of_noise_is_that_expected_of_few_batches(batches):
    """A square over an estimated variance has the mean n / (n - 2) of F with 1 and n = 2 (batches - 1) degrees.

    30,000 pixels of n >= 4: within 12 % for 4, whose variance is infinite, and within 5 % for the others.
    """
    comparison = compare_stacks(estimated(1, batches), estimated(2, batches))
    degrees = 2 * (batches - 1)
    assert comparison.expected_chi2 == pytest.approx(degrees / (degrees - 2))
    mean = np.mean([row.chi2_per_pixel for row in comparison.rows])
    assert mean == pytest.approx(comparison.expected_chi2, rel=0.12 if degrees == 4 else 0.05)


def test_equal_pictures_are_called_equal():
    a, b = estimated(3, 8), estimated(4, 8)
    assert compare_stacks(a, a).lines() == ["3 against 3: the same value in every pixel"]
    assert "χ² per pixel" in compare_stacks(a, b).lines()[1]


def test_the_rows_are_means_and_squares_by_hand():
    a, b = estimated(3, 8, level=10.2), estimated(4, 8)
    comparison = compare_stacks(a, b)
    for plane, row in enumerate(comparison.rows):
        difference = a.values[plane] - b.values[plane]
        assert row.mean_first == pytest.approx(a.values[plane].mean())
        assert row.relative_mean == pytest.approx(difference.sum() / b.values[plane].sum())
        chi2 = np.mean(difference**2 / (a.variance[plane] + b.variance[plane]))
        assert row.chi2_per_pixel == pytest.approx(chi2)


@pytest.mark.parametrize("with_variance", [True, False])
def test_exposures_are_divided_out_of_a_captures_signal_and_of_its_variance_twice(monkeypatch, tmp_path, with_variance):
    """Two bands of one second and of four, at f/8 and 50 mm from lens to image where these are stated."""
    seconds = np.array([1.0, 4.0])
    signal, planes = np.array([[[100.0, 200.0]], [[400.0, 800.0]]]), ("band", "y", "x")
    images = xr.Dataset(
        {
            "signal": (planes, signal),
            "variance": (planes, signal),
            "mask": (planes, np.array([[[0, 0]], [[0, 1]]])),
        }
    )
    bands = [SimpleNamespace(exposure_s=t) for t in seconds]
    capture = SimpleNamespace(manifest=SimpleNamespace(band=bands), band_ids=("a", "b"))
    optics = (8.0 * 50.0) ** 2 if with_variance else 1.0
    monkeypatch.setattr("cboxlab.calibration.capture.load_capture", lambda folder: capture)
    monkeypatch.setattr(
        "cboxlab.calibration.result.calibrate_capture",
        lambda capture: SimpleNamespace(capture=capture, images=images, camera=None),
    )
    monkeypatch.setattr(
        "cboxlab.calibration.radiometry.optical_factor",
        lambda _, band: band.exposure_s / optics if with_variance else None,
    )
    monkeypatch.setattr(stacks, "instrument_of", lambda *_: None)
    content = read_stack(tmp_path)
    np.testing.assert_allclose(content.values, optics * np.array([[[100, 200]], [[100, np.nan]]]))
    np.testing.assert_allclose(content.variance, optics**2 * np.array([[[100, 200]], [[25, 50]]]))
    assert content.unit == ("DN s^-1 mm^2" if with_variance else "DN s^-1")


def test_a_cube_with_missing_pixels_says_what_its_reader_did(tmp_path):
    """The factor of a header and a declared unit are stated for 34 of 35 pixels as for all of them."""
    header = (
        "ENVI\nsamples = 7\nlines = 5\nbands = 1\ndata type = 4\ninterleave = bsq\nbyte order = 0\n"
        "reflectance scale factor = 100\nwavelength units = nm\nwavelength = {550}\ndata ignore value = -9999\n"
    )
    values = np.full(35, 300.0, np.float32)
    for name, ignored in (("complete", 300.0), ("with-a-gap", -9999.0)):
        values[17] = ignored
        (tmp_path / f"{name}.hdr").write_text(header)
        (tmp_path / f"{name}.img").write_bytes(values.tobytes())
    complete, partial = (
        read_stack(tmp_path / f"{name}.hdr", Declared(units=RADIANCE_UNIT)) for name in ("complete", "with-a-gap")
    )
    assert complete.declared == partial.declared == ("units",)
    notes = compare_stacks(partial, complete).notes
    for name in ("complete", "with-a-gap"):
        assert any(f"{name}.hdr" in note and "reflectance scale factor" in note for note in notes)
