"""Direct light against analytic form factors, and pictures against enclosures whose radiance is known.

Every random number has a fixed seed. Each statistical comparison of the rendering tests (this file,
test_radiosity and test_integrators) fails by chance with a probability of at most 1e-6; there are about 300,
so one choice of all seeds in 3,000 would fail somewhere.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from cboxlab.rendering.device import dr, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.path_points import PathPoints
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.radiosity.final_gather import render_final_gather
from cboxlab.rendering.radiosity.lamp import build_lamp_samplers, direct_light
from cboxlab.rendering.visibility.primary import facet_coverage, pixel_coverage
from cboxlab.rendering.visibility.tracer import RAY_OFFSET_MM, build_tracer
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.lens import Lens
from cboxlab.validation.compare_renders.renderers.closed_forms import (
    parallel_squares,
    perpendicular_rectangles,
)
from helpers.scenes.boxes import BANDS, EDGE, box_with_lamp, camera_inside, grey, lamp_and, quad, square, walls
from oracles.form_factors import corner_to_rectangle
from scipy.integrate import dblquad
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

SIGMAS = 4.9


def light_at(scene, position, normal, samples=2**16, seed=1):
    """Mean of direct_light and its standard error over points (n, 3) with normals (n, 3), cycled."""
    tracer = build_tracer(scene)
    (lamp,) = build_lamp_samplers(tracer)
    position, normal = (np.resize(x, (samples, 3)).astype(np.float32) for x in (position, normal))
    generator = np.random.default_rng(seed)
    u, v = generator.random((2, samples)).astype(np.float32)
    value = direct_light(
        tracer,
        lamp,
        mi.Point3f(position.T),
        mi.Vector3f(normal.T),
        mi.Float(u),
        mi.Float(v),
        mi.Bool(np.ones(samples, bool)),
    )
    value = np.array(value, float)
    return value.mean(), value.std() / np.sqrt(samples)


def spread(corners, count, seed=2):
    """Points uniform over a quad that is a parallelogram."""
    s, t = np.random.default_rng(seed).random((2, count, 1))
    return corners[0] + s * (corners[1] - corners[0]) + t * (corners[3] - corners[0])


@pytest.mark.parametrize("distance", [150.0, 500.0, 2000.0, 8000.0])
def test_a_lamp_seen_whole_is_known_without_noise(distance):
    """Straight below a square lamp's centre: the catalogue's value in single precision, no scatter."""
    lamp = square(np.array([0.0, distance, 0.0]), 500.0, 1, -1)
    floor = quad("floor", square(np.zeros(3), 2000.0, 1, 1))
    mean, error = light_at(lamp_and([floor], lamp), np.zeros(3), np.array([0.0, 1.0, 0.0]), 256)
    expected = 4 * corner_to_rectangle(500.0, 500.0, distance - RAY_OFFSET_MM)
    assert mean == pytest.approx(expected, rel=3e-6)
    assert error < 1e-6 * expected


@pytest.mark.parametrize("distance", [300.0, 1000.0])
def test_parallel_squares(distance):
    """Two squares of side 1 m face each other: the mean irradiance over pi L is the form factor."""
    below = square(np.zeros(3), 500.0, 1, 1)
    scene = lamp_and([quad("floor", below)], square(np.array([0.0, distance, 0.0]), 500.0, 1, -1))
    count = 2**16
    mean, error = light_at(scene, spread(below, count), np.array([0.0, 1.0, 0.0]), count)
    expected = parallel_squares(1000.0 / distance)
    assert error < 0.005 * expected
    assert abs(mean - expected) < SIGMAS * error


def test_perpendicular_squares():
    """A wall of 1 m and a lamp of 1 m at right angles, 0.2 m from their common edge (gap by C-14 twice)."""
    wall = square(np.array([0.0, 500.0, 500.0]), 500.0, 0, 1)
    ceiling = square(np.array([700.0, 1000.0, 500.0]), 500.0, 1, -1)
    count = 2**16
    scene = lamp_and([quad("wall", wall)], ceiling)
    mean, error = light_at(scene, spread(wall, count), np.array([1.0, 0.0, 0.0]), count)
    expected = perpendicular_rectangles(1.2, 1.0) - perpendicular_rectangles(0.2, 1.0)
    assert error < 0.01 * expected
    assert abs(mean - expected) < SIGMAS * error


def test_a_wall_that_the_lamp_touches():
    """Squares of 1 m with a common edge: the catalogue's 0.20004, and each point's value without noise of the lamp.

    Points on the wall have the lamp's edge in their own horizon. Errors come from the points' places alone: their
    scatter over that of a mean of exact values is 1.
    """
    wall = square(np.array([0.0, 500.0, 500.0]), 500.0, 0, 1)
    scene = lamp_and([quad("wall", wall)], square(np.array([500.0, 1000.0, 500.0]), 500.0, 1, -1))
    count = 2**18
    mean, error = light_at(scene, spread(wall, count), np.array([1.0, 0.0, 0.0]), count)
    assert error < 0.0015 * mean
    assert abs(mean - perpendicular_rectangles(1.0, 1.0)) < SIGMAS * error
    near = np.array([[0.0, 999.0, 400.0]])
    assert light_at(scene, near, np.array([1.0, 0.0, 0.0]), 4096)[1] < 1e-6


def test_a_lamp_cut_by_the_horizon_is_known_without_noise():
    """A wall through a lamp: the part in front of it counts, by quadrature."""
    scene = lamp_and([], square(np.array([100.0, 1000.0, 500.0]), 500.0, 1, -1))
    mean, error = light_at(scene, np.array([[0.0, 300.0, 480.0]]), np.array([1.0, 0.0, 0.0]), 4096)

    def share(z, x):
        offset = np.array([x - RAY_OFFSET_MM, 700.0, z - 480.0])
        return offset[0] * offset[1] / (offset @ offset) ** 2 / np.pi

    expected = dblquad(share, RAY_OFFSET_MM, 600.0, 0.0, 1000.0)[0]
    assert mean == pytest.approx(expected, rel=1e-5) and error < 1e-6


def test_perpendicular_squares_formula_is_the_catalogue_value():
    assert perpendicular_rectangles(1.0, 1.0) == pytest.approx(0.20004, abs=1e-5)
    assert parallel_squares(1.0) == pytest.approx(0.19982, abs=1e-5)


def test_a_point_that_sees_the_whole_lamp_has_no_noise():
    """Straight below a corner: the analytic value, exactly, from every single sample."""
    lamp = square(np.array([150.0, 400.0, 100.0]), 100.0, 1, -1)
    point = np.array([[50.0, 0.0, 0.0]])
    mean, error = light_at(lamp_and([], lamp), point, np.array([0.0, 1.0, 0.0]), 4096)
    assert mean == pytest.approx(corner_to_rectangle(200.0, 200.0, 400.0), rel=2e-4)  # starts 0.01 mm above
    assert error < 1e-6


def test_a_blocker_leaves_the_rest_of_the_lamp():
    """A plate halfway hides, as seen from the origin, the lamp's half x < 0: two quarters remain."""
    lamp = square(np.array([0.0, 400.0, 0.0]), 100.0, 1, -1)
    plate = np.array([[0.0, 200, 300], [0, 200, -300], [-300, 200, -300], [-300, 200, 300]], float)
    floor = square(np.zeros(3), 1.0, 1, 1)
    scene = lamp_and([quad("plate", plate), quad("floor", floor)], lamp)
    mean, error = light_at(scene, np.zeros((1, 3)), np.array([0.0, 1.0, 0.0]))
    expected = 2 * corner_to_rectangle(100.0, 100.0, 400.0)
    assert error < 0.005 * expected
    assert abs(mean - expected) < SIGMAS * error


