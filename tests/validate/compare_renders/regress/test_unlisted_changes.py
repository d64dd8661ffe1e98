"""Changes that are not in the list come out as `unknown`; no name is above 0.9, however bad its competitors are.

Pictures are computed from the program's own light of the published box, by order of reflection, with noise made up.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.compare_renders.regress import UNKNOWN, name_line, regress_sides
from cboxlab.validation.compare_renders.regress.naming import named_changes
from cboxlab.validation.compare_renders.regress.variants import build_variants
from pictures import SIZE, noisy, rendered

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


@cache
def variants():
    return build_variants(cornell_box(), cornell_camera(SIZE), noisy(1))


def order(reflections):
    """(c, y, x) light after so many reflections."""
    last, before = (variants().light.change(max_bounces=k).picture() for k in (reflections, reflections - 1))
    return last - before


def with_more(light):
    """The picture with more light (c, y, x) than it has."""
    return rendered()[0] * variants().ratio(variants().picture + light)


def coordinates():
    """(y, x) from -1 to 1."""
    axis = np.linspace(-1, 1, SIZE)
    return np.meshgrid(axis, axis, indexing="ij")


def times(factor):
    """The picture times a factor (y, x)."""
    return rendered()[0] * factor[..., None]


def fall_off(power):
    u, v = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    camera = cornell_camera(SIZE)
    return times((camera.directions(u, v) @ camera.rotation.T)[..., 2] ** power)


def checkerboard(edge_px, contrast):
    rows, columns = np.indices((SIZE, SIZE))
    return times(1 + contrast * np.where((rows // edge_px + columns // edge_px) % 2, 1, -1))


def without_shadows():
    """Of the blocks, at the first reflection: the shadow ray is dropped where walls, floor and ceiling are seen."""
    box = cornell_box()
    walls = tuple(surface for surface in box.surfaces if "block" not in surface.name)
    bare = build_variants(replace(box, surfaces=walls), cornell_camera(SIZE), noisy(1))
    names, index = [surface.name for surface in box.surfaces], variants().surface_map().index
    seen = np.isin(index, [number for number, name in enumerate(names) if "block" not in name])
    return with_more(np.where(seen, np.maximum(bare.light.change(max_bounces=1).picture() - order(1), 0), 0))


UNLISTED = {
    "cos^4 fall-off": lambda: fall_off(4),
    "a weak fall-off": lambda: fall_off(1.2),
    "a gradient": lambda: times(1 + 0.05 * coordinates()[1]),
    "a weak gradient": lambda: times(1 + 0.025 * coordinates()[0]),
    "a coarse checkerboard": lambda: checkerboard(8, 0.15),
    "a fine checkerboard": lambda: checkerboard(2, 0.2),
    "direct light counted twice": lambda: with_more(order(1)),
    "the second reflection counted twice": lambda: with_more(order(2)),
    "a fifth of it counted twice": lambda: with_more(0.2 * order(2)),
    "the third reflection counted twice": lambda: with_more(order(3)),
    "no shadow of the blocks": without_shadows,
}


@pytest.mark.parametrize("change", UNLISTED)
def test_a_change_that_is_not_in_the_list_is_unknown(change):
    outcome, found = regress_sides(noisy(1, noise=0.02), noisy(2, UNLISTED[change](), noise=0.02))
    if outcome.same:
        pytest.skip("not seen: nothing is named")
    named = named_changes(found, variants())
    assert named[0].change == UNKNOWN, named[:3]
    best = next((one for one in named if one.change != UNKNOWN), None)
    if best is None:
        assert found.removed
        return
    assert best.probability < 0.5
    outcome = replace(outcome, named=named)
    assert "unknown" in name_line(outcome)
    record = outcome.to_dict()
    assert record["left_chi2_per_number"] == pytest.approx(best.chi2)
    assert record["fits"] is best.fits


def test_a_gradient_over_the_picture_is_described():
    _, found = regress_sides(noisy(1, noise=0.02), noisy(2, UNLISTED["a gradient"](), noise=0.02))
    assert named_changes(found, variants())[0].parameters == {"description": "smooth over the picture"}


def test_a_change_of_the_list_fits_and_is_named():
    outcome, found = regress_sides(noisy(1, noise=0.02), noisy(2, rendered(3)[0], noise=0.02))
    outcome = replace(outcome, named=named_changes(found, variants()))
    assert outcome.fits and outcome.named[0].probability > 0.99
    assert name_line(outcome).startswith("named path-depth")
