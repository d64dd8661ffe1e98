"""The demo end to end: the hidden effect of a capture is named, sized, added, and the error falls.

The capture has a quarter of the pixels of the bundled one, whose glare app/commands/test_demo.py finds.
"""

import importlib
import json
import warnings
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import AppliedEffect, Effect, apply_checked, catalogue
from cboxlab.rendering.image.blur import blur
from cboxlab.rendering.model.model_file import Model, load_model, write_model
from cboxlab.rendering.model.stages import displacement
from cboxlab.rendering.perturbation import warp_change
from cboxlab.scenes import cornell_box
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.api import verify
from cboxlab.validation.app.commands import console, demo_chain
from cboxlab.validation.compare.pipeline import validate_prepared
from cboxlab.validation.diagnose.alternatives import SelectedEffect
from cboxlab.validation.diagnose.evidence import first_significant, prior_pull
from cboxlab.validation.diagnose.fitting import fit
from cboxlab.validation.diagnose.further_captures import distance, further_captures, separations
from cboxlab.validation.diagnose.hypotheses import hypotheses
from cboxlab.validation.diagnose.linearised_fit import _by_lamp_scale, linearised_fit, residual_with
from cboxlab.validation.diagnose.search import screen, signature
from cboxlab.validation.diagnose.selection import best_singles
from cboxlab.validation.diagnose.unexplained import residual_data_of
from cboxlab.validation.report.diagnosis import diagnosis_record, path_steps, write_diagnosis
from cboxlab.validation.report.plots import MapRow
from cboxlab.validation.report.story import story
from helpers.captures.glare_capture import glare_capture
from helpers.files.raw_frames import read_raw
from helpers.programs.manual_commands import described
from PIL import Image
from scipy import stats
from scipy.ndimage import convolve

diagnosis_module = importlib.import_module("cboxlab.validation.diagnose.diagnosis")
pytestmark = pytest.mark.usefixtures("large_patches")

#: Side of the capture's pictures, px, and its veiling glare.
SIZE, GLARE = 64, 0.008


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """One demo, with a rougher render and larger patches than a user's: what was found, its folder, its text."""
    folder = tmp_path_factory.mktemp("demo") / "report"
    capture = glare_capture(folder.parent / "capture", SIZE, GLARE, relative_error=0.004)
    with warnings.catch_warnings(), console.console.capture() as text, pytest.MonkeyPatch.context() as patch:
        warnings.simplefilter("ignore")
        patch.setattr(demo_chain, "DEMO_CAPTURE", capture)
        diagnosis = demo_chain.run_demo(folder, Model(render=RenderSettings(noise=1.0)))
    return diagnosis, folder, text.get()


@pytest.fixture(scope="module")
def outcome(demo):
    """The demo's validation and diagnosis."""
    return demo[0]


def test_the_demo_leaves_a_report_and_a_raw_frame(demo):
    _, folder, _ = demo
    assert verify(folder).sound
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["chi2_per_dof"] > 2  # the hidden glare
    assert metrics["camera"]["reprojection_rms_px"] < 1.15 * 0.15
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "<html" in page and "The same light in another camera: Kodak DCS-200" in page
    counts, notes = read_raw(folder / "raw.tif")
    assert counts.shape == (SIZE, SIZE) and counts.dtype == np.uint16
    assert notes["camera"] == "Kodak DCS-200"
    preview = np.asarray(Image.open(folder / "raw.png"))
    assert preview.shape == (SIZE, SIZE, 3)
    # The red wall stands on the left, the green one on the right.
    left, right = preview[20:45, 2:6].mean(axis=(0, 1)), preview[20:45, -6:-2].mean(axis=(0, 1))
    assert left[0] > 1.5 * left[1] and right[1] > 1.2 * right[0]


def test_the_demo_prints_its_parts_in_order(demo):
    *_, text = demo
    steps = [text.index(f"{number}. ") for number in range(1, 6)]
    assert steps == sorted(steps)
    for phrase in (
        "reprojection rms",
        "Rendering of the model",
        "per degree of freedom",
        "of the excess χ²",
        "DCS-200",
    ):
        assert phrase in text
    assert "Noise does not explain the difference." in text


