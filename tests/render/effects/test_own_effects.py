"""A user's own package of effects, one for every stage, is installed: its effects are the catalogue's equals.

benchmarks/diagnosis/users_effects.py hides each of them in a capture and diagnoses it.
"""

import pytest
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import catalogue
from cboxlab.scenes import cornell_box
from cboxlab.validation.diagnose.hypotheses import hypotheses
from helpers.programs.installed_effects import own_effects

STAGES = {
    "washed-surface": "scene",
    "one-more-bounce": "settings",
    "soot": "transport",
    "focus-breathing": "camera",
    "decentred-lens": "camera",
    "warm-filters": "filter",
    "hood-shade": "optics",
    "row-ramp": "counts",
}


@pytest.fixture(scope="module", autouse=True)
def _installed(tmp_path_factory):
    with own_effects(tmp_path_factory.mktemp("site")):
        yield


def test_the_catalogue_holds_them_and_every_one_is_a_hypothesis():
    assert {name: effect.stage for name, effect in catalogue().items() if name in STAGES} == STAGES
    truncated = hypotheses(("f450", "f550"), cornell_box(), RenderSettings(max_bounces=2))
    members = {h.effect.id for h in truncated}
    assert set(STAGES) < members == set(catalogue())
    assert {h.fixed["where"] for h in truncated if h.effect.id == "washed-surface"} == {
        surface.name for surface in cornell_box().surfaces
    }
    ids = {h.effect.id for h in hypotheses(("f450",), cornell_box(), RenderSettings())}
    assert members - ids == {"interreflection", "one-more-bounce"}
