"""Signal whose noise counts where the model lacks light; scene that the checks of a capture see."""

from dataclasses import make_dataclass, replace
from types import SimpleNamespace

import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import CorrectedBands
from cboxlab.calibration.geometry import SurveyedPoints, fit_camera
from cboxlab.calibration.instrument import band_images
from cboxlab.scenes import cornell_box
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.compare.prepared import CalibratedCapture, _compared_with, with_tolerances
from cboxlab.validation.synthetic import perturbed_camera


def test_noise_is_the_photographs_where_it_is_twice_the_model():
    """Not for samples below a twentieth of the median, nor for masked ones."""
    usable = np.array([[[True, True, True, True, False, True, True]]])
    measured = np.array([[[100.0, 100, 100, 2, 900, 120, 80]]])
    model = np.array([[[49.0, 51, 0, 0.1, 1, 130, 70]]])
    capture = SimpleNamespace(usable=usable, measured=measured)
    signal = CalibratedCapture.noise_reference_signal(capture, model)
    np.testing.assert_array_equal(signal, [[[100.0, 51, 100, 0.1, 1, 130, 70]]])


def test_checks_see_the_scene_of_a_users_model_and_else_the_one_that_the_capture_states():
    capture, published = load_capture(DEMO_CAPTURE), cornell_box()
    users_box = replace(published, name="own-box")
    assert _compared_with(capture, published) is capture
    assert _compared_with(capture, users_box).scene is users_box
    silent = replace(capture, manifest=capture.manifest.model_copy(update={"scene": None}))
    assert _compared_with(silent, users_box) is silent


def test_without_darks_the_lamps_error_covers_levels_that_were_fitted():
    """100 photographs with unknown levels, references a little off: 68 and 95 % of scales within, four errors."""
    rng, shape, sigmas = np.random.default_rng(8), (2, 16, 16), np.array([0.5, 2.0])
    rendered, response = rng.uniform(2, 60, shape), np.linspace(0.6, 1.4, 256).reshape(16, 16)
    flats, variance, every = dict.fromkeys("ab", SimpleNamespace(response=response)), np.ones(shape), rendered > 0
    radiometry = SimpleNamespace(dark_sigma=0.001)
    pulls = []
    for _ in range(100):
        levels = (sigmas * np.clip(rng.standard_normal(2), -2, 2))[:, None, None] / response
        measured = (1 + 0.001 * rng.standard_normal()) * rendered + levels + rng.standard_normal(shape)
        bands = CorrectedBands(band_images("ab", measured, variance), variance, flats, (), dark_sigma_dn=sigmas)
        bands = bands.with_dark_levels_of(rendered, variance, every)
        calibration = SimpleNamespace(bands=bands, radiometry=radiometry, images=bands.images)
        prepared = CalibratedCapture(calibration, None, (), None, None, None, None)
        scale, sigma = prepared.lamp_scale(rendered, variance, every)
        pulls.append((scale - 1) / sigma)
    for limit, share in ((1.0, 0.683), (1.96, 0.95)):
        assert abs(np.mean(np.abs(pulls) < limit) - share) < 4 * np.sqrt(share * (1 - share) / 100)


def test_pixels_scatter_beyond_the_noise_of_both_pictures():
    bands = SimpleNamespace(with_scatter_of=lambda signal, variance, used, step: variance)
    calibration = make_dataclass("Calibration", ["bands", "capture", "predicted_variance"])(
        bands, SimpleNamespace(cell=None), lambda signal: 2 * signal
    )
    prepared = make_dataclass("Prepared", ["calibration"])(calibration)
    result = CalibratedCapture.with_scatter_of(prepared, np.full(3, 5.0), np.full(3, 0.5), np.ones(3, bool))
    np.testing.assert_array_equal(result.calibration.bands, 10.5)


def test_the_surveyed_camera_is_as_uncertain_as_its_points_on_blocks_that_move_together():
    """The covariance grows by the squared changes of cameras fitted to points on moved blocks.

    It grows by the picture's 0.005 px, too, which n points do not average: n (0.005 / 0.02)^2 of itself.
    """
    box, camera, draw, sigma = cornell_box(), perturbed_camera(256, 1), np.random.default_rng(3), 0.02
    corners = {name: box.surface(name).vertices_mm for name in ("short-block", "tall-block")}
    room = [x for s in box.surfaces if s.name not in corners for x in s.vertices_mm + 1e-3 * draw.normal(size=3)]
    names = tuple(map(str, range(len(room) + sum(map(len, corners.values())))))

    def fitted(scene):
        blocks = [scene.surface(name).vertices_mm for name in corners]
        return fit_camera(
            SurveyedPoints(names, position_mm, camera.project(np.vstack([room, *blocks]))),
            width_px=256,
            height_px=256,
            point_sigma_px=sigma,
            start=camera,
        )

    position_mm = np.vstack([room, *corners.values()])
    sound, expected = fitted(box), np.zeros((10, 10))
    moves = ({"by_mm": [0.1, 0, 0]}, {"by_mm": [0, 0, 0.1]}, {"turn_deg": 0.05})
    for block, move in ((block, move) for block in corners for move in moves):
        change = fitted(box.moved(block, **move)).camera.parameters - sound.camera.parameters
        expected += np.outer(change, change)
    expected += len(position_mm) / 16 * sound.camera.covariance
    growth = with_tolerances(sound, box).camera.covariance - sound.camera.covariance
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(growth / np.outer(size, size), expected / np.outer(size, size), atol=0.02)
