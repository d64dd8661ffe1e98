"""Scene files: what is written is read, every fault is reported with its place, and garbage never escapes."""

import functools
import json
import re
import tomllib

import numpy as np
import pytest
import trimesh
from cboxlab.scenes import load_scene
from cboxlab.scenes.scene_entries import SceneFile
from cboxlab.scenes.scene_file import PACKAGED
from cboxlab.utils.errors import InputError
from helpers.places import ROOT
from helpers.scenes.scene_files import BLOCK, GOOD, HEADER, LAMP, WHITE, fault, load
from hypothesis import given
from hypothesis import strategies as st

quoted = functools.partial(json.dumps, ensure_ascii=False)  # JSON's strings and lists are TOML's too


def test_a_sphere_has_its_area_and_radius(tmp_path):
    shape = '\n[[surface]]\nname = "ball"\nmaterial = "white"\nsphere = { center_mm = [1, 2, 3], radius_mm = 0.5 }\n'
    ball = load(tmp_path, GOOD + shape).surfaces[-1]
    assert ball.areas_mm2.sum() == pytest.approx(np.pi, rel=1e-9)
    assert ball.ball and ball.sphere_mm[1] == pytest.approx(0.5, rel=1e-9)
    np.testing.assert_allclose(ball.sphere_mm[0], [1, 2, 3], atol=1e-12)
    corners = ball.vertices_mm[ball.faces] - [1, 2, 3]
    assert np.linalg.norm(corners, axis=2) == pytest.approx(0.5, rel=2e-4)
    assert np.linalg.norm(corners.mean(axis=1), axis=1) == pytest.approx(0.5, rel=4e-4)
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("tx,tx->t", outward, corners.mean(axis=1)) > 0).all()
    both = shape.replace("sphere =", "box = { center_mm = [0, 1, 0], size_mm = [2, 2, 2] }\nsphere =")
    assert "box and sphere" in fault(tmp_path, GOOD + both)


def test_a_room_with_all_kinds_of_shapes(tmp_path):
    trimesh.creation.icosphere(radius=0.2).export(tmp_path / "ball.ply")
    (tmp_path / "paint.csv").write_text("wavelength_nm,grey\n400,0.2\n700,0.4\n")
    mesh = '\n[[surface]]\nname = "ball"\nmaterial = "grey"\nmesh = "ball.ply"\nunit_mm = 10\n'
    scene = load(tmp_path, GOOD + '[material.grey]\nreflectance = "paint.csv:grey"\n' + mesh)
    assert [surface.name for surface in scene.surfaces] == ["ceiling", "block", "ball"]
    assert scene.surface("ceiling").areas_mm2.sum() == pytest.approx(100 - 4)
    assert scene.surface("block").areas_mm2.sum() == pytest.approx(24)
    assert np.linalg.norm(scene.surface("ball").vertices_mm, axis=1) == pytest.approx(2.0)
    assert scene.materials["grey"].reflectance.at([300, 550, 800]) == pytest.approx([0.2, 0.3, 0.4])
    assert scene.materials["white"].reflectance.at([300, 550, 800]) == pytest.approx([0.75] * 3)
    assert scene.lamp.radiance.at([399, 550, 701]) == pytest.approx([0, 1.5, 0])


def test_a_lamp_that_reflects(tmp_path):
    """By a number, a table or a file, as a paint; black where nothing is said."""
    (tmp_path / "paint.csv").write_text("wavelength_nm,grey\n400,0.2\n700,0.4\n")
    for written, expected in (("0.6", [0.6, 0.6, 0.6]), ('"paint.csv:grey"', [0.2, 0.3, 0.4])):
        scene = load(tmp_path, GOOD.replace(LAMP, f"{LAMP}reflectance = {written}\n"))
        assert scene.lamp.reflects
        assert scene.lamp.reflectance.at([300, 550, 800]) == pytest.approx(expected)
        assert scene.reflectances([550.0])[:, 0] == pytest.approx([0.75, expected[1]])
    black = load(tmp_path, GOOD)
    assert not black.lamp.reflects and not black.reflectances([300, 550])[-1].any()


def test_two_lamps_in_one_ceiling_of_two_quads(tmp_path):
    twice = GOOD.replace("quads_mm = [[[-1", "quads_mm = [[[19, 10, 1], [19, 10, -1], [21, 10, -1], [21, 10, 1]], [[-1")
    assert "contains the lamp" in fault(tmp_path, twice)
    twice = twice.replace("[[[-5", "[[[15, 10, 5], [15, 10, -5], [25, 10, -5], [25, 10, 5]], [[-5")
    assert load(tmp_path, twice).surface("ceiling").areas_mm2.sum() == pytest.approx(200 - 8)


