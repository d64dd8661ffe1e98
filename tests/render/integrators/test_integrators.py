"""Three integrators, one picture: final gather, path tracer and stock Mitsuba; seeds, errors, bounces.

False alarms: as stated in test_render_physics.
"""

import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.choice import render_image
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.integrators.stock import render_stock
from cboxlab.rendering.radiosity.final_gather import gather, render_final_gather, solve_light
from cboxlab.rendering.visibility.pinhole import film_for, resampling
from cboxlab.scenes import Surface, cornell_box, cornell_camera
from cboxlab.scenes.shapes import sphere_mesh
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import ProgressReporter
from helpers.scenes.boxes import BANDS, EDGE, box_with_lamp, camera_inside, lamp_and, quad, square, walls
from scipy.stats import t as student

needs_llvm = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")
OWN = [
    pytest.param(render_path_tracer, marks=needs_llvm),
    pytest.param(render_final_gather, marks=needs_llvm),
]
#: For tests of what does not depend on the patches' size: fewer of them, which is faster.
COARSE = [
    pytest.param(render_path_tracer, marks=needs_llvm),
    pytest.param(partial(render_final_gather, patch_edge_mm=150.0), marks=needs_llvm, id="final_gather"),
]
BATCHES = 16
#: Two-sided 1e-6 point of Student's t with the degrees of freedom of two sets of 16 batches.
T_LIMIT = float(student.isf(0.5e-6, 2 * BATCHES - 2))


@pytest.fixture(scope="module")
def pictures():
    """The published box by all three, 24 x 24 pixels, with a lens that distorts and a shifted axis."""
    camera = replace(cornell_camera(24), k1=-0.1, principal_point_px=np.array([12.1, 10.9]))
    scene = cornell_box()
    return {
        "path": render_path_tracer(RenderJob(scene, camera, BANDS, samples=64, batches=BATCHES, seed=1)),
        "gather": render_final_gather(RenderJob(scene, camera, BANDS, samples=64, batches=BATCHES, seed=2)),
        "stock": render_stock(RenderJob(scene, camera, BANDS, samples=64, batches=BATCHES, seed=3)),
    }


def relative(image):
    """(batch, y, x, w) radiance over the lamp's, a wavelength without lamp light left out."""
    in_light = image.spectra.max(axis=0) > 0
    return (image.coefficients @ image.spectra)[..., in_light] / image.spectra.max(axis=0)[in_light]


@needs_llvm
def test_many_names_for_the_same_paints_change_nothing():
    """With a new paint on each surface, paints are looked up another way; paths stay the same."""
    scene = cornell_box()
    materials = {s.name: scene.materials[s.material] for s in scene.surfaces}
    many = replace(scene, materials=materials, surfaces=tuple(replace(s, material=s.name) for s in scene.surfaces))
    few, more = (
        render_path_tracer(RenderJob(box, cornell_camera(16), BANDS, samples=16, batches=1)) for box in (scene, many)
    )
    np.testing.assert_array_equal(few.coefficients, more.coefficients)


@needs_llvm
@pytest.mark.parametrize(("first", "other"), [("path", "gather"), ("path", "stock"), ("gather", "stock")])
def test_surface_means_agree(pictures, first, other):
    """Every surface's mean at every wavelength agrees within the scatter of its batches."""
    assert_means_agree(pictures[first], pictures[other])


def assert_means_agree(a, b):
    for index, name in enumerate(a.surface_names):
        visible = a.single_surface & b.single_surface & (a.surface == index)
        if visible.sum() < 4:
            continue
        assert_mean_agrees(a, b, visible, name)


def assert_mean_agrees(a, b, region, name):
    means = [relative(image)[:, region].mean(axis=1) for image in (a, b)]
    error = np.sqrt(sum(m.var(axis=0, ddof=1) for m in means) / BATCHES)
    difference = means[0].mean(axis=0) - means[1].mean(axis=0)
    assert np.all(np.abs(difference) < T_LIMIT * error), name
    assert np.all(error < 0.05 * means[0].mean(axis=0)), name


