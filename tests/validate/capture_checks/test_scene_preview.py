"""The coarse rendering of the checks against the final gather."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.radiosity import render_final_gather
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.capture_checks.scene_preview import MOST_PX, render_preview

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

BANDS = np.array([450.0, 650.0])


def test_the_preview_has_the_light_of_a_final_gather():
    """The mean over all pixels within 0.5 %, that of each surface within 6 %: a block has three or more patches."""
    scene, camera = cornell_box(), cornell_camera(48)
    image = render_final_gather(RenderJob(scene, camera, BANDS, samples=64, batches=2))
    rendered = image.project(np.eye(2))[0] / scene.lamp.radiance.at(BANDS)
    preview = render_preview(scene, camera, scene.reflectances(BANDS))
    compared = image.single_surface & preview.on_surface & (preview.surface == image.surface)
    assert np.count_nonzero(compared) > 0.9 * np.count_nonzero(image.single_surface & (image.surface >= 0)) - 100
    mean = preview.radiance[:, compared].mean(axis=1)
    np.testing.assert_allclose(mean, rendered[compared].mean(axis=0), rtol=0.005)
    for surface in np.unique(preview.surface[compared]):
        pixels = compared & (preview.surface == surface)
        mean = preview.radiance[:, pixels].mean(axis=1)
        np.testing.assert_allclose(mean, rendered[pixels].mean(axis=0), rtol=0.06)


def test_rows_and_columns_are_left_out_of_a_large_picture():
    camera = cornell_camera(2 * MOST_PX)
    preview = render_preview(cornell_box(), camera, cornell_box().reflectances(BANDS))
    assert preview.step == 2 and preview.surface.shape == (MOST_PX, MOST_PX)
    assert preview.radiance.shape == (2, MOST_PX, MOST_PX)


def test_lamp_background_and_back_sides_have_no_light():
    scene, camera = cornell_box(), cornell_camera(32)
    inside_out = tuple(replace(s, faces=s.faces[:, ::-1].copy()) if s.name == "back" else s for s in scene.surfaces)
    preview = render_preview(replace(scene, surfaces=inside_out), camera, scene.reflectances(BANDS))
    back = [surface.name for surface in scene.surfaces].index("back")
    assert not np.any(preview.surface == back) and np.any(preview.surface == -1)
    assert np.any(preview.surface == len(scene.surfaces)), "the lamp"
    assert np.all(preview.radiance[:, ~preview.on_surface] == 0) and np.all(preview.direct[~preview.on_surface] == 0)