def test_hidden_glare_is_found_and_sized(outcome):
    """Veiling glare of 0.8 % of all light, 20 times its measurement's error."""
    _, diagnosis = outcome
    assert not diagnosis.adequate
    assert diagnosis.selected == ("veiling-glare",)
    assert diagnosis.ranking[0].effect == "veiling-glare"
    fraction = diagnosis.path[-1].effects[0].values["fraction"]
    assert fraction == pytest.approx(GLARE, rel=0.05)
    assert diagnosis.heldout_pixels > 0.9
    assert diagnosis.heldout_bands > 0.9


def test_error_falls_to_the_noise(outcome):
    validation, diagnosis = outcome
    first, last = diagnosis.path[0], diagnosis.path[-1]
    assert first.comparison is validation.comparison
    assert last.comparison.chi2.per_dof < 1.2 < first.comparison.chi2.per_dof
    assert last.smooth_excess < 0.1 * first.smooth_excess
    noise = last.comparison.colour_noise["delta_e_ab"].mean
    assert last.comparison.colour["delta_e_ab"].mean < 1.1 * noise


@pytest.mark.filterwarnings("ignore")
def test_a_model_without_any_reflection_has_nothing_to_compare(outcome):
    with pytest.raises(InputError, match="max_bounces"):
        validate_prepared(outcome[0].prepared, Model(render=RenderSettings(max_bounces=0, noise=3.0)))


def test_record_has_the_agreed_keys(outcome, tmp_path):
    _, diagnosis = outcome
    write_diagnosis(tmp_path / "d.json", diagnosis)
    record = json.loads((tmp_path / "d.json").read_text())
    assert set(record) == described("docs/reference/files.md", "diagnosis.json")
    assert record == diagnosis_record(diagnosis)
    names = [entry["effect"] for entry in record["ranking"]]
    assert len(set(names)) == len(names) and "unknown" in names
    assert sum(entry["probability"] for entry in record["ranking"]) == pytest.approx(
        1.0
    )  # nothing missing is ruled out
    assert [step.effects for step in path_steps(diagnosis)] == [(), ("veiling-glare",)]


def test_report_gives_the_cause_its_size_and_why_not_another(outcome):
    _, diagnosis = outcome
    bands = [(i, f"band {i}") for i in range(len(diagnosis.residual))]
    lines = story(diagnosis, bands)
    assert lines.headline.sentence.startswith("The model lacks veiling-glare (fraction 0.00")
    first, second, third = diagnosis.causes
    assert first.effect == "veiling-glare" and first.behind_sigma == 0
    assert first.cosine > 0.5 and first.cosine_with_first == pytest.approx(1)
    assert max(second.cosine, third.cosine) < first.cosine
    text = " ".join(lines.missing.paragraphs)
    assert f"Why not {second.effect}" in text and f"Why not {third.effect}" in text
    signatures = [block for block in lines.missing.blocks if isinstance(block, MapRow)]
    assert len(signatures) == 4  # the difference and three causes, the same bands, one scale
    assert len({tuple(p.caption for p in row.panels) for row in signatures}) == 1
    assert {(row.scale.low, row.scale.high) for row in signatures} == {(-5, 5)}
    assert any("Add it to the model: veiling-glare fraction=0.00" in step for step in lines.next.steps)


def test_final_model_is_written_and_read_back(outcome, tmp_path):
    _, diagnosis = outcome
    write_model(tmp_path / "model.toml", diagnosis.model)
    again = load_model(tmp_path / "model.toml")
    assert [(e.id, dict(e.values)) for e in again.effects] == [(e.id, dict(e.values)) for e in diagnosis.model.effects]


@pytest.mark.parametrize(
    ("effect", "values"),
    [("camera-pose", {"rz_deg": 0.1, "tx_mm": 2.0}), ("lens-distortion", {"k1": -0.08})],
)
def test_a_camera_that_moved_after_the_survey_is_named_and_measured(outcome, effect, values):
    """The picture fits the fitted camera whatever the survey says: moving the survey's moves only what strains it.

    The survey itself is off by its own noise, so the estimate lies within 4 standard deviations of the truth.
    """
    validation, _ = outcome
    moved = apply_checked(effect, values, "test")
    surveyed = validation.prepared.calibrated_camera
    before = surveyed.with_parameters(surveyed.parameters - displacement(surveyed, (), (moved,)))
    glare = apply_checked("veiling-glare", {"fraction": GLARE}, "test")
    surveyed_there = replace(validation.prepared.camera_fit, camera=before)
    prepared = replace(validation.prepared, camera_fit=surveyed_there)
    linearised = linearised_fit(prepared, validation.rendered, (glare,))
    problem, residual = linearised.problem(()), linearised.model.residual
    hypotheses_by_id = [
        signature(linearised.predictor, (glare,), linearised.model.used, h)
        for h in hypotheses(linearised.predictor.sensing.curves.bands, cornell_box(), RenderSettings())
        if h.effect.id in ("camera-pose", "lens-distortion", "dark-offset")
    ]
    significant = first_significant(
        best_singles(problem, hypotheses_by_id, residual, 3), residual, linearised.model, residual, residual
    )
    assert significant is not None
    assert significant.hypothesis.effect.id == effect
    for name, value in values.items():
        assert abs(significant.numbers[name] - value) < 4 * significant.sigma[name]
    with_it = linearised_fit(prepared, validation.rendered, (glare, moved))
    assert prior_pull(residual) > 5
    assert prior_pull(residual_with(with_it, [])) < np.sqrt(stats.chi2.isf(1e-5, 11))


