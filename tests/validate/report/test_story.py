"""What the report says of causes: found, nothing known, adequate, not distinguished."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.rendering.model import Model
from cboxlab.validation.compare import regions_of
from cboxlab.validation.diagnose import Diagnosis, FurtherCaptureResult, LikelyCause, Limit, Ranked, Separation, Step
from cboxlab.validation.report.diagnosis import (
    diagnosis_record,
    evidence_sentences,
    further_sentences,
    limit_text,
    path_steps,
    separation_sentence,
    size_in_words,
)
from cboxlab.validation.report.metrics import metrics
from cboxlab.validation.report.numerals import chi2_text
from cboxlab.validation.report.page import ReportInputs, build_report
from cboxlab.validation.report.picture_sections import pooled
from cboxlab.validation.report.plots import MapRow
from cboxlab.validation.report.story import story
from helpers.fakes.box import BANDS, FakeBox, fake_run

BOX = FakeBox(size=32)
NAMED = [(4, "650 nm"), (0, "450 nm"), (1, "500 nm"), (2, "550 nm"), (3, "600 nm")]
AS_GIVEN, MENDED = BOX.compare(seed=1, factor=1.03), BOX.compare(seed=1)
GLARE, LEAK = {"fraction": 0.0301}, {"fraction": 0.01}


def _cause(name, values, cosine, first, behind):
    signature = AS_GIVEN.maps["residual_over_sigma"].values.astype(np.float32)
    return LikelyCause(name, values, {"fraction": 0.0012}, signature, cosine, first, behind)


def _diagnosis(selected, causes=(), separations=()):
    results = [AppliedEffect(catalogue()[name], catalogue_values(name)) for name in selected if name != "unknown"]
    steps = [Step((), (), 1.0, 3.0, AS_GIVEN)]
    if results:
        steps.append(Step(tuple(results), tuple({"fraction": 0.0012} for _ in results), 0.0, 3.0, MENDED))
    ranking = [Ranked(c.effect, dict(c.values), {}, 2.0, 0.4) for c in causes]
    return Diagnosis(
        adequate=not selected,
        chi2_per_dof=8.0,
        final_chi2_per_dof=1.0,
        ranking=tuple(ranking),
        selected=selected,
        indistinguishable=(),
        path=tuple(steps),
        heldout_pixels=0.9,
        heldout_bands=np.nan,
        separations=separations,
        model=Model(),
        residual=AS_GIVEN.maps["residual_over_sigma"].values.astype(np.float32),
        causes=tuple(causes),
    )


def catalogue_values(name):
    return {p.name: GLARE.get(p.name, p.low) for p in catalogue()[name].parameters}


CAUSES = [
    _cause("veiling-glare", GLARE, 0.93, 1.0, 0.0),
    _cause("dark-offset", {"dn": 3.0}, 0.41, 0.38, 21.4),
]


def test_the_first_sentence_is_the_cause_and_its_size():
    lines = story(_diagnosis(("veiling-glare",), CAUSES), NAMED)
    assert lines.headline.sentence == "The model lacks veiling-glare (fraction 0.0301 ± 0.0012)."
    assert [p.caption for p in lines.headline.pictures.panels] == [
        "Photograph minus rendering",
        "Change by veiling-glare alone",
    ]
    assert lines.falling is not None


def test_a_parameter_has_one_value_and_its_size_in_words():
    """The size is that of the final model wherever it stands, though the effect alone fits a little less."""
    alone = [_cause("veiling-glare", {"fraction": 0.0295}, 0.93, 1.0, 0.0), CAUSES[1]]
    report = story(_diagnosis(("veiling-glare",), alone), NAMED)
    everything = repr(report.missing.blocks[-1].rows) + repr([getattr(b, "caption", "") for b in report.missing.blocks])
    assert everything.count("fraction 0.0301 ± 0.0012") == 2 and "0.0295" not in everything
    assert "veiling-glare: 3.01 % of all light spreads evenly over the image." in report.headline.details
    before_after = report.falling.blocks[0]
    assert before_after.header[1:3] == ("model as given", "with the effects found")
    chi2 = before_after.rows[0]
    assert float(chi2[1]) == pytest.approx(AS_GIVEN.chi2.per_dof, rel=1e-3)
    assert float(chi2[2]) == pytest.approx(MENDED.chi2.per_dof, rel=1e-3)


@pytest.fixture(scope="module")
def two_effects(tmp_path_factory):
    """A diagnosis of two effects, and the page about it."""
    alone = [_cause("veiling-glare", {"fraction": 0.0295}, 0.93, 1.0, 0.0), CAUSES[1]]
    diagnosis = _diagnosis(("veiling-glare", "defocus"), alone)
    path = tmp_path_factory.mktemp("two-effects") / "report.html"
    build_report(path, ReportInputs(AS_GIVEN, fake_run(), [], story=story(diagnosis, NAMED)))
    return diagnosis, path.read_text(encoding="utf-8")


def _tables(page):
    """Tables of a page: caption, titles of the columns, and cells without their small print."""
    root = ET.fromstring(page.replace("<!DOCTYPE html>", ""))
    parents = {child: parent for parent in root.iter() for child in parent}
    for scroller in (e for e in root.iter() if e.get("class") == "scroll"):
        around = list(parents[scroller])
        below = around[around.index(scroller) + 1 :][:1]
        rows = [[(cell.text or "").strip().replace("\u00a0", " ") for cell in row] for row in scroller.iter("tr")]
        yield "".join(e.text or "" for e in below if e.get("class") == "caption under"), rows[0], rows[1:]


def _same(text, value):
    """Whether a text is a number rounded from a value; a dash stands for none."""
    if value is None:
        return text == "–"
    plain = text.replace("−", "-").replace("\u202f", "")
    mantissa, _, power = plain.partition("e")
    step = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return abs(float(plain) - value) <= 0.5000001 * step


def _percent(value):
    return None if value is None else 100 * value


def test_every_number_of_the_tables_is_that_of_the_files(two_effects):
    """What metrics.json and diagnosis.json have and the page shows is one number, rounded."""
    diagnosis, page = two_effects
    run = replace(fake_run(), path=path_steps(diagnosis))
    files, causes = metrics(AS_GIVEN, run), diagnosis_record(diagnosis)
    regions = files["regions"]
    every = {**files, "share_of_residuals": 1.0, "share_of_excess": 1.0}
    shares = {"χ²/dof": ("chi2_per_dof", 1), "share of the residuals, %": ("share_of_residuals", 100)}
    shares["share of the excess χ², %"] = ("share_of_excess", 100)
    of_band = {"mean difference, %": "mean_relative_difference", "rms difference, %": "rms_relative_difference"}
    of_band |= {"rms of noise, %": "rms_relative_noise", "beyond noise, %": "beyond_noise"}
    ranked = {each["effect"]: each for each in causes["ranking"]}
    cameras_of_files = files["camera_refitted"], files["camera"]
    camera = [
        [*c["position_mm"], *c["rotation_deg"], c["focal_length_px"], *c["principal_point_px"], c["k1"]]
        for c in cameras_of_files
    ]

    def expected(caption, titles, row, number):
        """(column, value) of a row."""
        if caption.startswith(("By place.", "By surface, its", "By band.")):
            of_row = every if row == "all" else regions[caption[3:].split(",")[0].rstrip(".").split(".")[0]][row]
            return [(title, of_row[key] * factor) for title, (key, factor) in shares.items()]
        if caption.startswith("By band: "):
            return [(title, 100 * files["bands"][row][key]) for title, key in of_band.items()]
        if caption.startswith("By surface: relative"):
            of_row = files["surfaces"][row]
            of_bands = [(f"{band}, %", _percent(value)) for band, value in of_row["relative_difference"].items()]
            return [*of_bands, ("ΔE*ab", of_row["delta_e_ab"]), ("interior px", of_row["interior_pixels"])]
        if caption.startswith("By surface: mean luminance"):
            return [
                (f"{kind}, cd/m²", files["surfaces"][row][key]["luminance_cd_m2"])
                for kind, key in (("photograph", "measured"), ("rendering", "rendered"))
            ]
        if caption.startswith("The rotation"):
            return [("value", camera[0][number]), ("from the points only", camera[1][number])]
        if caption.startswith("These pixels"):
            return [("pixels", files["masked"].get(row, files["pixels_used"]))]
        if caption.startswith("Noise alone"):
            keys = {"χ² per degree of freedom": "chi2_per_dof", "mean ΔE*ab": "delta_e_ab_mean"}
            ends = ((1, files["path"][0]), (2, files["path"][-1]))
            return [(titles[k], step[keys[row]]) for k, step in ends if row in keys]
        if "lamp" in titles[0]:
            return [("fitted", files["lamp_scale"]["value"]), ("standard deviation", files["lamp_scale"]["sigma"])]
        if titles[0] == "effect tried alone":
            return [("probability, %", 100 * ranked[row]["probability"])]
        return []

    compared = [
        (caption[:20], row[0], title, row[titles.index(title)], value)
        for caption, titles, rows in _tables(page)
        for number, row in enumerate(rows)
        for title, value in expected(caption, titles, row[0], number)
    ]
    assert [each for each in compared if not _same(*each[-2:])] == []
    assert len(compared) > 150
    cards = dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", page))
    assert _same(cards["χ² per degree of freedom"], files["chi2_per_dof"])
    assert _same(cards["mean ΔE*ab"], files["delta_e_ab"]["mean"])
    assert _same(cards["pixels used"], files["pixels_used"])


def test_every_printed_value_of_a_parameter_and_of_chi_square_is_the_same(two_effects):
    """On the whole page: headline, words, captions, tables, plots and the command that adds the effect."""
    diagnosis, page = two_effects
    body = re.sub(r"<(script|style)\b.*?</\1>", "", page, flags=re.DOTALL)
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body))
    for effect in diagnosis.path[-1].effects:
        (number,) = effect.effect.numbers
        printed = re.findall(rf"{effect.id} \({number.label} ([^ ,)]+)", text)
        assert len(printed) >= 1 and len(set(printed)) == 1, printed
        in_command = re.findall(rf"{effect.id} {number.name}=([\d.]*\d)", text)
        assert {float(value) for value in (*printed, *in_command)} == {effect.values[number.name]}
    assert len(re.findall(r"fraction 0\.0301 ± 0\.0012", text)) >= 3 and "0.0295" not in text
    printed = re.findall(r"χ²(?:/dof| per degree of freedom)(?: is| falls from)?\s+(\d[\d.]*\d)", text)
    parts = [region.chi2 for regions in regions_of(AS_GIVEN).values() for region in regions]
    assert len(printed) >= 3
    distances = re.findall(r"by ([\d.]+) standard deviations of the noise", text)
    assert len(distances) == 2 and len(set(distances)) == 1
    assert set(printed) <= {chi2_text(value.per_dof) for value in (AS_GIVEN.chi2, MENDED.chi2, *parts)}


def test_every_size_in_words_can_be_said():
    """The words of each effect take its parameters by name."""
    for effect in catalogue().values():
        values = {p.name: p.choices[0] if p.choices else 0.25 for p in effect.parameters}
        sentence = size_in_words(AppliedEffect(effect, values))
        assert sentence.startswith(effect.id) and sentence.endswith(".") and "{" not in sentence


@pytest.mark.parametrize(
    ("selected", "gain"),
    [
        (("veiling-glare", "unknown"), "veiling-glare lowers χ² in the other half by 90 %"),
        (("veiling-glare", "dark-offset"), "each effect lowers χ² in the other half by at least 90 %"),
    ],
)
def test_the_gain_where_held_out_is_the_effects_or_the_least_of_several(selected, gain):
    assert any(gain in sentence for sentence in evidence_sentences(_diagnosis(selected)))


def test_the_runner_up_is_answered():
    lines = story(_diagnosis(("veiling-glare",), CAUSES), NAMED)
    (why,) = [text for text in lines.missing.paragraphs if text.startswith("Why not")]
    assert "dark-offset instead of veiling-glare" in why and "21.4 standard deviations of the noise" in why
    assert "Its probability of 40.0 % is larger than this distance alone would leave" in why
    assert "cosine between the two patterns is 0.38" in why
    rows = [block for block in lines.missing.blocks if isinstance(block, MapRow)]
    assert len(rows) == 3
    assert all([p.caption for p in row.panels] == [name for _, name in NAMED] for row in rows)
    assert {(row.scale.low, row.scale.high) for row in rows} == {(-5, 5)}
    assert any("You need no further capture" in step for step in lines.next.steps)


def test_effects_that_cannot_be_separated_have_a_further_capture():
    close = [CAUSES[0], _cause("dark-offset", {"dn": 3.0}, 0.92, 0.98, 2.1)]
    separation = Separation("veiling-glare", "dark-offset", 4.41, "frames with the lens capped", 120.0, 400.0, True)
    lines = story(_diagnosis(("veiling-glare",), close, (separation,)), NAMED)
    steps = " ".join(lines.next.steps)
    assert "differ by 2.1 standard deviations of the noise, and 5 are needed" in steps
    assert "frames with the lens capped (120 s; 20.0 standard deviations expected)" in steps
    assert "no further capture" not in steps


def test_a_remainder_may_hide_the_distance_of_two_effects():
    separation = Separation("veiling-glare", "dark-offset", 110.0, "frames with the lens capped", 120.0, 400.0, True)
    sentence = separation_sentence(separation)
    assert "differ by 10.5 standard deviations of the noise, but what no effect explains" in sentence
    assert "5 are needed" not in sentence


@pytest.mark.parametrize(
    ("selected", "adequate", "advised"),
    [((), False, True), ((), True, False), (("veiling-glare",), False, False)],
)
def test_what_only_a_further_capture_shows_is_to_be_diagnosed_there(selected, adequate, advised):
    second = FurtherCaptureResult("second", True, 1.2, 1.2, adequate)
    sentences = " ".join(further_sentences(replace(_diagnosis(selected), further=(second,))))
    assert ("diagnose it as the first one" in sentences) == advised


@pytest.mark.parametrize(
    ("selected", "sentence"), [(("unknown",), "No known effect fits"), ((), "The model is adequate")]
)
def test_without_a_cause_the_first_sentence_says_so(selected, sentence):
    lines = story(_diagnosis(selected, CAUSES if selected else ()), NAMED)
    assert lines.headline.sentence.startswith(sentence)
    assert len(lines.headline.pictures.panels) == 1 and lines.falling is None


def test_chi_square_of_the_ranking_is_given_as_a_part_of_the_excess():
    """8 to 2 per degree of freedom, where 1 is noise: 6 of 7. No second definition of chi-square is shown."""
    lines = story(_diagnosis(("veiling-glare",), CAUSES), NAMED)
    table = lines.missing.blocks[-1]
    assert not any("χ²" in title for title in table.header)
    assert table.rows[0][2] == "85.7"


def test_bands_together_have_the_noise_of_one():
    noise = np.random.default_rng(0).standard_normal((len(BANDS), 50, 50))
    noise[0, :10] = np.nan
    assert pooled(noise).std() == pytest.approx(1, abs=0.05)
    assert np.isnan(pooled(np.full((2, 3, 3), np.nan))).all()


@pytest.mark.parametrize(
    ("effect", "parameter", "unit", "distance", "phrase"),
    [
        ("veiling-glare", "fraction", "1", 9.4e-5, "fraction off by 9.4e-05"),
        ("dark-offset", "dn", "DN", 0.086, "size off by 0.086 DN"),
        ("filter-shift", "effective_index", "1", 0.0025, "effective index of 20"),  # 20^-2
        ("fluorescence", "yield", "1", 0.0015, "yield off by 0.0015 (red, peak 500 nm)"),
    ],
)
def test_limits_are_said_in_the_effects_own_numbers(effect, parameter, unit, distance, phrase):
    choices = {"material": "red", "peak_nm": 500.0} if effect == "fluorescence" else {}
    assert limit_text(Limit(effect, choices, parameter, unit, distance, 1e-3, 0.8, True)) == phrase