def test_nothing_shines_behind_the_lamp_or_under_the_horizon():
    lamp = square(np.array([0.0, 400.0, 0.0]), 100.0, 1, -1)
    up, down = np.array([0.0, 1.0, 0.0]), np.array([0.0, -1.0, 0.0])
    assert light_at(lamp_and([], lamp), np.array([[0.0, 500.0, 0.0]]), down, 1024) == (0.0, 0.0)
    assert light_at(lamp_and([], lamp), np.zeros((1, 3)), down, 1024) == (0.0, 0.0)
    assert light_at(lamp_and([], lamp), np.zeros((1, 3)), up, 1024)[0] > 0


@pytest.mark.parametrize(("exponent", "edge_ratio"), [(2.0, 1.0), (0.7, 1.0), (0.0, 0.2), (3.0, 0.5)])
@pytest.mark.parametrize("sideways", [0.0, 350.0])
def test_the_lamps_pattern_by_quadrature(exponent, edge_ratio, sideways):
    """E / (pi L) at a floor point = (1 / pi) Int p cos^(2 + n) / r^2 dA, p the pattern with mean 1."""
    half, height = 150.0, 400.0
    lamp = square(np.array([0.0, height, 0.0]), half, 1, -1)
    scene = lamp_and([], lamp, exponent=exponent, edge_ratio=edge_ratio)
    mean, error = light_at(scene, np.array([[sideways, 0.0, 0.0]]), np.array([0.0, 1.0, 0.0]))

    def integrand(x, z):
        square_distance = (x - sideways) ** 2 + z**2 + height**2
        pattern = edge_ratio + (1 - edge_ratio) * (1 - (x / half) ** 2) * (1 - (z / half) ** 2)
        cosine = height / np.sqrt(square_distance)
        return pattern * cosine ** (2 + exponent) / square_distance

    expected = dblquad(integrand, -half, half, -half, half)[0] / np.pi / (edge_ratio + (1 - edge_ratio) * 4 / 9)
    assert error < 0.003 * expected
    assert abs(mean - expected) < SIGMAS * error


