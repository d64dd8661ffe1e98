"""Truths of a picture: closed forms of geometry and light, and sums that hold to rounding."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.dataset import light_parts, shadow_fraction, visible_points
from cboxlab.rendering.device import mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import NOTHING, RenderJob
from cboxlab.rendering.integrators import render_passes
from cboxlab.rendering.integrators.stock import scene_dict, sensor_dict
from cboxlab.rendering.visibility import film_for
from cboxlab.scenes import Lamp, Material, Scene, Spectrum, Surface, cornell_box, cornell_camera
from cboxlab.scenes.shapes import box_mesh, sphere_mesh
from helpers.scenes.boxes import BANDS, FLAT, box_with_lamp, camera_inside, quad, square

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators"),
    pytest.mark.usefixtures("large_patches"),
]


CAMERA = cornell_camera(24)


@pytest.fixture(scope="module")
def scene():
    """The published box with a paint that is black in one band, and a lamp that is dark in another."""
    box = cornell_box()
    dark = Material("dark", Spectrum(BANDS, np.array([0.0, 0.5, 0.8])))
    surfaces = tuple(replace(s, material="dark") if s.name == "left" else s for s in box.surfaces)
    materials = {"white": box.materials["white"], "green": box.materials["green"], "dark": dark}
    lamp = Lamp(box.lamp.surface, Spectrum(BANDS, np.array([1.0, 2.0, 0.0]), "zero"))
    return Scene(box.name, surfaces, materials, lamp)


@pytest.fixture(scope="module")
def image(scene):
    return render_passes(RenderJob(scene, CAMERA, BANDS, samples=64, batches=2, seed=3))


@pytest.fixture(scope="module")
def alone(image):
    """Pixels that show one surface, and no lamp."""
    return (image.coverage.max(axis=-1) == 1) & ~image.sees_lamp


def test_parts_sum_to_the_radiance_and_split_into_albedo_and_irradiance(scene, image, alone):
    """To rounding, also for a paint that is black and a lamp that is dark at a wavelength."""
    parts, mean = light_parts(image, scene), image.mean(np.eye(3))
    size = mean.max()
    np.testing.assert_allclose(parts.radiance, mean, atol=1e-6 * size)
    product = parts.albedo * parts.irradiance / np.pi
    np.testing.assert_allclose(product[alone], (mean - parts.reflections[0])[alone], atol=1e-6 * size)
    left = alone & (image.surface == [s.name for s in scene.surfaces].index("left"))
    assert (parts.irradiance[left][:, 0] > 0).all() and (mean[left][:, 0] == 0).all()
    assert not parts.irradiance[..., 2].any()
    emitted, lamp = parts.reflections[0], image.coverage[..., image.facet_surface == len(scene.surfaces)].sum(axis=-1)
    np.testing.assert_allclose(emitted, emitted[..., :1] * [1.0, 2.0, 0.0])
    np.testing.assert_allclose(emitted[..., 0], lamp, atol=0.06)


def test_albedo_is_the_reflectance_weighted_by_exact_areas(scene, image):
    parts = light_parts(image, scene)
    full = image.coverage.max(axis=-1) == 1
    for index, surface in enumerate(scene.surfaces):
        visible = full & (image.surface == index)
        expected = scene.materials[surface.material].reflectance.at(BANDS)
        np.testing.assert_allclose(parts.albedo[visible], np.broadcast_to(expected, (visible.sum(), 3)), rtol=1e-6)
    back, left = (image.coverage[..., image.facet_surface == index].sum(axis=-1) for index in (2, 4))
    edge = (back > 0) & (left > 0) & (back + left > 1 - 1e-6)
    white, dark = (scene.materials[name].reflectance.at(BANDS) for name in ("white", "dark"))
    expected = back[edge, None] * white + left[edge, None] * dark
    assert edge.any()
    np.testing.assert_allclose(parts.albedo[edge], expected, rtol=1e-5)


def test_light_of_one_reflection_is_that_of_a_rendering_with_one(scene, image, alone):
    single = render_passes(RenderJob(scene, CAMERA, BANDS, samples=64, batches=4, seed=4, max_bounces=1))
    first = light_parts(image, scene).reflections[1][alone][:, :2]
    mean, variance = (part[alone][:, :2] for part in single.project(np.eye(3)))
    error = np.sqrt(3 * variance) + 1e-5 * mean.max()  # two batches here, four there
    assert (np.abs(first - mean) < 8 * error).mean() > 0.99
    assert abs(first.sum() / mean.sum() - 1) < 3e-3


def test_direct_irradiance_of_an_empty_box_is_lamberts_form_factor():
    """Pi times the form factor of the lamp from the points at the pixels' centres, on the floor."""
    box, camera = box_with_lamp(0.5), camera_inside(24)
    picture = render_passes(RenderJob(box, camera, BANDS, samples=64, batches=2, seed=1))
    parts, points = light_parts(picture, box), visible_points(box, camera)
    floor = [s.name for s in box.surfaces].index("floor")
    on_floor = (picture.surface == floor) & (picture.coverage.max(axis=-1) == 1)
    direct = parts.reflections[1][on_floor][:, 0] / 0.5
    lamp = box.lamp.surface.vertices_mm
    expected = [_form_factor(lamp, at) for at in points.position_mm[on_floor]]
    assert on_floor.sum() > 50
    np.testing.assert_allclose(direct, expected, rtol=0.02)
    assert abs(direct.sum() / np.sum(expected) - 1) < 3e-3


