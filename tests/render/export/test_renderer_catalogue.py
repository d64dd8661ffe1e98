"""The catalogue of renderers: one file each, and entry points of other packages."""

import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.export import exported_scene, read_rendered, renderer_catalogue, renderer_of, write_export
from cboxlab.rendering.export.neutral import ExportSettings
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils import other_packages
from cboxlab.utils.errors import InputError
from helpers.programs.installed_renderers import own_renderers
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


SETTINGS = ExportSettings(array([550.0]), batches=2, subpixels=1)


@pytest.fixture
def plugged(monkeypatch, tmp_path):
    """Installs a changed renderer as the only one of another package and gives an export for it."""

    def plug(**fields):
        (tmp_path / "site").mkdir()
        with own_renderers(tmp_path / "site"):
            flat = renderer_of("flat")
        monkeypatch.setitem(sys.modules, "odd", SimpleNamespace(RENDERER=replace(flat, id="odd", **fields)))
        entry = EntryPoint("odd", "odd:RENDERER", "cboxlab.renderers")
        monkeypatch.setattr(other_packages, "entry_points", lambda group: [entry])
        renderer_catalogue.cache_clear()
        return exported_scene(cornell_box(), cornell_camera(4), SETTINGS)

    yield plug
    renderer_catalogue.cache_clear()


def assert_named(refusal, phrase):
    message = str(refusal.value)
    assert "entry point cboxlab.renderers: odd = odd:RENDERER" in message
    assert phrase in message and "\n" not in message


PIXELS = np.ones((2, 4, 4, 1))

#: What a renderer's reader does, and words of the message.
READS = {
    "raises": (lambda folder, layout: 1 / 0, "ZeroDivisionError"),
    "ends the program": (lambda folder, layout: sys.exit(3), "exit code 3"),
    "gives nothing": (lambda folder, layout: None, "a NoneType"),
    "gives a list": (lambda folder, layout: PIXELS.tolist(), "a list"),
    "gives text": (lambda folder, layout: PIXELS.astype(str), "<U"),
    "gives another shape": (lambda folder, layout: PIXELS[:, :3], "(2, 3, 4, 1)"),
    "gives what is not finite": (lambda folder, layout: PIXELS * np.nan, "not finite"),
}


@pytest.mark.parametrize("way", READS)
def test_a_renderer_whose_pictures_are_unsound_is_named_in_one_line(plugged, tmp_path, way):
    read, phrase = READS[way]
    write_export(tmp_path / "box", plugged(read=read))
    with pytest.raises(InputError) as refusal:
        read_rendered(tmp_path / "box", "odd")
    assert_named(refusal, phrase)


def test_a_renderer_that_cannot_write_leaves_no_export(plugged, tmp_path):
    exported = plugged(write=lambda folder, exported: [][1])
    with pytest.raises(InputError) as refusal:
        write_export(tmp_path / "box", exported)
    assert_named(refusal, "IndexError")
    assert not (tmp_path / "box").exists()


@pytest.mark.parametrize("variables", [lambda: 1 / 0, lambda: None, lambda: {"PATH": 7}, lambda: sys.exit()])
def test_a_renderer_with_faulty_variables_is_named(plugged, variables):
    plugged(environment=variables)
    with pytest.raises(InputError) as refusal:
        renderer_of("odd").environment()
    assert_named(refusal, "environment variables")


@pytest.mark.parametrize(
    "fields",
    [{"name": 7}, {"command": "run.py"}, {"command": ()}, {"command": ("{pyton}",)}, {"pixels": "film2"}, {"read": 1}],
)
def test_a_record_with_a_wrong_field_is_refused(plugged, fields):
    plugged(**fields)
    with pytest.raises(InputError) as refusal:
        renderer_catalogue()
    assert_named(refusal, next(iter(fields)))