def test_far_away_only_the_lamps_mean_counts():
    """On the axis at 40 widths a lamp darker at its edge gives what a uniform one gives, A / (pi r^2)."""
    lamp = square(np.array([0.0, 4000.0, 0.0]), 50.0, 1, -1)
    up = np.array([0.0, 1.0, 0.0])
    mean, error = light_at(lamp_and([], lamp, edge_ratio=0.1), np.zeros((1, 3)), up)
    assert abs(mean - 100.0**2 / (np.pi * 4000.0**2)) < SIGMAS * error + 2e-4 * mean
    assert error < 0.003 * mean


@pytest.mark.parametrize("render", [render_path_tracer, render_final_gather])
def test_a_box_that_absorbs_nothing_glows_like_its_lamp(render):
    """An enclosure of perfect white with one black lamp of radiance L: the radiance is L everywhere.

    (The lamp takes back what it gives, so the light is in equilibrium at the lamp's own radiance.) All
    orders of reflection count: direct light alone is a fifth of it.
    """
    scene = box_with_lamp(1.0, lamp_half=450.0)
    image = render(RenderJob(scene, camera_inside(16), BANDS, samples=256, batches=8, seed=5))
    wall = image.coverage[..., -1] == 0
    mean, _ = image.project(np.ones((3, 1)) / 3)
    batches = (image.coefficients[:, wall] @ image.spectra).mean(axis=(1, 2))
    error = batches.std(ddof=1) / np.sqrt(len(batches))
    assert error < 0.004
    # eight batches: Student's t with 7 degrees of freedom has its 1e-6 point at 10.4
    assert abs(batches.mean() - 1) < 10.4 * error
    assert np.abs(mean[wall] - 1).max() < 0.5


def test_random_numbers_of_a_path_are_uniform_and_independent():
    """Over many lanes, each pair of one path's numbers fills a 16 x 16 grid evenly (chi-squared, 1e-6)."""
    lanes = 2**16
    points = PathPoints(8, dr.arange(mi.UInt32, lanes), seed=3)
    for index, depth in ((0, 0), (3, 0), (5, 1), (6, 2), (7, 3), (2, 9)):
        i, d = dr.full(mi.UInt32, index, lanes), dr.full(mi.UInt32, depth, lanes)
        vertex = points.at_vertex(i, d)
        numbers = [*points.direction(i, d), vertex.light_u, vertex.light_v, vertex.roulette]
        numbers += points.pixel(i) if depth == 0 else points.direction(i, d + 1)
        values = [np.array(n) for n in numbers]
        for a in range(len(values)):
            for b in range(a):
                grid = np.histogram2d(values[a], values[b], 16, ((0, 1), (0, 1)))[0]
                statistic = np.sum((grid - lanes / 256) ** 2) / (lanes / 256)
                assert chi2.sf(statistic, 255) > 1e-6, (index, depth, a, b)


def test_each_lanes_points_are_stratified():
    """64 paths of one lane: one number in each 64th of the unit interval, at every vertex and column."""
    lane, index = np.repeat([0, 17], 64), np.tile(np.arange(64), 2)
    points = PathPoints(64, mi.UInt32(lane), seed=8)
    for depth in (0, 1, 2, 5):
        vertex = points.at_vertex(mi.UInt32(index), dr.opaque(mi.UInt32, depth, 128))
        direction = points.direction(mi.UInt32(index), dr.opaque(mi.UInt32, depth, 128))
        for numbers in (direction[0], vertex.light_v, vertex.roulette):
            cells = (np.array(numbers).reshape(2, 64) * 64).astype(int)
            assert np.all(np.sort(cells, axis=1) == np.arange(64))