@pytest.mark.parametrize(
    "linearised",
    [
        None,
        ("veiling-glare", {"fraction": GLARE}),
        ("wall-reflectance", {"material": "red", "scale": 1.2}),
        ("ambient-light", {"radiance": 2e-7, "spectrum": "daylight"}),
        ("dark-offset", {"dn": 150.0}),
    ],
)
@pytest.mark.parametrize("included", [False, True])
def test_the_lamps_scale_does_what_a_brighter_lamp_does(outcome, linearised, included):
    """To rounding, with another effect in the model, the camera fitted 0.03 px next to where the picture was rendered
    from. Reflected light grows with the lamp; light of the room and offsets of counts do not."""
    rendered = outcome[0].rendered
    others = () if linearised is None else (apply_checked(*linearised, "test"),)
    light = tuple(e for e in others if included and e.stage in ("scene", "transport"))
    moved = rendered.predictor.camera.parameters + np.array([0.1, *np.zeros(9)])
    still = replace(rendered.predictor, included=light).at_lamp(1.0)
    camera = still.camera.with_parameters(moved)
    moved_picture = still.with_camera(camera)
    brighter = apply_checked("lamp-power", {"scale": 1.3}, "test")
    before, after = moved_picture.signal(others), moved_picture.signal((*others, brighter))
    mask = rendered.used & (rendered.predictor.base.signal > 300)
    assert np.abs(before - still.signal(others))[mask].max() > 10
    if linearised is None:
        np.testing.assert_allclose(before, still.signal(()) + warp_change(still.warp, camera), atol=1e-6)
    np.testing.assert_allclose(1.3 * moved_picture.at_lamp(1.3).signal(others)[mask], after[mask], rtol=1e-5)
    grown = np.median(after[mask] / before[mask])
    if linearised is not None and linearised[0] in ("ambient-light", "dark-offset"):
        assert 1.0 < grown < 1.299
    else:
        assert grown == pytest.approx(1.3, rel=1e-5)


def test_derivative_by_the_lamps_scale_and_noise_are_of_light_alone(outcome):
    """With an offset of counts the signal is a straight line in the lamp's power, which does not pass through 0; the
    picture's error grows with the power, so that over it it stays."""
    predictor = outcome[0].rendered.predictor.at_lamp(1.3)
    offset = (apply_checked("dark-offset", {"dn": 150.0}, "test"),)
    slope = 2 * predictor.at_lamp(2.6).signal(offset) - predictor.signal(offset)
    np.testing.assert_allclose(_by_lamp_scale(predictor, offset), slope, rtol=1e-6, atol=1e-6)
    assert (predictor.signal(offset) - slope).min() > 80
    error = np.random.default_rng(3).standard_normal(slope.shape)
    noise, unscaled = (each.signal_and_noise((), error)[1] for each in (predictor, predictor.at_lamp(1.0)))
    np.testing.assert_allclose(noise, unscaled, atol=1e-8)
    assert noise.std() > 0.9


def test_a_lamp_between_two_patterns_lights_as_if_traced(outcome):
    """Mixed from the pictures of two patterns, against its own rays.

    Pixels' errors are independent of each other (false alarm 1e-6 a comparison); beyond them the patches' own light,
    traced with 512 rays each, may be off by 0.1% of a surface's mean.
    """
    predictor = outcome[0].rendered.predictor
    scene = replace(predictor.scene, lamp=replace(predictor.scene.lamp, edge_ratio=0.3))
    effect = apply_checked("lamp-nonuniform", {"edge_ratio": 0.3}, "test")
    mixed, traced = predictor.patch_picture((effect,)), predictor.patch_picture_of(scene, ())
    plain, image = predictor.patch_picture(()), predictor.image
    change = 0.0
    for surface in range(len(image.surface_names)):
        mask = image.single_surface & (image.surface == surface)
        off, level = (mixed - traced)[:, mask].mean(axis=0), plain[:, mask].mean()
        assert abs(off.mean()) < 4.9 * off.std() / np.sqrt(mask.sum()) + 0.001 * level
        change = max(change, abs((mixed - plain)[:, mask].mean()) / level)
    assert change > 0.01


