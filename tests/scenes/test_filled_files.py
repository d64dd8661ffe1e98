"""Surfaces of scene files with a medium inside, and what is refused."""

import numpy as np
import pytest
from helpers.scenes.scene_files import BLOCK, GOOD, fault, load

MILK = """
[material.skin]
reflectance = 0.5
bsdf = { type = "dielectric", int_ior = 1.33 }
"""
INSIDE = 'inside = { scattering_per_mm = "milk.csv:scattering", absorption_per_mm = 0.001, anisotropy = 0.7 }\n'
FILLED = GOOD + MILK + BLOCK.replace('"block"', '"glass"').replace('"white"', '"skin"') + INSIDE


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "milk.csv").write_text("wavelength_nm,scattering\n400,0.02\n700,0.01\n")
    return tmp_path


def test_a_block_is_filled(folder):
    scene = load(folder, FILLED)
    inside = scene.surface("glass").inside
    assert inside.scattering_per_mm.at([550]) == pytest.approx(0.015)
    assert inside.absorption_per_mm.at([550]) == pytest.approx(0.001) and inside.anisotropy == 0.7
    assert scene.surface("block").inside is None and not scene.diffuse
    assert all(surface.inside is None for surface in scene.lambertian.surfaces) and scene.lambertian.diffuse
    assert folder / "milk.csv" in scene.origin.files


@pytest.mark.parametrize("shape", ["sphere = { center_mm = [0, 2, 0], radius_mm = 1 }", 'mesh = "tetrahedron.obj"'])
def test_spheres_and_closed_meshes_are_filled(folder, shape):
    faces = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (folder / "tetrahedron.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n" + faces)
    box = "box = { center_mm = [0, 1, 0], size_mm = [2, 2, 2], yaw_deg = 15 }"
    text = FILLED[: FILLED.rindex(box)] + FILLED[FILLED.rindex(box) :].replace(box, shape)
    surface = load(folder, text).surface("glass")
    corners = surface.vertices_mm[surface.faces]
    assert np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0
    for wrong, phrase in (
        (faces.replace("f 3 1 4\n", ""), "an open surface"),
        ("f 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n", "turned inside out"),
    ):
        (folder / "tetrahedron.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n" + wrong)
        if shape.startswith("mesh"):
            assert "surface[2] (glass).inside: found " in (message := fault(folder, text)) and phrase in message


def test_what_cannot_be_filled_is_reported(folder):
    opaque = FILLED.replace('bsdf = { type = "dielectric", int_ior = 1.33 }', "")
    assert "a medium behind the opaque material 'skin'" in fault(folder, opaque)
    assert "(glass).inside.absorption_per_mm: found -1" in fault(folder, FILLED.replace("0.001", "-1"))
    assert "(glass).inside.scattering_per_mm" in fault(folder, FILLED.replace("milk.csv:scattering", "milk.csv:fat"))
    assert "inside.anisotropy" in fault(folder, FILLED.replace("0.7", "1.0"))