@needs_llvm
def test_a_box_with_a_ball_of_many_triangles():
    """Groups of small triangles as patches: surface means agree with the path tracer's, which has no patches."""
    published = cornell_box()
    ball = Surface("ball", "white", *sphere_mesh([186.0, 90.0, 169.0], 90.0), ball=True)
    surfaces = tuple(s for s in published.surfaces if s.name != "short-block")
    scene = replace(published, surfaces=(*surfaces, ball))
    camera = cornell_camera(24)
    gather = render_final_gather(RenderJob(scene, camera, BANDS, samples=64, batches=BATCHES, seed=4))
    paths = render_path_tracer(RenderJob(scene, camera, BANDS, samples=128, batches=BATCHES, seed=5))
    assert_means_agree(gather, paths)
    covered = gather.coverage[..., gather.facet_surface == gather.surface_names.index("ball")].sum(axis=-1)
    mask = covered > 0.999  # by several of its faces in most pixels
    assert mask.sum() > 20
    assert_mean_agrees(gather, paths, mask, "ball")
    stock = render_stock(RenderJob(scene, camera, BANDS, samples=128, batches=BATCHES, seed=6))
    assert_mean_agrees(stock, paths, mask, "ball")


@needs_llvm
@pytest.mark.parametrize(("first", "other"), [("path", "gather"), ("path", "stock"), ("gather", "stock")])
def test_pixels_agree_as_their_standard_errors_say(pictures, first, other):
    """Difference over standard error has mean 0, mean square nu / (nu - 2), nu between 15 and 30."""
    a, b = pictures[first], pictures[other]
    where = a.single_surface & b.single_surface & (a.surface >= 0)
    sets = [relative(image)[:, where].mean(axis=-1) for image in (a, b)]
    error = np.sqrt(sum(s.var(axis=0, ddof=1) for s in sets) / BATCHES)
    z = (sets[0].mean(axis=0) - sets[1].mean(axis=0)) / error
    assert len(z) > 250
    assert abs(z.mean()) < 4.9 * np.sqrt(1.15 / len(z))
    # the variance of a square of Student's t is about 3 here, a little more where light is skewed
    assert 1.0 - 4.9 * np.sqrt(3.5 / len(z)) < np.mean(z**2) < 1.15 + 4.9 * np.sqrt(3.5 / len(z))


@needs_llvm
def test_what_pixels_cover_is_the_same(pictures):
    """Stock Mitsuba's coverage agrees with ours within the sampling of edges, 1/8 of a pixel."""
    a, b = pictures["path"], pictures["stock"]
    assert np.abs(a.coverage - b.coverage).max() < 0.15
    assert np.abs(a.coverage - b.coverage).mean() < 0.002
    assert np.mean(a.surface != b.surface) < 0.01
    assert np.array_equal(a.facet_surface, b.facet_surface)


@pytest.mark.parametrize("integrator", COARSE)
def test_scatter_between_seeds_is_the_stated_error(integrator):
    """The variance of 12 renders' means over the variance that they state, over all pixels, is 1."""
    scene, camera = box_with_lamp(0.6, front=False), camera_inside(16, z=-900.0, focal=0.9)
    renders = [integrator(RenderJob(scene, camera, BANDS[:1], samples=32, batches=8, seed=s)) for s in range(12)]
    where = renders[0].single_surface & (renders[0].surface >= 0)
    means, variances = (np.array(x)[:, where, 0] for x in zip(*(r.project(np.eye(1)) for r in renders), strict=True))
    ratio = means.var(axis=0, ddof=1).sum() / variances.mean(axis=0).sum()
    # relative variance of the ratio: 2 / 11 of the observed plus 2 / (12 * 7) of the stated, per pixel;
    # pixels near the lamp weigh more than others, which halves how many there are
    assert abs(ratio - 1) < 4.9 * np.sqrt((2 / 11 + 2 / 84) / (0.5 * where.sum()))


