"""Interreflection between patches: conservation of energy, reciprocity, the white furnace, patches.

False alarms: as stated in test_render_physics.
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device import device_array, dr, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.radiosity import solution
from cboxlab.rendering.radiosity.lamp import build_lamp_samplers, direct_light
from cboxlab.rendering.radiosity.patch_slopes import PatchSlopes, build_slopes
from cboxlab.rendering.radiosity.patches import build_patches, patch_of, patch_points
from cboxlab.rendering.radiosity.solution import indirect_basis, solve_exchange, trace_exchange
from cboxlab.rendering.visibility.tracer import build_tracer
from cboxlab.scenes import Scene, Surface, cornell_box
from cboxlab.scenes.shapes import box_mesh, sphere_mesh
from helpers.scenes.boxes import EDGE, FLAT, box_with_lamp, grey, lamp_and, quad, square, walls

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

SIGMAS = 4.9


def exchange_of(scene, edge_mm, samples, seed):
    tracer = build_tracer(scene)
    patches = build_patches(tracer, edge_mm)
    return tracer, patches, trace_exchange(tracer, build_lamp_samplers(tracer), patches, samples, seed)


def closed_cube():
    """A cube without opening; the lamp hangs outside."""
    lamp = square(np.full(3, -EDGE), 10.0, 1, -1)
    return lamp_and([quad(name, corners) for name, corners in walls().items()], lamp)


@pytest.fixture(scope="module")
def cornell_patches():
    tracer = build_tracer(cornell_box())
    return tracer, build_patches(tracer, 90.0)


def test_patches_tile_their_surfaces(cornell_patches):
    """Areas sum to the surfaces', no edge is longer than asked, all patches of a triangle are equal."""
    tracer, patches = cornell_patches
    for index, surface in enumerate(tracer.scene.surfaces):
        total = patches.area[patches.surface == index].sum()
        assert total == pytest.approx(surface.areas_mm2.sum(), rel=1e-12)
    edges = np.linalg.norm(patches.corners - np.roll(patches.corners, 1, axis=1), axis=2)
    assert edges.max() <= 90.0 * (1 + 1e-12)
    for triangle in np.unique(patches.triangle):
        assert np.ptp(patches.area[patches.triangle == triangle]) < 1e-9 * patches.area.max()


def test_every_point_of_a_patch_belongs_to_it(cornell_patches):
    """Random points of every patch, from its corners, are found again by triangle and barycentric place."""
    tracer, patches = cornell_patches
    weights = np.random.default_rng(4).dirichlet(np.ones(3), (50, len(patches)))
    weights = 0.002 / 3 + 0.998 * weights  # not within rounding of an edge
    points = np.einsum("spk,pkx->spx", weights, patches.corners)
    a, b, c = np.moveaxis(tracer.vertices[patches.triangle], 1, 0)
    basis = np.stack([b - a, c - a], axis=-1)
    uv = np.einsum("pkx,spx->spk", np.linalg.pinv(basis), points - a).reshape(-1, 2)
    triangle = np.tile(patches.triangle, 50).astype(np.uint32)
    active = dr.full(mi.Bool, True, len(uv))
    patch = patch_of(patches, mi.UInt32(triangle), mi.Point2f(uv.T.astype(np.float32)), active)
    assert np.array_equal(np.array(patch), np.tile(np.arange(len(patches)), 50))


def test_slopes_reproduce_a_plane(cornell_patches):
    """Values that change evenly over each flat face are found exactly at any place of patches that have two
    neighbours; the weights in Dr.Jit say the same."""
    tracer, patches = cornell_patches
    slopes = build_slopes(tracer, patches)
    generator = np.random.default_rng(8)
    per_facet = generator.standard_normal((len(tracer.facet_surface), 3))
    facet = patches.facet
    values = np.einsum("px,px->p", per_facet[facet], slopes.centre)[:, None]
    patch = np.repeat(np.arange(len(patches)), 4)
    points = np.einsum("nk,nkx->nx", generator.dirichlet(np.ones(3), len(patch)), patches.corners[patch])
    values_at = slopes.at(values, patch, points)[:, 0]
    mask = (slopes.neighbour != np.arange(len(patches))[:, None]).sum(axis=1) >= 2
    assert mask.mean() > 0.9
    expected = np.einsum("nx,nx->n", per_facet[facet[patch]], points)
    # the triangles of a face are coplanar within 2 degrees only, so a plane through their patches is, too
    flat = ~np.isin(
        facet[patch],
        [f for f in range(len(per_facet)) if np.ptp(tracer.normals[tracer.facet == f], axis=0).max() > 1e-9],
    )
    used = mask[patch] & flat
    assert used.sum() > 1000
    assert values_at[used] == pytest.approx(expected[used], abs=1e-6 * np.abs(expected).max())
    parts = slopes.weights(
        mi.UInt32(patch.astype(np.uint32)),
        mi.Point3f(points.T.astype(np.float32)),
        dr.full(mi.Bool, True, len(patch)),
    )
    compiled_values = sum(np.array(w) * values[np.array(n), 0] for n, w in parts)
    assert compiled_values == pytest.approx(values_at, abs=1e-4 * np.abs(values).max())


