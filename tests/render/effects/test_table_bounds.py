"""Kernels read their tables within bounds, also in the lanes of rays that meet nothing.

Such lanes may hold NaN, which processors turn into different integers: what one of them reads without harm ends the
program on another. In Dr.Jit's debug mode every index is checked, and one out of bounds is printed.
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device import dr
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked, catalogue
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.perturbation.patch_light import patch_light
from cboxlab.rendering.perturbation.patch_transport import build_patch_transport
from cboxlab.rendering.radiosity.final_gather import render_final_gather, solve_light
from cboxlab.scenes import Spectrum, cornell_box, cornell_camera

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

NM = np.array([450.0, 550.0, 650.0])
GRID = np.arange(400.0, 701.0)


@pytest.fixture(scope="module")
def uneven():
    """The published box under an uneven lamp, seen by 16 x 16 pixels, some of them past it."""
    scene = cornell_box().with_lamp(Spectrum(np.array([300.0, 900.0]), np.ones(2)))
    return replace(scene, lamp=replace(scene.lamp, pattern=np.array([[0.5, 1.5]]))), cornell_camera(16)


@pytest.fixture
def bounds(capfd, uneven):
    """Checks every index in the test's kernels."""
    with dr.scoped_set_flag(dr.JitFlag.Debug):
        yield
    assert "out-of-bounds" not in capfd.readouterr().err


@pytest.mark.usefixtures("bounds", "large_patches")
@pytest.mark.parametrize("render", [render_path_tracer, render_final_gather])
def test_pictures(uneven, render):
    assert render(RenderJob(*uneven, NM, 16, 2, seed=1)).project(np.eye(3))[0].max() > 0


@pytest.mark.usefixtures("bounds")
def test_effects_of_transport(uneven):
    scene, camera = uneven
    transport = build_patch_transport(solve_light(scene, NM, patch_edge_mm=150.0, patch_samples=64), camera, 16)
    light = patch_light(transport, scene, NM, GRID, (GRID == NM[:, None]).astype(float), np.ones(GRID.size))
    for effect in (e for e in catalogue().values() if e.stage == "transport"):
        fixed = {p.name: p.choices[0] if p.choices else p.default for p in effect.parameters if p.null is None}
        moved = {p.name: p.null + 0.1 * (p.high - p.null) for p in effect.parameters if p.null is not None}
        assert np.isfinite(apply_checked(effect.id, fixed | moved, "test").apply(light).picture()).all()
