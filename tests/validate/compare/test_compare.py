"""The comparison judges noise as noise and finds what is more than noise."""

import numpy as np
import pytest
from cboxlab.calibration.instrument.band_images import Mask, band_images
from cboxlab.validation.compare.comparison import ChiSquare, Expectation, compare
from cboxlab.validation.report.metrics import metrics
from cboxlab.validation.report.verdict import report_verdict, warnings
from helpers.fakes.box import BANDS, SURFACES, FakeBox, fake_run
from scipy.ndimage import gaussian_filter
from scipy.stats import kstest

BOX = FakeBox()


def test_chi2_and_what_noise_makes_of_it():
    """30 of 20 degrees: 1.5 each, 10 more than expected, with a chance of 0.07 (tables of chi-square)."""
    chi2 = ChiSquare(30.0, 24, 20.0)
    assert (chi2.per_dof, chi2.excess) == (1.5, 10.0)
    assert chi2.per_dof_sigma == pytest.approx(0.3162, abs=1e-4)
    assert chi2.p_value == pytest.approx(0.0699, abs=1e-4)


def test_chi2_of_pure_noise_is_one():
    """Every split of chi2 stays within five standard deviations of 1 (14 figures, 1e-5 false alarms)."""
    comparison = BOX.compare(seed=1)
    splits = [comparison.chi2, comparison.chi2_edges, comparison.chi2_interiors]
    splits += [row.chi2 for row in comparison.by_band.values()]
    splits += [row.chi2 for row in comparison.by_surface.values()]
    for chi2 in splits:
        assert abs(chi2.per_dof - 1.0) < 5 * chi2.per_dof_sigma
    assert comparison.chi2_edges.count + comparison.chi2_interiors.count == comparison.chi2.count
    assert report_verdict(comparison).level == "explained"


def test_p_values_of_pure_noise_are_uniform():
    """Kolmogorov-Smirnov over 100 independent pictures, false-alarm rate 0.1%."""
    small = FakeBox(size=10)
    p_values = [small.compare(seed=seed).chi2.p_value for seed in range(100)]
    assert kstest(p_values, "uniform").pvalue > 1e-3


def test_p_values_count_the_error_of_a_measured_variance():
    """A gain from 500 variances errs by 6 %. The p-values of noise alone are uniform if it is counted, else not.

    Kolmogorov-Smirnov over 400 reduced chi-squares of 2000 residuals, false-alarm rate 0.1 %.
    """
    rng = np.random.default_rng(6)
    values = rng.chisquare(2000, 400) / (rng.chisquare(500, 400) / 500)
    counted, ignored = ([ChiSquare(v, 2000, 2000.0, sigma).p_value for v in values] for sigma in (np.sqrt(2 / 500), 0))
    assert kstest(counted, "uniform").pvalue > 1e-3 > kstest(ignored, "uniform").pvalue
    sigma = ChiSquare(2000.0, 2000, 2000.0, float(np.sqrt(2 / 500))).per_dof_sigma
    assert np.std(values / 2000) == pytest.approx(sigma, rel=0.15)  # standard error 3.5 %


def test_fitted_parameters_come_off_the_degrees_of_freedom():
    plain, fitted = BOX.compare(seed=2), BOX.compare(seed=2, expectation=Expectation(11))
    assert fitted.chi2.dof == pytest.approx(plain.chi2.dof - 11)
    assert sum(row.chi2.dof for row in fitted.by_band.values()) == pytest.approx(fitted.chi2.dof)


def test_render_noise_is_counted():
    """A render as noisy as the camera leaves chi2 at 1; the ratio of the two is reported."""
    comparison = FakeBox(render_over_sensor=1.5).compare(seed=3)
    assert abs(comparison.chi2.per_dof - 1) < 5 * comparison.chi2.per_dof_sigma
    assert comparison.render_sigma_over_sensor_sigma == pytest.approx(1.5)
    assert any("noisier" in text for text in warnings(comparison, fake_run()))


