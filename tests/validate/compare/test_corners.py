"""Corners of the practice capture from rough clicks, against its survey, which they do not use."""

from dataclasses import replace
from pathlib import Path

import cboxlab.validation
import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.geometry import SurveyedPoints
from cboxlab.calibration.result import calibrate_capture
from cboxlab.rendering.visibility import MARGIN_PX, RAYS_ACROSS, build_tracer, facet_coverage, part_of_lamps
from cboxlab.rendering.visibility.square_faces import _near_light
from cboxlab.scenes import cornell_camera, load_scene
from cboxlab.validation.compare import locate_corners, scene_corners
from cboxlab.validation.compare.corners import _Square
from cboxlab.validation.compare.edge_offsets import are_visible
from cboxlab.validation.synthetic import perturbed_camera
from scipy.ndimage import gaussian_filter

DEMO = Path(cboxlab.validation.__file__).parent / "data" / "demo-capture"
#: Corners of the box, one near the picture's border, upper corners and two feet of blocks, and one behind a block.
IDS = ("c02", "c03", "c06", "c07", "c12", "c15", "c18", "c20", "c21", "c22", "c24")
#: A foot whose shadow is not that of the lamp alone, and a corner behind a block.
REFUSED = {"c23": "do not determine it", "c20": "hidden"}
#: The camera with which the capture was made; its survey differs from it by up to 0.12 px.
CAMERA = perturbed_camera(128, 7)


@pytest.fixture(scope="module")
def calibration():
    return calibrate_capture(load_capture(DEMO))


def clicks(calibration, ids, seed, error_px):
    """Projections of corners by the true camera, and clicks at a distance from them."""
    corners = {corner.id: corner for corner in scene_corners(calibration.capture.scene)}
    values = np.array([corners[name].position_mm for name in ids])
    truth = CAMERA.project(values)
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(ids))
    error = error_px * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return truth, SurveyedPoints(ids, values, truth + error)


def test_corners_of_a_scene_have_names_and_leave_the_lamp_out(calibration):
    corners = scene_corners(calibration.capture.scene)
    assert len({corner.id for corner in corners}) == len(corners) == 24
    assert corners[1].name == "floor, back, right"
    lamp = np.concatenate([lamp.vertices_mm for lamp in calibration.capture.scene.all_surfaces[-1:]])
    assert min(np.linalg.norm(lamp - corner.position_mm, axis=1).min() for corner in corners) > 1


def test_clicks_are_refined_by_the_edges(calibration):
    """Of clicks 1.5 px off, a twentieth of a pixel remains; shadows that begin at a block's foot do not hinder."""
    ids = (*IDS, "c23")
    truth, clicked = clicks(calibration, ids, 3, 1.5)
    corners = locate_corners(calibration.photograph, calibration.capture.scene, clicked)
    error = np.linalg.norm(corners.points.image_px - truth, axis=1)
    by_edges = dict(zip(ids, corners.by_edges, strict=True))
    assert by_edges == {name: name not in REFUSED for name in ids}
    assert error[corners.by_edges].max() < 0.15 and np.sqrt(np.mean(error[corners.by_edges] ** 2)) < 0.08
    # a corner that the edges do not determine stays where it was clicked, and says why
    assert np.array_equal(corners.points.image_px[~corners.by_edges], clicked.image_px[~corners.by_edges])
    assert all(REFUSED.get(name, "") in why for name, why in zip(ids, corners.reasons, strict=True))
    assert [bool(why) for why in corners.reasons] == [*~corners.by_edges]


def test_corners_of_a_drawn_picture_have_no_bias_and_their_stated_error():
    """The picture is drawn from exact coverages of pixels and has 1 % of noise, so that its corners are known exactly.

    Brightness bends within each face, as no polynomial does.
    """
    scene, camera = load_scene("cornell-box"), replace(cornell_camera(96), position_mm=np.array([270.0, 268.0, -812.0]))
    coverage = facet_coverage(build_tracer(scene), camera, 512, 0)
    v, u = np.mgrid[:96, :96] / 96
    level = 0.2 + 0.6 * np.modf(np.arange(1, coverage.shape[-1] + 1) * 0.618)[0]
    bend = np.stack([1 + 0.1 * np.sin(3 * u + k) + 0.1 * np.cos(4 * v - k) for k in range(len(level))], axis=-1)
    picture = gaussian_filter((coverage * level * bend).sum(axis=-1), 0.25)
    picture += np.random.default_rng(1).normal(0, 0.01, picture.shape) * picture
    corners = {corner.id: corner.position_mm for corner in scene_corners(scene)}
    ids = ("c02", "c03", "c06", "c08", "c10", "c12", "c18", "c22", "c24")
    truth = camera.project(np.array([corners[name] for name in ids]))
    rough = truth + np.random.default_rng(2).normal(0, 0.4, truth.shape)
    located = locate_corners(picture, scene, SurveyedPoints(ids, np.array([corners[n] for n in ids]), rough, "drawn"))
    error, sigma = (located.points.image_px - truth)[located.by_edges], located.sigma_px[located.by_edges]
    assert len(sigma) >= 6
    assert np.abs(error.mean(axis=0)).max() < 0.06 and np.sqrt(np.mean(error**2)) < 0.07
    assert 0.2 < np.mean((error / sigma[:, None]) ** 2) < 2


