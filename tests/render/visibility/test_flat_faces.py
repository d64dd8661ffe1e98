"""Faces intersected in the kernel: the hits of Embree up to rounding, without gaps between faces."""

import numpy as np
import pytest
from cboxlab.rendering.device import dr, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.visibility.faces_and_tree import triangle_tree
from cboxlab.rendering.visibility.flat_faces import MOST_FACES, FlatFaces, flat_faces
from cboxlab.rendering.visibility.tracer import build_tracer, facets
from cboxlab.scenes import cornell_box
from helpers.scenes.hits import (
    COUNT,
    ROUNDING_MM,
    between_surfaces,
    blocked_by,
    differing,
    directions,
    hit_of,
    normals_of,
    rays,
)

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

BOX = np.array(
    [
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]],
        [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]],
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
    ],
    dtype=float,
)


def triangles(quads):
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def both(vertices):
    """The same triangles as faces and in Embree's tree."""
    normals = normals_of(vertices)
    faces = flat_faces(vertices, facets(normals, np.zeros(len(vertices), int))[0])
    assert faces is not None
    return faces, triangle_tree(vertices), normals


def turned(vertices, seed):
    """Rotated at random, so that no face follows an axis."""
    turn, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return vertices @ (turn * np.linalg.det(turn)).T


def scenes():
    rng = np.random.default_rng(3)
    loose = rng.uniform(0, 500, (30, 1, 3)) + rng.uniform(-80, 80, (30, 3, 3))
    bent = 500 * BOX + rng.uniform(-9, 9, BOX.shape)  # no quadrilateral is plane
    return {
        "published box": build_tracer(cornell_box()).vertices,
        "turned box": turned(500 * triangles(BOX), 1),
        "loose triangles": loose,
        "bent walls": triangles(bent),
    }


@pytest.mark.parametrize("name", scenes())
def test_random_rays_meet_what_embree_says(name):
    vertices = scenes()[name]
    faces, tree, normals = both(vertices)
    rng = np.random.default_rng(7)
    low, high = vertices.reshape(-1, 3).min(axis=0), vertices.reshape(-1, 3).max(axis=0)
    direction = directions(rng)
    ray = rays(rng.uniform(low - 200, high + 200, (COUNT, 3)), direction)
    hits, expected = hit_of(faces, ray), hit_of(tree, ray)
    (hit, _, triangle, uv), (_, _, triangle_tree, uv_tree) = hits, expected
    differs = differing(hits, expected, normals, direction)  # within rounding of an edge
    assert differs.sum() <= 20
    same = hit & ~differs & (triangle == triangle_tree)
    assert same.sum() >= hit.sum() - 40
    edge = np.linalg.norm(vertices[:, 1] - vertices[:, 0], axis=1).min()
    angle = np.abs(np.einsum("ij,ij->i", normals[triangle_tree % len(normals)], direction))
    close = np.abs(uv[:, same] - uv_tree[:, same]) * edge * angle[same]
    assert np.quantile(close, 0.999) < ROUNDING_MM
    ray.maxt = 150.0
    blocked = blocked_by(faces, ray)
    assert (blocked != blocked_by(tree, ray)).sum() <= 20
    np.testing.assert_array_equal(hit_of(faces, ray)[0], blocked)