BALL = '\n[[surface]]\nname = "ball"\nmaterial = "white"\n'
FAULTS = {
    "unknown key": (GOOD.replace("yaw_deg", "yaw_deq"), ["surface[1].box.yaw_deq", "Did you mean 'yaw_deg'"]),
    "unknown table": (GOOD + "[lamps]\n", ["lamps", "Did you mean 'lamp'"]),
    "lamp missing": (HEADER + WHITE + BLOCK, ["lamp", "required"]),
    "format": (GOOD.replace("scene/1", "scene/2"), ["format", "'scene/2'", "'scene/1'"]),
    "missing material": (
        GOOD.replace('"white"', '"whit"'),
        ["surface[0] (ceiling)", "'whit'", "mean 'white'"],
    ),
    "duplicate name": (GOOD + BLOCK, ["surface[2] (block)", "unique"]),
    "surface named like the lamp": (GOOD.replace('"block"', '"light"'), ["surface[1] (light)", "unique"]),
    "no surface": (HEADER + "surface = []\n" + LAMP + WHITE, ["surface", "at least 1"]),
    "reflectance above 1": (GOOD.replace("0.75", "75"), ["material.white", "75", "0 to 1", "percent"]),
    "reflectance below 0": (GOOD.replace("0.75", "-0.1"), ["-0.1", "0 to 1"]),
    "reflectance nan": (GOOD.replace("0.75", "nan"), ["material.white", "finite"]),
    "reflectance of another kind": (GOOD.replace("0.75", "[1]"), ["material.white", "file.csv:column"]),
    "hole in a table": (
        GOOD.replace("0.75", "{ wavelength_nm = [400, 410, 420, 500], values = [0.1, 0.1, 0.1, 0.1] }"),
        ["a gap in the table from 420 to 500 nm"],
    ),
    "wavelengths in µm": (GOOD.replace("[400, 700]", "[0.4, 0.7]"), ["lamp.radiance", "0.4 to 0.7", "in nm"]),
    "wavelengths out of order": (GOOD.replace("[400, 700]", "[700, 400]"), ["lamp.radiance", "ascending"]),
    "unequal table": (GOOD.replace("[400, 700]", "[400, 500, 700]"), ["lamp.radiance", "equal length"]),
    "nan in a table": (GOOD.replace("[1.0, 2.0]", "[1.0, nan]"), ["lamp.radiance", "finite"]),
    "negative radiance": (GOOD.replace("[1.0, 2.0]", "[1.0, -2.0]"), ["lamp.radiance", "-2 at 700"]),
    "key missing in a table": (
        GOOD.replace("wavelength_nm", "wavelength"),
        ["lamp.radiance", "wavelength", "mean 'wavelength_nm'"],
    ),
    "missing spectrum file": (GOOD.replace("0.75", '"no.csv:white"'), ["material.white", "no.csv"]),
    "spectrum outside the folder": (
        GOOD.replace("0.75", '"../no.csv:white"'),
        ["material.white", "leaves the folder"],
    ),
    "lamp that reflects too much": (
        GOOD.replace(LAMP, LAMP + "reflectance = 78\n"),
        ["lamp.reflectance", "divide by 100"],
    ),
    "constant lamp": (
        GOOD.replace("{ wavelength_nm = [400, 700], values = [1.0, 2.0] }", "1.0"),
        ["lamp.radiance"],
    ),
    "nan in a corner": (GOOD.replace("[-5, 10, 5]", "[nan, 10, 5]"), ["surface[0].quads_mm[0][0][0]", "nan"]),
    "three corners": (GOOD.replace("[-5, 10, 5], ", ""), ["surface[0].quads_mm[0]", "at least 4"]),
    "duplicate corners": (
        GOOD.replace('hole = "light"', "").replace("[5, 10, 5]", "[5, 10, -5]"),
        ["surface[0] (ceiling)", "without area"],
    ),
    "zero area": (
        GOOD.replace(
            "[-1, 10, 1], [-1, 10, -1], [1, 10, -1], [1, 10, 1]",
            "[0, 10, 1], [0, 10, 0], [0, 10, -1], [0, 10, -2]",
        ),
        ["lamp", "without area"],
    ),
    "crossed quad": (
        GOOD.replace('hole = "light"', "").replace("[5, 10, -5], [5, 10, 5]", "[5, 10, 5], [5, 10, -5]"),
        ["surface[0] (ceiling).quads_mm[0]", "crosses itself"],
    ),
    "box without size": (
        GOOD.replace("size_mm = [2, 2, 2]", "size_mm = [2, 0, 2]"),
        ["surface[1].box.size_mm[1]"],
    ),
    "two shapes": (GOOD + 'mesh = "a.obj"\n', ["surface[1] (block)", "box and mesh"]),
    "no shape": (GOOD + BALL, ["surface[2] (ball)", "no shape"]),
    "hole next to a box": (GOOD + 'hole = "light"\n', ["surface[1] (block).hole", "quads_mm"]),
    "hole of another name": (
        GOOD.replace('hole = "light"', 'hole = "window"'),
        ["hole", "'window'", "'light'"],
    ),
    "lamp in the ceiling's plane": (
        GOOD.replace('hole = "light"', ""),
        ["surface[0] (ceiling)", 'add hole = "light"'],
    ),
    "lamp below the ceiling": (GOOD.replace("[[[-1, 10, 1]", "[[[-1, 9, 1]"), ["hole", "one plane"]),
    "lamp facing up": (
        GOOD.replace(
            "[-1, 10, 1], [-1, 10, -1], [1, 10, -1], [1, 10, 1]",
            "[1, 10, 1], [1, 10, -1], [-1, 10, -1], [-1, 10, 1]",
        ),
        ["backwards", "reverse"],
    ),
    "mesh missing": (GOOD + BALL + 'mesh = "no.obj"\n', ["no.obj", "no such file"]),
    "mesh outside the folder": (
        GOOD + BALL + 'mesh = "../no.obj"\n',
        ["surface[2] (ball).mesh", "leaves the folder"],
    ),
    "mesh of another kind": (GOOD + BALL + 'mesh = "no.blend"\n', ["no.blend", ".stl"]),
    "no toml": (GOOD + "[[[", ["room.toml", "TOML"]),
    "key twice": (GOOD + BLOCK + 'name = "b"\n', ["room.toml", "TOML"]),
}