def test_a_users_effect_may_give_a_surface_another_paint(outcome):
    """All that is red in a new paint, a tenth darker: what wall-reflectance makes of the old one, to rounding."""
    predictor = outcome[0].rendered.predictor
    darker = apply_checked("wall-reflectance", {"material": "red", "scale": 0.9}, "test")

    def repaint(scene):
        surfaces = tuple(replace(s, material="new") if s.material == "red" else s for s in scene.surfaces)
        new = darker.apply(scene).materials["red"]
        return replace(scene, surfaces=surfaces, materials={**scene.materials, "new": new})

    effect = AppliedEffect(Effect("repainted", "scene", "", (), repaint, ""), {})
    after, plain = predictor.patch_picture((effect,)), predictor.patch_picture(())
    np.testing.assert_allclose(after, predictor.patch_picture((darker,)), rtol=1e-5)
    in_light = plain > 0
    assert abs(after[in_light] / plain[in_light] - 1).max() > 0.05
    # a picture rendered with it: what remains is explained with the paints of that scene
    linearised = linearised_fit(outcome[0].prepared, outcome[0].rendered, ())
    repainted = replace(linearised, predictor=replace(predictor, included=(effect,)))
    excess = residual_data_of(repainted, linearised.model.residual, outcome[0].prepared.calibration.capture)
    np.testing.assert_allclose(excess.moved, repainted.scale * repainted.derivative[7:9], rtol=1e-5)
    assert len(excess.transport.reflectance) == len(predictor.scene.materials) + 2  # the new paint and the lamp


def test_a_capped_frame_separates_an_offset_from_glare(outcome):
    """Glare needs light, an offset does not: frames with the lens capped and the lamp on separate the two.

    An offset of d DN in n capped frames' samples of variance v makes at least n d^2 / v of chi2, glare nothing.
    """
    validation, _ = outcome
    linearised = linearised_fit(validation.prepared, validation.rendered, ())
    problem, residual = linearised.problem(()), linearised.model.residual
    hypotheses_by_id = {
        h.effect.id: h
        for h in hypotheses(linearised.predictor.sensing.curves.bands, cornell_box(), RenderSettings())
        if h.effect.id in ("dark-offset", "veiling-glare")
    }
    fitted = {
        name: fit(
            problem,
            next(screen(problem, [signature(linearised.predictor, (), linearised.model.used, h)], residual)),
            residual,
        )
        for name, h in hypotheses_by_id.items()
    }
    glare, offset = fitted["veiling-glare"], fitted["dark-offset"]
    rivals = (replace(glare, chi2=offset.chi2),)
    effect = SelectedEffect(offset, rivals, linearised.model.chi2, 1.0, 1.0, 0.01, linearised.model.count, 1.0)
    (separation,) = separations(validation.prepared, linearised, [effect])
    assert (separation.effect, separation.alternative, separation.enough) == ("dark-offset", "veiling-glare", True)
    capped = next(c for c in further_captures(validation.prepared, linearised) if c.capped)
    dark = validation.prepared.calibration.predicted_variance(np.zeros(linearised.base.shape))[linearised.model.used]
    least = np.sum(offset.numbers["dn"] ** 2 / dark)
    reached = distance(validation.prepared, linearised, capped, (), offset, glare)
    now = distance(validation.prepared, linearised, None, (), offset, glare)
    assert 0.9 * least < reached - now < 1.2 * least


