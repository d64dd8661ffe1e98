"""A scene is a value: changed copies in memory, and files that read back the same."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.scenes import Material, Spectrum, cornell_box, load_scene
from cboxlab.scenes.scene_file import packaged_scenes
from cboxlab.utils.errors import InputError
from helpers.scenes.scene_files import GOOD, load

WAVELENGTHS = np.arange(400.0, 701.0, 25.0)


def assert_same(first, second):
    """Geometry, materials, lamps and media to the last digit; a ball's triangles to rounding."""
    assert first.name == second.name and first.source == second.source
    assert [s.name for s in first.all_surfaces] == [s.name for s in second.all_surfaces]
    for surface_before, other in zip(first.all_surfaces, second.all_surfaces, strict=True):
        assert (surface_before.material, surface_before.ball) == (other.material, other.ball)
        corners = [surface.vertices_mm[surface.faces] for surface in (surface_before, other)]
        np.testing.assert_allclose(*corners, rtol=0, atol=1e-9 if surface_before.ball else 0)
        if surface_before.texture_uv is not None:
            uv = [surface.texture_uv[surface.faces] for surface in (surface_before, other)]
            np.testing.assert_allclose(*uv, rtol=0, atol=1e-15)
        assert (surface_before.inside is None) == (other.inside is None)
    np.testing.assert_array_equal(first.reflectances(WAVELENGTHS), second.reflectances(WAVELENGTHS))
    np.testing.assert_array_equal(first.lamp_radiance(WAVELENGTHS), second.lamp_radiance(WAVELENGTHS))
    assert (first.medium is None) == (second.medium is None)


@pytest.mark.parametrize("name", packaged_scenes())
def test_a_packaged_scene_reads_back_from_the_file_that_it_writes(name, tmp_path):
    scene = load_scene(name)
    assert_same(load_scene(scene.write(tmp_path / "room.toml")), scene)


def test_blocks_are_written_as_quads_and_need_no_mesh(tmp_path):
    box = load_scene("cornell-box")
    assert any(len(surface.faces) > 2 for surface in box.surfaces)
    box.with_reflectance("red", 0.3).write(tmp_path / "room.toml")
    assert not [path.name for path in tmp_path.iterdir() if "block" in path.name]


EVERYTHING = (
    GOOD
    + """
[[surface]]
name = "ball"
material = "white"
sphere = { center_mm = [3, 1, 0], radius_mm = 0.5 }

[[surface]]
name = "glass"
material = "glass"
box = { center_mm = [-3, 1, 0], size_mm = [1, 1, 1] }
inside = { scattering_per_mm = 0.1, absorption_per_mm = { wavelength_nm = [400, 700], values = [0.1, 0.2] } }

[[surface]]
name = "picture"
material = "print"
mesh = "picture.obj"

[material.glass]
reflectance = 0.0
bsdf = { type = "dielectric", int_ior = 1.5 }

[material.print]
texture = { image = "print.npy", spectra = [0.2, { wavelength_nm = [400, 700], values = [0.1, 0.7] }] }
"""
)


def test_spheres_meshes_textures_and_media_read_back(tmp_path):
    np.save(tmp_path / "print.npy", np.random.default_rng(1).uniform(0, 0.5, (3, 4, 2)))
    (tmp_path / "picture.obj").write_text(
        "v 0 0 0\nv 1.1 0 0\nv 1 0.1 1\nvt 0 0\nvt 1 0\nvt 0.7 0.3\nf 1/1 3/3 2/2\n", encoding="ascii"
    )
    scene = load(tmp_path, EVERYTHING)
    (tmp_path / "copy").mkdir()
    copy = load_scene(scene.write(tmp_path / "copy" / "room.toml"))
    assert_same(scene, copy)
    np.testing.assert_array_equal(scene.materials["print"].texture.weights, copy.materials["print"].texture.weights)
    assert dict(copy.materials["glass"].bsdf) == {"type": "dielectric", "int_ior": 1.5}


def test_a_changed_copy_leaves_the_scene_as_it_was():
    box = cornell_box()
    before = box.materials["red"].reflectance.at(550.0)
    copy = box.with_reflectance("red", [400, 700], [0.1, 0.3])
    assert copy.materials["red"].reflectance.at(550.0) == pytest.approx(0.2)
    assert box.materials["red"].reflectance.at(550.0) == before
    assert box.origin.reference == "cornell-box" and copy.origin is None
    brighter = box.with_lamp(box.lamp.radiance.scaled(2.0))
    np.testing.assert_allclose(brighter.lamp_radiance(WAVELENGTHS), 2 * box.lamp_radiance(WAVELENGTHS))
    gloss = replace(box.material("white"), bsdf={"type": "roughplastic"})
    assert box.with_material(gloss).materials["white"].bsdf is not None


