"""Coverage by polygons: what many camera rays say, traced through Embree's tree, and areas known by a formula."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.perturbation import pixels_per_unit
from cboxlab.rendering.visibility import build_tracer, pixel_coverage
from cboxlab.rendering.visibility.faces_and_tree import FacesAndTree, triangle_tree
from cboxlab.rendering.visibility.flat_faces import flat_faces
from cboxlab.rendering.visibility.polygon_coverage import _classes, _shares, polygon_coverage
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.camera import PARAMETER_NAMES
from cboxlab.scenes.lens import Lens
from cboxlab.scenes.scene import Surface
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

SIZE, SAMPLES = 24, 16384
TURNED = Rotation.from_euler("yxz", [4.0, -3.0, 10.0], degrees=True).as_matrix()


def cameras():
    published = cornell_camera(SIZE)
    inside = replace(published, position_mm=np.array([300.0, 400.0, 60.0]))
    return {
        "published": published,
        "distorted": replace(published, k1=-0.12),
        "through a lens of many terms": replace(published, k1=-0.12, lens=Lens(k2=0.1, p1=0.01, aspect=1.03)),
        "through a fisheye": replace(published, k1=0.25, lens=Lens("fisheye", k2=0.01)),
        "inside, past a block": inside,
        "wide, from within": replace(inside, focal_length_px=0.2 * published.focal_length_px),
        "askew, sees backs": replace(published, position_mm=np.array([540.0, 300.0, -500.0])),
        "turned and tilted": replace(published, rotation=TURNED @ published.rotation),
        "in the plane of a wall": replace(published, position_mm=np.array([300.0, 0.0, -800.0])),
    }


@pytest.mark.parametrize("name", cameras())
def test_shares_are_those_of_rays(name):
    """A share by n low-discrepancy points is wrong by a few parts of n^-3/4, 7e-4."""
    camera = cameras()[name]
    tracer = build_tracer(cornell_box())
    pixels = np.arange(SIZE * SIZE)
    shares, expected = (
        pixel_coverage(t, [camera], pixels, SAMPLES, seed=3)[0]
        for t in (tracer, replace(tracer, accelerator=triangle_tree(tracer.vertices)))
    )
    assert 0 < expected.sum() / len(pixels) <= 1
    assert ((expected > 0) & (expected < 1)).any(axis=1).sum() > 20
    assert np.abs(shares - expected).max() < 1.5e-3


@pytest.mark.parametrize("name", cameras())
def test_near_a_mesh_shares_are_those_of_rays_and_away_from_it_those_of_the_box_alone(name):
    box, camera = cornell_box(), cameras()[name]
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=60.0)
    mesh.apply_translation([420.0, 330.0, 300.0])
    ball = Surface("ball", "white", np.asarray(mesh.vertices), np.asarray(mesh.faces))
    tracer = build_tracer(replace(box, surfaces=(*box.surfaces, ball)))
    assert isinstance(tracer.accelerator, FacesAndTree)
    pixels = np.arange(SIZE * SIZE)
    shares, expected = (
        pixel_coverage(t, [camera], pixels, SAMPLES, seed=3)[0]
        for t in (tracer, replace(tracer, accelerator=triangle_tree(tracer.vertices)))
    )
    assert np.abs(shares - expected).max() < 1.5e-3
    of_ball = tracer.facet_surface == len(box.surfaces)
    away = ~expected[:, of_ball].any(axis=1)
    alone = pixel_coverage(build_tracer(box), [camera], pixels, 1)[0]
    exact = np.all(shares[:, ~of_ball] == alone, axis=1)
    assert exact[away].sum() > 0.9 * away.sum() and not exact[~away].any()


def test_cameras_asked_together_see_what_each_sees_alone():
    """What a pixel may see is sorted out once for all of them: cameras half a pixel (rms) apart, of several lenses."""
    published, tracer = cornell_camera(SIZE), build_tracer(cornell_box())
    pixels, steps = np.arange(SIZE * SIZE), np.diag(0.5 / pixels_per_unit(tracer, published))
    several = [published.with_parameters(published.parameters + step) for step in (0 * steps[0], *steps, *-steps)]
    together = pixel_coverage(tracer, several, pixels, 1)
    for camera, shares in zip(several, together, strict=True):
        np.testing.assert_allclose(shares, pixel_coverage(tracer, [camera], pixels, 1)[0], atol=2e-6)


def shares_of(*outlines):
    """(f,) share of a single pixel, one unit wide at one unit's distance, that sees each flat face."""
    triangles = [outline[list(corners)] for outline in outlines for corners in ((0, 1, 2), (0, 2, 3))]
    faces = flat_faces(np.array(triangles, float), np.repeat(np.arange(len(outlines)), 2))
    camera = replace(
        cornell_camera(1),
        position_mm=np.zeros(3),
        rotation=np.eye(3),
        focal_length_px=1.0,
        principal_point_px=np.zeros(2),
    )
    return polygon_coverage(faces, [camera], np.array([0]))[0, 0]