@pytest.mark.parametrize(("text", "phrases"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_reported_with_its_place(tmp_path, text, phrases):
    message = fault(tmp_path, text)
    assert "room.toml" in message
    for phrase in phrases:
        assert phrase in message


def test_all_faults_are_reported_at_once(tmp_path):
    text = (
        GOOD.replace("0.75", "7.5")
        .replace("[1.0, 2.0]", "[-1.0, 2.0]")
        .replace('material = "white"', 'material = "wite"')
    )
    message = fault(tmp_path, text)
    assert all(phrase in message for phrase in ("3 more", "7.5", "radiance -1", "surface[0]", "surface[1]", "'wite'"))
    message = fault(tmp_path, GOOD.replace("yaw_deg", "yaw").replace("hole", "whole"))
    assert "Did you mean 'yaw_deg'" in message and "Did you mean 'hole'" in message


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", b"v 0 0 0\n"),
        ("a.obj", b"f 1 2 3\n"),
        ("a.ply", b"ply\n"),
        ("a.stl", b"solid"),
        ("a.ply", b"\xff" * 99),
    ],
)
def test_a_broken_mesh_is_reported(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    assert name in fault(tmp_path, GOOD + BALL + f'mesh = "{name}"\n')


@pytest.mark.parametrize("name", ["cornel-box", "missing.toml", ".", "\0"])
def test_a_scene_that_is_not_there(name):
    with pytest.raises(InputError) as error:
        load_scene(name)
    assert name not in ("cornel-box", "missing.toml") or "cornell-box" in str(error.value)


coordinate = st.floats(-1000, 1000).map(lambda value: round(value, 3))
rooms = st.fixed_dictionaries(
    {
        "origin": st.tuples(coordinate, coordinate, coordinate),
        "size": st.tuples(*[st.floats(0.5, 1000).map(lambda value: round(value, 3))] * 3),
        "yaw": st.floats(-360, 360),
        "steps": st.lists(st.integers(5, 10), min_size=1, max_size=20),
        "reflectance": st.lists(st.floats(0, 1), min_size=21, max_size=21),
        "source": st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]) | st.sampled_from("\t\n\r")),
        "name": st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,20}", fullmatch=True).filter(lambda n: n != "light"),
    }
)


