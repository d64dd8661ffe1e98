"""calibrate as a whole: on captures of known truth, on the shared ones, on real ones that lack much."""

import csv
import json

import numpy as np
import pytest
import tifffile
import xarray as xr
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.capture.mosaic import channel_mask
from cboxlab.calibration.colour.patch_colour import patch_errors, patch_xyz, smoothest_spectra
from cboxlab.calibration.colour.shading import PatchPixels, fit_shading
from cboxlab.calibration.result.calibrate import calibrate
from cboxlab.calibration.result.write import write_calibration
from helpers.fake_capture import CONSTANT, FakeCapture
from PIL import Image

KEYS = {
    "suspicions",
    "capture", "bands", "channels", "camera", "target_intrinsics", "gain_e_per_dn", "read_noise_e",
    "dark_level", "linearity", "C", "K", "filter_weights", "colour", "masked",
    "patches", "notes", "sensor", "uncertainty",
}  # fmt: skip


@pytest.fixture(scope="module")
def colorchecker(shared):
    return calibrate(load_capture(shared / "real" / "seven-band-colorchecker"))


@pytest.fixture(scope="module")
def baseline(shared):
    return calibrate(load_capture(shared / "captures" / "baseline"))


def record(calibration, folder):
    write_calibration(calibration, folder)
    return json.loads((folder / "calibration.json").read_text())


def test_absolute_luminance_of_a_known_scene(tmp_path):
    """Y of the fake scene by direct integration of its radiance, against Y from the counts.

    The seven bells miss ybar a little: for this smooth spectrum by less than 3%; noise is far below.
    """
    fake = FakeCapture(tmp_path / "c", seed=2)
    calibration = calibrate(load_capture(fake.write()))
    xyz = calibration.xyz()
    from cboxlab.calibration.colour.colorimetry import colour_matching_functions

    luminance = 683.0 * np.sum(colour_matching_functions()[1] * fake.spectrum) * fake.light
    used = xyz["mask"].values == 0
    assert (xyz["xyz"].values[1] / luminance)[used].mean() == pytest.approx(1.0, abs=0.03)
    assert calibration.radiometry.constant == pytest.approx(CONSTANT, rel=1e-3)


def test_everything_written_is_whole_and_documented(baseline, tmp_path):
    found = record(baseline, tmp_path / "out")
    assert set(found) == KEYS
    assert not [path.name for path in (tmp_path / "out").iterdir() if path.name.startswith(".")]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "calibration.json", "noise.png", "dark.png", "filters.png", "xyz.nc", "geometry.png",
    }  # fmt: skip
    with xr.open_dataset(tmp_path / "out" / "xyz.nc", engine="h5netcdf") as xyz:
        assert {"capture", "cboxlab_version", "command"} <= set(xyz.attrs)
    camera = found["camera"]
    assert np.shape(camera["covariance"]) == (10, 10) and len(camera["position_sigma_mm"]) == 3
    assert len(found["dark_level"]) == 7 and len(found["C"]["bands"]) == 7
    assert set(found["filter_weights"]["residual_rms"]) == {"X", "Y", "Z"}


def test_dark_levels_rise_linearly(baseline, tmp_path):
    """100 DN of bias and 1.5 DN/s in most pixels of the baseline capture, 5% of it for its spread."""
    levels = record(baseline, tmp_path)["dark_level"]
    slope, bias = np.polyfit([x["exposure_s"] for x in levels], [x["median_dn"] for x in levels], 1)
    assert slope == pytest.approx(1.5, rel=0.05) and bias == pytest.approx(100.0, abs=1.0)


def test_baseline_repeats_scatter_as_predicted(baseline):
    """Half the squared difference of a band's two frames is twice the variance of their mean, flat and dark
    apart: 7 x 65,000 samples, standard error 0.2%; the gain's own 0.2% adds; limit 2%."""
    capture, ratios = baseline.capture, []
    for index, band in enumerate(capture.manifest.band):
        first, second = capture.frames(band).astype(float)
        used = baseline.images["mask"].values[index] == 0
        charge = (first + second) / 2 - baseline.dark.bias
        smooth = np.maximum(charge, 0.0)
        half = (first - second) ** 2 / 2
        ratios.append(np.sum(half[used]) / np.sum(baseline.noise.variance(smooth)[used]))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("name", ["seven-band-colorchecker", "seven-band-disks"])
