"""Edges of the photograph against the model's: a block that stands elsewhere is found, with its uncertainty."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.compare.edge_alignment import EDGE_BIAS_PX, align_edges, align_photograph
from cboxlab.validation.compare.edge_offsets import EdgeOffsets, measure_edges
from scipy import stats

SIZE, FINE = 224, 16
SURVEY = np.diag(np.array([1, 1, 3, 0.1, 0.1, 0.02, 1, 1, 1, 0.01]) ** 2)
SHIFT_MM = np.array([3.0, 0.0, -4.0])


def photograph(scene, camera):
    """(y, x) flat shades of all faces, painted from far to near on a grid FINE times as fine, then averaged."""
    rng = np.random.default_rng(3)
    fine = np.zeros((SIZE * FINE, SIZE * FINE), np.float32)
    far_first = sorted(scene.surfaces, key=lambda s: ("block" in s.name, -s.vertices_mm[:, 2].mean()))
    for surface in far_first:
        shade = {}
        for face in surface.faces:
            corners = surface.vertices_mm[face]
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            normal /= np.linalg.norm(normal)
            value = shade.setdefault(tuple(np.round(normal, 2)), rng.uniform(0.2, 1.0))
            if normal @ (corners[0] - camera.position_mm) >= 0:
                continue
            image = (camera.project(corners) + 0.5) * FINE - 0.5
            cv2.fillConvexPoly(fine, np.round(image * 256).astype(np.int32), float(value), cv2.LINE_8, 8)
    return fine.reshape(SIZE, FINE, SIZE, FINE).mean(axis=(1, 3)).astype(float)


@pytest.fixture(scope="module")
def measured():
    """The short block stands SHIFT_MM off, and the camera is a little off its calibration."""
    box, true = cornell_box(), cornell_camera(SIZE)
    moved = tuple(
        replace(s, vertices_mm=s.vertices_mm + SHIFT_MM) if s.name == "short-block" else s for s in box.surfaces
    )
    picture = photograph(replace(box, surfaces=moved), true)
    picture += 0.002 * np.random.default_rng(1).standard_normal(picture.shape)
    offset = np.array([0.6, -0.5, 2, 0.05, -0.04, 0.01, 0.5, -0.4, 0.4, 0.004])
    start = true.with_parameters(true.parameters + offset)
    start = replace(start, covariance=SURVEY)
    return true, start, measure_edges(picture, start, box)


@pytest.fixture(scope="module")
def aligned(measured):
    true, start, offsets = measured
    return true, start, *align_edges(offsets, start)


def test_the_block_is_found_where_it_stands(aligned):
    """Mahalanobis square below 16.3, the 99.9% point of chi2(3), and clearly not at its modelled place."""
    short = next(e for e in aligned[3] if e.name == "short-block")
    off = short.shift_mm - SHIFT_MM
    assert off @ np.linalg.solve(short.covariance, off) < 16.3
    assert short.shift_mm @ np.linalg.solve(short.covariance, short.shift_mm) > 16.3
    assert np.sqrt(short.covariance[0, 0]) < 1.0
    assert short.rms_after_px < 0.5 * short.rms_before_px


def test_what_stands_right_is_left_there(aligned):
    tall = next(e for e in aligned[3] if e.name == "tall-block")
    assert tall.shift_mm @ np.linalg.solve(tall.covariance, tall.shift_mm) < 16.3


def test_samples_far_from_all_others_are_left_out(measured, aligned):
    """Every thirtieth is 12 px off, as at a stain: all of them are left out, and the camera stays within its error."""
    _, start, offsets = measured
    stained = offsets.offset_px.copy()
    stained[::30] += 12.0
    refined, errors = align_edges(replace(offsets, offset_px=stained), start)
    number = np.count_nonzero(offsets.owner[::30] == 0)
    assert number > 5 and errors[0].samples <= aligned[3][0].samples - 0.9 * number
    difference = refined.parameters - aligned[2].parameters
    assert difference @ np.linalg.solve(refined.covariance, difference) < 4


def test_the_camera_is_improved(aligned):
    """Corners of the room appear where they are to a third of what the survey's camera missed them by."""
    true, start, refined, errors = aligned
    corners = cornell_box().surface("back").vertices_mm
    missed = [np.abs(c.project(corners) - true.project(corners)).max() for c in (start, refined)]
    assert missed[1] < missed[0] / 3
    off = refined.parameters - true.parameters
    # The 99.9% point of chi2(10).
    assert off @ np.linalg.solve(refined.covariance, off) < 29.6
    assert errors[0].name == "room" and errors[0].samples > 100