@pytest.mark.parametrize("integrator", [*COARSE, render_stock])
def test_the_same_seed_gives_the_same_picture(integrator):
    scene, camera = cornell_box(), cornell_camera(12)
    first, again, other = (integrator(RenderJob(scene, camera, BANDS, samples=4, batches=2, seed=s)) for s in (7, 7, 8))
    assert np.array_equal(first.coefficients, again.coefficients)
    assert np.array_equal(first.coverage, again.coverage)
    assert not np.array_equal(first.coefficients, other.coefficients)
    assert not np.array_equal(first.coefficients[0], first.coefficients[1])


@pytest.mark.parametrize("integrator", [*COARSE, render_stock])
def test_the_picture_is_linear_in_the_lamp(integrator):
    """Twice the lamp's radiance: twice the picture, exactly, with the same noise."""
    scene, camera = cornell_box(), cornell_camera(12)
    double = scene.with_lamp(scene.lamp.radiance.scaled(2.0))
    dim, two = (
        integrator(RenderJob(s, camera, BANDS, samples=4, batches=2, seed=7)).project(np.eye(3))
        for s in (scene, double)
    )
    assert np.array_equal(2 * dim[0], two[0])
    assert np.array_equal(4 * dim[1], two[1])


@pytest.mark.parametrize("integrator", [*COARSE, render_stock])
def test_reflections_are_counted_and_add_up(integrator):
    """0 shows the lamp alone, 1 direct light, and so on; each adds light, and the sum is the whole.

    In a grey box the share of a further reflection is at most the reflectance of what was there before.
    """
    scene, camera = box_with_lamp(0.5), camera_inside(12)
    images = [
        integrator(RenderJob(scene, camera, BANDS[:1], samples=64, batches=8, seed=3, max_bounces=n))
        for n in (0, 1, 2, 3, None)
    ]
    lamp, walls = images[0].coverage[..., -1] == 1, images[0].coverage[..., -1] == 0
    light = [relative(image)[..., 0].mean(axis=0) for image in images]
    assert np.all(light[0][walls] == 0)
    assert lamp.sum() >= 1
    for picture in light:
        assert picture[lamp] == pytest.approx(1.0, abs=1e-6)
    means = np.array([picture[walls].mean() for picture in light])
    added = np.diff(means)
    assert np.all(added > 0)
    assert added[1] < 0.5 * added[0] * 1.5  # the first reflection is uneven, so its light may gather in view
    assert added[2] < 0.5 * added[1] * 1.1
    assert added[3] < added[2]


@pytest.mark.parametrize("integrator", COARSE)
@pytest.mark.parametrize("max_bounces", [0, None])
def test_the_lamps_own_picture_shows_its_pattern(integrator, max_bounces):
    """Radiance e + (1 - e)(1 - X^2)(1 - Z^2) over its mean, times cos^n of the angle, at points seen, to 1%."""
    scene = box_with_lamp(0.5, lamp_half=400.0, edge_ratio=0.3, exponent=2.0)
    camera = replace(camera_inside(16), focal_length_px=5.0)
    image = integrator(RenderJob(scene, camera, BANDS[:1], samples=256, batches=2, max_bounces=max_bounces))
    fine = (np.arange(8) - 3.5) / 8
    v, u, dv, du = np.meshgrid(np.arange(16), np.arange(16), fine, fine, indexing="ij")
    ray = camera.directions(u + du, v + dv)
    at = camera.position_mm + ray * ((EDGE - camera.position_mm[1]) / ray[..., 1])[..., None]
    x, z = (at[..., i] / 400.0 - EDGE / 800.0 for i in (0, 2))
    pattern = (0.3 + 0.7 * (1 - x**2) * (1 - z**2)) / (0.3 + 0.7 * 4 / 9) * ray[..., 1] ** 2
    lamp = image.coverage[..., -1] == 1
    assert lamp.sum() > 10
    image_px = image.project(np.eye(1))[0][lamp][:, 0]
    assert np.ptp(image_px) > 0.2
    assert image_px == pytest.approx(pattern.mean(axis=(2, 3))[lamp], rel=0.01, abs=0.005)


