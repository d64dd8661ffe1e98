"""Response series out of a capture's own tables: a sphere at several settings, through the whole calibration."""

from dataclasses import replace

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.correction import correct_bands, measure_noise, read_darks
from cboxlab.calibration.detector.response_points import ResponsePoint, _middle, light_series, response_points
from cboxlab.calibration.result.calibrate import calibrate_capture
from cboxlab.calibration.result.write import write_calibration
from helpers.fakes.capture import BIAS, DISTANCE_MM, F_NUMBER, GAIN, READ_NOISE, FakeCapture

TIMES, STOPS, DISTANCES, LEVELS = (0.25, 0.5, 1.0), (5.6, 11.0, 16.0), (40.0, 46.0, 52.0), (0.1, 0.25, 0.5)


def series_capture(folder, late_s=0.0, times=TIMES, further=True, shade=0.0):
    """A capture of one band whose sphere was taken at other times, and at other f-numbers, distances and levels, too.

    shade : part of the light that a strip along the right and the lower border lacks in every second frame.
    """
    fake = FakeCapture(folder, seed=4, centres=(550,))
    fake.write()
    base = fake.exposure["f550"]
    text = (folder / "capture.toml").read_text()
    spectra = (folder / "spectra" / "all.csv").read_text().splitlines()
    names = [f"sphere{level:g}" for level in LEVELS]
    at = spectra[0].split(",").index("sphere")
    rows = [",".join([spectra[0], *names])]
    rows += [",".join([r, *(f"{float(r.split(',')[at]) * level:.10g}" for level in LEVELS)]) for r in spectra[1:]]
    (folder / "spectra" / "all.csv").write_text("\n".join(rows) + "\n")
    settings = [(t, F_NUMBER, DISTANCE_MM, 1.0) for t in times]
    if further:
        settings += [(0.4, f, DISTANCE_MM, 1.0) for f in STOPS]
        settings += [(0.4, F_NUMBER, d, 1.0) for d in DISTANCES]
        settings += [(0.4, F_NUMBER, DISTANCE_MM, level) for level in (*LEVELS, 1.0)]
    darks = set()
    for index, (share, stop, distance, level) in enumerate(settings):
        seconds = float(f"{share * base:.4g}")
        optics = (F_NUMBER / stop) ** 2 * (DISTANCE_MM / distance) ** 2
        signal = fake.signal_per_s["f550"] * (seconds + late_s) * optics * level * fake.flat
        for border in (np.s_[-fake.height // 5 :, :], np.s_[:, -fake.width // 5 :]):
            signal[border] *= 1 - shade * (index % 2)
        column = "sphere" if level == 1 else f"sphere{level:g}"
        # the last one has a repeat
        names = [f"frames/series-{index}.tif", "frames/repeat.tif"][: 1 + (index == len(settings) - 1)]
        for name in names:
            tifffile.imwrite(folder / name, fake.counts(signal, seconds))
        text += (
            f'[[reference]]\nband = "f550"\nradiance = "spectra/all.csv:{column}"\nexposure_s = {seconds}\n'
            f"f_number = {stop}\nimage_distance_mm = {distance}\nframes = {names}\n"
        )
        if seconds not in darks and seconds != base:
            darks.add(seconds)
            tifffile.imwrite(folder / f"frames/d-{index}.tif", fake.counts(0 * signal, seconds))
            text += f'[[dark]]\nexposure_s = {seconds}\nframes = ["frames/d-{index}.tif"]\n'
    (folder / "capture.toml").write_text(text)
    return fake


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("series") / "c"
    series_capture(folder)
    return calibrate_capture(load_capture(folder))


def test_all_four_laws_hold_on_a_camera_that_obeys_them(straight):
    results = {s.key: s.fit for s in straight.sensor.responses if s.source == "reference"}
    assert set(results) == {"exposure", "f_number", "image_distance", "flux"}
    for fit in results.values():
        assert fit.departure is None and fit.probability > 1e-3, fit.verdict
        assert np.abs(fit.residual).max() < 0.01


def test_the_slopes_are_the_sensor_equation(straight):
    """The slope in photon flux is C t / (f^2 d^2), with the nominal C of the fake camera."""
    fit = next(s.fit for s in straight.sensor.responses if s.key == "flux")
    table = next(r for r in straight.capture.manifest.reference if "sphere0.1" in r.radiance)
    expected = straight.radiometry.nominal * table.exposure_s / (F_NUMBER * DISTANCE_MM) ** 2
    assert abs(fit.slope - expected) < 4.5 * fit.slope_sigma


@pytest.fixture(scope="module")
def points(straight):
    capture = straight.capture
    dark = read_darks(capture)
    noise = measure_noise(capture, dark)
    return response_points(capture, correct_bands(capture, dark, noise), dark, noise)


#: Variance of a count without charge, DN^2.
FLOOR = (READ_NOISE / GAIN) ** 2 + 1 / 12


def test_a_points_error_is_that_of_a_mean(straight, points):
    """Shot noise of the middle's pixels over the root of their number; read noise of frame and darks at most thrice."""
    pixels, floor = _middle(straight.capture.shape).sum(), FLOOR
    assert {point.frames for point in points} == {1, 2}
    for point in points:
        shot = point.signal_dn / GAIN / point.frames / pixels
        assert 0.9 * shot < point.sigma_dn**2 < 1.1 * (shot + 3 * floor / pixels)


def test_the_error_that_points_share_is_that_of_the_flats_mean(straight, points):
    """By the noise that the fake camera has, over the root of the number of all counts of the middle of the flat."""
    (flat,) = straight.capture.flats("f550")
    middle = _middle(straight.capture.shape)
    level = straight.capture.frames(flat).mean(axis=0)[middle].mean() - BIAS
    counts = len(flat.frames) * middle.sum()
    shot, most = (np.sqrt((level / GAIN + share * FLOOR) / counts) / level for share in (0, 3))
    for point in points:
        assert 0.95 * shot < point.flat_sigma < 1.05 * most


def test_a_points_count_is_the_mean_of_what_is_stored(straight, points):
    middle = _middle(straight.capture.shape)
    means = [straight.capture.frames(table)[:, middle].mean() for table in straight.capture.references("f550")]
    stored = [point.count_dn for point in points if point.source == "reference"]
    assert len(stored) > 10
    np.testing.assert_allclose(stored, means, rtol=1e-9)


def test_light_and_error_of_a_series_for_the_curve():
    """Light is t / (f d)^2 times the flux, 1 where one is not stated; a shutter's scatter falls with repeats, too."""
    settings = {"exposure": 0.5, "f_number": 4.0, "image_distance": None, "flux": 3.0}
    changes = ({}, {"exposure": 2.0}, {"image_distance": 10.0, "flux": None})
    exposures = [ResponsePoint("f550", "flat", settings | c, 1000.0, 0.5, 1100.0 + i, 4) for i, c in enumerate(changes)]
    (series,) = light_series((*exposures, replace(exposures[0], source="scene")))
    assert series.name == "f550 flat"
    np.testing.assert_allclose(series.light, [0.5 * 3 / 16, 2 * 3 / 16, 0.5 / 1600])
    np.testing.assert_allclose(series.count, [1100, 1101, 1102])
    np.testing.assert_allclose(series.sigma, np.hypot(0.5, 0.001 * 1000 / 2))


def test_the_curve_is_a_line_on_a_linear_camera(straight):
    curve = straight.sensor.curve
    assert curve.statistics["rms"] < 0.002 and curve.line_rms < 0.002
    assert not [note for note in straight.notes if "does not hold" in note]


def test_a_late_shutter_is_named(tmp_path):
    """2% of the shortest exposure added to every one."""
    folder = tmp_path / "c"
    base = float(FakeCapture(folder, centres=(550,)).exposure["f550"])
    late = 0.02 * 0.25 * base
    series_capture(folder, late_s=late)
    calibration = calibrate_capture(load_capture(folder))
    fit = next(s.fit for s in calibration.sensor.responses if s.key == "exposure")
    assert fit.departure is not None and fit.departure.kind == "offset"
    assert abs(fit.departure.size - late) < 4 * fit.departure.sigma
    assert any("shutter offset" in note for note in calibration.notes)


def test_plots_and_record_are_written(straight, tmp_path):
    names = {path.name for path in write_calibration(straight, tmp_path)}
    assert {"response.png", "curve.png", "calibration.json", "xyz.nc"} <= names
    assert np.all([(tmp_path / name).stat().st_size > 0 for name in names])


def test_only_the_middle_of_the_field_is_used(tmp_path):
    """A shadow along two borders in every second frame changes no law."""
    series_capture(tmp_path / "c", shade=0.5)
    responses = calibrate_capture(load_capture(tmp_path / "c")).sensor.responses
    results = {s.key: s.fit for s in responses if s.source == "reference"}
    assert set(results) == {"exposure", "f_number", "image_distance", "flux"}
    for fit in results.values():
        assert fit.departure is None and fit.probability > 1e-3, fit.verdict


@pytest.mark.parametrize(("shortest", "curve"), [(0.25, True), (0.5, False)])
def test_a_curve_needs_light_over_a_factor_of_three(tmp_path, shortest, curve):
    """Nine exposures from a part of the band's own one up to it."""
    series_capture(tmp_path / "c", times=np.linspace(shortest, 0.95, 9).tolist(), further=False)
    assert (calibrate_capture(load_capture(tmp_path / "c")).sensor.curve is not None) == curve
