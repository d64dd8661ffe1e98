"""Even light on flat faces: what rays meet on average is what form factors say, and pictures do not change by it."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device import SobolPoints, cosine_hemisphere, device_array, dr, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.radiosity.face_controls import CONTROLLED
from cboxlab.rendering.radiosity.final_gather import gather, solve_light
from cboxlab.rendering.radiosity.gathering import least_variance_shares
from cboxlab.rendering.visibility import RAY_OFFSET_MM, FlatFaces
from cboxlab.scenes import Surface, cornell_box, cornell_camera
from cboxlab.scenes.shapes import sphere_mesh
from helpers.scenes.boxes import BANDS

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

#: Points and normals: floor, back wall, ceiling, the two blocks' tops, a slope in the middle of the room.
PLACES = np.array(
    [
        [[400.0, 0.0, 100.0], [0, 1, 0]],
        [[300.0, 400.0, 559.2], [0, 0, -1]],
        [[100.0, 548.8, 100.0], [0, -1, 0]],
        [[180.0, 165.0, 170.0], [0, 1, 0]],
        [[370.0, 330.0, 350.0], [0, 1, 0]],
        [[250.0, 250.0, 100.0], [0.6, -0.48, 0.64]],
    ]
)


@pytest.fixture(scope="module")
def light():
    return solve_light(cornell_box(), BANDS, patch_edge_mm=100.0, patch_samples=512, seed=3)


def test_the_mean_along_rays_is_that_of_form_factors(light):
    """2^17 Sobol' rays from each point, in 16 independent sets: within four standard errors, which are small."""
    controls, rays, sets = light.controls[0], 2**13, 16
    lanes = dr.arange(mi.UInt32, len(PLACES) * sets)
    point, normal = (device_array(mi.Float, np.repeat(PLACES[:, k], sets, axis=0)) for k in (0, 1))
    at, towards = dr.gather(mi.Point3f, point, lanes), dr.gather(mi.Vector3f, normal, lanes)
    start, numbers = at + towards * RAY_OFFSET_MM, SobolPoints(2, rays, lanes, 5)

    def body(i, sums):
        direction = cosine_hemisphere(towards, numbers.point(i, 0), numbers.point(i, 1))
        walls, blocks = controls.along(mi.Ray3f(start, direction), 3, mi.Bool(True))
        return i + 1, [old + new for old, new in zip(sums, [*walls, *blocks], strict=True)]

    zeros = [dr.zeros(mi.Float, dr.width(lanes)) for _ in range(2 * (3 + CONTROLLED))]
    _, sums = dr.while_loop((dr.zeros(mi.UInt32, dr.width(lanes)), zeros), lambda i, _: i < rays, body)
    means = np.array([total.numpy() for total in sums]).reshape(-1, len(PLACES), sets) / rays
    walls, blocks = controls.mean(start, towards, 3)
    exact = np.array([total.numpy() for total in (*walls, *blocks)]).reshape(-1, len(PLACES), sets).mean(axis=2)
    error = means.std(axis=2, ddof=1) / np.sqrt(sets)
    size = np.abs(exact).max(axis=1, keepdims=True)
    assert (np.abs(means.mean(axis=2) - exact) <= 4 * error + 2e-6 * size).all()
    assert (error < 4e-3 * size + 1e-9).all()
    assert np.count_nonzero(size) >= 3 + 2 * CONTROLLED + 1  # walls of three materials, blocks of one