@needs_llvm
def test_one_solution_serves_all_cameras():
    """Light solved once and gathered through two cameras: the pictures that each would get on its own."""
    scene = cornell_box()
    light = solve_light(scene, BANDS, patch_edge_mm=150.0, seed=3)
    for camera in (cornell_camera(12), replace(cornell_camera(16), k1=-0.1)):
        image = render_final_gather(RenderJob(scene, camera, BANDS, 16, 2, seed=3), patch_edge_mm=150.0)
        shared = gather(light, camera, samples=16, batches=2, seed=3)
        assert np.array_equal(image.coefficients, shared.coefficients)
        assert np.array_equal(image.spectra, shared.spectra)


@needs_llvm
def test_the_patches_size_does_not_show():
    """Patches of 140 mm, more than three times the default's edge, change surface means by 0.2% at most.

    In deep shadow it is more of little: 0.05% of the picture's mean stands next to it. The pictures share their
    random numbers, and the errors of their difference come from its batches.
    """
    scene, camera = cornell_box(), cornell_camera(24)
    images = [
        gather(solve_light(scene, BANDS[1:], patch_edge_mm=edge, seed=1), camera, 128, BATCHES, seed=2)
        for edge in (40.0, 140.0)
    ]
    fine, coarse = (relative(image) for image in images)
    used = images[0].single_surface & (images[0].surface >= 0)
    everywhere = fine[:, used].mean(axis=(0, 1))
    for index in range(len(images[0].surface_names)):
        region = used & (images[0].surface == index)
        mean = fine[:, region].mean(axis=(0, 1))
        change = (coarse - fine)[:, region].mean(axis=1)
        error = change.std(axis=0, ddof=1) / np.sqrt(BATCHES)
        allowed = 0.002 * mean + 0.0005 * everywhere
        assert np.all(np.abs(change.mean(axis=0)) < allowed + T_LIMIT * error), index
    difference = (coarse - fine)[:, used].mean(axis=(0, 1)) / everywhere
    assert np.abs(difference).max() < 0.001


@needs_llvm
def test_the_dark_side_of_a_lit_plate():
    """A plate lit from above hangs over a floor: from below it is black, so the floor gets less, not more."""
    floor = quad("floor", walls()["floor"])
    plate = quad("plate", square(np.array([EDGE / 2, 300.0, EDGE / 2]), 300.0, 1, 1))
    scene = lamp_and([floor, plate], square(np.array([EDGE / 2, 900.0, EDGE / 2]), 400.0, 1, -1))
    camera = camera_inside(16, z=-600.0, focal=1.0)
    pictures = [
        relative(r(RenderJob(scene, camera, BANDS[:1], samples=64, batches=BATCHES, seed=2))).mean(axis=(1, 2))
        for r in (render_path_tracer, render_final_gather)
    ]
    error = np.sqrt(sum(p.var(axis=0, ddof=1) for p in pictures) / BATCHES)
    mean = pictures[0].mean(axis=0)
    assert np.all(error < 0.002 * mean)
    assert np.all(np.abs(pictures[1].mean(axis=0) - mean) < T_LIMIT * error)


@pytest.mark.parametrize("integrator", OWN)
def test_a_lamp_that_lights_nothing(integrator):
    """Behind the camera and turned away: a black picture, not an error."""
    away = square(np.full(3, -EDGE), 10.0, 1, -1)
    scene = lamp_and([quad("back", walls()["back"])], away)
    image = integrator(RenderJob(scene, camera_inside(8), BANDS, samples=4, batches=2))
    assert np.all(image.project(np.eye(3))[0] == 0)


@pytest.mark.parametrize("cut", [1, 2, 3])
@needs_llvm
def test_cut_pictures_agree_between_integrators(cut):
    scene, camera = cornell_box(), cornell_camera(16)
    sets = [
        relative(r(RenderJob(scene, camera, BANDS, samples=64, batches=BATCHES, seed=4, max_bounces=cut))).mean(
            axis=(1, 2)
        )
        for r in (render_path_tracer, render_final_gather, render_stock)
    ]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        error = np.sqrt((sets[i].var(axis=0, ddof=1) + sets[j].var(axis=0, ddof=1)) / BATCHES)
        assert np.all(np.abs(sets[i].mean(axis=0) - sets[j].mean(axis=0)) < T_LIMIT * error + 1e-6)


