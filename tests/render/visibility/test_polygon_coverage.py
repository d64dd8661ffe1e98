"""Coverage by polygons: what the same camera rays say, traced through Embree's tree."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.render.device.variant import compiled
from cboxlab.render.visibility import build_tracer, pixel_coverage
from cboxlab.render.visibility.faces_and_tree import in_a_tree
from cboxlab.scenes import cornell_box, cornell_camera
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

SIZE, SAMPLES = 40, 256
TURNED = Rotation.from_euler("yxz", [4.0, -3.0, 10.0], degrees=True).as_matrix()


def cameras():
    published = cornell_camera(SIZE)
    inside = replace(published, position_mm=np.array([300.0, 400.0, 60.0]))
    return {
        "published": published,
        "distorted": replace(published, k1=-0.12),
        "inside, past a block": inside,
        "wide, from within": replace(inside, focal_length_px=0.2 * published.focal_length_px),
        "askew, sees backs": replace(published, position_mm=np.array([540.0, 300.0, -500.0])),
        "turned and tilted": replace(published, rotation=TURNED @ published.rotation),
        "in the plane of a wall": replace(published, position_mm=np.array([300.0, 0.0, -800.0])),
    }


@pytest.mark.parametrize("name", cameras())
def test_shares_are_those_of_rays(name):
    camera = cameras()[name]
    tracer = build_tracer(cornell_box())
    pixels = np.arange(SIZE * SIZE)
    found, expected = (
        pixel_coverage(t, [camera], pixels, SAMPLES, seed=3)[0]
        for t in (tracer, replace(tracer, accelerator=in_a_tree(tracer.vertices)))
    )
    assert 0 < expected.sum() / len(pixels) <= 1
    assert ((expected > 0) & (expected < 1)).any(axis=1).sum() > 20
    off = np.abs(found - expected) * SAMPLES
    assert off.max() <= 2  # samples within rounding of an edge
    assert (off > 0.5).sum() <= 0.01 * len(pixels)