@given(room=rooms)
def test_what_is_written_is_read(tmp_path_factory, room):
    x, y, z = room["origin"]
    wavelength = [400 + sum(room["steps"][:count]) for count in range(len(room["steps"]) + 1)]
    values = room["reflectance"][: len(wavelength)]
    quad = [[x, y, z], [x + 5, y, z], [x + 5, y, z + 5], [x, y, z + 5]]
    text = f"""
format = "scene/1"
name = {quoted(room["name"])}
source = {quoted(room["source"])}
[material.paint]
reflectance = {{ wavelength_nm = {wavelength}, values = {values} }}
[lamp]
quads_mm = [[[0, 2000, 0], [1, 2000, 0], [1, 2000, 1], [0, 2000, 1]]]
radiance = {{ wavelength_nm = [400], values = [1] }}
[[surface]]
name = {quoted(room["name"])}
material = "paint"
quads_mm = {quoted([quad])}
[[surface]]
name = "light-box"
material = "paint"
box.center_mm = {quoted(room["origin"])}
box.size_mm = {quoted(room["size"])}
box.yaw_deg = {room["yaw"]!r}
"""
    scene = load(tmp_path_factory.mktemp("scene"), text)
    assert (scene.name, scene.source) == (room["name"], room["source"])
    paint = scene.materials["paint"].reflectance
    assert np.array_equal(paint.wavelength_nm, wavelength) and np.array_equal(paint.values, values)
    assert np.array_equal(scene.surfaces[0].vertices_mm, quad)
    a, b, c = room["size"]
    assert scene.surfaces[1].areas_mm2.sum() == pytest.approx(2 * (a * b + b * c + c * a))
    assert scene.surfaces[1].vertices_mm.mean(axis=0) == pytest.approx(room["origin"], abs=1e-9)


toml_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just("white"),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@given(
    content=st.one_of(st.binary(max_size=100), st.text(max_size=100).map(lambda text: text.encode("utf-8", "replace")))
)
def test_garbage_is_an_input_error(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("scene") / "room.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"room\.toml"):
        load_scene(path)


def paths(value, path=()):
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from paths(inner, (*path, key))


@given(data=st.data(), value=toml_values)
def test_a_value_replaced_by_anything_is_read_or_reported(tmp_path_factory, data, value):
    """One place of a good file is overwritten by an arbitrary value; nothing but InputError may come out."""
    content = tomllib.loads(GOOD + BALL + 'mesh = "ball.ply"\n')
    key_path = data.draw(st.sampled_from([path for path in paths(content) if path]))
    parent = content
    for key in key_path[:-1]:
        parent = parent[key]
    parent[key_path[-1]] = value
    folder = tmp_path_factory.mktemp("scene")
    trimesh.creation.icosphere(subdivisions=1).export(folder / "ball.ply")
    (folder / "room.toml").write_text(as_toml(content), encoding="utf-8")
    try:
        scene = load_scene(folder / "room.toml")
    except InputError as error:
        assert "room.toml" in str(error) or "ball.ply" in str(error)
    else:
        assert all(np.isfinite(surface.areas_mm2).all() for surface in scene.surfaces)


def as_toml(table):
    return "".join(f"{quoted(key)} = {inline(value)}\n" for key, value in table.items())


def inline(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{quoted(key)} = {inline(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return '""' if value is None else quoted(value)


def test_the_packaged_file_obeys_the_format_and_its_files_are_packaged():
    content = tomllib.loads((PACKAGED / "cornell-box.toml").read_text())
    SceneFile.model_validate(content)
    references = [entry["reflectance"] for entry in content["material"].values()] + [content["lamp"]["radiance"]]
    assert all((PACKAGED / reference.split(":")[0]).is_file() for reference in references)


def test_the_example_on_the_page_of_the_format_is_read(tmp_path):
    page = (ROOT / "docs" / "scene-format.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    scene = load(tmp_path, example)
    assert scene.surface("ceiling").areas_mm2.sum() == pytest.approx(600 * 600 - 200 * 100)
    towards_the_middle = [300, 300, 100] - scene.lamp.surface.vertices_mm[0]
    a, b, c = scene.lamp.surface.vertices_mm[scene.lamp.surface.faces[0]]
    assert np.cross(b - a, c - a) @ towards_the_middle > 0