def test_pictures_have_the_same_mean_and_less_noise_with_them(light):
    camera = cornell_camera(24)
    with_them = gather(light, camera, 256, 16, seed=1)
    without = gather(replace(light, controls=(None,)), camera, 256, 16, seed=2)
    controlled, other = (image.coefficients.astype(float) @ image.spectra for image in (with_them, without))
    mask = with_them.coverage.max(axis=-1) == 1
    mask &= ~with_them.sees_lamp
    scatter = [np.median(x.var(axis=0, ddof=1)[mask] / x.mean(axis=0)[mask] ** 2) for x in (controlled, other)]
    assert scatter[0] < 0.7 * scatter[1]
    means = [x[:, mask].mean(axis=1) for x in (controlled, other)]
    error = np.sqrt(sum(m.var(axis=0, ddof=1) for m in means) / 16)
    assert (np.abs(means[0].mean(axis=0) - means[1].mean(axis=0)) < 4.5 * error).all()


def test_shares_are_those_of_least_squares():
    """Of correlated numbers, against NumPy's; where the faces have no light that varies, nothing is taken off."""
    rng = np.random.default_rng(2)
    w, noise, control = rng.standard_normal((3, 500, 64)) + 1
    b = 0.6 * w + control
    v = np.linspace(0.2, 0.7, 500)[:, None] * w + 0.4 * b + noise
    products = v, w, b, v * w, v * b, w * w, w * b, b * b
    shares = least_variance_shares([device_array(mi.Float, p.mean(axis=1)) for p in products])
    centred = [x - x.mean(axis=1, keepdims=True) for x in (v, w, b)]
    exact = [np.linalg.lstsq(np.stack([x, y], axis=1), z, rcond=None)[0] for z, x, y in zip(*centred, strict=True)]
    assert np.stack([x.numpy() for x in shares], axis=1) == pytest.approx(np.clip(exact, 0, 1), abs=2e-4)
    nothing = least_variance_shares([mi.Float(x) for x in (1, 0, 0, 0, 0, 0, 0, 0)])
    assert [x.numpy()[0] for x in nothing] == [0, 0]


def test_each_pixel_takes_off_what_leaves_the_least_noise(light):
    """Relative variances with faces' light taken off over those without, means over a surface's pixels.

    With all of it taken off everywhere they are 1.24 on the floor, where in a block's shadow the walls are hidden, and
    0.66 on the short block; with the shares of walls and blocks exchanged 1.0 on the latter.
    """
    camera = cornell_camera(48)
    with_them = gather(light, camera, 128, 32, seed=1)
    without = gather(replace(light, controls=(None,)), camera, 128, 32, seed=1)
    controlled, other = (
        values.var(axis=0, ddof=1) / np.maximum(values.mean(axis=0), 1e-30) ** 2
        for values in ((i.coefficients.astype(float) @ i.spectra)[..., 1] for i in (with_them, without))
    )
    mask = (with_them.coverage.max(axis=-1) == 1) & ~with_them.sees_lamp
    for name, most in (("floor", 1.05), ("short-block", 0.62), ("back", 0.55)):
        region = mask & (with_them.surface == with_them.surface_names.index(name))
        assert controlled[region].mean() < most * other[region].mean(), name
    ratio = np.sqrt(controlled[mask] / other[mask])
    assert np.percentile(ratio, 50) < 0.8
    assert np.percentile(ratio, 99) < 2


def test_faces_that_lie_on_one_another_count_once():
    """A second floor in the floor's place: the same walls are controlled."""
    box = cornell_box()
    floor = next(s for s in box.surfaces if s.name == "floor")
    double = replace(box, surfaces=(*box.surfaces, replace(floor, name="second-floor")))
    controls = [solve_light(b, BANDS, patch_edge_mm=200.0, patch_samples=64).controls[0] for b in (box, double)]
    assert controls[0].count == controls[1].count
    assert controls[0].walls == controls[1].walls


def test_scenes_in_a_tree_have_none():
    box = cornell_box()
    ball = Surface("ball", "white", *sphere_mesh((185, 83, 169), 80))
    light = solve_light(replace(box, surfaces=(*box.surfaces, ball)), BANDS, patch_edge_mm=200.0, patch_samples=64)
    assert not isinstance(light.tracer.accelerator, FlatFaces)
    assert light.controls == (None,)
