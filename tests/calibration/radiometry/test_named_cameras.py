"""Sensitivities by a camera's name: a capture of a known light, whose channels' levels the references show."""

import dataclasses
import re

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.result.calibrate import calibrate_capture
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings, MosaicSensor, behind_mosaic
from cboxlab.scenes import camera_columns, camera_names, named_camera_channel
from cboxlab.scenes.spectra import Spectrum, planck
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photograph_image, photographed_scene

NAME = "Nikon 5100 (NPL)"
LEVELS = {"R": 0.35, "G": 0.5, "B": 0.42}
LIGHT = 2e-5 * planck(WAVELENGTH_NM, 3400.0)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """An even field by a camera with the sensitivities of a Nikon 5100, each channel at its own level."""
    size, columns = 48, camera_columns(NAME)
    camera = perturbed_camera(size, 4)
    settings = behind_mosaic(CaptureSettings(bit_depth=14, gain_e_per_dn=2.0, read_noise_e=4.0), "RGGB")
    probe = photographable(size)
    efficiency = {letter: named_camera_channel(column).scaled(LEVELS[letter]) for letter, column in columns.items()}
    sensor = sensor_efficiency()
    dyes = {
        letter: Spectrum(WAVELENGTH_NM, curve.at(WAVELENGTH_NM) / sensor, "zero")
        for letter, curve in efficiency.items()
    }
    settings = dataclasses.replace(settings, mosaic=MosaicSensor("RGGB", dyes))
    folder = tmp_path_factory.mktemp("named") / "capture"
    photograph_image(folder, probe, (), None, photographed_scene(Model()), camera, settings=settings, seed=3)
    return folder


def sensor_efficiency():
    from cboxlab.rendering.synthetic.capture_writer import channel_efficiencies

    return channel_efficiencies(None)[None].at(WAVELENGTH_NM)


def photographable(size):
    """An even field of the light, with two batches."""
    coefficients = np.ones((2, size, size, 1))
    coverage = np.stack([np.ones((size, size)), np.zeros((size, size))], axis=-1).astype(np.float32)
    return RenderedImage(coefficients, LIGHT[None], WAVELENGTH_NM, coverage, np.array([0]), ("wall",))


def capture_of(original, tmp_path, reference="camera:nikon 5100 (npl)"):
    folder = tmp_path / "capture"
    folder.mkdir()
    for part in ("frames", "spectra"):
        (folder / part).mkdir()
        for file in (original / part).iterdir():
            (folder / part / file.name).write_bytes(file.read_bytes())
    (folder / "points.csv").write_bytes((original / "points.csv").read_bytes())
    text = (original / "capture.toml").read_text()
    text = re.sub(r"(?ms)^\[camera.quantum_efficiency\]\n.*?\n\n?(?=\[)", "", text)
    text = text.replace("[camera]\n", f'[camera]\nquantum_efficiency = "{reference}"\n')
    (folder / "capture.toml").write_text(text)
    return folder


def test_levels_come_from_the_references_and_colours_are_those_of_the_tables(original, tmp_path):
    nominal, calibration = (
        calibrate_capture(load_capture(original)),
        calibrate_capture(load_capture(capture_of(original, tmp_path))),
    )
    levels = {column[-1]: level for column, level in calibration.capture.channel_levels.items()}
    for letter, level in LEVELS.items():
        assert levels[letter] == pytest.approx(level / max(LEVELS.values()), rel=3e-3)
    for response, other in zip(calibration.responses, nominal.responses, strict=True):
        np.testing.assert_allclose(response.weights, other.weights, rtol=4e-3, atol=1e-6 * other.weights.max())
    assert any(NAME in note and "from the references" in note for note in calibration.notes)
    assert not any("constant" in s.what.lower() or "gain" in s.what.lower() for s in calibration.suspicions)


def test_without_references_the_levels_are_unknown(original, tmp_path):
    folder = capture_of(original, tmp_path)
    path = folder / "capture.toml"
    path.write_text(re.sub(r"(?ms)^\[\[reference\]\]\n.*?(?=^\[)", "", path.read_text()))
    calibration = calibrate_capture(load_capture(folder))
    assert any("the channels' levels are unknown" in note for note in calibration.notes)
    assert calibration.radiometry.constant is None


def test_an_unknown_camera_is_refused_with_those_that_are_known(original, tmp_path):
    with pytest.raises(InputError, match="camera:Nikon 5100"):
        load_capture(capture_of(original, tmp_path, "camera:Nikon D9"))


def test_the_curves_are_those_of_photons():
    """For light of equal photons the peak of blue, where a photon has more energy, is lower than for equal energy."""
    from colour import MSDS_CAMERA_SENSITIVITIES

    assert NAME in camera_names()
    table = MSDS_CAMERA_SENSITIVITIES[NAME]
    curve = named_camera_channel(f"camera:{NAME}:B")
    energy = np.array(table.values)[:, 2] / np.array(table.wavelengths)
    np.testing.assert_allclose(curve.at(table.wavelengths), energy / energy.max(), atol=1e-12)