def test_vertices_of_a_path_take_separate_columns():
    """Lamp points of two vertices: 64 paths reach far more of 8 x 8 cells than the 8 that one column would leave."""
    lane, index = (values.astype(np.uint32) for values in (np.zeros(64), np.arange(64)))
    points = PathPoints(64, mi.UInt32(lane), seed=3)
    first, second, third = (
        (np.array(points.at_vertex(mi.UInt32(index), dr.opaque(mi.UInt32, depth, 64)).light_u) * 8).astype(int)
        for depth in range(3)
    )
    for first_column, other in ((first, second), (first, third), (second, third)):
        assert len(np.unique(8 * first_column + other)) >= 16


def test_later_vertices_of_one_lanes_paths_are_independent():
    """4096 paths of one lane: the directions of two vertices fill an 8 x 8 grid evenly, 64 paths in each cell."""
    count = 4096
    lane, index = (values.astype(np.uint32) for values in (np.full(count, 5), np.arange(count)))
    points = PathPoints(count, mi.UInt32(lane), seed=3)
    first = {
        depth: np.array(points.direction(mi.UInt32(index), dr.opaque(mi.UInt32, depth, count))[0])
        for depth in (2, 3, 4, 7, 20)
    }
    for first_column, other in combinations(first, 2):
        cells = np.histogram2d(first[first_column], first[other], 8, ((0, 1), (0, 1)))[0]
        assert np.abs(cells - 64).max() < 6 * np.sqrt(64), (first_column, other)


@pytest.mark.parametrize(
    ("k1", "lens"),
    [
        (0.0, Lens()),
        (-0.15, Lens()),
        (0.2, Lens()),
        (-0.2, Lens(k2=0.3, p1=0.01, p2=-0.02, aspect=1.02)),
        (-0.03, Lens("fisheye", k2=0.02)),
    ],
)
def test_what_a_pixel_covers_is_where_the_camera_puts_it(k1, lens):
    """Small squares' coverage is the density of their projected points, distortion included, to 1%."""
    values = np.array([[250.0, 300.0, 900.0], [500.0, 500.0, 900.0], [800.0, 750.0, 900.0], [180.0, 850.0, 900.0]])
    marks = [quad(f"mark-{i}", square(p, 25.0, 2, -1)) for i, p in enumerate(values)]
    scene = lamp_and(marks, square(np.array([500.0, 2000.0, 500.0]), 10.0, 1, -1))
    principal = np.array([30.2, 33.4])
    camera = replace(camera_inside(64, z=-700.0, focal=1.3), k1=k1, lens=lens, principal_point_px=principal)
    coverage = facet_coverage(build_tracer(scene), camera, samples=1024)
    grid = (np.arange(500) + 0.5) / 10 - 25.0
    for index, position in enumerate(values):
        offsets = np.stack([*np.meshgrid(grid, grid), np.zeros((500, 500))], axis=-1).reshape(-1, 3)
        u, v = camera.project(position + offsets).T
        count = np.histogram2d(v, u, bins=[np.arange(65) - 0.5] * 2)[0]
        around = camera.project(position + np.array([[-25.0, 0, 0], [25, 0, 0], [0, -25, 0], [0, 25, 0]]))
        area = abs(np.linalg.det(np.stack([around[1] - around[0], around[3] - around[2]])))
        assert np.abs(coverage[..., index] - count / count.sum() * area).max() < 0.01


def crossing_squares():
    """Two squares that cut each other: no edge lies along the line where one hides the other."""
    first = square(np.array([500.0, 500.0, 900.0]), 300.0, 2, -1)
    return lamp_and(
        [quad("one", first), quad("other", first + np.array([0.0, 0.0, 0.3]) * (first[:, :1] - 430.0))],
        square(np.array([500.0, 2000.0, 500.0]), 10.0, 1, -1),
    )


