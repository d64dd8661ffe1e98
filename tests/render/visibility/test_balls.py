"""Balls in the kernel: the hits of the sphere itself, computed in double precision."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device import mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.visibility.faces_and_tree import FacesAndTree
from cboxlab.rendering.visibility.tracer import build_tracer, intersect
from cboxlab.scenes import Surface
from cboxlab.scenes.scene import Medium
from cboxlab.scenes.shapes import moved_on_floor, sphere_mesh
from helpers.scenes.boxes import EDGE, FLAT, box_with_lamp
from helpers.scenes.hits import COUNT, ROUNDING_MM, blocked_by, directions, hit_of, rays

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

PLACES = {"low": ([300.0, 120.0, 400.0], 120.0), "high": ([650.0, 700.0, 300.0], 80.0)}
BALLS = {name: Surface(name, "grey", *sphere_mesh(*placement), ball=True) for name, placement in PLACES.items()}


def tracer_of(*surfaces):
    box = box_with_lamp(0.5)
    return build_tracer(replace(box, surfaces=(*box.surfaces, *surfaces)))


def entered(origin, direction, centre, radius):
    """Distance to where a ray enters a sphere, infinite where it does not, and by how far it misses or dips in, mm."""
    offset = origin - centre
    along = np.einsum("ij,ij->i", offset, direction)
    margin = radius - np.linalg.norm(offset - along[:, None] * direction, axis=1)
    t = -along - np.sqrt(np.maximum(radius**2 - (radius - margin) ** 2, 0))
    return np.where((margin > 0) & (t > 0), t, np.inf), margin


def test_rays_meet_the_spheres_themselves():
    """Anywhere in the room, next to its walls: what each ray meets, where, and the ball's normal there. Within 0.05
    mm of a ball's outline rounding decides."""
    tracer, walls = tracer_of(*BALLS.values()), tracer_of()
    assert isinstance(tracer.accelerator, FacesAndTree) and tracer.accelerator.tree is None
    rng = np.random.default_rng(1)
    origin, direction = rng.uniform(1, EDGE - 1, (COUNT, 3)), directions(rng)
    each = [entered(origin, direction, np.array(centre), radius) for centre, radius in PLACES.values()]
    outside = np.all([np.linalg.norm(origin - c, axis=1) > r + 0.1 for c, r in PLACES.values()], axis=0)
    clear = outside & (np.min([np.abs(margin) for _, margin in each], axis=0) > 0.05)
    nearest, which = np.min([t for t, _ in each], axis=0), np.argmin([t for t, _ in each], axis=0)
    ray = rays(origin, direction)
    _, behind, *_ = hit_of(walls.accelerator, ray)
    hit = intersect(tracer, ray)
    distance, triangle, normal = np.array(hit.distance), np.array(hit.triangle), np.array(hit.normal).T
    off = np.abs(distance - np.minimum(nearest, behind)) * np.abs(np.einsum("ij,ij->i", normal, direction))
    assert off[clear].max() < ROUNDING_MM
    on_ball = clear & (nearest < behind)
    assert on_ball.sum() > 5000
    surface = len(walls.scene.surfaces) + which
    assert (tracer.surface[triangle] == surface)[on_ball].all()
    assert (tracer.surface[triangle] < len(walls.scene.surfaces)).sum() > 0.5 * COUNT
    centres = np.array([centre for centre, _ in PLACES.values()])[which]
    outwards = origin + distance[:, None] * direction - centres
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    np.testing.assert_allclose(normal[on_ball], outwards[on_ball], atol=1e-5)
    # the triangle that stands for the place: its edges are a thirtieth of the radius
    assert np.einsum("ij,ij->i", tracer.normals[triangle], outwards)[on_ball].min() > np.cos(1 / 25)
    ray.maxt = 300.0
    blocked = blocked_by(tracer.accelerator, ray)
    sure = clear & (np.abs(np.minimum(nearest, behind) - 300) > 0.05)
    np.testing.assert_array_equal(blocked[sure], (np.minimum(nearest, behind) < 300)[sure])