def test_real_captures_say_what_they_lack(shared, tmp_path, name):
    calibration = calibrate(load_capture(shared / "real" / name))
    found = record(calibration, tmp_path)
    text = " ".join(found["notes"])
    for lack in (
        "no flat field",
        "no reference frames",
        "camera.quantum_efficiency",
        "no [geometry]",
        "gain not",
    ):
        assert lack in text
    assert found["camera"] is None and found["filter_weights"] is None and found["K"] is None
    assert found["channels"] == {
        "f400": "B", "f450": "B", "f500": "G", "f550": "G", "f600": "R", "f650": "R", "f700": "R",
    }  # fmt: skip


def test_the_camera_behind_the_real_captures_has_one_shutter(shared, colorchecker):
    """Same camera, two days: black level -0.2 to -0.4 DN, exposure offset 0.3 to 0.6 ms, in both."""
    disks = calibrate(load_capture(shared / "real" / "seven-band-disks"))
    for found in (colorchecker.linearity, disks.linearity):
        assert 0.15 < found.black_level_dn < 0.45
        assert 3e-4 < found.exposure_offset_s < 7e-4
        assert all(found.rms_corrected[b] < found.rms_deviation[b] for b in found.rms_deviation)


def test_visible_patches_against_the_spectrometer(colorchecker):
    """Mean error in reflectance over 16 patches and 7 bands: 0.0103 when this was written.

    Only the white patch's table entered. The scoring target is 0.014.
    """
    table, known = colorchecker.patches, colorchecker.capture.label_reflectances()
    rows = [i for i, label in enumerate(table.labels) if label.column in known]
    truth = [table.filters @ known[table.labels[i].column].at(table.grid.nm) for i in rows]
    error = np.abs(table.reflectance[rows] - truth)
    assert len(rows) == 16 and error.mean() < 0.012 and error.max() < 0.08


def test_patch_colours_against_the_spectrometer(colorchecker):
    """Delta E*ab over the visible patches but white, under D65: mean 2.83, largest 7.66 when this was written."""
    known = colorchecker.capture.label_reflectances()
    errors = patch_errors(colorchecker.patches, known)
    assert len(errors.labels) == 15 and 19 not in errors.labels
    assert errors.delta_e_ab.mean() < 3.0 and errors.delta_e_ab.max() < 8.0
    assert np.abs(errors.reflectance).mean() < 0.012
    assert patch_errors(colorchecker.patches, {}) is None


def test_patches_file(colorchecker, tmp_path):
    write_calibration(colorchecker, tmp_path)
    rows = {int(row["label"]): row for row in csv.DictReader((tmp_path / "patches.csv").open())}
    assert len(rows) == 24 and rows[19]["illuminant"] == "D65"
    assert float(rows[19]["Y"]) == pytest.approx(100.0, abs=1e-4)
    known = colorchecker.patches.filters @ colorchecker.capture.label_reflectances()["p19_white_95"].at(
        colorchecker.patches.grid.nm
    )
    written = [float(rows[19][band]) for band in colorchecker.patches.bands]
    np.testing.assert_allclose(written, known, atol=6e-6)
    assert all(
        float(row[f"{band}_sigma"]) > 0 for row in rows.values() for band in colorchecker.patches.bands
    )


def test_smoothest_spectrum_keeps_the_band_means_and_straight_lines(colorchecker):
    table = colorchecker.patches
    spectra = smoothest_spectra(table.filters, table.grid.nm)
    np.testing.assert_allclose(table.filters @ spectra, np.eye(7), atol=1e-8)
    line = 0.2 + table.grid.nm / 2000
    np.testing.assert_allclose(spectra @ (table.filters @ line), line, atol=1e-8)


def test_even_white_has_the_chromaticity_of_the_illuminant(colorchecker):
    """A reflectance of 1 in every band: D65, x = 0.3127, y = 0.3290 (CIE 15)."""
    from dataclasses import replace

    table = replace(colorchecker.patches, reflectance=np.ones_like(colorchecker.patches.reflectance))
    xyz = patch_xyz(table)[0][0]
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), [0.3127, 0.3290], atol=5e-4)


def patches_under(light, rng, noise=0.5):
    """Twelve patches of random reflectance on a 200 x 300 frame under a light (v, u)."""
    found = []
    for row in range(3):
        for column in range(4):
            v, u = (
                a.ravel()
                for a in np.mgrid[row * 60 + 10 : row * 60 + 50, column * 70 + 10 : column * 70 + 60]
            )
            signal = 200 * rng.uniform(0.05, 1.0) * light(u, v)
            found.append(
                PatchPixels(
                    u.astype(float), v.astype(float), signal + noise * rng.standard_normal(u.size), noise
                )
            )
    return found