def square(x, y, half, z):
    """(4, 3) corners of a square across the axis, centred at slopes x, y, that covers 2 half of slope."""
    return (
        np.array(
            [
                [x - half, y - half, 1],
                [x - half, y + half, 1],
                [x + half, y + half, 1],
                [x + half, y - half, 1],
            ]
        )
        * z
    )


def test_areas_by_formula():
    """A square by itself; before another one; beyond the pixel's side."""
    near, far = square(0.1, 0.0, 0.2, 2.0), square(0.0, 0.0, 0.4, 5.0)
    np.testing.assert_allclose(shares_of(near), [0.16], atol=2e-6)
    np.testing.assert_allclose(shares_of(near, far), [0.16, 0.64 - 0.16], atol=2e-6)
    np.testing.assert_allclose(shares_of(square(0.4, 0.5, 0.3, 1.0)), [0.4 * 0.3], atol=2e-6)


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.2, np.pi / 4])
def test_faces_that_pass_through_each_other(turn):
    """A steep square meets a level one in the pixel's middle line, turned about the axis: half of each is in front."""
    c, s = np.cos(turn), np.sin(turn)
    level = square(0.0, 0.0, 2.0, 1.0)
    steep = np.array([[-2, -2, 0.8], [-2, 2, 0.8], [2, 2, 1.2], [2, -2, 1.2]], float)
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(shares_of(level @ turned.T, steep @ turned.T), [0.5, 0.5], atol=2e-6)


def test_shares_follow_a_camera_without_steps():
    """Moved by a ten-thousandth of a pixel at a time, no share rises by more than an edge of full length sweeps."""
    tracer, camera = build_tracer(cornell_box()), cornell_camera(SIZE)
    step = np.zeros(10)
    step[PARAMETER_NAMES.index("principal_u_px")] = 1e-4
    moved = [camera.with_parameters(camera.parameters + k * step) for k in range(20)]
    shares = pixel_coverage(tracer, moved, np.arange(SIZE * SIZE), SAMPLES)
    rises = np.diff(shares, axis=0)
    assert np.abs(rises).max() < 1.2e-4
    assert np.abs(shares[-1] - shares[0]).max() > 1.8e-3
    assert np.abs(np.diff(rises, axis=0)).max() < 5e-6


def test_a_mesh_that_fills_the_picture():
    box = cornell_box()
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=60.0)
    mesh.apply_translation([278.0, 273.0, 300.0])
    ball = Surface("ball", "white", np.asarray(mesh.vertices), np.asarray(mesh.faces))
    tracer = build_tracer(replace(box, surfaces=(*box.surfaces, ball)))
    camera = replace(cornell_camera(SIZE), position_mm=np.array([278.0, 273.0, 220.0]))
    coverage = pixel_coverage(tracer, [camera], np.arange(SIZE * SIZE), 64)[0]
    assert np.all(coverage[:, tracer.facet_surface == len(box.surfaces)].sum(axis=1) > 1 - 1e-6)


def test_no_pixels_have_no_shares():
    """As along the borders of a picture that shows one wall."""
    tracer = build_tracer(cornell_box())
    assert pixel_coverage(tracer, [cornell_camera(SIZE)], np.zeros(0, int), 1).shape[:2] == (1, 0)


def test_pixels_that_no_line_crosses_show_their_nearest_face():
    """Bounds may leave two faces to a pixel that no edge crosses; the face of the larger 1 / t is the nearer one."""
    ((members, lines, faces),) = _classes(np.zeros(3, int), np.full(3, 2), cameras=1)
    functions = np.zeros((len(members), faces, 5, 3))
    functions[..., 2] = 1.0
    functions[:, 1, 0, 2] = 2.0
    np.testing.assert_array_equal(_shares(np.zeros((len(members), lines, 3)), functions), [[0.0, 1.0]] * 3)