def specks():
    """Squares of 0.1 x 0.1 pixels: a hundredth of a pixel."""
    positions = np.random.default_rng(4).uniform([150.0, 150.0, 900.0], [850.0, 850.0, 900.0], (40, 3))
    marks = [quad(f"mark-{i}", square(p, 1.0, 2, -1)) for i, p in enumerate(positions)]
    return lamp_and(marks, square(np.array([500.0, 2000.0, 500.0]), 10.0, 1, -1))


def turned(camera, degrees):
    """From the middle of the cube, edges pass next to and behind the camera."""
    turn = Rotation.from_rotvec(degrees, degrees=True).as_matrix()
    return replace(camera, rotation=turn @ camera.rotation, position_mm=np.full(3, 480.0))


@pytest.mark.parametrize(
    ("scene", "camera"),
    [
        (specks(), camera_inside(64, z=-700.0, focal=1.3)),
        (crossing_squares(), camera_inside(64, z=-700.0, focal=1.3)),
        (cornell_box(), cornell_camera(64)),
        (box_with_lamp(0.5), turned(camera_inside(64), [25.0, 10.0, 40.0])),
        (box_with_lamp(0.5), replace(turned(camera_inside(64, focal=0.8), [60.0, -20.0, 5.0]), k1=-0.12)),
        (box_with_lamp(0.5), replace(turned(camera_inside(64, focal=0.8), [-20.0, 130.0, 0.0]), k1=0.2)),
    ],
    ids=["specks", "no edge", "published box", "inside", "barrel", "pincushion"],
)
def test_no_pixel_that_sees_several_faces_is_overlooked(scene, camera):
    """Coverage is what 1024 rays in every pixel find, to the last one."""
    tracer = build_tracer(scene)
    everywhere = pixel_coverage(tracer, [camera], np.arange(64**2), 1024)[0]
    assert np.count_nonzero((everywhere > 0) & (everywhere < 1)) > 40
    assert np.array_equal(facet_coverage(tracer, camera, 1024).reshape(everywhere.shape), everywhere)


def test_a_lamp_in_the_corner_leaves_no_tails():
    """A lamp against two walls, 64 samples a pixel: no pixel of a batch is off by half; single ones were 16 times too
    bright."""
    ceiling = {
        "lamp": [[0, 400], [400, 400], [400, 1000], [0, 1000]],
        "behind": [[400, 0], [1000, 0], [1000, 1000], [400, 1000]],
        "before": [[0, 0], [400, 0], [400, 400], [0, 400]],
    }
    corners = {name: np.array([[x, EDGE, z] for x, z in quads], float) for name, quads in ceiling.items()}
    surfaces = [quad(n, c) for n, c in walls().items() if n != "ceiling"]
    surfaces += [quad(name, corners[name]) for name in ("behind", "before")]
    scene = replace(lamp_and(surfaces, corners["lamp"]), materials={"grey": grey(0.6)})
    image = render_final_gather(RenderJob(scene, camera_inside(24), BANDS[:1], samples=64, batches=6, seed=3))
    values = (image.coefficients @ image.spectra)[..., 0]
    middle = np.median(values, axis=0)
    assert np.abs(values / middle - 1)[:, ~image.sees_lamp].max() < 0.5


@pytest.mark.parametrize("render", [render_path_tracer, render_final_gather])
def test_a_symmetric_box_looks_symmetric(render):
    """The box and the camera are their own mirror images in x, so left and right differ by noise only."""
    camera = camera_inside(20, z=-900.0, focal=0.9)
    image = render(RenderJob(box_with_lamp(0.6, front=False), camera, BANDS, samples=32, batches=16, seed=11))
    mean, variance = image.project(np.ones((3, 1)) / 3)
    alone = image.single_surface & (image.surface >= 0)
    alone &= alone[:, ::-1]
    left_right = alone.copy()
    left_right[:, 10:] = False
    spread_of = variance + variance[:, ::-1]
    left_right &= spread_of[..., 0] > 0
    z = (mean - mean[:, ::-1])[left_right] / np.sqrt(spread_of[left_right])
    assert len(z) > 100
    # the sum of n squares of nearly normal scores (30 degrees of freedom) has variance about 2.5 n
    assert abs(np.mean(z)) < SIGMAS * np.sqrt(1.07 / len(z))
    assert np.mean(z**2) < 1.07 + SIGMAS * np.sqrt(2.5 / len(z))


def test_the_room_is_as_large_as_the_tests_believe():
    assert box_with_lamp(0.5).surface("floor").areas_mm2.sum() == pytest.approx(EDGE**2)