def test_illumination_is_recovered_from_the_patches_alone():
    """A light of cubic logarithm: ratios between places within 4 of the stated sigmas, sigmas below 0.5%.

    40 charts: mean square pull within [0.25, 2]. The jackknife is known to err on the large side with few
    patches, never on the small one.
    """

    def light(u, v):
        x, y = (u - 140) / 140, (v - 90) / 140
        return np.exp(-0.4 * x + 0.2 * y - 0.1 * x * y + 0.15 * x**3)

    rng, pulls = np.random.default_rng(12), []
    for _ in range(40):
        patches = patches_under(light, rng)
        shading = fit_shading(patches)
        assert shading.order == 3
        for u, v in ((40.0, 30.0), (250.0, 30.0), (40.0, 150.0), (250.0, 150.0)):
            ratio = shading.at(u, v) / shading.at(140.0, 90.0) / (light(u, v) / light(140.0, 90.0))
            sigma = shading.relative_sigma(u, v, (140.0, 90.0))
            assert sigma < 0.005
            pulls.append((ratio - 1) / sigma)
    assert 0.25 < np.mean(np.square(pulls)) < 2.0


def test_too_few_bright_patches_give_no_shading():
    patches = patches_under(lambda u, v: 1.0 + 0 * u, np.random.default_rng(1), noise=300.0)
    assert fit_shading(patches) is None


def test_chart_of_known_reflectances_through_the_whole_chain(tmp_path):
    """Patches under uneven light behind a mosaic, with stray light in one band: reflectances return.

    8 patches of 32 x 32 px, 3 bands, 5 e-/DN; the darkest patch is neutral, the white one known.
    """
    rng = np.random.default_rng(21)
    height, width, pattern = 80, 160, "RGGB"
    true = np.array([rng.uniform(0.1, 0.8, 3) for _ in range(8)])
    true[0], true[7] = 0.9, 0.04
    labels = np.zeros((height, width), np.uint8)
    scene = np.full((3, height, width), 0.2)
    for index in range(8):
        window = np.s_[
            4 + 38 * (index // 4) : 36 + 38 * (index // 4), 4 + 40 * (index % 4) : 36 + 40 * (index % 4)
        ]
        labels[window] = index + 1
        scene[(slice(None), *window)] = true[index][:, None, None]
    u = np.indices((height, width))[1] / width
    folder = tmp_path / "chart"
    (folder / "frames").mkdir(parents=True)
    text = 'format = "capture/1"\n[camera]\nwidth_px = 160\nheight_px = 80\n'
    text += "bit_depth = 12\ngain_e_per_dn = 5.0\n"
    text += f'[mosaic]\npattern = "{pattern}"\n'
    stray = (0.0, 0.0, 0.05)
    for band, (name, channel) in enumerate((("f450", "B"), ("f550", "G"), ("f620", "R"))):
        light = 3000 * np.exp(-(0.3 + 0.2 * band) * u)
        signal = np.where(
            channel_mask(pattern, (height, width), channel), light * (scene[band] + stray[band]), 30
        )
        counts = np.rint(rng.poisson(5 * signal) / 5).astype(np.uint16)
        tifffile.imwrite(folder / f"frames/{name}.tif", counts)
        text += f'[[band]]\nid = "{name}"\nexposure_s = 1.0\nframes = ["frames/{name}.tif"]\n'
        text += f'transmittance = "filters.csv:{name}"\n'
    grid = np.arange(400, 701)
    bells = [np.exp(-0.5 * ((grid - c) / 5) ** 2) for c in (450, 550, 620)]
    np.savetxt(folder / "filters.csv", np.column_stack([grid, *bells]), delimiter=",", comments="",
               header="wavelength_nm,f450,f550,f620")  # fmt: skip
    (folder / "known.csv").write_text("wavelength_nm,w\n400,0.9\n700,0.9\n")
    Image.fromarray(labels).save(folder / "labels.png")
    names = "".join(f"{i + 1},{'white' if i == 0 else f'p{i}'},{'w' if i == 0 else ''}\n" for i in range(8))
    (folder / "names.csv").write_text("label,name,column\n" + names)
    text += '[labels]\nimage = "labels.png"\nnames = "names.csv"\nreflectance = "known.csv"\n'
    (folder / "capture.toml").write_text(text)
    table = calibrate(load_capture(folder)).patches
    # Stray light in proportion to the light at the patch is what the offset can describe.
    np.testing.assert_allclose(table.offset, stray, atol=0.006)
    np.testing.assert_allclose(table.reflectance, true, atol=0.015)
    assert np.mean(np.abs(table.reflectance - true)) < 0.005
