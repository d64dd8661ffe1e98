"""Other renderers make the same pictures of a box as ours, also inside a closed box; what differs is told."""

import numpy as np
import pytest
from boxes import box_with_lamp, camera_inside
from cboxlab.render.device.variant import compiled
from cboxlab.render.export import ExportSettings, exported_scene, read_rendered, write_export
from cboxlab.scenes import InputError, cornell_box, cornell_camera
from cboxlab.validate.renderers import compare_renderers, judge, missing, reference_cube, run_renderer

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

RENDERERS = ["mitsuba", "radiance", "raysect", "luxcore", "pbrt"]
SIZE = 24


def distorted():
    return cornell_camera(SIZE).with_parameters([270, 280, -800, 1, -1, 2, 32, 11, 12, -0.06])


@pytest.fixture(scope="module")
def distorted_box():
    settings = ExportSettings(np.array([450.0, 550.0, 600.0, 650.0]), samples=32, batches=4)
    exported = exported_scene(cornell_box(), distorted(), settings)
    return exported, reference_cube(exported)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_renderer_agrees_with_ours_through_a_distorting_lens(distorted_box, renderer, tmp_path):
    """Mean light and each surface within four standard deviations: seven surfaces, 0.05 % false alarms."""
    if lacking := missing(renderer):
        pytest.skip(lacking)
    exported, reference = distorted_box
    write_export(tmp_path / "box", exported)
    run = run_renderer(tmp_path / "box", renderer)
    judged = judge(renderer, read_rendered(tmp_path / "box", renderer), reference, exported, run)
    whole = judged.outcome.whole
    assert abs(whole.difference) < 4 * whole.sigma and whole.sigma < 0.02
    assert {n: d for n, (d, s) in judged.surfaces.items() if abs(d) > max(4 * s, 0.005)} == {}
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
    whole = judged.outcome.whole
    assert abs(whole.difference) < 4 * whole.sigma < 0.04


def test_light_that_is_cut_short_is_named(tmp_path):
    """Stock Mitsuba with two reflections, asked for all."""
    settings = ExportSettings(np.array([450.0, 550.0, 650.0]), samples=64, batches=4)
    whole = exported_scene(cornell_box(), cornell_camera(32), settings)
    cut = exported_scene(cornell_box(), cornell_camera(32), settings, max_bounces=2)
    write_export(tmp_path / "box", cut)
    run = run_renderer(tmp_path / "box", "mitsuba")
    judged = judge("mitsuba", read_rendered(tmp_path / "box", "mitsuba"), reference_cube(whole), whole, run)
    assert judged.sentence.startswith("different") and "path-depth (max_bounces 2)" in judged.sentence
    assert judged.agreeing == ()


def test_what_is_not_installed_is_said_and_the_rest_is_run(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    settings = ExportSettings(np.array([550.0]), samples=4, batches=2)
    exported = exported_scene(cornell_box(), cornell_camera(16), settings)
    compared = compare_renderers(exported, ["pbrt"], tmp_path / "out")
    assert compared.judged == () and "pbrt" in compared.left_out[0]
    with pytest.raises(InputError, match="not installed"):
        run_renderer(tmp_path / "out", "pbrt")