def test_what_leaves_a_patch_arrives_or_escapes():
    """In an open box without a lamp in sight every ray meets a patch or leaves: rows and escape sum to 1."""
    scene = lamp_and([quad(n, c) for n, c in walls(front=False).items()], square(np.full(3, -EDGE), 10.0, 1, -1))
    _, _, exchange = exchange_of(scene, 250.0, 512, seed=1)
    assert exchange.form_factors.sum(axis=1) + exchange.escape == pytest.approx(1.0, abs=2e-6)
    # one side of six is missing
    assert 0.1 < exchange.escape.mean() < 0.3
    assert np.all(exchange.direct == 0)


def test_what_stands_on_a_patch_takes_its_place():
    """Patches under a block have no light and no form factors; those it covers in part have their free part's.

    A block stands on the floor of an open box. A floor patch's free points see the surroundings whole, so its
    row and escape sum to 1 as everywhere else; their direct light is that of the free points alone.
    """
    lamp = square(np.array([EDGE / 2, 900.0, EDGE / 2]), 100.0, 1, -1)
    middle = np.array([EDGE / 2, 100.0, EDGE / 2])
    block = Surface("block", "grey", *box_mesh(middle, [420.0, 200.0, 420.0], 0.0))
    boxes = [quad(n, c) for n, c in walls(ceiling=False).items()]
    tracer, patches, exchange = exchange_of(lamp_and([*boxes, block], lamp), 150.0, 1024, seed=5)
    _, _, dark = exchange_of(lamp_and([*boxes, block], square(np.full(3, -EDGE), 10.0, 1, -1)), 150.0, 256, seed=5)
    floor = patches.surface == list(walls(ceiling=False)).index("floor")
    inside = np.abs(patches.corners[:, :, [0, 2]] - EDGE / 2).max(axis=2) < 210.0
    under, free, partly = (floor & x for x in (inside.all(1), ~inside.any(1), inside.any(1) & ~inside.all(1)))
    assert under.sum() > 4 and partly.sum() > 8 and free.sum() > 20
    total = dark.form_factors.sum(axis=1) + dark.escape
    assert np.all(total[under] == 0) and np.all(exchange.direct[under] == 0)
    assert not np.isin(exchange.slopes.neighbour[free | partly], np.nonzero(under)[0]).any()
    assert total[partly] == pytest.approx(1.0, abs=1e-5)
    assert total[free] == pytest.approx(1.0, abs=1e-5)
    # what reaches the floor next to the block: from points of the patch itself, outside the block's base
    generator = np.random.default_rng(1)
    for index in np.nonzero(partly)[0][:6]:
        points = generator.dirichlet(np.ones(3), 2**14) @ patches.corners[index]
        points = points[np.abs(points[:, [0, 2]] - EDGE / 2).max(axis=1) > 210.0].astype(np.float32)
        u, v = generator.random((2, len(points))).astype(np.float32)
        normal = mi.Vector3f(np.tile(np.array([[0.0], [1.0], [0.0]], np.float32), len(points)))
        active = mi.Bool(np.ones(len(points), bool))
        light = np.array(
            direct_light(
                tracer, build_lamp_samplers(tracer)[0], mi.Point3f(points.T), normal, mi.Float(u), mi.Float(v), active
            ),
            float,
        )
        # the exchange's own points, at least 100 of them, are no noisier than as many independent ones
        error = light.std() * np.sqrt(1 / len(light) + 1 / (1024 * len(points) / 2**14))
        assert abs(exchange.direct[index, 0] - light.mean()) < SIGMAS * error + 1e-6


