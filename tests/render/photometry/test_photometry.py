"""Luminance and chromaticity of surfaces against the observer's tables, and sums by hand."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderedImage
from cboxlab.rendering.photometry import (
    Photometry,
    SurfaceSums,
    surface_sums,
    tristimulus_weights,
    why_no_luminance,
)
from cboxlab.rendering.radiosity import gather, solve_light
from colour import MSDS_CMFS, SDS_ILLUMINANTS
from helpers.scenes.boxes import box_with_lamp, camera_inside

GRID = np.arange(400.0, 701.0, 30.0)
CMFS = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]


@pytest.mark.parametrize("wavelength_nm", [GRID, np.array([380.5, 410, 433, 500, 512.5, 600, 690, 830, 900])])
def test_weights_integrate_the_observers_tables(wavelength_nm):
    """Against a trapezoidal sum in steps of 0.01 nm of spectra that are linear between the wavelengths."""
    fine = np.arange(wavelength_nm[0], wavelength_nm[-1] + 0.005, 0.01)
    radiance = np.random.default_rng(2).random((4, wavelength_nm.size))
    between = np.array([np.interp(fine, wavelength_nm, row) for row in radiance])
    rows = [np.interp(fine, CMFS.wavelengths, row, 0, 0) for row in CMFS.values.T]
    expected = [[683.0 * np.trapezoid(weights_at * row, fine) for row in rows] for weights_at in between]
    assert radiance @ tristimulus_weights(wavelength_nm) == pytest.approx(np.array(expected), rel=1e-4)


def test_standard_illuminants_have_their_published_chromaticities():
    """CIE 15:2018, tables 3.1 and 11.3: A (0.44758, 0.40745), D65 (0.31272, 0.32903), from 380 to 780 nm by 5 nm."""
    grid = np.arange(380.0, 781.0, 5.0)
    for name, x, y in (("A", 0.44758, 0.40745), ("D65", 0.31272, 0.32903)):
        table = SDS_ILLUMINANTS[name]
        xyz = np.interp(grid, table.wavelengths, table.values) @ tristimulus_weights(grid)
        assert xyz[:2] / xyz.sum() == pytest.approx([x, y], abs=2e-4)


def test_a_line_of_one_watt_has_683_lumens():
    grid = np.arange(400.0, 701.0, 1.0)
    assert (grid == 555) @ tristimulus_weights(grid)[:, 1] == pytest.approx(683, rel=1e-3)


@pytest.mark.parametrize(
    ("wavelength_nm", "phrase"),
    [
        (np.arange(400.0, 701.0, 10.0), None),
        (np.linspace(380.0, 780.0, 10), None),
        (np.linspace(400.0, 700.0, 9), "9 wavelengths from 400 to 700 nm"),
        (np.arange(410.0, 701.0, 10.0), "from 410 to 700 nm"),
        (np.arange(400.0, 691.0, 10.0), "from 400 to 690 nm"),
        (np.array([550.0]), "1 wavelength from 550"),
    ],
)
def test_wavelengths_that_do_not_suffice_are_refused(wavelength_nm, phrase):
    reason = why_no_luminance(wavelength_nm)
    assert reason is None if phrase is None else phrase in reason


def picture(batches=5):
    """Two surfaces, the second of two faces, and a lamp a hundred times as bright, in 3 x 4 pixels."""
    generator = np.random.default_rng(7)
    coverage = np.zeros((3, 4, 4), np.float32)
    coverage[0, :, 0] = 1  # the first surface alone
    coverage[1, 0, 0], coverage[1, 0, 3] = 0.9, 0.1  # at the lamp's edge
    coverage[1, 1, 3] = 1
    coverage[1, 2, 1], coverage[1, 2, 2] = 0.4, 0.6  # an edge within the second surface
    coverage[1, 3, 2] = 1
    coverage[2, 0, 0], coverage[2, 0, 1] = 0.7, 0.3  # between the surfaces
    coverage[2, 1, 0] = 0.8  # next to the background
    spectra = generator.random((3, GRID.size))
    spectra[2] *= 100
    mean = np.einsum("yxf,fk->yxk", coverage, np.eye(3)[[0, 1, 1, 2]])
    scatter = 0.01 * generator.standard_normal((batches, *mean.shape))
    return RenderedImage(
        (mean + scatter).astype(np.float32), spectra, GRID, coverage, np.array([0, 1, 1, 2]), ("one", "two")
    )


def test_means_are_those_of_pixels_that_a_surface_covers_whole():
    image = picture()
    light = Photometry(surface_sums(image), GRID)
    xyz = image.coefficients.astype(float) @ image.spectra @ tristimulus_weights(GRID)  # (b, y, x, 3)
    where = {"one": np.zeros((3, 4), bool), "two": np.zeros((3, 4), bool)}
    where["one"][0], where["two"][1, 2:] = True, True
    parts = [(light.surfaces[name], mask) for name, mask in where.items()]
    lamp = np.zeros((3, 4), bool)
    lamp[1, 1] = True
    for part, mask in [*parts, (light.lamp, lamp), (light.picture, np.ones((3, 4), bool))]:
        values = xyz[:, mask]
        variance = values.var(axis=0, ddof=1) / 5
        assert part.pixels == mask.sum()
        assert part.xyz == pytest.approx(values.mean(axis=(0, 1)))
        assert part.luminance_sigma == pytest.approx(np.sqrt(variance[:, 1].sum()) / mask.sum())
    naive = xyz.mean(axis=0)[image.surface == 0, 1].mean()
    assert naive > 1.5 * light.surfaces["one"].luminance  # what the map of surfaces would give


def test_errors_of_chromaticity_are_those_of_small_changes():
    """By drawing X, Y, Z of the stated covariance: 200,000 draws give a standard deviation to 0.2 %."""
    part = Photometry(surface_sums(picture()), GRID).surfaces["two"]
    samples = np.random.default_rng(3).multivariate_normal(part.xyz, part.covariance / 100, 200_000)
    xy = samples[:, :2] / samples.sum(axis=1, keepdims=True)
    assert part.chromaticity == pytest.approx(part.xyz[:2] / part.xyz.sum())
    assert xy.std(axis=0) * 10 == pytest.approx(part.chromaticity_sigma, rel=0.02)


def test_strips_add_up_and_are_kept_to_the_bit():
    image = picture()
    complete = surface_sums(image)
    rows = [
        replace(image, coefficients=image.coefficients[:, part], coverage=image.coverage[part])
        for part in (slice(0, 1), slice(1, 3))
    ]
    first, other = (SurfaceSums.from_text(surface_sums(row).text()) for row in rows)
    both = first + other
    assert np.array_equal(both.pixels, complete.pixels) and both.surface_names == ("one", "two")
    assert both.xyz == pytest.approx(complete.xyz) and both.covariance == pytest.approx(complete.covariance)


def test_what_is_not_known_is_none():
    """A single batch has no error; a surface that covers no pixel has no values."""
    single = Photometry(surface_sums(picture(batches=1)), GRID).to_dict()
    assert single["surfaces"]["one"]["luminance_cd_m2"] > 0
    assert single["surfaces"]["one"]["luminance_sigma_cd_m2"] is single["picture"]["x_sigma"] is None
    image = picture()
    hidden = Photometry(surface_sums(replace(image, coverage=image.coverage[:, :, [0, 0, 0, 3]] * 0.4)), GRID)
    row = hidden.to_dict()["surfaces"]["two"]
    assert row.pop("pixels") == 0 and set(row.values()) == {None}


@pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")
def test_standard_errors_of_surfaces_cover_the_scatter_of_seeds():
    """40 pictures of one light field: scatter over stated variance, 5 surfaces and the picture.

    The mean ratio of 195 degrees of freedom has a standard deviation of 0.10; 5 standard deviations are allowed.
    """
    light = solve_light(box_with_lamp(0.6), GRID, seed=1)
    camera = camera_inside(12)
    sums_by_seed = [surface_sums(gather(light, camera, 4, 8, seed=seed)) for seed in range(40)]
    lamp = len(sums_by_seed[0].surface_names)  # without noise
    parts = [i for i, pixels in enumerate(sums_by_seed[0].pixels) if pixels > 3 and i != lamp]
    assert len(parts) >= 6
    for q in range(3):
        means = np.array([[sums.part(i).xyz[q] for i in parts] for sums in sums_by_seed])
        values = np.array([[sums.part(i).covariance[q, q] for i in parts] for sums in sums_by_seed])
        ratio = means.var(axis=0, ddof=1) / values.mean(axis=0)
        assert ratio.mean() == pytest.approx(1, abs=0.5)
