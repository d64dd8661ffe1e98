"""Means of two cubes, with errors, in `cbox compare`."""

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.files import write_cube
from cboxlab.validation.compare_renders import compare_stacks, read_stack

RELATIVE = 0.05


def cube(tmp_path, name, seed, factor=1.0, error=True, wavelengths=(450.0, 550.0, 650.0)):
    rng = np.random.default_rng(seed)
    shape = (40, 40, len(wavelengths))
    spectrum = np.exp(-(((np.array(wavelengths) - 600) / 80) ** 2))
    level = np.linspace(1, 1.5, 40)[:, None, None] * spectrum * np.ones(shape)
    radiance = factor * level * (1 + RELATIVE * rng.standard_normal(shape))
    fields = {"radiance": (("y", "x", "wavelength"), radiance.astype(np.float32))}
    if error:
        fields["standard_error"] = (("y", "x", "wavelength"), RELATIVE * level, {"batches": 16})
    path = tmp_path / name
    write_cube(path, xr.Dataset(fields, coords={"wavelength": list(wavelengths)}))
    return read_stack(path)


def test_a_mean_has_an_error_bar(tmp_path):
    """Three independent wavelengths of 1600 pixels each, both sides noisy: 5 % sqrt(2/4800), within a third."""
    compared = compare_stacks(cube(tmp_path, "a.nc", 1, 1.02), cube(tmp_path, "b.nc", 2))
    means = compared.means[0]
    assert means.sigma == pytest.approx(RELATIVE * np.sqrt(2 / 4800), rel=0.33)
    assert abs(means.difference - 0.02) < 5 * means.sigma


def test_a_cube_without_errors_is_not_exact(tmp_path):
    compared = compare_stacks(cube(tmp_path, "a.nc", 1), cube(tmp_path, "b.nc", 2, error=False))
    assert any("estimated" in note for note in compared.notes)
    for row in compared.rows:
        assert row.chi2_per_pixel == pytest.approx(1.0, abs=0.25)


def test_other_wavelengths_are_compared_by_ratio(tmp_path):
    """Straight interpolation of this spectrum would be 9 % off."""
    grid = tuple(np.arange(440.0, 661.0, 20.0))
    shifted = tuple(np.arange(450.0, 651.0, 20.0))
    compared = compare_stacks(
        cube(tmp_path, "a.nc", 1, wavelengths=grid), cube(tmp_path, "b.nc", 2, wavelengths=shifted)
    )
    assert len(compared.rows) == len(shifted)
    assert any("interpolated" in note for note in compared.notes)
    assert max(abs(row.mean_first / row.mean_second - 1) for row in compared.rows) < 0.03
