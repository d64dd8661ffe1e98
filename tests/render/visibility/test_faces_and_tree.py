"""Flat walls in the kernel and meshes in a tree: together the hits of one tree with everything."""

import numpy as np
import pytest
import trimesh
from cboxlab.rendering.device import mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.visibility.faces_and_tree import FacesAndTree, build_accelerator, triangle_tree
from cboxlab.rendering.visibility.flat_faces import FlatFaces
from cboxlab.rendering.visibility.tracer import facets
from helpers.scenes.hits import COUNT, between_surfaces, blocked_by, differing, directions, hit_of, normals_of, rays

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

WALLS = np.array(
    [
        [[0, 0, 0], [0, 0, 500], [500, 0, 500], [500, 0, 0]],
        [[0, 500, 0], [500, 500, 0], [500, 500, 500], [0, 500, 500]],
        [[0, 0, 500], [0, 500, 500], [500, 500, 500], [500, 0, 500]],
        [[0, 0, 0], [0, 500, 0], [0, 500, 500], [0, 0, 500]],
        [[500, 0, 0], [500, 0, 500], [500, 500, 500], [500, 500, 0]],
    ],
    dtype=float,
)
ROOM = np.concatenate([WALLS[:, [0, 1, 2]], WALLS[:, [0, 2, 3]]])


def ball(centre, radius=60.0):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return np.asarray(mesh.triangles) + np.asarray(centre, float)


def scene(*meshes):
    """The room as one surface and each mesh as another: both accelerators, normals, all triangles."""
    vertices = np.concatenate([ROOM, *meshes])
    surface = np.repeat(np.arange(1 + len(meshes)), [len(ROOM), *map(len, meshes)])
    normals = normals_of(vertices)
    return (
        build_accelerator(vertices, facets(normals, surface)[0], surface, {}),
        triangle_tree(vertices),
        normals,
        vertices,
    )


BALLS = {
    "one": [[250, 100, 250]],
    "out of the open front, beyond the walls' hull": [[250, 100, -20]],
    "six, in one box": [[100 + 60 * i, 100 + 50 * (i % 3), 150 + 40 * i] for i in range(6)],
}


@pytest.mark.parametrize("name", BALLS)
def test_rays_meet_what_one_tree_says(name):
    meshes = [ball(centre, 30.0 if len(BALLS[name]) > 1 else 60.0) for centre in BALLS[name]]
    both, tree, normals, _ = scene(*meshes)
    assert isinstance(both, FacesAndTree) and len(both.boxes) == 1
    assert (both.faces.room is None) == ("beyond" in name)  # walls are not the hull then
    rng = np.random.default_rng(2)
    direction = directions(rng)
    direction[::10] = np.eye(3)[rng.integers(3, size=len(direction[::10]))]  # along the boxes' planes
    ray = rays(rng.uniform(-150, 650, (COUNT, 3)), direction)
    hits, expected = hit_of(both, ray), hit_of(tree, ray)
    (hit, _, triangle, uv), (_, _, triangle_tree, uv_tree) = hits, expected
    differs = differing(hits, expected, normals, direction)
    assert differs.sum() <= 20
    assert (triangle >= len(ROOM))[hit].mean() > 0.01
    same = hit & ~differs & (triangle == triangle_tree)
    assert same.sum() >= hit.sum() - 100  # at edges either triangle
    angle = np.abs(np.einsum("ij,ij->i", normals[triangle_tree % len(normals)], direction))
    close = np.abs(uv[:, same] - uv_tree[:, same]) * angle[same]
    assert np.quantile(close, 0.99) < 1e-3
    ray.maxt = 200.0
    blocked = blocked_by(both, ray)
    assert (blocked != blocked_by(tree, ray)).sum() <= 20
    np.testing.assert_array_equal(hit_of(both, ray)[0], blocked)


@pytest.mark.parametrize("name", BALLS)
def test_segments_between_surfaces_may_leave_out_the_hull(name):
    both, tree, normals, vertices = scene(*(ball(centre) for centre in BALLS[name]))
    rng = np.random.default_rng(3)
    indices = rng.integers(len(vertices), size=(2, COUNT))
    indices[:, ::2] = rng.integers(len(ROOM), size=(2, COUNT // 2))
    ray, facing = between_surfaces(vertices, normals, indices, rng)
    enclosed, expected = blocked_by(both, ray, enclosed=True)[facing], blocked_by(tree, ray)[facing]
    assert 50 < expected.sum() < len(expected) - 50
    assert (enclosed != expected).sum() <= 5


def test_lanes_that_are_not_asked_meet_nothing():
    both, *_ = scene(ball([250, 100, 250]))
    ray = rays(np.full((4, 3), [250.0, 400.0, 250.0]), np.array([[0, -1.0, 0], [0, -1, 0], [1, 0, 0], [1, 0, 0]]))
    active = [True, False, True, False]
    hit, _, triangle, _ = hit_of(both, ray, active)
    assert hit.tolist() == active
    assert triangle[0] >= len(ROOM) > triangle[2]
    assert np.array(both.ray_test(ray, mi.Bool(active))).tolist() == active


def test_a_few_faces_need_no_tree_and_many_flat_ones_stay_in_it():
    few, *_ = scene()
    assert isinstance(few, FlatFaces)
    crowd = [np.roll(ROOM, 1, axis=2) * 0.05 + 40 * i for i in range(12)]  # 120 triangles of small surfaces
    tree, *_ = scene(ball([250, 100, 250]), *crowd)
    assert isinstance(tree, mi.Scene)
