"""Another renderer's picture that lacks light: the depth of its paths is found, and its energy is stated.

The capture is photographed without any effect; the pictures in place of ours are ours, complete or cut.
"""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain import RenderSettings
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.files import write_cube
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic.photographer import CaptureSettings
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.compare import prepare, validate_capture
from cboxlab.validation.diagnose.external_render import external_render
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photograph_image, photographed_scene

external_render_module = importlib.import_module("cboxlab.validation.diagnose.external_render")
pytestmark = [
    pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer"),
    pytest.mark.usefixtures("large_patches"),
]

SIZE, SEED = 32, 3
GRID = np.arange(400.0, 701.0, 20.0)


@pytest.mark.parametrize(("excess", "expected"), [(None, None), (0.0, 3), (0.6, 3), (3.0, None)])
def test_a_depth_must_explain_a_quarter_of_what_is_above_noise(monkeypatch, excess, expected):
    """Ratios by depth are known; the truth is complete, or lacks what is beyond three reflections, and more errors.

    excess : chi2 by other errors over that of the missing light; a quarter is passed below 3.
    """
    rng, shape = np.random.default_rng(2), (2, 40, 40)
    signal = rng.uniform(500, 1500, shape)
    ratios = {depth: 1 + rng.uniform(0, 0.1 / depth, shape) for depth in (1, 2, 3, 4)}
    variance = np.full(shape, 25.0)
    truth = signal if excess is None else signal * ratios[3]
    measured = truth + 5 * rng.standard_normal(shape)
    if excess:
        # a pattern alike for all depths, within what a residual may count
        size = np.sqrt(excess * np.mean((signal * (ratios[3] - np.mean(ratios[3]))) ** 2))
        measured = measured + size * np.where(np.indices(shape).sum(axis=0) % 2, 1.0, -1.0)
    calibration = SimpleNamespace(predicted_variance=lambda values: variance)
    prepared = SimpleNamespace(measured=measured, calibration=calibration, lamp_sigma=None)
    rendered = SimpleNamespace(signal=signal, variance=0 * variance, used=np.ones(shape, bool))
    monkeypatch.setattr(external_render_module, "_ratios", lambda validation, rendered: ratios)
    assert external_render_module._depth(SimpleNamespace(prepared=prepared), rendered) == expected


@pytest.fixture(scope="module")
def complete():
    camera, scene = perturbed_camera(SIZE, SEED), photographed_scene(Model())
    return render_image(RenderJob(scene, camera, WAVELENGTH_NM, 64, 2, seed=SEED))


@pytest.fixture(scope="module")
def capture(complete, tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign") / "capture"
    camera, scene = perturbed_camera(SIZE, SEED), photographed_scene(Model())
    photograph_image(folder, complete, (), None, scene, camera, settings=CaptureSettings(), seed=SEED)
    return folder


@pytest.fixture(scope="module")
def answers(capture, tmp_path_factory):
    """By the number of reflections of a cube through the calibrated camera: the validation, what is found, the cube."""
    path = tmp_path_factory.mktemp("cubes") / "cube.nc"
    prepared, model = prepare(load_capture(capture), Model()), Model(render=RenderSettings(noise=2.0))
    results = {}
    for depth in (4, None):
        camera = prepared.calibrated_camera
        cube = render_image(RenderJob(prepared.scene, camera, GRID, 128, 2, seed=SEED + 1, max_bounces=depth)).cube()
        write_cube(path, cube)
        results[depth] = *external_render(validate_capture(load_capture(capture), model, picture=path)), cube
    return results


def test_the_depth_at_which_paths_end_is_found(answers):
    validation, side, _ = answers[4]
    assert side.max_bounces == 4
    assert validation.model.render.max_bounces == 4
    assert answers[None][1].max_bounces is None


def test_missing_light_is_reported_and_not_fitted_away(answers):
    """The cube's light outside the lamp over the complete cube's, all wavelengths alike, within 2 % of the light; the
    lamp's true power, which both share, is within what the capture states."""
    validation, side, cube = answers[4]
    outside = (cube["surface"].values >= 0) & (answers[None][2]["surface"].values >= 0)
    light, total_light = (float(answers[depth][2]["radiance"].values[outside].sum()) for depth in (4, None))
    assert light / total_light < 0.97
    assert (1 + side.energy) / (1 + answers[None][1].energy) == pytest.approx(light / total_light, abs=0.02)
    assert abs(answers[None][1].energy) < 2.5 * side.lamp_sigma
    assert abs(validation.fit.lamp_scale - 1) <= 2 * side.lamp_sigma + 1e-9