def test_the_faces_of_a_block_shine_on_the_floor_at_its_foot_as_far_as_they_are_seen():
    """Right before the middle of a face, it fills half of the hemisphere; the other face looks away."""
    scene = load_scene("cornell-box")
    block = next(surface for surface in scene.surfaces if surface.name == "short-block").vertices_mm
    feet = {tuple(corner) for corner in block[block[:, 1] == 0].tolist()}
    foot, other = np.array([290.0, 0.0, 114.0]), np.array([130.0, 0.0, 65.0])
    assert {tuple(foot), tuple(other)} <= feet
    outwards = np.cross([0.0, 1.0, 0.0], foot - other)
    outwards *= -np.sign(outwards @ (block.mean(axis=0) - foot)) / np.linalg.norm(outwards)
    points = (foot + other) / 2 + np.outer([0.01, 50.0, 5000.0], outwards)
    front, side = sorted(_near_light(scene, foot, np.array([0.0, 1.0, 0.0, 0.0]), points), key=lambda each: -each[0])
    assert front[0] == pytest.approx(0.5, abs=1e-3) and front[2] < 1e-3 < 0.1 < front[1] < 0.45
    assert side.max() == 0
    # none of the floor on the block, which has floor in front and behind
    assert _near_light(scene, foot, np.array([*outwards, outwards @ foot]), points) == []


def test_too_few_corners_stay_as_clicked(calibration):
    _, clicked = clicks(calibration, IDS[:4], 2, 0.5)
    corners = locate_corners(calibration.photograph, calibration.capture.scene, clicked)
    assert corners.fit is None and "4 usable points" in corners.reason and not corners.by_edges.any()
    assert np.array_equal(corners.points.image_px, clicked.image_px)


def test_the_part_of_the_lamp_that_a_position_sees_is_that_of_many_rays():
    """Against 4000 rays to random points of the lamp, which have 0.008; 50 points in even order have 0.08 at most."""
    scene, rng = load_scene("cornell-box"), np.random.default_rng(3)
    positions = np.column_stack([rng.uniform(20, 530, 40), np.full(40, 0.01), rng.uniform(20, 530, 40)])
    parts = part_of_lamps(scene, positions)
    low, high = scene.lamp.surface.vertices_mm.min(axis=0), scene.lamp.surface.vertices_mm.max(axis=0)
    ends = rng.uniform(low, high, (4000, 3))
    rays = [np.mean(are_visible(scene, replace(cornell_camera(8), position_mm=at), ends)) for at in positions]
    np.testing.assert_allclose(parts, rays, atol=0.08)
    assert abs(np.mean(parts - rays)) < 0.02
    assert np.sum((parts > 0.1) & (parts < 0.9)) >= 3 and parts.min() == 0 and parts.max() == 1


def test_a_corners_error_is_that_of_its_noise_also_where_few_pixels_determine_it():
    """Of 25 pixels the position and the brightness of two faces take 8 degrees of freedom."""
    v, u = np.mgrid[-2:3, -2:3].reshape(2, -1).astype(float)
    rays = (np.arange((2 * MARGIN_PX + 1) * RAYS_ACROSS) - (RAYS_ACROSS - 1) / 2) / RAYS_ACROSS - MARGIN_PX

    def face(u, v):
        """A quarter of the picture, blurred by a pixel."""
        return np.clip(0.5 + u, 0, 1) * np.clip(0.5 + v, 0, 1)

    square = object.__new__(_Square)
    shares = [face(rays[None], rays[:, None]), 1 - face(rays[None], rays[:, None])]
    square._at, square._of_blur = np.stack([v, u]), lambda blur: (shares, [])
    fits = []
    for noise in 1e-3 * np.random.default_rng(4).standard_normal((400, v.size)):
        square._measured = 1 + face(u, v) + noise
        fits.append(square._fit(0.0, 1, 2.0, np.zeros(2))[:2])
    shifts, sigmas = (np.array(values) for values in zip(*fits, strict=True))
    assert np.std(shifts, axis=0).mean() == pytest.approx(np.sqrt(np.mean(sigmas**2)), rel=0.12)
