"""What surveys tolerate, in the picture, and when the picture is rendered again."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.diagnose import stepwise
from cboxlab.validation.diagnose.stepwise import refitted, tolerated_changes


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_what_a_tolerance_changes_is_its_share_of_a_step_at_the_lamps_power(scale):
    """A step of 0.2 mm changes 3 DN; a tolerance of 0.05 mm is a quarter of it. Numbers without any are left out."""
    free = (SimpleNamespace(tolerance=0.05), SimpleNamespace(tolerance=0.0))
    stand_in = SimpleNamespace(
        hypothesis=SimpleNamespace(free=free), steps=(0.2, 1.0), changes=(np.array([3.0, -3.0]), np.ones(2))
    )
    (change,) = tolerated_changes(SimpleNamespace(scale=scale), [stand_in, SimpleNamespace(changes=None)])
    np.testing.assert_allclose(change, scale * np.array([0.75, -0.75]))


@pytest.mark.parametrize(
    ("moved_mm", "stage", "pilots"),
    [(0.0, "optics", []), (1.0, "optics", [0.5]), (30.0, "optics", [0.5]), (30.0, "scene", [None])],
)
def test_the_picture_is_rendered_again_where_the_camera_moved(monkeypatch, moved_mm, stage, pilots):
    """The fit first finds the camera 30 mm (some pixels) from where the picture was rendered from, then there. The
    pilot of the first picture serves again where the light is the same. A camera that hardly moved is settled."""
    before = cornell_camera(32)
    after = before.with_parameters(before.parameters + np.array([moved_mm, *np.zeros(9)]))
    calls = []

    def rendered_from(prepared, light, camera, settings, effects, progress, pilot):
        calls.append((camera, light, pilot))
        return SimpleNamespace(camera=camera)

    settled = []

    def refitted_picture(prepared, rendered, effects, near=None):
        settled.append(near)
        return SimpleNamespace(fit=SimpleNamespace(camera=after, lamp_scale=0.5), pilot=0.5, signal=8.0, variance=12.0)

    monkeypatch.setattr(stepwise, "refitted_picture", refitted_picture)
    monkeypatch.setattr(stepwise, "solved_light", lambda *_: "another light")
    monkeypatch.setattr(stepwise, "replace", lambda changed_object, **_: changed_object)
    monkeypatch.setattr(stepwise, "rendered_from", rendered_from)
    rendered_with = []

    def linearised_fit(prepared, altered, included, added):
        rendered_with.append((prepared, included, added))
        return altered.fit.camera

    monkeypatch.setattr(stepwise, "linearised_fit", linearised_fit)
    predictor = SimpleNamespace(camera=before, signal=lambda effects: None)
    linearised = SimpleNamespace(rendered=SimpleNamespace(used="used", predictor=predictor), model_effects=("own",))
    prepared = SimpleNamespace(scene=cornell_box(), fitted_about=lambda *prediction: prediction)
    validation = SimpleNamespace(prepared=prepared, model=SimpleNamespace(render=None), light="light")
    stand_in = SimpleNamespace(applied="found", hypothesis=SimpleNamespace(effect=SimpleNamespace(stage=stage)))
    assert refitted(validation, linearised, [stand_in]) is after
    assert calls == [(after, "another light" if stage == "scene" else "light", pilot) for pilot in pilots]
    # what is unknown of the capture is fitted to the picture at the lamp's power
    assert rendered_with == [((4.0, 3.0, "used"), ("own",), ("found",))]
    assert settled == [None, *[moved_mm == 1.0] * len(pilots)]


def test_an_effect_that_priors_judge_need_not_explain_the_picture(monkeypatch):
    """A lamp that misses its stated power gains 20 of chi-square, next to 3,000 by soft corners."""
    monkeypatch.setattr(stepwise, "residual_with", lambda linearised, selected: np.array([np.sqrt(5980.0)]))
    monkeypatch.setattr(stepwise, "_has_remainder", lambda linearised, selected: True)
    picture = SimpleNamespace(model=SimpleNamespace(chi2=6000.0, count=3000))
    by_priors, by_picture = SimpleNamespace(by_priors=True), SimpleNamespace(by_priors=False)
    assert not stepwise._explain_too_little(picture, [by_priors])
    assert stepwise._explain_too_little(picture, [by_picture])
    assert stepwise._explain_too_little(picture, [by_priors, by_picture])
