"""The report stands alone, is well-formed and says what the figures say."""

import base64
import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from cboxlab.validation.compare import COLOUR_DIFFERENCES, read_map, regions_of, write_maps
from cboxlab.validation.compare.colour_difference import ColourDifference
from cboxlab.validation.compare.comparison import compare
from cboxlab.validation.report.blocks import Cell, Headline, ReportSection, ReportTable, Story
from cboxlab.validation.report.metrics import metrics
from cboxlab.validation.report.numerals import number, with_error
from cboxlab.validation.report.page import ReportInputs, build_report
from cboxlab.validation.report.plots import falling_curve, map_row, residual_scale
from cboxlab.validation.report.verdict import report_verdict
from cboxlab.validation.report.viewer import picture_data
from colour.difference import delta_E_CIE1994
from helpers.fakes.box import BANDS, SURFACES, FakeBox, fake_run, fake_weights
from PIL import Image

BOX = FakeBox(size=64)
ASSUMPTIONS = ["The lamp's scale was refitted within its stated 2 %.", "Paints are Lambertian & <opaque>."]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Reports of pure noise without a diagnosis, and of a 3% error with a story and a folded section."""
    folder = tmp_path_factory.mktemp("reports")
    step = ReportSection(
        "The error falling",
        ("Effects added one at a time.",),
        (falling_curve(["as given", "+ veiling-glare"], [7.3, 1.02], [1.9, 0.3], "ΔE*ab"),),
    )
    table = ReportTable(("effect", "fraction"), [("veiling-glare", Cell("0.031", "± 0.001", True))])
    pictures = map_row({"before": np.ones((8, 8)), "after": np.zeros((8, 8))}, residual_scale())
    story = Story(
        Headline("Glare of 3 % is missing.", ("It lies everywhere.",), pictures),
        ReportSection("What is missing", ("Glare.",), (table,)),
        step,
        ReportSection("What to do next", steps=("Add it.",)),
    )
    inputs = {
        "noise": ReportInputs(BOX.compare(seed=1), fake_run(), ASSUMPTIONS, *fake_weights()),
        "error": ReportInputs(
            BOX.compare(seed=2, factor=1.03),
            fake_run(lamp_scale=1.05),
            ASSUMPTIONS,
            story=story,
            further_warnings=("A hand-written warning.",),
            provenance=[("command", "cbox x"), ("date", "today")],
        ),
    }
    for name, text in inputs.items():
        build_report(folder / f"{name}.html", text)
    return folder


@pytest.fixture(scope="module")
def pages(folder):
    return {name: (folder / f"{name}.html").read_text(encoding="utf-8") for name in ("noise", "error")}


@pytest.mark.parametrize("name", ["noise", "error"])
def test_self_contained(pages, name):
    page = pages[name]
    for target in re.findall(r"""(?:src|href|poster|data|action)\s*=\s*["']([^"']*)""", page):
        assert target.startswith(("data:", "#")), target[:80]
    for target in re.findall(r"url\(([^)]*)\)", page):
        assert target.strip("'\"").startswith(("data:", "#")), target[:80]
    assert "@import" not in page


@pytest.mark.parametrize("name", ["noise", "error"])
def test_well_formed_with_unique_identifiers(pages, name):
    """Every element is closed (the page is XML, too), no identifier stands twice, every reference is met."""
    root = ET.fromstring(pages[name].replace("<!DOCTYPE html>", ""))
    identifiers = [e.get("id") for e in root.iter() if e.get("id")]
    assert len(identifiers) == len(set(identifiers))
    references = {r for r in re.findall(r'(?:url\(|href=")#([^)"]+)', pages[name])}
    assert references <= set(identifiers)


def test_the_finding_stands_before_any_picture(pages):
    """The first heading is the cause and its size, and the picture that shows it stands next to it."""
    for name, sentence in (
        ("error", "Glare of 3\xa0% is missing."),
        ("noise", "The model is adequate: noise explains the difference."),
    ):
        page = pages[name]
        assert re.findall(r"<h1>(.*?)</h1>", page) == [sentence]
        assert page.index(sentence) < page.index("<img") < page.index("<h2>")


def test_pictures_are_there(pages):
    """The headline's, one residual map per band, colour, luminance and XYZ maps decode at the capture's size."""
    uris = re.findall(r'src="data:image/png;base64,([^"]+)"', pages["noise"])
    assert len(uris) == 1 + len(BANDS) + len(COLOUR_DIFFERENCES) + 1 + 3
    for uri in uris:
        assert Image.open(io.BytesIO(base64.b64decode(uri))).size == (BOX.size, BOX.size)
    assert pages["noise"].count("<svg") == 6  # two each of residuals, scatter, weights


def test_a_third_colour_difference_needs_one_record(monkeypatch, tmp_path):
    """CIE94 in the table alone: figures, tables and maps of the report, metrics.json, the files of maps have it."""
    third = ColourDifference("delta_e_94", "ΔE94", "CIE94", "dE94", delta_E_CIE1994)
    monkeypatch.setitem(COLOUR_DIFFERENCES, third.id, third)
    comparison = BOX.compare(seed=1)
    build_report(tmp_path / "report.html", ReportInputs(comparison, fake_run(), ASSUMPTIONS))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "mean ΔE94" in page
    header = next(row for row in re.findall(r"<tr>(.*?)</tr>", page, re.DOTALL) if "interior px" in row)
    assert re.sub(r"<[^>]*>|\s", "", header).endswith("ΔE*abCIEDE2000ΔE94interiorpx")
    assert "ΔE*ab (1976)" in page and ">CIE94<" in page
    content = metrics(comparison, fake_run())
    assert content[third.id]["mean"] == comparison.colour[third.id].mean > 0
    assert all(third.id in row for row in content["surfaces"].values())
    write_maps(tmp_path, comparison, {})
    assert "dE94" in read_map(tmp_path / "difference.exr")[0].channel.values
    # no JavaScript computes it, so the viewer does not offer it
    assert [d["id"] for d in picture_data(comparison)["colour_differences"]] == ["delta_e_ab", "delta_e_2000"]


def test_verdict_in_words(pages):
    assert "Where it fails" in pages["error"]
    assert re.search(r"Most of the excess χ² is (in interiors of|on) surfaces[^:]*: \d+\xa0%", pages["error"])
    for text in (*SURFACES, *BANDS):
        assert text in pages["noise"]


def test_bands_stand_by_wavelength(pages):
    rows = re.findall(r'<th scope="row">(\d+)\xa0nm</th>', pages["noise"])
    assert rows == sorted(rows[: len(BANDS)]) * 2


@pytest.mark.parametrize("kind", ["place", "surface", "band"])
def test_shares_of_the_excess_sum_to_a_hundred(kind):
    """Every residual is in one row, what is outside the box among them; with a 3% error every row is in excess."""
    c = BOX.compare(seed=2, factor=1.03)
    regions = regions_of(c)[kind]
    assert sum(r.share_of_excess for r in regions) == pytest.approx(1)
    assert sum(r.chi2.value for r in regions) == pytest.approx(c.chi2.value)
    assert sum(r.chi2.count for r in regions) == c.chi2.count
    assert ("outside the box" in [r.name for r in regions]) == (kind != "band")


def test_what_is_outside_the_box_is_no_edge():
    """Light on the black surround alone: all of the excess is outside, none of it at edges of surfaces."""
    measured, rendered = BOX.images(3)
    outside = (BOX.surface < 0) & ~BOX.lamp
    measured.signal.values[:, outside] += 20 * np.sqrt(BOX.sensor_variance[:, outside])
    c = compare(
        measured,
        rendered,
        BOX.sensor_variance,
        xyz_per_dn=BOX.xyz_per_dn,
        lamp_xyz=BOX.lamp_xyz,
        surface=BOX.surface,
        surface_names=SURFACES,
        single_surface=BOX.single_surface,
    )
    interiors, edges, beyond = regions_of(c)["place"]
    assert beyond.share_of_excess == pytest.approx(1, abs=0.01)
    assert abs(edges.share_of_excess) < 0.01 and abs(interiors.share_of_excess) < 0.01
    assert "outside the box" in report_verdict(c).details[3]


def test_worst_is_the_highest_chi2_per_dof():
    """A small block 6 % off, a large floor 3 % off: the floor has more excess, the block is worst."""
    factor = np.ones(BOX.truth.shape)
    factor[:, BOX.surface == 0] = 1.03
    factor[:, BOX.surface == 5] = 1.08
    details = report_verdict(BOX.compare(seed=2, factor=factor)).details
    assert (
        details[3].startswith("The largest part of the excess χ² comes from ") and "worst region is block" in details[4]
    )


def test_order_of_the_report_is_fixed(pages):
    titles = re.findall(r"<h2>(.*?)</h2>", pages["error"])
    assert titles == [
        "Warnings",
        "Compare",
        "Where it fails",
        "What is missing",
        "The error falling",
        "What to do next",
        "Details",
    ]
    folded = re.findall(r"<summary>(.*?)</summary>", pages["noise"])
    assert folded[0] == "Differences by surface and by band" and folded[-1].startswith("From bands to colour")
    assert "cbox x" in pages["error"] and "today" in pages["error"]


def test_warnings_and_assumptions(pages):
    assert "Warnings" not in pages["noise"]
    assert "A hand-written warning." in pages["error"]
    assert "by 2.5 stated standard deviations" in pages["error"]
    assert "Lambertian &amp; &lt;opaque&gt;" in pages["error"]


def test_scales():
    """The scale of residuals is fixed and centred on 0; NaN is clear; both ends are labelled."""
    values = np.array([[-3.3, 0.0], [np.nan, 1.2]])
    scale = residual_scale()
    assert (scale.low, scale.high) == (-5.0, 5.0)
    painted = scale.paint(values)
    assert painted[1, 0, 3] == 0 and painted[0, 1, :3].min() > 240
    assert painted[0, 0, 2] > painted[0, 0, 0] and painted[1, 1, 0] > painted[1, 1, 2]
    assert scale.ticks[0][1].startswith("−") and any(abs(p - 50) < 1e-9 and t == "0" for p, t in scale.ticks)
    assert [t for _, t in scale.ticks] == ["−5", "−2.5", "0", "2.5", "5"]


def test_numbers():
    assert [number(v, 2, True) for v in (0.001, -0.001, -1.5, 1.5, np.nan)] == [
        "0.00",
        "0.00",
        "−1.50",
        "+1.50",
        "–",
    ]


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (0.004031, 1.2e-5, "0.004031 ± 0.000012"),
        (3.94e-8, 1.53e-9, "3.94e−08 ± 1.5e−09"),
        (-0.6428, 0.91, "−0.64 ± 0.91"),
        (524.4, 12.0, "524 ± 12"),
        (1.0, 0.0, "1"),
        (0.25, np.nan, "0.25"),
    ],
)
def test_a_number_is_shown_as_good_as_its_error(value, sigma, expected):
    assert with_error(value, sigma) == expected