def _form_factor(polygon, point):
    """Form factor of a polygon above a horizontal surface (Lambert 1760)."""
    rays = polygon - point
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(rays, np.roll(rays, -1, axis=0), strict=True):
        axis = np.cross(a, b)
        total += np.arccos(np.clip(a @ b, -1, 1)) * axis[1] / np.linalg.norm(axis)
    return abs(total) / (2 * np.pi)


def test_points_of_flat_faces_and_of_a_sphere_have_closed_forms():
    centre, radius = np.array([500.0, 300.0, 500.0]), 120.0
    scene = box_with_lamp(0.5, front=False)
    ball = Surface("ball", "grey", *sphere_mesh(centre, radius), ball=True)
    scene = Scene(scene.name, (*scene.surfaces, ball), scene.materials, scene.lamp)
    camera = camera_inside(33)
    points = visible_points(scene, camera)
    names = [s.name for s in scene.surfaces]
    rows, columns = np.indices(points.depth_mm.shape)
    d = camera.directions(columns, rows)
    eye = camera.position_mm
    on_ball = points.surface == names.index("ball")
    along = d @ (centre - eye)
    root = along**2 - np.sum((centre - eye) ** 2) + radius**2
    np.testing.assert_array_equal(on_ball, root > 0)
    distance = along - np.sqrt(np.maximum(root, 0))
    np.testing.assert_allclose(points.position_mm[on_ball], (eye + distance[..., None] * d)[on_ball], atol=1e-6)
    np.testing.assert_allclose(points.normal[on_ball], (points.position_mm[on_ball] - centre) / radius, atol=1e-9)
    back = points.surface == names.index("back")
    np.testing.assert_allclose(points.position_mm[back][:, 2], 1000.0, atol=1e-9)
    np.testing.assert_allclose(points.depth_mm[back], 1000.0 - eye[2], atol=1e-9)
    np.testing.assert_allclose(points.normal[back], np.broadcast_to([0.0, 0, -1], (back.sum(), 3)), atol=1e-12)
    image = camera.project(points.position_mm.reshape(-1, 3))
    np.testing.assert_allclose(image, np.stack([columns.ravel(), rows.ravel()], axis=1), atol=1e-9)


def test_shadows_of_a_small_lamp_are_those_of_similar_triangles():
    """A plate halfway below a tiny lamp shades twice its size on the floor; the rest is in full light."""
    lamp = square(np.array([0.0, 400.0, 0.0]), 0.5, 1, -1)
    floor = quad("floor", square(np.array([0.0, 0.0, 0.0]), 300.0, 1, 1))
    plate = Surface("plate", "grey", *box_mesh([0.0, 200.0, 0.0], [80.0, 1.0, 80.0], 0.0))
    scene = Scene("test", (floor, plate), {"grey": Material("grey", FLAT.scaled(0.5))}, Lamp(quad("light", lamp), FLAT))
    camera = _looking_down()
    shadow = shadow_fraction(scene, camera, 1)[0]
    points = visible_points(scene, camera)
    on_floor = points.surface == 0
    x, z = np.abs(points.position_mm[..., 0]), np.abs(points.position_mm[..., 2])
    reach = np.maximum(x, z)
    assert (shadow[on_floor & (reach < 70)] == 1).all() and (on_floor & (reach < 70)).any()
    assert (shadow[on_floor & (reach > 95) & (reach < 280)] == 0).all()
    assert np.isnan(shadow[points.surface == NOTHING]).all()


def _looking_down():
    """A camera off to one side that sees the floor below the plate."""
    camera = replace(cornell_camera(41), position_mm=np.array([0.0, 150.0, -500.0]))
    forward = np.array([0.0, -150.0, 500.0]) / np.hypot(150, 500)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return replace(camera, rotation=np.array([right, np.cross(forward, right), forward]))


def test_points_and_albedo_are_those_of_stock_mitsuba(scene, image, alone):
    """Its AOVs at the pixels' centres: distance, position, normal and albedo, to single precision."""
    points, parts = visible_points(scene, CAMERA), light_parts(image, scene)
    reflectances = [{"type": "rgb", "value": row.tolist()} for row in scene.reflectances(BANDS)]
    with mi.scoped_set_variant("scalar_rgb"):
        black = {"type": "rgb", "value": 0.0}
        loaded = mi.load_dict(
            scene_dict(scene, dict(zip(scene.materials, reflectances, strict=False)), [black], [black])
        )
        view = sensor_dict(film_for(CAMERA, 1), CAMERA, {"pixel_format": "luminance"})
        view["sampler"] = {"type": "stratified", "sample_count": 1, "jitter": False}
        aovs = mi.load_dict({"type": "aov", "aovs": "t:depth,p:position,n:sh_normal,a:albedo"})
        picture = np.array(mi.render(loaded, sensor=mi.load_dict(view), integrator=aovs), float)[..., -10:]
    hit = (points.surface >= 0) & (points.surface < len(scene.surfaces))
    assert hit.mean() > 0.8
    rows, columns = np.indices(hit.shape)
    depth = picture[..., 0] * (CAMERA.directions(columns, rows) @ CAMERA.rotation[2]) + view["near_clip"]
    np.testing.assert_allclose(points.depth_mm[hit], depth[hit], rtol=1e-6)
    np.testing.assert_allclose(points.position_mm[hit], picture[..., 1:4][hit], atol=1e-3)
    np.testing.assert_allclose(points.normal[hit], picture[..., 4:7][hit], atol=1e-5)
    np.testing.assert_allclose(parts.albedo[alone], picture[..., 7:][alone], rtol=1e-6, atol=1e-7)
