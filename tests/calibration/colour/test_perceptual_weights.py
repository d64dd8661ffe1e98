"""XYZ from three broad channels: the weights of least colour difference, against weights of least relative error."""

import dataclasses

import numpy as np
import pytest
from cboxlab.calibration.colour.colorimetry import train_filter_weights
from cboxlab.calibration.colour.colour_error import colour_error, lab_differences
from cboxlab.calibration.colour.perceptual_weights import _difference_rows, perceptual_weights
from cboxlab.calibration.colour.radiance_ensemble import evaluation_radiances, training_radiances, training_whites
from cboxlab.calibration.instrument import colour_matching_functions
from cboxlab.rendering.synthetic import CaptureSettings, MosaicSensor, behind_mosaic, tungsten_lamp, unit_factors
from cboxlab.rendering.synthetic.capture_writer import channel_efficiencies
from cboxlab.scenes import camera_columns, cornell_box, named_camera_channel
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM

LAMPS = {"lamp": tungsten_lamp().at(WAVELENGTH_NM)}


@pytest.fixture(scope="module")
def responses():
    """Three channels with the sensitivities of a Nikon 5100."""
    sensor = channel_efficiencies(None)[None].at(WAVELENGTH_NM)
    dyes = {
        letter: Spectrum(WAVELENGTH_NM, named_camera_channel(column).at(WAVELENGTH_NM) / sensor, "zero")
        for letter, column in camera_columns("Nikon 5100 (NPL)").items()
    }
    settings = dataclasses.replace(behind_mosaic(CaptureSettings(), "RGGB"), mosaic=MosaicSensor("RGGB", dyes))
    return unit_factors(settings, 64).responses()


def test_small_differences_are_those_of_ciede2000():
    """The quadratic form against the differences that colour-science computes, for near neutral and chromatic colours.

    Its widths of hue are mean ones, so it holds to a quarter.
    """
    generator = np.random.default_rng(3)
    white = np.tile([0.9505, 1.0, 1.089], (400, 1))
    xyz = white * generator.uniform(0.05, 0.9, (400, 1)) * generator.uniform(0.75, 1.0, (400, 3))
    step = 1e-4 * xyz * generator.standard_normal((400, 3))
    expected = lab_differences(xyz + step, xyz, white)[1]
    lengths = np.linalg.norm(np.einsum("nda,na->nd", _difference_rows(xyz, white), step), axis=1)
    ratio = lengths / expected
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    assert np.percentile(np.abs(np.log(ratio)), 90) < 0.3


def test_three_channels_are_better_than_by_relative_error(responses):
    materials = np.stack([m.reflectance.at(WAVELENGTH_NM) for m in cornell_box().materials.values()])
    training, evaluation = training_radiances(LAMPS, materials), evaluation_radiances(LAMPS)
    assert len(evaluation.names) == 108
    by_difference = perceptual_weights(responses, training, training_whites(LAMPS), 0.01)
    by_relative = train_filter_weights(responses, training, 0.01)
    perceptual, relative = (
        colour_error(weights, responses, evaluation).delta_e_2000 for weights in (by_difference, by_relative)
    )
    assert perceptual.mean() < 1.65
    assert perceptual.mean() < 0.8 * relative.mean()


def test_enough_bands_are_exact(responses):
    """Responses that are the colour-matching functions themselves get unit weights."""
    goal = colour_matching_functions()
    exact = [dataclasses.replace(response, response=curve) for response, curve in zip(responses, goal, strict=True)]
    training = training_radiances(LAMPS, None, 300)
    weights = perceptual_weights(exact, training, training_whites(LAMPS, 300), 0.0).weights
    np.testing.assert_allclose(weights, np.eye(3), atol=1e-3)


def test_weights_do_not_depend_on_the_unit_of_the_light(responses):
    """Noise is relative to a signal's rms: light of 1e-20 to 1, signals of 1e-4 to 1e16 e-, have the same weights."""
    training, whites = training_radiances(LAMPS, None, 300), training_whites(LAMPS, 300)
    plain = perceptual_weights(responses, training, whites, 0.05).weights
    for unit in (1e-20, 1e-18, 1e-16, 1e-12):
        weights = perceptual_weights(responses, unit * training, unit * whites, 0.05).weights
        np.testing.assert_allclose(weights, plain, rtol=1e-6)