def test_a_moved_block_keeps_its_shape_and_turns_about_its_own_foot():
    box = cornell_box()
    block, moved = (scene.surface("tall-block") for scene in (box, box.moved("tall-block", (10.0, 0.0, -5.0), 30.0)))
    np.testing.assert_allclose(block.areas_mm2, moved.areas_mm2, rtol=1e-12)
    footprints = [s.vertices_mm[s.vertices_mm[:, 1] < 1.0] for s in (block, moved)]
    centres = [np.unique(feet.round(9), axis=0).mean(axis=0) for feet in footprints]
    np.testing.assert_allclose(centres[1] - centres[0], [10.0, 0.0, -5.0], atol=1e-9)
    edges = [np.diff(s.vertices_mm[:2], axis=0)[0] for s in (block, moved)]
    cosine = edges[0] @ edges[1] / np.prod([np.linalg.norm(edge) for edge in edges])
    assert np.degrees(np.arccos(cosine)) == pytest.approx(30.0, abs=1e-6)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda box: box.with_reflectance("rde", 0.5), "Did you mean 'red'"),
        (lambda box: box.with_reflectance("red", [400, 700], [0.1, 1.2]), "from 0 to 1"),
        (lambda box: box.with_reflectance("red", [400, 700], [0.1]), "equal length"),
        (lambda box: box.with_reflectance("red", None), "a Spectrum, one number"),
        (lambda box: box.with_lamp([400, 700], [-1.0, 1.0]), "0 or more"),
        (lambda box: box.with_material("red"), "a Material"),
        (lambda box: box.moved("tall-blok"), "Did you mean 'tall-block'"),
        (lambda box: box.moved("tall-block", (1.0, 2.0)), "three finite numbers, mm"),
        (lambda box: box.moved("tall-block", "up"), "numbers"),
        (lambda box: box.write("room.json"), "'.toml'"),
        (lambda box: load_scene(3), "a packaged scene's name"),
    ],
)
def test_a_wrong_argument_is_one_input_error(change, text):
    with pytest.raises(InputError) as error:
        change(cornell_box())
    assert text in str(error.value)


def test_what_only_an_effect_states_is_not_written(tmp_path):
    box = cornell_box()
    uneven = replace(box, lamp=replace(box.lamp, edge_ratio=0.5))
    with pytest.raises(InputError, match="the effects of the lamp"):
        uneven.write(tmp_path / "room.toml")
    assert not list(tmp_path.iterdir())


def test_a_scene_replaces_nothing_but_a_scene(tmp_path):
    """A manifest, a model, and meshes that another program wrote stay as they are."""
    box = cornell_box()
    ceiling = box.surface("ceiling")
    cut = replace(ceiling, faces=ceiling.faces[:-1])
    box = replace(box, surfaces=tuple(cut if s is ceiling else s for s in box.surfaces))
    for text in ('format = "capture/1"\n', 'format = "model/1"\n', "", "[", 'format = "scene/1"\n'):
        (tmp_path / "capture.toml").write_text(text)
        with pytest.raises(InputError, match="a file that is no scene file"):
            box.write(tmp_path / "capture.toml")
        assert [path.name for path in tmp_path.iterdir()] == ["capture.toml"]
        assert (tmp_path / "capture.toml").read_text() == text
    mesh = tmp_path / "room-ceiling.obj"
    mesh.write_text("v 0 0 0\n")
    with pytest.raises(InputError, match=r"room-ceiling\.obj.*exists already"):
        box.write(tmp_path / "room.toml")
    assert mesh.read_text() == "v 0 0 0\n" and not (tmp_path / "room.toml").exists()
    mesh.unlink()
    box.write(tmp_path / "room.toml")
    (tmp_path / "room.toml").unlink()  # as a run that was killed between both files leaves it
    box.write(tmp_path / "room.toml")
    moved = replace(cut, vertices_mm=cut.vertices_mm + 1.0)
    other = replace(box, surfaces=tuple(moved if s is cut else s for s in box.surfaces))
    assert_same(load_scene(other.write(tmp_path / "room.toml")), other)


def test_a_name_that_no_scene_file_has_is_not_written(tmp_path):
    box = cornell_box()
    ceiling = box.surface("ceiling")
    odd = replace(ceiling, name="../ceiling", faces=ceiling.faces[:-1])
    box = replace(box, surfaces=tuple(odd if s is ceiling else s for s in box.surfaces))
    with pytest.raises(InputError, match=r"surface\[1\]\.name: found '\.\./ceiling'"):
        box.write(tmp_path / "room.toml")
    assert not list(tmp_path.iterdir())


def test_a_scene_prints_in_five_lines():
    lines = repr(cornell_box()).splitlines()
    assert len(lines) == 5 and "tall-block (white)" in lines[1] and "13650 mm2" in lines[3]
    html = cornell_box().with_material(Material("<b>", Spectrum([550.0], [0.5])))._repr_html_()
    assert "&lt;b&gt;" in html and html.count("<tr>") == 5