def test_rays_from_points_of_its_triangles_leave_it():
    """The triangles' middles lie up to 0.02 % of the radius within the sphere."""
    tracer = tracer_of(BALLS["low"])
    indices = np.flatnonzero(tracer.surface == len(tracer.scene.surfaces) - 1)
    indices = np.tile(indices, COUNT // len(indices))
    rng = np.random.default_rng(2)
    direction = directions(rng, len(indices))
    direction *= np.sign(np.einsum("ij,ij->i", direction, tracer.normals[indices]))[:, None]
    middles = tracer.vertices[indices].mean(axis=1)
    triangle = np.array(intersect(tracer, rays(middles, direction)).triangle)
    met_itself = np.isin(tracer.surface[triangle], tracer.surface[indices[0]])
    grazing = np.einsum("ij,ij->i", direction, tracer.normals[indices]) < 0.03
    assert not met_itself[~grazing].any()


def test_a_ball_next_to_a_mesh_and_walls():
    """A ball in front of a mesh hides it, and the other way round."""
    vertices, faces = sphere_mesh([300.0, 120.0, 700.0], 100.0)
    mesh = Surface("mesh", "grey", vertices, faces)
    tracer = tracer_of(BALLS["low"], mesh)
    assert tracer.accelerator.tree is not None and len(tracer.accelerator.balls.spheres) == 1
    height = np.linspace(30.0, 210.0, 50)
    for z, direction, first in ((50.0, 1.0, "low"), (950.0, -1.0, "mesh")):
        origin = np.column_stack([np.full(50, 300.0), height, np.full(50, z)])
        hit = intersect(tracer, rays(origin, np.tile([0.0, 0.0, direction], (50, 1))))
        names = [tracer.scene.surfaces[i].name for i in tracer.surface[np.array(hit.triangle)]]
        assert names == [first] * 50
        if first == "mesh":
            normals = tracer.normals[np.array(hit.triangle)]
            np.testing.assert_allclose(np.array(hit.normal).T, normals, atol=1e-6)
    assert np.array(hit.front).all()


def test_a_moved_ball_is_met_where_it_went():
    ball = BALLS["low"]
    moved = replace(ball, vertices_mm=moved_on_floor(ball.vertices_mm, 20.0, -30.0, 25.0))
    np.testing.assert_allclose(moved.sphere_mm[0], [320.0, 120.0, 370.0], atol=1e-6)
    hit = intersect(tracer_of(moved), rays(np.array([[320.0, 900.0, 370.0]]), np.array([[0.0, -1.0, 0.0]])))
    assert np.array(hit.distance) == pytest.approx(900 - 240, abs=0.01)


def test_what_light_passes_through_stays_a_mesh():
    """Its rays start within it, too."""
    filled = replace(BALLS["low"], inside=Medium(FLAT.scaled(0.001), FLAT.scaled(0.0)))
    assert tracer_of(filled).accelerator.balls is None
    several = [replace(BALLS["high"], name=f"ball {i}") for i in range(17)]
    assert tracer_of(*several).accelerator.balls is None
    tracer = tracer_of(BALLS["low"])
    shining = replace(tracer.scene.materials["grey"], bsdf={"type": "conductor"})
    assert build_tracer(replace(tracer.scene, materials={"grey": shining})).accelerator.balls is None


def test_lanes_that_are_not_asked_meet_no_ball():
    accelerator = tracer_of(BALLS["low"]).accelerator
    down = rays(np.full((2, 3), [300.0, 900.0, 400.0]), np.tile([0.0, -1.0, 0.0], (2, 1)))
    active = [True, False]
    assert hit_of(accelerator, down, active)[0].tolist() == active
    assert blocked_by(accelerator, down, active=mi.Bool(active)).tolist() == active
