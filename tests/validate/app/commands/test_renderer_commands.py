"""Commands for other renderers, and any camera for `cbox render`."""

import json

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.files import read_cube
from cboxlab.rendering.model.model_file import Model, write_model
from helpers.captures.large_patches import PATCHES
from helpers.programs.command_line import assert_one_line_of_help
from helpers.programs.installed_renderers import own_renderers

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer"),
    pytest.mark.usefixtures("large_patches"),
]

CLOSED = """
format = "scene/1"
name = "closed"
[lamp]
quads_mm = [[[400, 600, 200], [400, 600, 400], [200, 600, 400], [200, 600, 200]]]
radiance = { wavelength_nm = [400, 700], values = [1.0, 1.0] }
[material.grey]
reflectance = 0.5
[[surface]]
name = "ceiling"
material = "grey"
quads_mm = [[[600, 600, 0], [600, 600, 600], [0, 600, 600], [0, 600, 0]]]
hole = "light"
[[surface]]
name = "others"
material = "grey"
quads_mm = [
  [[600, 0, 0], [0, 0, 0], [0, 0, 600], [600, 0, 600]],
  [[600, 0, 600], [0, 0, 600], [0, 600, 600], [600, 600, 600]],
  [[0, 0, 600], [0, 0, 0], [0, 600, 0], [0, 600, 600]],
  [[600, 0, 0], [600, 0, 600], [600, 600, 600], [600, 600, 0]],
  [[600, 600, 0], [0, 600, 0], [0, 0, 0], [600, 0, 0]],
]
"""


def camera_file(path, **entries):
    entry = {
        "format": "camera/1",
        "width_px": 20,
        "height_px": 12,
        "position_mm": [300, 300, 60],
        "look_at_mm": [300, 250, 600],
        "focal_length_px": 10,
        **entries,
    }
    path.write_text(json.dumps(entry))
    return path


def test_a_camera_inside_a_closed_box_sees_light_everywhere(tmp_path, cbox):
    """All light stays in the box: behind no pixel is anything dark, and the mean is near that of a grey enclosure.

    With emitted flux pi L A and reflectance 0.5 the mean radiance of the walls, averaged over their area, is
    0.5 / (1 - 0.5 s) L A_lamp / A_walls where s is the part of light that stays (the lamp absorbs): 0.0193 to 0.02 L.
    """
    (tmp_path / "box.toml").write_text(CLOSED)
    (tmp_path / "model.toml").write_text('format = "model/1"\nscene = "box.toml"\n')
    camera = camera_file(tmp_path / "camera.json")
    out = tmp_path / "cube.nc"
    code, _, err = cbox(
        "render", tmp_path / "model.toml", "--camera", camera, "--out", out, "--samples", 32, "--wavelengths", "550"
    )
    assert code == 0, err
    radiance = read_cube(out)["radiance"].values[..., 0]
    assert radiance.shape == (12, 20) and radiance.min() > 0.005
    assert 0.01 < np.median(radiance) < 0.04


def test_renderers_are_run_and_what_they_wrote_is_collected(tmp_path, cbox, monkeypatch):
    out = tmp_path / "box"
    code, said, err = cbox(
        "renderers",
        "cornell-box",
        "--with",
        "mitsuba",
        "--size",
        24,
        "--samples",
        16,
        "--wavelengths",
        "550,600",
        "--out",
        out,
        "--json",
        tmp_path / "found.json",
    )
    assert code == 0, err
    assert "tall-block" in said and "mitsuba: " in said
    record = json.loads((tmp_path / "found.json").read_text())
    (renderer,) = record["renderers"]
    assert set(renderer["surfaces"]) == set(renderer["bands"]) and len(renderer["bands"]["floor"]["sigma"]) == 2
    assert abs(renderer["surfaces"]["back"]["relative_difference"]) < 0.05
    assert renderer["variance_times_cpu_s"] > 0 and (out / "bias-mitsuba.png").stat().st_size > 1000
    assert cbox("verify", out)[0] == 0
    first = read_cube(out / "mitsuba.nc")
    (out / "mitsuba.nc").unlink()
    code, said, err = cbox("renderers", "--collect", out, "--json", tmp_path / "collected.json")
    assert code == 0 and "mitsuba.nc" in said
    assert json.loads((tmp_path / "collected.json").read_text())["cubes"]["mitsuba"] == str(out / "mitsuba.nc")
    assert np.array_equal(read_cube(out / "mitsuba.nc")["radiance"], first["radiance"])


def test_mistakes_end_in_one_line(tmp_path, cbox):
    assert_one_line_of_help(cbox("renderers", "cornell-box", "--with", "mitsubba"), ["Did you mean 'mitsuba'"])
    assert_one_line_of_help(cbox("renderers"), ["MODEL"])
    assert_one_line_of_help(cbox("renderers", "--collect", tmp_path), ["pictures"])
    camera = camera_file(tmp_path / "camera.json", focal_length_px=0)
    assert_one_line_of_help(cbox("export", "cornell-box", "--to", tmp_path / "x", "--camera", camera), ["focal"])
    write_model(tmp_path / "hazy.toml", Model().with_effect(apply_checked("haze", {}, "test")))
    assert_one_line_of_help(cbox("export", tmp_path / "hazy.toml", "--to", tmp_path / "x"), ["haze", "Leave it out"])
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    assert_one_line_of_help(cbox("export", "cornell-box", "--to", tmp_path / "full", "--size", 8), ["exists already"])
    assert not (tmp_path / "x").exists()


def test_a_renderer_of_another_package_is_exported_for_and_run(tmp_path, cbox, monkeypatch):
    """Its entry point is all that names it; one without its program is named in one line, and the other is run."""
    (tmp_path / "site").mkdir()
    monkeypatch.setattr("cboxlab.validation.compare_renders.regress.variants._PATCHES_PER_DIAGONAL", PATCHES)
    size = "--size", 16, "--wavelengths", "550,600", "--samples", 16
    with own_renderers(tmp_path / "site"):
        code, said, err = cbox("export", "cornell-box", "--to", tmp_path / "box", *size)
        assert code == 0 and "flat" in said, err
        assert (tmp_path / "box" / "flat" / "run.py").exists()
        record = tmp_path / "found.json"
        code, said, err = cbox("renderers", "cornell-box", "--with", "flat,absent", *size, "--json", record)
        assert code == 0 and "flat: different" in said, err
        assert said.count("Absent") == 1 and "Absent is not installed: it needs no-such-program" in said
        judged = json.loads(record.read_text())["renderers"]
        assert [renderer["renderer"] for renderer in judged] == ["flat"]
