"""Changes that are not in the list come out as `unknown`; no name is above 0.9, however bad its competitors are.

Pictures are computed from the program's own light of the published box, by order of reflection, with noise made up.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders.regress import UNKNOWN, name_line, regress_sides
from cboxlab.validation.compare_renders.regress.causes import causes
from cboxlab.validation.compare_renders.regress.naming import named_changes
from cboxlab.validation.compare_renders.regress.variants import build_variants
from pictures import SIZE, noisy, rendered, variants

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


@cache
def light_until(reflections):
    """(c, y, x) light after up to a number of reflections."""
    return variants().light.change(max_bounces=reflections).picture()


def order(reflections):
    """(c, y, x) light after a number of reflections."""
    return light_until(reflections) - light_until(reflections - 1)


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
    visible = np.isin(index, [number for number, name in enumerate(names) if "block" not in name])
    return with_more(np.where(visible, np.maximum(bare.light.change(max_bounces=1).picture() - order(1), 0), 0))


def quadrant(contrast):
    down, right = coordinates()
    return times(np.where((down > 0) & (right > 0), 1 + contrast, 1.0))


def squared_direct(part):
    """Direct light with a further term in its square, as no renderer of the list has it."""
    light = order(1)
    return with_more(part * light**2 / light.mean())


UNLISTED = {
    "a coarse checkerboard": lambda: checkerboard(8, 0.15),
    "a fine checkerboard": lambda: checkerboard(2, 0.2),
    "a quarter of the picture": lambda: quadrant(0.1),
    "a ripple": lambda: times(1 + 0.1 * np.sin(7 * coordinates()[0] + 3 * coordinates()[1])),
    "two reflections of wrong weights": lambda: with_more(0.15 * order(1) + 0.2 * order(3)),
    "a roulette that pays back twice": lambda: with_more(sum((1.25 ** (n - 3) - 1) * order(n) for n in range(4, 9))),
    "squared direct light": lambda: squared_direct(0.3),
}

LISTED = {
    "cos^4 fall-off": ("fall-off", lambda: fall_off(4)),
    "the second reflection counted twice": ("counted-light", lambda: with_more(order(2))),
    "all later light weighted": ("counted-light", lambda: with_more(0.2 * (variants().picture - light_until(2)))),
    "no shadow of the blocks": ("no-shadow", without_shadows),
}


@pytest.mark.parametrize("change", LISTED)
def test_a_cause_of_the_catalogue_is_named(change):
    name, picture = LISTED[change]
    outcome, names = regress_sides(noisy(1, noise=0.02), noisy(2, picture(), noise=0.02))
    assert not outcome.same
    first = named_changes(names, variants())[0]
    assert first.change == name
    assert first.fits


@pytest.mark.parametrize("change", UNLISTED)
def test_a_change_that_is_not_in_the_list_is_unknown(change):
    outcome, names = regress_sides(noisy(1, noise=0.02), noisy(2, UNLISTED[change](), noise=0.02))
    if outcome.same:
        pytest.skip("not seen: nothing is named")
    changes = named_changes(names, variants())
    assert changes[0].change == UNKNOWN, changes[:3]
    best = next((change_named for change_named in changes if change_named.change != UNKNOWN), None)
    if best is None:
        assert names.removed
        return
    assert best.probability < 0.5
    outcome = replace(outcome, changes=changes)
    assert "unknown" in name_line(outcome)
    record = outcome.to_dict()
    assert record["left_chi2_per_number"] == pytest.approx(best.chi2)
    assert record["fits"] is best.fits


def test_a_cause_of_a_file_is_tried(tmp_path, monkeypatch):
    """A user's cause, named by a variable of the environment; a file that holds none is bad input."""
    lines = [
        "import numpy as np",
        "from cboxlab.validation.compare_renders.regress.causes import Cause, Trial",
        "def trials(pictures):",
        "    x, y = pictures.across()",
        "    yield Trial(lambda a: {'part': float(a[0])}, (pictures.baseline * ((x > 0) & (y > 0))[..., None],))",
        "CAUSE = Cause('lower-right', 'A factor on a quarter.', trials)",
    ]
    (tmp_path / "quarter.py").write_text("\n".join(lines))
    monkeypatch.setenv("CBOXLAB_REGRESS_CAUSES", str(tmp_path / "quarter.py"))
    causes.cache_clear()
    _, names = regress_sides(noisy(1, noise=0.02), noisy(2, quadrant(0.1), noise=0.02))
    first = named_changes(names, None)[0]
    assert first.change == "lower-right"
    assert first.parameters["part"] == pytest.approx(0.1, abs=0.02)
    (tmp_path / "quarter.py").write_text("CAUSE = 1")
    causes.cache_clear()
    with pytest.raises(InputError, match=r"quarter\.py"):
        causes()
    monkeypatch.delenv("CBOXLAB_REGRESS_CAUSES")
    causes.cache_clear()


def test_a_change_of_the_list_fits_and_is_named():
    cut = with_more(light_until(3) - variants().picture)
    outcome, names = regress_sides(noisy(1, noise=0.02), noisy(2, cut, noise=0.02))
    outcome = replace(outcome, changes=named_changes(names, variants()))
    assert outcome.fits and outcome.changes[0].probability > 0.99
    assert name_line(outcome).startswith("named path-depth")