def test_a_blur_gains_nothing_by_averaging_the_pictures_own_noise(outcome):
    """White noise of variance v keeps the sum of k^2 v behind a blur with kernel k; that much chi2 is not the truth's.

    One draw of n values: the sum of squares scatters by sqrt(2 sum of (v / sigma^2)^2); false alarm 6e-5 at 4.
    """
    validation, _ = outcome
    linearised = linearised_fit(validation.prepared, validation.rendered, ())
    delta = np.zeros((15, 15))
    delta[7, 7] = 1.0
    kernel = blur(delta, 0.4)
    variance = np.where(np.isfinite(validation.rendered.variance), validation.rendered.variance, 0.0)
    behind = np.stack([convolve(v, kernel**2, mode="nearest") for v in variance])
    model = linearised.model
    expected = linearised.scale**2 * np.sum((variance - behind)[model.used] / model.sigma**2)
    scatter = np.sqrt(2 * np.sum((variance[model.used] / model.sigma**2) ** 2))
    problem = linearised.problem(())
    gain = problem.noise_averaging_gain(apply_checked("defocus", {"sigma_px": 0.4}, "test"))
    assert abs(gain - expected) < 4 * scatter < 0.2 * expected
    brighter = apply_checked("wall-reflectance", {"material": "red", "scale": 1.1}, "test")
    assert problem.noise_averaging_gain(brighter) == 0


def test_every_effect_is_tried_and_truncation_only_where_light_was_cut():
    limited = hypotheses(("f400", "f550"), cornell_box(), RenderSettings(max_bounces=2))
    assert {h.effect.id for h in limited} == set(catalogue())
    complete = hypotheses(("f400", "f550"), cornell_box(), RenderSettings())
    assert "interreflection" not in {h.effect.id for h in complete}
    bands = {h.fixed["band"] for h in complete if h.effect.id == "band-gain"}
    assert bands == {"f400", "f550"}
    assert all(np.isfinite(p.step) for h in complete for p in h.free)


class _Reached(Exception):
    """The end of what a test looks at."""


@pytest.mark.parametrize(
    ("remains", "next_to_flaws", "single_pixels", "taken_off"),
    [
        (True, False, False, [True]),
        (True, True, False, [False]),
        (False, True, True, [False, True]),
        (False, True, False, [False]),
    ],
    ids=["flaws explain it", "more remains", "single pixels are flaws", "nothing remains"],
)
def test_what_small_flaws_explain_is_taken_off_before_a_family_explains_it(
    monkeypatch, remains, next_to_flaws, single_pixels, taken_off
):
    """Of the residual, of that with the rendering's errors, and of the one without effects that it is compared with."""
    residual, rendered, change = np.array([3.0, 1.0]), np.array([5.0, 0.5]), np.array([1.0, -2.0])
    without = residual - change

    @dataclass(frozen=True)
    class Start:
        residual: np.ndarray

        def whiten_used(self, change_dn):
            return 0.5 * change_dn

        @property
        def chi2(self):
            return float(self.residual @ self.residual)

    def something_remains(model, part, with_rendered):
        if np.array_equal(part, residual):
            return remains
        np.testing.assert_allclose((part, with_rendered), (without, rendered - change))
        return next_to_flaws

    def to_report(several, model, rest, by_effects, any_remains):
        shapes = 0.25 * change if not (remains or taken_off[-1]) else 0.0
        left = without if taken_off[-1] else residual
        np.testing.assert_allclose(rest, left - shapes)
        start = np.array([7.0, 4.0]) - (change if taken_off[-1] else 0)
        assert by_effects == pytest.approx(start @ start - left @ left)
        assert any_remains == (remains and not taken_off[-1])
        raise _Reached

    explained = []
    monkeypatch.setattr(diagnosis_module, "residual_with_rendered", lambda linearised, effects: rendered)
    monkeypatch.setattr(diagnosis_module, "something_remains", something_remains)
    monkeypatch.setattr(diagnosis_module.unexplained, "residual_data_of", lambda linearised, rest, capture: rest)
    monkeypatch.setattr(diagnosis_module.unexplained, "explanation_to_report", to_report)
    monkeypatch.setattr(diagnosis_module, "explain_masked_families", lambda excess: ())
    best = SimpleNamespace(single_pixels=single_pixels)
    monkeypatch.setattr(diagnosis_module, "explain", lambda excess, progress: explained.append(excess) or best)
    start = Start(np.array([7.0, 4.0]))
    answer = SimpleNamespace(linearised=SimpleNamespace(model=start), residual=residual, effects=[])
    flaws = SimpleNamespace(small=True, change_dn=2 * change, by_lens_dn=0.5 * change)
    judged = SimpleNamespace(flaws=flaws, unlisted=0.0)
    with pytest.raises(_Reached):
        diagnosis_module._explained(SimpleNamespace(model=start), answer, judged, None, NO_PROGRESS)
    np.testing.assert_allclose(explained, [without if is_taken_off else residual for is_taken_off in taken_off])
