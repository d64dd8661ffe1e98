"""The catalogue of renderers: one file each, and entry points of other packages."""

from importlib.metadata import EntryPoint

import pytest
from cboxlab.rendering.export import exported_scene, renderer_catalogue, renderer_of, write_export
from cboxlab.rendering.export.neutral import ExportSettings
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils import other_packages
from cboxlab.utils.errors import InputError
from helpers.installed_renderers import own_renderers
from numpy import array


def test_every_file_is_a_renderer_that_says_what_it_needs():
    catalogue = renderer_catalogue()
    assert {"cycles", "luxcore", "mitsuba", "pbrt", "radiance", "raysect"} <= set(catalogue)
    for identifier, renderer in catalogue.items():
        assert identifier == renderer.id
        assert renderer.package or renderer.programs
        assert renderer.needs
    assert [name for name, renderer in catalogue.items() if renderer.by_default] == ["mitsuba", "radiance", "raysect"]
    assert renderer_of("radiance").needs == "oconv and rtrace, or the package pyradiance"


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        ("nowhere:RENDERER", "nowhere"),
        ("math:pi", "a float"),
        ("cboxlab.rendering.export.renderers.mitsuba:RENDERER", "'mitsuba'"),
    ],
)
def test_an_entry_point_that_is_no_new_renderer_is_named(monkeypatch, value, fault):
    entry = EntryPoint("flat", value, "cboxlab.renderers")
    monkeypatch.setattr(other_packages, "entry_points", lambda group: [entry])
    renderer_catalogue.cache_clear()
    try:
        with pytest.raises(InputError, match=f"flat = {value}.*{fault}"):
            renderer_catalogue()
    finally:
        renderer_catalogue.cache_clear()


def test_a_renderer_installed_later_gets_its_folder_in_an_export_that_is_there(tmp_path):
    exported = exported_scene(cornell_box(), cornell_camera(4), ExportSettings(array([550.0]), batches=2, subpixels=1))
    write_export(tmp_path / "box", exported)
    picture = tmp_path / "box" / "mitsuba" / "out"
    picture.mkdir()
    (tmp_path / "site").mkdir()
    with own_renderers(tmp_path / "site"):
        write_export(tmp_path / "box", exported)
    assert (tmp_path / "box" / "flat" / "run.py").exists()
    assert picture.exists()
