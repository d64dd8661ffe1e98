"""Pixels whose camera rays need no intersection: all their rays meet the plane stated for them."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device import device_array, dr, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.visibility import build_tracer, facet_coverage, intersect, pixel_rays, planar_pixels
from cboxlab.scenes import cornell_box, cornell_camera

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


def test_every_ray_through_such_a_pixel_meets_its_plane_first():
    tracer, camera = build_tracer(cornell_box()), cornell_camera(64)
    coverage = facet_coverage(tracer, camera)
    planar = planar_pixels(tracer, camera, coverage)
    assert len(planar.index) > 0.7 * 64**2
    rays = pixel_rays(camera, device_array(mi.UInt32, planar.index))
    for u, v in np.random.default_rng(1).random((40, 2)):
        ray = rays(dr.opaque(mi.Float, u), dr.opaque(mi.Float, v))
        hit = intersect(tracer, ray)
        dr.eval(hit, ray)  # together: one kernel
        assert dr.all(hit.reflecting)
        assert (hit.material.numpy() == planar.material).all()
        off = (planar.normal * hit.position.numpy().T).sum(axis=1) - planar.height
        assert np.abs(off).max() < 2e-3
        assert ((planar.normal * ray.d.numpy().T).sum(axis=1) < 0).all()


def test_edges_lamps_and_nothing_are_left_out():
    tracer, camera = build_tracer(cornell_box()), cornell_camera(64)
    coverage = facet_coverage(tracer, camera)
    planar = np.zeros(coverage.shape[:2], bool)
    planar.ravel()[planar_pixels(tracer, camera, coverage).index] = True
    assert not planar[coverage.max(axis=-1) < 1].any()
    assert not planar[coverage[..., -1] > 0].any()
    assert not planar[coverage.sum(axis=-1) == 0].any()


def test_a_camera_that_looks_away_sees_none():
    tracer, camera = build_tracer(cornell_box()), cornell_camera(16)
    behind = replace(camera, position_mm=np.array([278.0, 273.0, 5000.0]))
    coverage = facet_coverage(tracer, behind)
    assert not coverage.any() and not len(planar_pixels(tracer, behind, coverage).index)


def test_pixels_of_a_bent_face_are_left_out():
    """The red wall's two triangles are not in one plane: no pixel along its bend is called planar."""
    tracer, camera = build_tracer(cornell_box()), cornell_camera(64)
    coverage = facet_coverage(tracer, camera)
    planar = planar_pixels(tracer, camera, coverage)
    left_index = [s.name for s in tracer.scene.surfaces].index("left")
    indices = np.flatnonzero(coverage[..., tracer.facet_surface == left_index].sum(axis=-1) == 1)
    missing = np.setdiff1d(indices, planar.index)
    assert 20 < len(missing) < 0.2 * len(indices)