def test_scale_error_is_reported_as_such():
    """A lamp 2% too bright: +2% on every surface, in every band and in Y, within four standard errors."""
    comparison = BOX.compare(seed=4, factor=1.02)
    for row in comparison.by_surface.values():
        np.testing.assert_array_less(np.abs(row.relative - 0.02), 4.5 * row.relative_sigma)
    for row in comparison.by_band.values():
        expected = np.hypot(row.relative.rms_noise, 0.02)
        assert row.relative.rms == pytest.approx(expected, rel=0.03)
        assert row.beyond_noise == pytest.approx(0.02, abs=0.004)
    assert comparison.luminance.mean == pytest.approx(0.02, abs=5e-4)
    # dL* = 116/3 (Y/Yn)^(1/3) 0.02, for a near-neutral surface most of Delta E.
    row = comparison.by_surface["ceiling"]
    relative_luminance = comparison.maps.xyz_rendered.values[(BOX.surface == 1), 1].mean() / comparison.white.luminance
    assert row.colour["delta_e_ab"] == pytest.approx(116 / 3 * relative_luminance ** (1 / 3) * 0.02, rel=0.05)
    assert row.colour["delta_e_ab"] > 10 * row.colour_noise["delta_e_ab"]
    assert report_verdict(comparison).level == "unexplained"


def test_white_is_no_pixel_at_the_lamps_edge():
    """Pixels that see a part of the lamp are as bright as the picture is coarse."""
    near, bright = gaussian_filter(BOX.lamp.astype(float), 0.7) > 0.02, FakeBox()
    object.__setattr__(bright, "truth", np.where(near, 10 * BOX.truth.max(), BOX.truth))
    white = BOX.compare(seed=4).white
    assert bright.compare(seed=4).white.luminance == pytest.approx(white.luminance, rel=0.02)


def test_luminance_and_chromaticity_are_those_of_the_interiors_mean_xyz():
    """From the maps of X, Y, Z; a green wall 5 % too bright in one band is so in its luminance and its colour alone."""
    factor = np.ones(BOX.truth.shape)
    factor[3, BOX.surface == SURFACES.index("green wall")] = 1.05
    comparison = BOX.compare(seed=7, factor=factor)
    surfaces = metrics(comparison, fake_run())["surfaces"]
    maps = comparison.maps
    mask = (maps["edge_distance_px"].values >= 3) & (maps["mask"].values == 0).all(axis=0)
    for index, name in enumerate(SURFACES):
        for side in ("measured", "rendered"):
            x, y, z = maps[f"xyz_{side}"].values[mask & (maps["surface"].values == index)].mean(axis=0)
            expected = {"luminance_cd_m2": y, "x": x / (x + y + z), "y": y / (x + y + z)}
            assert surfaces[name][side] == pytest.approx(expected)
    wall = surfaces["green wall"]
    assert wall["measured"]["luminance_cd_m2"] > 1.004 * wall["rendered"]["luminance_cd_m2"]
    assert wall["measured"]["x"] > wall["rendered"]["x"] + 0.001


def test_a_surface_that_is_not_seen_has_no_luminance():
    row = metrics(BOX.compare(seed=7, surface_names=(*SURFACES, "hidden")), fake_run())["surfaces"]["hidden"]
    nothing = dict.fromkeys(("luminance_cd_m2", "x", "y"))
    assert row["interior_pixels"] == 0 and row["measured"] == row["rendered"] == nothing


def test_standard_errors_of_surface_means_cover():
    """68% and 95% of the differences of means lie within one and two sigma (binomial, to 4 sigma)."""
    small = FakeBox(size=48)
    pulls = np.concatenate(
        [
            (row.measured - row.rendered) / row.sigma
            for seed in range(40)
            for row in small.compare(seed).by_surface.values()
            if row.interior_pixels
        ]
    )
    for width, share in ((1, 0.6827), (2, 0.9545)):
        tolerance = 4 * np.sqrt(share * (1 - share) / pulls.size)
        assert abs(np.mean(np.abs(pulls) < width) - share) < tolerance