def test_without_edges_nothing_is_claimed():
    camera = replace(cornell_camera(64), covariance=SURVEY)
    flat = measure_edges(np.ones((64, 64)), camera, cornell_box())
    assert isinstance(flat, EdgeOffsets) and flat.offset_px.size == 0
    with pytest.raises(ValueError, match="too few edges"):
        align_edges(flat, camera)
    with pytest.raises(ValueError, match="covariance"):
        align_edges(flat, cornell_camera(64))


def test_an_object_of_few_samples_is_reported(samples):
    """Three samples of the short block are left."""
    camera = replace(cornell_camera(SIZE), covariance=SURVEY)
    block = samples.objects.index("short-block")
    indices = np.flatnonzero(samples.owner == block)[3:]
    kept_samples = np.delete(np.arange(samples.owner.size), indices)
    per_sample = ("place_mm", "normal", "offset_px", "owner", "edge")
    few = replace(samples, **{name: getattr(samples, name)[kept_samples] for name in per_sample})
    _, errors = align_edges(few, camera)
    (short,) = (error for error in errors if error.name == "short-block")
    assert not short.determined and short.samples == 3 and np.isnan(short.covariance).all()
    assert all(error.determined for error in errors if error.name != "short-block")


@pytest.fixture(scope="module")
def samples():
    """Where the picture of the box as modelled shows its edges."""
    return measure_edges(photograph(cornell_box(), cornell_camera(SIZE)), cornell_camera(SIZE), cornell_box())


def test_covariances_by_simulation(samples):
    """150 cameras drawn from their calibration, edges and samples off by what is assumed of them.

    Mahalanobis squares of camera and blocks: shares within the 68% and 95% points by the binomial, 4 standard errors
    (less than 4 false alarms in 10,000).
    """
    true, rng = cornell_camera(SIZE), np.random.default_rng(4)
    edges = [samples.edge == number for number in np.unique(samples.edge)]
    squares = {"camera": [], "short-block": [], "tall-block": []}
    for _ in range(150):
        error = rng.multivariate_normal(np.zeros(10), SURVEY)
        start = replace(true.with_parameters(true.parameters + error), covariance=SURVEY)
        away = true.project(samples.place_mm) - start.project(samples.place_mm)
        offset = np.sum(samples.normal * away, axis=1) + 0.05 * rng.standard_normal(len(samples.edge))
        for edge in edges:
            along = np.linalg.norm(samples.place_mm[edge] - samples.place_mm[edge][0], axis=1)
            along -= along.mean()
            drift = along / max(np.abs(along).max(), 1e-12)
            offset[edge] += EDGE_BIAS_PX * (rng.standard_normal() + drift * rng.standard_normal())
        refined, errors = align_edges(replace(samples, offset_px=offset), start)
        off = refined.parameters - true.parameters
        squares["camera"].append(off @ np.linalg.solve(refined.covariance, off))
        for block in errors[1:]:
            squares[block.name].append(block.shift_mm @ np.linalg.solve(block.covariance, block.shift_mm))
    for name, values in squares.items():
        for level in (0.68, 0.95):
            share = np.mean(np.array(values) < stats.chi2.ppf(level, 10 if name == "camera" else 3))
            assert abs(share - level) < 4 * np.sqrt(level * (1 - level) / 150), name


def test_a_loose_calibration_is_refused():
    """4 px from the truth other edges come into the search: the answer would be wrong and sure of itself."""
    camera = cornell_camera(SIZE)
    loose = replace(camera, covariance=SURVEY + np.diag([0, 0, 0, 0.8**2, 0, 0, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match="uncertainty"):
        align_photograph(np.ones((SIZE, SIZE)), loose, cornell_box())


def test_measuring_again_finds_a_camera_that_one_search_missed():
    """Corners 1.5 px off and more: found to 0.3 px, three of the EDGE_BIAS_PX that the picture's edges have."""
    true, box = cornell_camera(SIZE), cornell_box()
    start = true.with_parameters(true.parameters + np.array([1, -1, 3, 0.15, -0.1, 0.02, 1, -1, 1, 0.01]))
    start = replace(start, covariance=SURVEY)
    corners = box.surface("back").vertices_mm
    picture = photograph(box, true) + 0.002 * np.random.default_rng(2).standard_normal((SIZE, SIZE))
    refined, _ = align_photograph(picture, start, box)
    assert np.abs(start.project(corners) - true.project(corners)).max() > 1.5
    assert np.abs(refined.project(corners) - true.project(corners)).max() < 0.3


def test_an_edge_of_two_faces_is_counted_once(samples):
    room = samples.owner == 0
    ends = {
        tuple(np.round(np.sort(samples.place_mm[samples.edge == n][[0, -1]], axis=0), -1).ravel())
        for n in np.unique(samples.edge[room])
    }
    assert len(ends) == len(np.unique(samples.edge[room]))
