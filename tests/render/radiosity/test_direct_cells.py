"""Direct light in cells: its means over surfaces, its value next to shadows, and points that an object covers."""

import numpy as np
import pytest
from cboxlab.rendering.device import SobolPoints, device_array, dr, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.radiosity.direct_cells import build_direct_cells
from cboxlab.rendering.radiosity.lamp import build_lamp_samplers, direct_light
from cboxlab.rendering.radiosity.patches import build_patches, patch_points
from cboxlab.rendering.visibility import RAY_OFFSET_MM, build_tracer, intersect
from cboxlab.scenes import cornell_box

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

EDGE_MM, PATCH_MM, POINTS = 10.0, 60.0, 4096


@pytest.fixture(scope="module")
def tracer():
    return build_tracer(cornell_box())


@pytest.fixture(scope="module")
def means(tracer):
    """Over the free points of large patches, with as many of the lamp: what cells say, and what shadow rays say."""
    lamp = build_lamp_samplers(tracer)[0]
    cells = build_direct_cells(tracer, (lamp,), EDGE_MM, 256, seed=1)[0]
    patches = build_patches(tracer, PATCH_MM)
    lane = dr.arange(mi.UInt32, len(patches))
    points, points_at = SobolPoints(4, POINTS, lane, 2), patch_points(tracer, patches)

    def body(i, read, traced, unshadowed):
        at, normal = points_at(lane, points.point(i, 0), points.point(i, 1))
        above = intersect(tracer, mi.Ray3f(at + normal * RAY_OFFSET_MM, normal))
        free = ~above.valid | above.front
        hit = intersect(tracer, mi.Ray3f(at + normal, -normal), free)
        light = direct_light(tracer, lamp, at, normal, points.point(i, 2), points.point(i, 3), free)
        return (
            i + 1,
            read + cells.at(hit, hit.reflecting),
            traced + light,
            unshadowed + dr.select(free, mi.Float(1), 0),
        )

    zero = dr.zeros(mi.Float, len(patches))
    state = (dr.zeros(mi.UInt32, len(patches)), zero, zero, zero)
    _, *sums = dr.while_loop(state, lambda i, *_: i < POINTS, body)
    read, traced, unshadowed = (total.numpy() for total in sums)
    return patches, read / np.maximum(unshadowed, 1), traced / np.maximum(unshadowed, 1), unshadowed


@pytest.mark.parametrize("edge_mm", [100.0, 200.0])
def test_rays_read_cells_from_four_of_their_edges_on(tracer, edge_mm):
    cells = build_direct_cells(tracer, (build_lamp_samplers(tracer)[0],), edge_mm, 4, seed=1)[0]
    assert cells.far.numpy().tolist() == [4 * edge_mm]


def test_means_over_surfaces_are_those_of_shadow_rays(tracer, means):
    patches, read, traced, unshadowed = means
    for surface, name in enumerate(s.name for s in tracer.scene.surfaces):
        weight = patches.area * unshadowed * (patches.surface == surface)
        if name == "ceiling":  # in the lamp's plane
            assert np.abs(read[patches.surface == surface]).max() < 1e-6
            continue
        assert np.average(read, weights=weight) == pytest.approx(np.average(traced, weights=weight), rel=2e-4), name


def test_patches_in_light_and_shadow_agree(means):
    """Half shadows and the patches along the blocks' feet among them; of the brightest patch's light."""
    _, read, traced, unshadowed = means
    free = unshadowed > 0.1 * POINTS
    assert np.abs(read - traced)[free].max() < 0.0025 * traced.max()
    assert np.count_nonzero((traced > 0.02 * traced.max()) & (traced < 0.2 * traced.max()) & free) > 20


def test_what_an_object_covers_adds_no_shadow(tracer, means):
    """A patch covered in part has the light of its free part; covered patches are dark."""
    _, read, traced, unshadowed = means
    partly = (unshadowed > 0.2 * POINTS) & (unshadowed < 0.8 * POINTS) & (traced > 0.05 * traced.max())
    assert np.count_nonzero(partly) > 5
    assert read[partly] == pytest.approx(traced[partly], rel=0.03)
    assert (read[unshadowed == 0] == 0).all()


def test_no_light_where_no_ray_ends(tracer):
    lamp = build_lamp_samplers(tracer)[0]
    cells = build_direct_cells(tracer, (lamp,), 100.0, 16, seed=1)[0]
    outwards = mi.Ray3f(mi.Point3f(278, 273, -800), mi.Vector3f(device_array(mi.Float, [0.0]), 0, -1))
    hit = intersect(tracer, outwards)
    assert cells.at(hit, hit.reflecting).numpy() == [0]