def test_no_ray_leaves_a_closed_box():
    """Aimed at edges, corners and diagonals, where two faces or more meet, and along walls."""
    vertices = turned(500 * triangles(BOX), 2)
    faces, _, _ = both(vertices)
    rng = np.random.default_rng(8)
    corners = vertices[rng.integers(len(vertices), size=COUNT)]
    share = np.sort(rng.random((COUNT, 1)), axis=0)
    share[: COUNT // 10] = 0  # corners
    target = corners[:, 0] + share * (corners[:, 1] - corners[:, 0])
    middle = vertices.reshape(-1, 3).mean(axis=0)
    origin = middle + rng.uniform(-200, 200, (COUNT, 3)) @ np.linalg.qr(vertices[0] - middle)[0]
    origin = middle + 0.9 * (origin - middle)
    origin[::3] = middle + 0.999 * (target - middle)[::-1][::3]  # near a wall, often along it
    assert hit_of(faces, rays(origin, target - origin))[0].all()


def test_segments_between_points_of_surfaces_need_no_hull():
    vertices = build_tracer(cornell_box()).vertices
    faces, _, normals = both(vertices)
    assert 0 < sum(faces.hull) < len(faces.hull)
    rng = np.random.default_rng(9)
    indices = rng.integers(len(vertices), size=(2, COUNT))
    ray, facing = between_surfaces(vertices, normals, indices, rng)
    free, enclosed = (~blocked_by(faces, ray, enclosed=e)[facing] for e in (False, True))
    assert 0.1 < free.mean() < 0.9
    assert (free != enclosed).sum() <= 5


def test_lanes_that_are_not_asked_meet_nothing():
    faces, _, _ = both(500 * triangles(BOX))
    ray = rays(np.full((4, 3), 250.0), np.eye(4, 3) + 0.1)
    active = mi.Bool([True, False, True, False])
    hit = faces.ray_intersect_preliminary(ray, active=active)
    assert np.array(hit.is_valid()).tolist() == [True, False, True, False]
    assert np.array(dr.isfinite(hit.t)).tolist() == [True, False, True, False]
    assert np.array(faces.ray_test(ray, active)).tolist() == [True, False, True, False]


def test_many_faces_are_left_to_a_tree():
    vertices = np.random.default_rng(1).random((MOST_FACES + 1, 3, 3))
    assert flat_faces(vertices, np.arange(len(vertices))) is None
    assert isinstance(flat_faces(vertices[:-1], np.arange(len(vertices) - 1)), FlatFaces)


def block(seed=None):
    """Five faces of a block without its underside, outwards; turned where a seed is given."""
    numbers_found = triangles(200 * BOX[1:] + 100 * np.array([1, 0, 1]))
    return numbers_found if seed is None else turned(numbers_found, seed)


@pytest.mark.parametrize("seed", [None, 4])
def test_a_block_is_one_convex_body_that_rays_enter_and_leave_as_embree_says(seed):
    """From outside, from inside, and through the open side, which has no face."""
    vertices = block(seed)
    faces, tree, normals = both(vertices)
    (body,) = faces.bodies
    assert not faces.rows and faces.room is None and body.faces == [0, 1, 2, 3, 4]
    assert sum(not side.faces for side in body.sides) == 1 and body.closed
    rng = np.random.default_rng(5)
    middle = vertices.reshape(-1, 3).mean(axis=0)
    direction = directions(rng)
    ray = rays(middle + rng.uniform(-400, 400, (COUNT, 3)), direction)
    hits, expected = hit_of(faces, ray), hit_of(tree, ray)
    (hit, _, triangle, _), (_, _, triangle_tree, _) = hits, expected
    differs = differing(hits, expected, normals, direction)
    assert differs.sum() <= 20
    assert 0.02 < hit.mean() < 0.5
    assert (triangle[hit & ~differs] == triangle_tree[hit & ~differs]).mean() > 0.999
    ray.maxt = 250.0
    blocked = blocked_by(faces, ray)
    assert (blocked != blocked_by(tree, ray)).sum() <= 20


def test_rays_along_a_blocks_faces_meet_what_embree_says():
    """Directions with zeros of both signs, from everywhere about and inside the block."""
    faces, tree, _ = both(block())
    assert len(faces.bodies) == 1
    rng = np.random.default_rng(6)
    direction = np.zeros((COUNT, 3), np.float32)
    direction[np.arange(COUNT), rng.integers(3, size=COUNT)] = 1
    direction *= rng.choice([-1, 1], (COUNT, 3))
    ray = rays(rng.uniform(-50, 400, (COUNT, 3)), direction)
    (hit, t, *_), (hit_tree, t_tree, *_) = hit_of(faces, ray), hit_of(tree, ray)
    np.testing.assert_array_equal(hit, hit_tree)
    np.testing.assert_allclose(t[hit], t_tree[hit], atol=ROUNDING_MM)
    np.testing.assert_array_equal(blocked_by(faces, ray), hit_tree)


def test_what_is_no_convex_body_is_the_room_or_single_faces():
    """A block with a face that looks inwards, one with a dent, and walls seen from inside."""
    good = block()
    inwards = good.copy()
    inwards[[0, 5]] = inwards[[0, 5], ::-1]
    dent = good.copy()
    dent[np.all(np.isclose(dent, good[0, 0]), axis=-1)] += 0.5 * (good.reshape(-1, 3).mean(axis=0) - good[0, 0])
    for vertices, single in ((inwards, 0), (dent, 2), (good[:, ::-1], 0)):
        faces, _, _ = both(vertices)
        assert not faces.bodies and len(faces.rows) == single
        assert len(faces.room.faces if faces.room else []) + single == len(faces.planes)


def test_the_walls_of_the_published_box_are_one_room_with_a_divided_ceiling():
    faces = build_tracer(cornell_box()).accelerator
    assert faces.room.faces == np.flatnonzero(faces.hull).tolist() and not faces.rows
    assert [len(side.faces) for side in faces.room.sides if len(side.faces) > 1] == [5]
    assert sum(not side.faces for side in faces.room.sides) == 1  # the front


def fan(quad, middle):
    """Four triangles about a point of a quadrilateral."""
    return np.stack([quad, np.roll(quad, -1, axis=0), np.broadcast_to(middle, (4, 3))], axis=1)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_wall_of_several_faces_is_divided_as_embree_says(seed):
    """A wall of four triangles, some joined; one with a gap, which stays open there."""
    rng = np.random.default_rng(seed)
    quads = 500 * BOX
    middles = [(quad.T * rng.dirichlet((3, 3, 3, 3))).sum(axis=1) for quad in quads[:2]]
    parts = [fan(quad, middle) for quad, middle in zip(quads[:2], middles, strict=True)]
    vertices = turned(np.concatenate([parts[0], parts[1][:3], triangles(quads[2:])]), seed)
    faces, tree, normals = both(vertices)
    assert max(len(side.faces) for side in faces.room.sides) in (3, 4)
    assert sum(not side.faces for side in faces.room.sides) == 1 and len(faces.rows) in (2, 3)
    rng = np.random.default_rng(seed)
    middle = vertices.reshape(-1, 3).mean(axis=0)
    direction = directions(rng)
    ray = rays(middle + rng.uniform(-350, 350, (COUNT, 3)), direction)
    hits, expected = hit_of(faces, ray), hit_of(tree, ray)
    (hit, _, triangle, _), (_, _, triangle_tree, _) = hits, expected
    differs = differing(hits, expected, normals, direction)
    assert differs.sum() <= 20
    assert (triangle[hit & ~differs] != triangle_tree[hit & ~differs]).sum() <= 40
    assert set(triangle[hit]) == {*range(len(vertices))}


def test_rays_from_within_cross_one_wall_of_the_room():
    """That which they would meet if the blocks were not there, single faces among them."""
    vertices = np.concatenate([triangles(500 * BOX[:5, ::-1]), block() + np.array([50, 0, 50])])
    gap = vertices.copy()
    gap[0, 2] = gap[0].mean(axis=0)  # a floor that does not fill its side
    for corners, single in ((vertices, 0), (gap, 2)):
        faces, _, _ = both(corners)
        assert len(faces.rows) == single
        walls = [i for i in range(len(faces.planes)) if faces.hull[i]]
        empty, *_ = both(corners[:10])
        rng = np.random.default_rng(4)
        start = rng.uniform(1, 499, (COUNT, 3))
        ray = rays(start, directions(rng))
        wall, entered = (np.array(crossings) for crossings in faces.crossed(ray, walls))
        hit, _, triangle, _ = hit_of(empty, ray)
        of = np.full(len(corners), -1)
        of[faces.triangles.numpy()[::2]] = of[faces.triangles.numpy()[1::2]] = range(len(faces.planes))
        expected = np.where(hit, of[triangle % len(corners)], len(faces.planes))
        assert (wall != expected).sum() <= 20
        assert 0.02 < (entered < len(faces.planes)).mean() < 0.5


def test_a_block_above_the_floor_is_entered_from_below_too():
    """Its open side is then not on the scene's hull: what is inside is met from there."""
    floor = np.array([[[0, 0, 0], [0, 0, 500], [500, 0, 500]], [[0, 0, 0], [500, 0, 500], [500, 0, 0]]], float)
    vertices = np.concatenate([floor, block() + np.array([0, 50, 0])])
    faces, tree, _ = both(vertices)
    (body,) = faces.bodies
    assert not body.closed
    start = np.array([[200.0, 1.0, 200.0], [200.0, 1.0, 20.0]])
    ray = rays(start, np.array([[0.0, 1, 0.1], [0, 1, 0.1]]))
    ray.maxt = 1000.0
    for enclosed in (False, True):
        assert np.array(faces.ray_test(ray, enclosed=enclosed)).tolist() == [True, False]
    assert np.array(tree.ray_test(ray)).tolist() == [True, False]


def test_a_fine_convex_mesh_about_the_faces_leaves_them_loose():
    index = np.arange(10_000) + 0.5
    height, turn = 1 - index / 5_000, np.pi * (1 + 5**0.5) * index  # a spiral of even density
    across = np.sqrt(1 - height**2)
    sphere = 2_000 * np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    walls = triangles(500 * BOX)[:6]
    faces = flat_faces(walls, facets(normals_of(walls), np.zeros(6, int))[0], np.concatenate([sphere, *walls]))
    assert faces.room is None and len(faces.rows) == 6
