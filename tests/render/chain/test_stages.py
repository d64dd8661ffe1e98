"""The stages of the chain: one list, which every effect of the catalogue keeps to."""

from typing import get_args

import pytest
from cboxlab.rendering.chain.stages import PHOTOGRAPHED, STAGES, Stage, after_stage, stages_between
from cboxlab.rendering.effects import apply_checked, catalogue
from helpers.fakes.stages import counts, light, start


def test_the_list_names_every_stage_once_in_the_order_of_light():
    assert tuple(STAGES) == get_args(Stage)
    assert next(iter(STAGES)) == "scene" and next(reversed(STAGES)) == "counts"
    assert set(PHOTOGRAPHED) == set(STAGES) - {"settings"}


def test_stages_between_two():
    assert stages_between("filter", "counts") == ("filter", "optics", "counts")
    assert stages_between("camera", "camera") == ("camera",)
    assert stages_between("scene", "counts") == tuple(STAGES)


@pytest.mark.parametrize("identifier", [name for name, e in catalogue().items() if e.stage != "transport"])
def test_an_effect_takes_and_returns_its_stages_value(identifier):
    effect = catalogue()[identifier]
    value = start(effect)
    assert type(value) is STAGES[effect.stage]
    assert type(apply_checked(identifier, {}, "test").apply(value)) is STAGES[effect.stage]


def test_a_stage_takes_its_own_effects_in_their_order_and_passes_over_the_others():
    glare = apply_checked("veiling-glare", {"fraction": 0.1}, "test")
    edge = apply_checked("vignetting", {"edge_loss": 0.5}, "test")
    offset = apply_checked("dark-offset", {"dn": 5.0}, "test")
    result = after_stage(light(), [glare, offset, edge], "optics")
    assert (result.signal == edge.apply(glare.apply(light())).signal).all()
    assert (result.signal != glare.apply(edge.apply(light())).signal).any()
    assert (after_stage(counts(), [glare, offset, edge], "counts").scene == offset.apply(counts()).scene).all()
