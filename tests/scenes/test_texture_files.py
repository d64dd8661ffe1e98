"""Textures of scene files: pictures, spectra, texture coordinates, and what is refused."""

import numpy as np
import pytest
from helpers.scenes.scene_files import BLOCK, GOOD, fault, load
from PIL import Image

PAINT = """
[material.poster]
texture = { image = "grey.png", spectra = [{ wavelength_nm = [400, 700], values = [0.2, 0.8] }, 0.1] }
"""
WALL = """
[[surface]]
name = "wall"
material = "poster"
quads_mm = [[[-5, 0, 5], [5, 0, 5], [5, 10, 5], [-5, 10, 5]]]
"""
POSTER = GOOD + PAINT + WALL
MESH = WALL.replace("quads_mm = [[[-5, 0, 5], [5, 0, 5], [5, 10, 5], [-5, 10, 5]]]", 'mesh = "wall.obj"')


@pytest.fixture
def folder(tmp_path):
    Image.fromarray(np.array([[0, 255, 51], [102, 204, 0]], np.uint8)).save(tmp_path / "grey.png")
    return tmp_path


def test_a_grey_picture_mixes_two_paints(folder):
    scene = load(folder, POSTER)
    texture = scene.materials["poster"].texture
    assert texture.weights[..., 0] == pytest.approx(np.array([[0, 1, 0.2], [0.4, 0.8, 0]]))
    assert texture.weights.sum(axis=2) == pytest.approx(1.0)
    share = np.mean([0, 1, 0.2, 0.4, 0.8, 0])
    assert scene.materials["poster"].reflectance.at([400, 550]) == pytest.approx(
        share * np.array([0.2, 0.5]) + (1 - share) * 0.1
    )
    assert scene.surface("wall").texture_uv.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert scene.surface("block").texture_uv is None and not scene.diffuse
    assert folder / "grey.png" in scene.origin.files


def test_channels_of_a_picture_and_of_an_array_have_a_spectrum_each(folder):
    rgb = np.array([[[255, 0, 0], [0, 255, 51]]], np.uint8)
    Image.fromarray(rgb).save(folder / "colour.png")
    text = POSTER.replace("grey.png", "colour.png").replace(", 0.1]", ", 0.1, 0.5]")
    assert load(folder, text).materials["poster"].texture.weights == pytest.approx(rgb / 255)
    Image.fromarray(np.array([[0, 65535], [13107, 0]], np.uint16)).save(folder / "deep.png")
    deep = load(folder, POSTER.replace("grey.png", "deep.png")).materials["poster"].texture
    assert deep.weights[..., 0] == pytest.approx(np.array([[0, 1], [0.2, 0]]))
    np.save(folder / "many.npy", np.full((2, 3, 4), 0.2))
    text = POSTER.replace("grey.png", "many.npy").replace(", 0.1]", ", 0.1, 0.5, 1.0]")
    assert load(folder, text).materials["poster"].texture.weights.shape == (2, 3, 4)


def test_a_mesh_brings_coordinates_with_v_upwards(folder):
    corners = "v -5 0 5\nv 5 0 5\nv 5 10 5\nv -5 10 5\n"
    (folder / "wall.obj").write_text(corners + "vt 0 0\nvt 0.5 0\nvt 0.5 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    wall = load(folder, GOOD + PAINT + MESH).surface("wall")
    for vertex, uv in zip(wall.vertices_mm, wall.texture_uv, strict=True):
        assert uv == pytest.approx([(vertex[0] + 5) / 20, 1 - vertex[1] / 10])
    (folder / "wall.obj").write_text(corners + "f 1 2 3\nf 1 3 4\n")
    assert "a mesh without texture coordinates" in fault(folder, GOOD + PAINT + MESH)


def test_what_cannot_be_a_texture_is_refused(folder):
    def fault_of(old, new):
        return fault(folder, POSTER.replace(old, new))

    assert len(load(folder, POSTER.replace(", 0.1]", "]")).materials["poster"].texture.spectra) == 1
    assert "found 3 spectra for 1 channel; expected 1, or 2" in fault_of(", 0.1]", ", 0.1, 0.2]")
    assert "material.poster.texture: found reflectance 1.8 at 700 nm in row 0, column 1" in fault_of("0.8]", "1.8]")
    assert "material.poster.texture: found reflectance -0.1" in fault_of(", 0.1]", ", -0.1]")
    assert "material.poster.texture.image" in fault_of("grey.png", "none.png")
    assert "which leaves the folder" in fault_of("grey.png", "../grey.png")
    (folder / "text.png").write_text("no picture")
    assert "material.poster.texture.image: found UnidentifiedImageError" in fault_of("grey.png", "text.png")
    np.save(folder / "odd.npy", np.array([np.nan]))
    assert "not finite" in fault_of("grey.png", "odd.npy")
    assert "a texture and a reflectance" in fault_of("[material.poster]\n", "[material.poster]\nreflectance = 0.5\n")
    assert "a texture and a bsdf" in fault_of("[material.poster]\n", '[material.poster]\nbsdf = { type = "diffuse" }\n')
    assert "material.white.reflectance: found nothing" in fault_of(
        "[material.white]\nreflectance = 0.75\n", "[material.white]\n"
    )
    block = BLOCK.replace('"white"', '"poster"')
    assert "a texture on a box; expected quads_mm without a hole" in fault(folder, POSTER.replace(BLOCK, block))
    assert "a texture on a hole" in fault(
        folder,
        POSTER.replace('name = "ceiling"\nmaterial = "white"', 'name = "ceiling"\nmaterial = "poster"'),
    )