@pytest.fixture(scope="module")
def room_with_a_ball():
    """A ball of small triangles in a box with an open front and a lamp that lights nothing; patches of 200 mm."""
    ball = Surface("ball", "grey", *sphere_mesh([500.0, 300.0, 500.0], 150.0), ball=True)
    surfaces = [quad(n, c) for n, c in walls(front=False).items()]
    scene = lamp_and([*surfaces, ball], square(np.full(3, -EDGE), 10.0, 1, -1))
    return exchange_of(scene, 200.0, 2048, seed=6)


def test_a_curved_surface_has_few_faces(room_with_a_ball):
    """Its faces are nearly flat and cover all directions; walls keep a face each."""
    tracer, *_ = room_with_a_ball
    faces = np.unique(tracer.facet[tracer.surface == 5])
    assert 20 < len(faces) <= 48
    for face in faces:
        normals = tracer.normals[tracer.facet == face]
        assert (normals @ normals[0]).min() > np.cos(np.radians(35))
    assert len(tracer.facet_surface) == 5 + len(faces) + 1


def test_small_triangles_share_patches(room_with_a_ball):
    """Groups have their triangles' area, every triangle finds its own group, and points on it are spread by area."""
    tracer, patches, _ = room_with_a_ball
    ball = patches.surface == 5
    assert ball.sum() < 400
    assert patches.area[ball].sum() == pytest.approx(4 * np.pi * 150.0**2, rel=1e-9)
    middle = np.full(2, 1 / 3)
    where = mi.Point2f(np.tile(middle[:, None], len(patches.triangle)).astype(np.float32))
    inside = mi.UInt32(patches.triangle.astype(np.uint32))
    pieces = ball[patches.patch]
    values = np.array(patch_of(patches, inside, where, dr.full(mi.Bool, True, len(patches.triangle))))
    assert np.array_equal(values[pieces], patches.patch[pieces])
    count = 4096
    lane = mi.UInt32(np.repeat(np.flatnonzero(ball), count).astype(np.uint32))
    u, v = np.random.default_rng(2).random((2, count * ball.sum())).astype(np.float32)
    position, normal = patch_points(tracer, patches)(lane, mi.Float(u), mi.Float(v))
    points = np.array(position).T.reshape(-1, count, 3)
    error = points.std(axis=1) / np.sqrt(count)
    assert (np.abs(points.mean(axis=1) - patches.centre[ball]) < SIGMAS * error + 1e-3).all()
    outward = (points - [500.0, 300.0, 500.0]) / 150.0
    assert (np.einsum("pnx,pnx->pn", outward, np.array(normal).T.reshape(-1, count, 3)) > 0.998).all()


def test_groups_of_triangles_exchange_light_as_patches_do(room_with_a_ball):
    """Rows and escape sum to 1, rays from the ball to the walls and back agree, and a ball does not see itself."""
    _, patches, exchange = room_with_a_ball
    assert exchange.form_factors.sum(axis=1) + exchange.escape == pytest.approx(1.0, abs=1e-5)
    member = np.eye(7)[patches.surface][:, :6]
    fraction = exchange.form_factors @ member
    flow = member.T @ (patches.area[:, None] * fraction)
    variance = member.T @ (patches.area[:, None] ** 2 * fraction * (1 - fraction) / 2048)
    z = (flow - flow.T) / np.sqrt(variance + variance.T + 1e-300)
    assert np.abs(z[np.triu_indices(6, 1)]).max() < SIGMAS
    assert flow[5, 5] == 0
    assert flow[5].sum() > 0.7 * patches.area[patches.surface == 5].sum()


