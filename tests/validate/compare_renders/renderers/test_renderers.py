"""Other renderers make the same pictures of a box as ours, also inside a closed box; differences are reported."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.export import ExportSettings, as_rendered, exported_scene, read_rendered, write_export
from cboxlab.scenes import Lamp, Spectrum, Surface, cornell_box, cornell_camera
from cboxlab.scenes.shapes import sphere_mesh
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders.renderers import (
    compare_renderers,
    comparing,
    judge,
    missing,
    reference_cube,
    run_renderer,
)
from helpers.scenes.boxes import box_with_lamp, camera_inside, quad, square

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

RENDERERS = ["mitsuba", "radiance", "raysect", "luxcore", "pbrt", "cycles"]
SIZE = 24


def distorted():
    return cornell_camera(SIZE).with_parameters([270, 280, -800, 1, -1, 2, 32, 11, 12, -0.06])


@pytest.fixture(scope="module")
def distorted_box():
    settings = ExportSettings(np.array([450.0, 550.0, 600.0, 650.0]), samples=32, batches=4)
    exported = exported_scene(cornell_box(), distorted(), settings)
    return {
        lamp: (scene, reference_cube(scene))
        for lamp, scene in {True: exported, False: exported.with_black_lamps}.items()
    }


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_renderer_agrees_with_ours_through_a_distorting_lens(distorted_box, renderer, tmp_path):
    """Mean light and each surface within four standard deviations: seven surfaces, 0.05 % false alarms."""
    if lacking := missing(renderer):
        pytest.skip(lacking)
    write_export(tmp_path / "box", distorted_box[True][0])
    run = run_renderer(tmp_path / "box", renderer)
    exported, reference = distorted_box[renderer != "radiance"]
    judged = judge(renderer, read_rendered(tmp_path / "box", renderer), reference, exported, run)
    overall = judged.outcome.picture_mean
    assert abs(overall.difference) < 4 * overall.sigma and overall.sigma < 0.02
    assert {n: d for n, (d, s) in judged.surfaces.items() if abs(d) > max(4 * s, 0.005)} == {}
    assert bool(judged.remark) == (renderer == "radiance")
    assert run.cpu_s > 0 and judged.cost > 0


@pytest.mark.parametrize("renderer", ["radiance", "mitsuba"])
def test_inside_a_closed_box_of_grey_walls(renderer, tmp_path):
    """A camera in a box without opening; the wall behind it lights the others."""
    if lacking := missing(renderer):
        pytest.skip(lacking)
    settings = ExportSettings(np.array([450.0, 550.0, 650.0]), samples=64, batches=4)
    exported = exported_scene(box_with_lamp(0.6), camera_inside(SIZE), settings)
    write_export(tmp_path / "box", exported)
    run_renderer(tmp_path / "box", renderer)
    judged = judge(renderer, read_rendered(tmp_path / "box", renderer), reference_cube(exported), exported)
    overall = judged.outcome.picture_mean
    assert abs(overall.difference) < 4 * overall.sigma < 0.04


def lamp_above_a_white_floor():
    """A lamp over a bright floor, from where it is seen: what it reflects is a tenth of the light."""
    scene = box_with_lamp(0.8)
    return replace(scene, lamp=replace(scene.lamp, reflectance=Spectrum(np.array([550.0]), np.array([0.8]))))


def mean_light(cube):
    """Its mean over the picture and wavelengths, and the standard error, wavelengths fully correlated."""
    error = cube["standard_error"].values.astype(float).mean(axis=-1)
    return float(cube["radiance"].mean()), float(np.sqrt((error**2).sum()) / error.size)


@pytest.fixture(scope="module")
def reflecting_box():
    """The export, the mean of our picture of it, and of one with a black lamp."""
    settings = ExportSettings(np.array([500.0, 600.0]), samples=96, batches=4)
    exported = exported_scene(lamp_above_a_white_floor(), camera_inside(16), settings)
    means = (mean_light(reference_cube(scene, samples=64))[0] for scene in (exported, exported.with_black_lamps))
    return exported, *means


@pytest.mark.parametrize("renderer", ["mitsuba", "raysect", "luxcore", "pbrt", "cycles"])
def test_the_lamp_reflects_as_ours(reflecting_box, renderer, tmp_path):
    """In a closed box of reflectance 0.8, where a black lamp takes several per cent of the light."""
    if lacking := missing(renderer):
        pytest.skip(lacking)
    exported, ours, black = reflecting_box
    write_export(tmp_path / "box", exported)
    run_renderer(tmp_path / "box", renderer)
    theirs, error = mean_light(read_rendered(tmp_path / "box", renderer))
    assert abs(theirs - ours) < 4 * error
    assert theirs - black > 8 * error


@pytest.mark.parametrize("renderer", ["mitsuba", "raysect", "radiance", "luxcore", "pbrt", "cycles"])
def test_two_lamps_have_their_own_spectra(renderer, tmp_path):
    """A second lamp on the back wall, bright where the first is dark; means at both wavelengths."""
    if lacking := missing(renderer):
        pytest.skip(lacking)
    box = box_with_lamp(0.6)
    corners = square(np.array([300.0, 500.0, 999.0]), 120.0, 2, -1)
    sloped = (Spectrum(np.array([500.0, 600.0]), np.array(ends)) for ends in ([1.0, 3.0], [9.0, 0.5]))
    lamp = replace(box.lamp, radiance=next(sloped))
    scene = replace(box, lamp=lamp, further_lamps=(Lamp(quad("second", corners), next(sloped)),))
    settings = ExportSettings(np.array([500.0, 600.0]), samples=96, batches=4)
    exported = exported_scene(scene, camera_inside(12), settings)
    write_export(tmp_path / "box", exported)
    run_renderer(tmp_path / "box", renderer)
    theirs, ours = read_rendered(tmp_path / "box", renderer), reference_cube(exported, samples=64)
    for channel in (0, 1):
        pair = (mean_light(cube.isel(wavelength=[channel])) for cube in (theirs, ours))
        (their_box, error), (our_box, _) = pair
        assert abs(their_box - our_box) < 4.5 * error < 0.05 * our_box


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_ball_is_where_ours_is_and_as_large(renderer, tmp_path):
    """A ball before the camera, pixel by pixel: of 8 batches the squares of differences over standard errors have
    a mean of 1.4, which scatters by 0.3."""
    if lacking := missing(renderer):
        pytest.skip(lacking)
    box = box_with_lamp(0.6)
    ball = Surface("ball", "grey", *sphere_mesh([500.0, 350.0, 500.0], 250.0), ball=True)
    settings = ExportSettings(np.array([500.0, 600.0]), samples=256, batches=8)
    exported = exported_scene(replace(box, surfaces=(*box.surfaces, ball)), camera_inside(16), settings)
    write_export(tmp_path / "box", exported)
    run_renderer(tmp_path / "box", renderer)
    theirs, ours = read_rendered(tmp_path / "box", renderer), reference_cube(exported, samples=64)
    on_ball = ours["surface"].values == len(box.surfaces)
    assert on_ball.sum() > 60
    pair = [cube["radiance"].values.mean(axis=-1)[on_ball] for cube in (theirs, ours)]
    error = np.hypot(*(cube["standard_error"].values.mean(axis=-1)[on_ball] for cube in (theirs, ours)))
    z = (pair[0] - pair[1]) / error
    assert np.mean(z**2) < 1.4 + 4.9 * 0.3


def test_radiance_is_compared_with_a_lamp_that_reflects_nothing_and_that_is_said():
    settings = ExportSettings(np.array([500.0, 600.0]))
    exported = exported_scene(lamp_above_a_white_floor(), camera_inside(16), settings)
    assert not as_rendered(exported, "radiance").scene.lamp.reflects
    assert as_rendered(exported, "mitsuba") is exported
    plain = exported_scene(box_with_lamp(0.8), camera_inside(16), settings)
    assert as_rendered(plain, "radiance") is plain


@pytest.mark.parametrize("channels", [1, 3])
def test_few_wavelengths_are_no_colours_to_radiance(channels, tmp_path):
    """Three spectral samples are red, green and blue to it, which it mixes: light of 450 nm was 50 % too much."""
    if lacking := missing("radiance"):
        pytest.skip(lacking)
    settings = ExportSettings(np.array([450.0, 550.0, 650.0])[:channels], samples=32, batches=4)
    exported = exported_scene(cornell_box(), cornell_camera(16), settings).with_black_lamps
    write_export(tmp_path / "box", exported)
    run_renderer(tmp_path / "box", "radiance")
    judged = judge("radiance", read_rendered(tmp_path / "box", "radiance"), reference_cube(exported), exported)
    assert all(abs(row.difference) < max(4 * row.sigma, 0.02) for row in judged.outcome.of_kind("band"))


def test_an_interrupted_run_goes_on(tmp_path):
    """A batch that is there is not rendered again, and the time of a part is not stated as that of all."""
    settings = ExportSettings(np.array([550.0]), samples=4, batches=3)
    exported = exported_scene(cornell_box(), cornell_camera(16), settings)
    out = tmp_path / "box"
    write_export(out, exported)
    first = run_renderer(out, "mitsuba")
    picture = read_rendered(out, "mitsuba")["radiance"]
    batch_file = out / "mitsuba" / "out" / "batch-0-group-0.exr"
    (out / "mitsuba" / "out" / "batch-2-group-0.exr").unlink()
    before = batch_file.stat().st_mtime_ns
    write_export(out, exported)
    again = run_renderer(out, "mitsuba")
    assert batch_file.stat().st_mtime_ns == before
    assert first.cpu_s > 0 and np.isnan(again.cpu_s)
    assert np.array_equal(read_rendered(out, "mitsuba")["radiance"], picture)
    with pytest.raises(InputError):
        write_export(out, exported.with_black_lamps)


def test_light_that_is_cut_short_is_named(tmp_path):
    """Stock Mitsuba with two reflections, asked for all."""
    settings = ExportSettings(np.array([450.0, 550.0, 650.0]), samples=64, batches=4)
    complete = exported_scene(cornell_box(), cornell_camera(32), settings)
    cut = exported_scene(cornell_box(), cornell_camera(32), settings, max_bounces=2)
    write_export(tmp_path / "box", cut)
    run = run_renderer(tmp_path / "box", "mitsuba")
    judged = judge("mitsuba", read_rendered(tmp_path / "box", "mitsuba"), reference_cube(complete), complete, run)
    assert judged.sentence.startswith("different") and "path-depth (max_bounces 2)" in judged.sentence
    assert judged.agreeing == ()


def test_a_renderer_that_fails_leaves_the_others_their_results(tmp_path, monkeypatch):
    def run(export, renderer):
        if renderer == "pbrt":
            raise InputError(export / renderer, "ended with 2", "a picture")
        return run_renderer(export, renderer)

    monkeypatch.setattr(comparing, "missing", lambda name: "")
    monkeypatch.setattr(comparing, "run_renderer", run)
    settings = ExportSettings(np.array([550.0]), samples=4, batches=2)
    exported = exported_scene(cornell_box(), cornell_camera(16), settings)
    compared = compare_renderers(exported, ["pbrt", "mitsuba"], tmp_path / "out")
    assert [judged.renderer for judged in compared.judged] == ["mitsuba"]
    assert "ended with 2" in str(compared.failed[0]) and (tmp_path / "out" / "mitsuba.nc").exists()
    with pytest.raises(InputError, match="ended with 2"):
        compare_renderers(exported, ["pbrt"], tmp_path / "other")


def test_what_is_not_installed_is_said_and_the_rest_is_run(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    settings = ExportSettings(np.array([550.0]), samples=4, batches=2)
    exported = exported_scene(cornell_box(), cornell_camera(16), settings)
    compared = compare_renderers(exported, ["pbrt"], tmp_path / "out")
    assert compared.judged == () and "pbrt" in compared.left_out[0]
    with pytest.raises(InputError, match="not installed"):
        run_renderer(tmp_path / "out", "pbrt")