@needs_llvm
def test_other_wavelengths_do_not_change_a_wavelength():
    """Until roulette begins the picture at 550 nm is the same alone and among 13 wavelengths, same paths."""
    arguments = {"samples": 8, "batches": 2, "seed": 1, "max_bounces": 2}
    alone = render_path_tracer(RenderJob(cornell_box(), cornell_camera(12), BANDS[1:2], **arguments))
    among = render_path_tracer(RenderJob(cornell_box(), cornell_camera(12), np.linspace(400, 700, 13), **arguments))
    assert alone.wavelength_nm[0] == among.wavelength_nm[6]
    assert alone.coefficients[..., 1] == pytest.approx(among.coefficients[..., 7], rel=1e-5, abs=1e-8)


@pytest.mark.parametrize("k1", [0.0, -0.2, 0.15])
def test_resampling_keeps_straight_lines_where_they_are(k1):
    """A ramp in the plane, resampled through a distorting lens, has each pixel's own value to 0.02 px."""
    camera = replace(camera_inside(32, focal=1.1), k1=k1, principal_point_px=np.array([14.0, 17.5]))
    film = film_for(camera, 4)
    matrix = resampling(film, camera)
    assert matrix.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    ramp = (matrix @ film.centres()).reshape(32, 32, 2)
    v, u = np.indices((32, 32))
    fine = (np.arange(5) - 2) / 5
    samples = np.array([camera.directions(u + a, v + b) @ camera.rotation.T for a in fine for b in fine])
    expected = (samples[..., :2] / samples[..., 2:]).mean(axis=0)
    inner = np.s_[2:-2, 2:-2]
    assert np.abs(ramp - expected)[inner].max() * camera.focal_length_px < 0.02


def test_stock_mitsuba_refuses_lamps_it_cannot_show():
    with pytest.raises(InputError, match=r"lamp.exponent: found 2; expected 0 without a compiled variant"):
        render_stock(RenderJob(box_with_lamp(0.5, exponent=2.0), camera_inside(8), BANDS))


@pytest.mark.parametrize("name", ["default", "path", "stock"])
@needs_llvm
def test_the_door_to_all_integrators(name):
    """Each integrator is reached by name, reports its progress up to 1, and returns the whole picture."""
    messages = []
    progress = ProgressReporter(lambda stage, done: messages.append(done))
    image = render_image(
        RenderJob(cornell_box(), cornell_camera(8), BANDS, samples=4, batches=2), progress=progress, integrator=name
    )
    assert image.project(np.eye(3))[0].shape == (8, 8, 3)
    assert messages == sorted(messages)
    assert messages[-1] == pytest.approx(1.0)


def test_without_a_compiler_there_is_a_hint_and_a_picture():
    """In a process that finds no LLVM the stock integrator renders, after one line on how to be faster."""
    program = """
import warnings, numpy as np
from unittest import mock
with mock.patch("ctypes.CDLL", side_effect=OSError), mock.patch("drjit.has_backend", return_value=False):
    from cboxlab.rendering.device import variant
    assert not variant.compiled()
from cboxlab.rendering.integrators import RenderJob, render_image
from cboxlab.scenes import cornell_box, cornell_camera
with warnings.catch_warnings(record=True) as messages:
    warnings.simplefilter("always")
    image = render_image(RenderJob(cornell_box(), cornell_camera(8), np.linspace(400, 700, 4), samples=8, batches=2))
hints = [str(w.message) for w in messages if "LLVM" in str(w.message)]
assert hints == [variant.HINT], messages
assert image.project(np.eye(4))[0].mean() > 0
assert (image.surface >= 0).sum() > 40
print("rendered")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip().endswith("rendered"), done.stderr