def test_reciprocity():
    """A_i F_ij = A_j F_ji for all pairs of surfaces: ray counts from both ends agree (binomial errors).

    The floor is not compared: the blocks cover a part that has no form factors. The lamp reflects, so it is the
    last of the surfaces; what it gives to each of them is the light that falls on them directly.
    """
    tracer, patches, exchange = exchange_of(cornell_box(), 60.0, 1024, seed=2)
    surfaces = len(tracer.scene.surfaces) + 1
    member = np.eye(surfaces)[patches.surface]
    flow = member.T @ (patches.area[:, None] * exchange.form_factors) @ member
    # stratified points only lower the variance of independent rays that is used here
    fraction = exchange.form_factors @ member
    variance = member.T @ (patches.area[:, None] ** 2 * fraction * (1 - fraction) / 1024)
    z = (flow - flow.T) / np.sqrt(variance + variance.T + 1e-300)
    free = [i for i, surface in enumerate(tracer.scene.surfaces) if surface.name != "floor"] + [surfaces - 1]
    pairs = z[np.ix_(free, free)][np.triu_indices(len(free), 1)]
    assert len(pairs) == 21
    assert np.abs(pairs).max() < SIGMAS
    received = member.T @ (patches.area * exchange.direct[:, 0])
    error = np.sqrt(variance[-1]) + 2e-3 * received  # direct light varies over a patch less than hits do
    assert np.all(np.abs(flow[-1] - received)[free] <= SIGMAS * error[free])
    assert np.count_nonzero(received[free]) == 5 and received[-1] == 0  # not the ceiling, nor the lamp itself
    assert flow.sum() > 0.2 * patches.area.sum()


def test_white_furnace():
    """A closed cube whose walls emit 1 and reflect r glows with 1 / (1 - r) everywhere, to 0.01%.

    So it does from any start: darkness, or light that differs from wall to wall. ``solve`` takes what arrives first, so
    walls that emit 1 by themselves are walls onto which 1 / r falls.
    """
    _, patches, exchange = exchange_of(closed_cube(), 250.0, 256, seed=3)
    reflectance = np.broadcast_to([0.1, 0.5, 0.9], (len(patches), 3))
    uneven = 1.0 + patches.surface[:, None] * [0.1, 0.2, 0.3]
    for near in (None, uneven):
        radiance = solve_exchange(exchange, reflectance, source=1.0 / reflectance, near=near)
        assert radiance == pytest.approx(1.0 / (1.0 - reflectance), rel=1e-4)


def test_black_walls_pass_nothing_on():
    _, patches, exchange = exchange_of(closed_cube(), 500.0, 64, seed=3)
    direct_only = replace(exchange, direct=np.ones_like(exchange.direct))
    coefficients, spectra = indirect_basis(direct_only, 0, np.ones((len(patches), 1)), np.zeros((1, 5)))
    assert np.all(coefficients @ spectra == 0.0)


class Doubled(PatchSlopes):
    def weights(self, patch, position, active):
        return [(patch, mi.Float(2.0))]


def test_light_that_multiplies_is_refused():
    """Rays that find more than all of a hemisphere are no exchange of light."""
    tracer, patches, sound = exchange_of(closed_cube(), 500.0, 64, seed=3)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(ArithmeticError, match="2 of their light"):
        patch.setattr(solution, "build_slopes", lambda *_: Doubled(**vars(sound.slopes)))
        with pytest.warns(RuntimeWarning, match="differs in nothing"):
            trace_exchange(tracer, build_lamp_samplers(tracer), patches, 64, 3)


def test_a_disturbed_exchange_is_traced_once_more():
    """The message names the disturbed numbers: here the slopes of one patch, and with them the form factors to it."""
    tracer, patches, sound = exchange_of(closed_cube(), 500.0, 64, seed=3)
    across = sound.slopes.across.copy()
    across[17] = np.nan
    lost = replace(sound.slopes, across=across, packed_across=device_array(mi.Float, across))
    solutions = iter([lost, sound.slopes])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solution, "build_slopes", lambda *_: next(solutions))
        with pytest.warns(RuntimeWarning, match="not finite") as warnings_raised:
            again = trace_exchange(tracer, build_lamp_samplers(tracer), patches, 64, 3)
    message = str(warnings_raised[0].message)
    assert "9 slopes between [17, 0, 0] and [17, 2, 2] (first bits 7fc00000)" in message
    assert "form factors between" in message and "escape" not in message
    assert np.array_equal(again.form_factors, sound.form_factors)


def test_each_reflection_of_the_furnace():
    """Stopped after n reflections the furnace holds the first n terms of its geometric series."""
    _, patches, exchange = exchange_of(closed_cube(), 500.0, 64, seed=3)
    reflectance = np.full((len(patches), 1), 0.6)
    for count in (1, 2, 5):
        radiance = solve_exchange(exchange, reflectance, source=np.ones((len(patches), 1)), max_reflections=count)
        assert radiance == pytest.approx(sum(0.6**n for n in range(1, count + 1)), rel=1e-5)


