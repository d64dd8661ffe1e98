"""Edges of the photograph against the model's: a block that stands elsewhere is found, with its uncertainty."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cboxlab.calibration.edge_alignment import EdgeOffsets, align_edges, measure_edges
from cboxlab.scenes import cornell_box, cornell_camera

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
def aligned():
    """The short block stands SHIFT_MM off, and the camera is a little off its calibration."""
    box, true = cornell_box(), cornell_camera(SIZE)
    moved = tuple(
        replace(s, vertices_mm=s.vertices_mm + SHIFT_MM) if s.name == "short-block" else s
        for s in box.surfaces
    )
    picture = photograph(replace(box, surfaces=moved), true)
    picture += 0.002 * np.random.default_rng(1).standard_normal(picture.shape)
    offset = np.array([0.6, -0.5, 2, 0.05, -0.04, 0.01, 0.5, -0.4, 0.4, 0.004])
    stated = true.with_parameters(true.parameters + offset)
    stated = replace(stated, covariance=SURVEY)
    return true, stated, *align_edges(measure_edges(picture, stated, box), stated)


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


def test_the_camera_is_improved(aligned):
    """Corners of the room appear where they are to a third of what the survey's camera missed them by."""
    true, stated, refined, errors = aligned
    corners = cornell_box().surface("back").vertices_mm
    missed = [np.abs(c.project(corners) - true.project(corners)).max() for c in (stated, refined)]
    assert missed[1] < missed[0] / 3
    assert refined.covariance is None
    assert errors[0].name == "room" and errors[0].samples > 100


def test_without_edges_nothing_is_claimed():
    camera = replace(cornell_camera(64), covariance=SURVEY)
    flat = measure_edges(np.ones((64, 64)), camera, cornell_box())
    assert isinstance(flat, EdgeOffsets) and flat.offset_px.size == 0
    with pytest.raises(ValueError, match="too few edges"):
        align_edges(flat, camera)
    with pytest.raises(ValueError, match="covariance"):
        align_edges(flat, cornell_camera(64))
