"""Merged floating-point pictures as frames: read as they are, with the noise that is stated, repeated or estimated."""

import re

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction.merged_noise import _line
from cboxlab.calibration.result.calibrate import calibrate_capture
from cboxlab.calibration.result.plots import plot_noise
from cboxlab.utils.errors import InputError

SHAPE = (60, 160)
#: Electrons for each unit of the pictures, and rms of a dark pixel, e-.
GAIN, READ = 2e4, 30.0


def light():
    """Values of 0.016 to 2; two faces with an edge between them."""
    v, u = np.indices(SHAPE)
    return 0.04 * 50 ** (u / SHAPE[1]) * np.where(v < SHAPE[0] // 2, 1.0, 0.4)


def picture(seed):
    generator = np.random.default_rng(seed)
    return (generator.poisson(GAIN * light()) + READ * generator.standard_normal(SHAPE)) / GAIN


def write_tiff(path, values):
    tifffile.imwrite(path.with_suffix(".tif"), values.astype(np.float32))
    return path.with_suffix(".tif").name


def write_exr(path, values):
    pixels = np.ascontiguousarray(values, np.float32)
    header = {"type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": pixels}).write(str(path.with_suffix(".exr")))
    return path.with_suffix(".exr").name


def write_hdr(path, values):
    planes = np.stack([0.5 * values, values, 2 * values], axis=-1)  # B, G, R
    cv2.imwrite(str(path.with_suffix(".hdr")), np.maximum(planes, 0).astype(np.float32))
    return f"{path.with_suffix('.hdr').name}[1]"


def capture(folder, noise, write=write_tiff, repeats=1, seed=0):
    folder.mkdir(parents=True)
    names = [write(folder / f"box-{k}", picture(seed + k)) for k in range(repeats)]
    (folder / "capture.toml").write_text(
        'format = "capture/1"\ndark = "subtracted"\nscale = "free"\n'
        f"[camera]\nwidth_px = {SHAPE[1]}\nheight_px = {SHAPE[0]}\nbit_depth = 16\n"
        f'[[band]]\nid = "a"\nexposure_s = 1.0\nframes = {names!r}\n'.replace("'", '"')
        + noise
    )
    return folder


POISSON = f'[noise]\nkind = "poisson"\ngain_e_per_unit = {GAIN}\nread_noise_e = {READ}\n'


@pytest.mark.parametrize("write", [write_tiff, write_exr, write_hdr])
def test_values_are_read_as_they_are_stored(tmp_path, write):
    result = calibrate_capture(load_capture(capture(tmp_path / "c", POISSON, write)))
    tolerance = 1 / 60 if write is write_hdr else 1e-6  # RGBE has eight bits of the brightest channel
    np.testing.assert_allclose(
        result.images["signal"].values[0],
        np.maximum(picture(0), 0) if write is write_hdr else picture(0),
        rtol=tolerance,
        atol=tolerance * 0.1,
    )
    assert not result.suspicions and any("the noise is stated" in note for note in result.notes)


def test_pulls_with_the_stated_noise_are_standard_normal(tmp_path):
    bands = calibrate_capture(load_capture(capture(tmp_path / "c", POISSON))).bands
    pull = (bands.images["signal"].values[0] - light()) / np.sqrt(bands.predicted_variance(light()[None])[0])
    assert abs(pull.std() - 1) < 4 / np.sqrt(2 * pull.size) and abs(pull.mean()) < 4 / np.sqrt(pull.size)


@pytest.mark.parametrize(("kind", "repeats"), [("repeats", 3), ("estimated", 1)])
def test_noise_comes_from_repeats_or_neighbours(tmp_path, kind, repeats):
    folder = capture(tmp_path / "c", f'[noise]\nkind = "{kind}"\n', repeats=repeats)
    result = calibrate_capture(load_capture(folder))
    (note,) = [note for note in result.notes if note.startswith("merged pictures")]
    assert ("repeats" if kind == "repeats" else "estimated") in note
    expected = (light() / GAIN + (READ / GAIN) ** 2) / repeats
    variance = result.bands.predicted_variance(light()[None])[0]
    assert np.abs(np.log(variance / expected)).max() < np.log(1.25)


def test_values_that_are_not_finite_are_saturated(tmp_path):
    folder = capture(tmp_path / "c", POISSON)
    values = picture(0)
    values[3:6, 70:75] = np.inf
    values[50, 10] = np.nan
    write_tiff(folder / "box-0", values)
    mask = calibrate_capture(load_capture(folder)).images["mask"].values[0]
    assert (mask[3:6, 70:75] > 0).all() and mask[50, 10] > 0 and np.count_nonzero(mask) == 16


def fault(folder):
    with pytest.raises(InputError) as error:
        calibrate_capture(load_capture(folder))
    return str(error.value)


@pytest.mark.parametrize(
    ("noise", "phrases"),
    [
        ("", ("floating-point values", "[noise]")),
        ('[noise]\nkind = "poisson"\n', ("noise.gain_e_per_unit", "Add it")),
        ('[noise]\nkind = "gauss"\n', ("noise.kind", "'gauss'", "repeats")),
        ('[noise]\nkind = "estimated"\nread_noise_e = 3.0\n', ("noise.read_noise_e", "Leave it out")),
        ('[noise]\nkind = "repeats"\n', ("noise.kind", "two frames or more")),
        ('[noise]\nkind = "poisson"\ngain_e_per_unit = -1.0\n', ("noise.gain_e_per_unit", "-1")),
    ],
)
def test_each_mistake_is_one_clear_message(tmp_path, noise, phrases):
    message = fault(capture(tmp_path / "c", noise))
    assert all(word in message for word in phrases), message


def test_a_picture_of_several_channels_asks_which_one(tmp_path):
    folder = capture(tmp_path / "c", POISSON, write_hdr)
    path = folder / "capture.toml"
    path.write_text(path.read_text().replace("box-0.hdr[1]", "box-0.hdr"))
    assert re.search(r"R, G, B in one file.*box-0\.hdr\[0\]", fault(folder))


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
def test_the_line_of_noise_weighs_variances_by_their_own_scatter_in_any_unit(unit):
    """Floor and slope are those of least squares with the true weights, to a fifth of their standard errors."""
    level, degrees = np.linspace(0, 100, 60), 200.0
    true = 0.2 + 0.5 * level
    variance = true * np.random.default_rng(2).chisquare(degrees, 60) / degrees
    weight = np.sqrt(degrees / 2) / true
    design = np.stack([np.ones(60), level], axis=1) * weight[:, None]
    expected, errors = np.linalg.lstsq(design, variance * weight)[0], np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    line = _line([*zip(level, unit * variance, np.full(60, degrees), strict=True)]) / unit
    np.testing.assert_array_less(np.abs(line - expected), 0.2 * errors)


def test_results_of_merged_pictures_are_written(tmp_path):
    """The plot of their noise has no full scale."""
    result = calibrate_capture(load_capture(capture(tmp_path / "c", POISSON, repeats=2)))
    plot_noise(result, tmp_path / "noise.png")
    assert (tmp_path / "noise.png").stat().st_size > 0