@pytest.mark.parametrize("front", [True, False])
@pytest.mark.parametrize(("reflectance", "lamp"), [(0.3, 0.0), (0.9, 0.0), (0.9, 0.6)])
def test_energy_is_conserved(front, reflectance, lamp):
    """What the lamp emits is absorbed by the walls and the lamp itself, or leaves by the opening.

    Flux over pi L: the lamp's is its area; a patch absorbs A (1 - rho) b / rho. Eight seeds give the error.
    """
    balances = []
    for seed in range(8):
        scene = box_with_lamp(reflectance, front=front, reflectance=FLAT.scaled(lamp))
        tracer, patches, exchange = exchange_of(scene, 125.0, 128, seed)
        rho = np.array([reflectance, lamp])[patches.material]
        b = solve_exchange(exchange, rho[:, None])[:, 0]
        absorbed = np.sum(patches.area * b * (1 - rho) / rho)
        elsewhere = np.maximum(1 - exchange.form_factors.sum(axis=1), 0)  # the opening, and a black lamp
        emitted = build_lamp_samplers(tracer)[0].area
        if not front:  # the lamp's own light that goes straight out: form factor by integration over the front
            emitted -= emitted * _lamp_to_front()
        balances.append((absorbed + np.sum(patches.area * b * elsewhere)) / emitted)
    error = np.std(balances, ddof=1) / np.sqrt(8)
    assert error < 0.001
    # Student's t with 7 degrees of freedom has its 1e-6 point at 10.4
    assert abs(np.mean(balances) - 1) < 10.4 * error


def _lamp_to_front():
    """Form factor of the lamp (side 400, 300 from the edge) to the front, by Lambert's formula.

    From a lamp point to the whole front wall, a rectangle at right angles; averaged over the lamp.
    """
    x, z = np.meshgrid((np.arange(200) + 0.5) * 2 + 300, (np.arange(200) + 0.5) * 2 + 300)
    total = np.zeros_like(x)
    for width in (x, EDGE - x):  # two rectangles, each with a corner at the foot of the point
        total += np.arctan(width / z) - z / np.hypot(z, EDGE) * np.arctan(width / np.hypot(z, EDGE))
    return float(np.mean(total / (2 * np.pi)))


@pytest.mark.parametrize("paints", ["published", "of lines", "white"])
def test_the_short_basis_holds_at_every_wavelength(paints):
    """The basis equals the bounce-by-bounce solution at all wavelengths: to 0.01% of the brightest patch, rms over
    patches to 0.02%. Paints of lines have other colours at wavelengths between those that it begins with."""
    scene = cornell_box()
    wavelengths = np.linspace(400, 700, 31)
    _, patches, exchange = exchange_of(scene, 120.0, 256, seed=6)
    reflectances = scene.reflectances(wavelengths)
    if paints == "of lines":
        reflectances = np.random.default_rng(2).uniform(0.05, 0.95, reflectances.shape)
    if paints == "white":
        reflectances = np.full(reflectances.shape, 0.99)
    rho = reflectances[patches.material]
    for cut in (None, 3):
        coefficients, spectra = indirect_basis(
            exchange, 0, np.eye(len(reflectances))[patches.material], reflectances, cut
        )
        expected = solve_exchange(exchange, rho, max_reflections=cut) - rho * exchange.direct
        error = np.abs(coefficients @ spectra - expected)
        assert error.max() < 1e-4 * expected.max()
        rms = np.linalg.norm(error, axis=0) / np.linalg.norm(expected, axis=0)
        assert rms.max() < 2e-4


def test_colours_do_not_mix():
    """Of two paints one is black: its patches send out nothing, the others' do."""
    surfaces = [quad(n, c, "black" if n == "left" else "grey") for n, c in walls(ceiling=False).items()]
    lamp = quad("light", walls()["ceiling"])
    scene = Scene(
        "two", tuple(surfaces), {"grey": grey(0.5), "black": grey(0.0, "black")}, lamp_and([], lamp.vertices_mm).lamp
    )
    _, patches, exchange = exchange_of(scene, 250.0, 64, seed=1)
    b = solve_exchange(exchange, np.array([[0.5], [0.0]])[patches.material])
    assert np.all(b[patches.material == 1] == 0)
    assert np.all(b[patches.material == 0] > 0)
