"""Pixels on the edges of faces: what many points along each edge say, for edges inside, half seen and behind."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.visibility.face_edges import face_edges, pixels_on_edges
from cboxlab.scenes import cornell_camera
from cboxlab.scenes.lens import Lens

SQUARE = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0.0, 0, 0], [1, 1, 0], [0, 1, 0]]])


def lengths(edges):
    return sorted(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1))


def test_the_diagonal_of_a_square_is_no_edge_unless_it_parts_two_faces():
    assert lengths(face_edges(SQUARE, np.array([4, 4]))) == pytest.approx([1, 1, 1, 1])
    assert lengths(face_edges(SQUARE, np.array([4, 5]))) == pytest.approx([1, 1, 1, 1, np.sqrt(2)])


#: Ends in the camera's axes (right, down, forward), mm; the half field is 0.357 of the distance.
EDGES = {
    "inside": ((-100.0, -150.0, 1000.0), (180.0, 90.0, 1400.0)),
    "out of the picture at both ends": ((-900.0, 30.0, 1000.0), (800.0, 160.0, 1200.0)),
    "from behind the camera": ((40.0, 80.0, -500.0), (90.0, -60.0, 1500.0)),
    "upright": ((20.0, -2000.0, 900.0), (20.0, 3000.0, 900.0)),
    "seen end on": ((5.0, 7.0, 500.0), (10.0, 14.0, 1000.0)),
}


@pytest.mark.parametrize("name", EDGES)
@pytest.mark.parametrize(
    ("k1", "lens"), [(0.0, Lens()), (-0.2, Lens()), (-0.1, Lens(k2=0.3, p1=0.01)), (-0.02, Lens("fisheye", k2=0.01))]
)
def test_an_edge_crosses_the_pixels_of_its_points(name, k1, lens):
    """All pixels that 40 000 points of the edge are seen in, and none whose centre is a pixel away from all of them."""
    camera = replace(cornell_camera(64), k1=k1, lens=lens, position_mm=np.array([3.0, -5.0, 20.0]))
    edge = np.array(EDGES[name]) @ camera.rotation + camera.position_mm
    pixels = pixels_on_edges(camera, edge[None])
    along = np.linspace(0, 1, 40_001)[:, None]
    points = edge[0] + along * (edge[1] - edge[0])
    right, down, forward = ((points - camera.position_mm) @ camera.rotation.T).T
    near = (forward > 1.0) & (np.hypot(right, down) < forward)  # beyond, the distortion folds back into the picture
    uv = camera.project(points[near])
    crossed = np.zeros_like(pixels)
    column, row = np.rint(uv).astype(int).T
    inside = (column >= 0) & (column < 64) & (row >= 0) & (row < 64)
    crossed[row[inside], column[inside]] = True
    assert inside.any() and np.all(pixels[crossed])
    v, u = np.nonzero(pixels)
    away = np.min(np.hypot(u[:, None] - uv[None, ::20, 0], v[:, None] - uv[None, ::20, 1]), axis=1)
    assert away.max() < 1.0


def test_an_edge_behind_the_camera_crosses_nothing():
    camera = cornell_camera(32)
    edge = np.array([[-100.0, 50.0, -900.0], [200.0, 10.0, -300.0]]) @ camera.rotation + camera.position_mm
    assert not pixels_on_edges(camera, edge[None]).any()