def test_noise_expectation_of_colour_difference():
    """Where the render is exact, Delta E is what the expectation from noise says."""
    comparison = BOX.compare(seed=5)
    for visible, noise in (
        (comparison.colour["delta_e_ab"], comparison.colour_noise["delta_e_ab"]),
        (comparison.colour["delta_e_2000"], comparison.colour_noise["delta_e_2000"]),
    ):
        assert visible.mean == pytest.approx(noise.mean, rel=0.03)
        assert visible.p95 == pytest.approx(noise.p95, rel=0.05)
    assert comparison.luminance.rms == pytest.approx(comparison.luminance.rms_noise, rel=0.05)


def test_blur_sits_at_edges_and_gradient_in_interiors():
    """Defocus puts its excess at edges; a smooth error puts it inside, in proportion to the area."""
    blurred = np.array([gaussian_filter(plane, 0.7) for plane in np.where(BOX.lamp, 0.0, BOX.truth)])
    blur = np.where(BOX.truth > 0, blurred / np.maximum(BOX.truth, 1e-9), 1.0)
    at_edges = BOX.compare(seed=6, factor=blur)
    assert at_edges.share_of_excess_at_edges > 0.95
    smooth = BOX.compare(seed=6, factor=1 + 0.05 * np.linspace(-1, 1, BOX.size)[None, None, :])
    share = smooth.chi2_edges.count / smooth.chi2.count
    assert smooth.share_of_excess_at_edges == pytest.approx(share, abs=0.15)


def test_error_in_one_band_and_surface_is_named():
    factor = np.ones(BOX.truth.shape)
    factor[3, BOX.surface == SURFACES.index("green wall")] = 1.05
    comparison = BOX.compare(seed=7, factor=factor)
    details = " ".join(report_verdict(comparison).details)
    assert "green wall" in details and "f600" in details
    assert abs(comparison.by_surface["floor"].chi2.per_dof - 1) < 5 * comparison.by_surface["floor"].chi2.per_dof_sigma


def test_masked_pixels_do_not_matter_and_are_counted():
    """Nonsense under a mask leaves every figure alone."""
    measured, rendered = BOX.images(seed=8)
    arguments: dict = {
        "xyz_per_dn": BOX.xyz_per_dn,
        "lamp_xyz": BOX.lamp_xyz,
        "surface": BOX.surface,
        "surface_names": SURFACES,
        "single_surface": BOX.single_surface,
    }
    mask, signal = measured.mask.values.copy(), measured.signal.values.copy()
    mask[2, 20:30, 40:60] |= np.uint8(Mask.HOT)
    clean = compare(band_images(BANDS, signal, measured.variance, mask), rendered, BOX.sensor_variance, **arguments)
    signal[2, 20:30, 40:60] = np.nan
    spoilt = compare(band_images(BANDS, signal, measured.variance, mask), rendered, BOX.sensor_variance, **arguments)
    assert spoilt.chi2 == clean.chi2
    assert spoilt.colour["delta_e_ab"] == clean.colour["delta_e_ab"]
    assert spoilt.luminance == clean.luminance
    assert spoilt.masked["hot"] == 200
    assert spoilt.masked["lamp"] == BOX.lamp.sum()
    assert spoilt.pixels_used == BOX.size**2 - (np.any(mask, axis=0)).sum()
    assert np.isnan(spoilt.maps.residual_over_sigma.values[2, 25, 50])
    assert np.isfinite(spoilt.maps.residual_over_sigma.values[1, 25, 50])
    signal[0, 50, 50] = np.nan
    with pytest.raises(ValueError, match="f450"):
        compare(band_images(BANDS, signal, measured.variance, mask), rendered, BOX.sensor_variance, **arguments)
