"""The report stands alone, is well-formed and says what the figures say."""

import base64
import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from cboxlab.validate.blocks import Cell, ReportSection, Table, number, with_error
from cboxlab.validate.plots import Scale, diverging_scale, falling_curve, map_row, sequential_scale
from cboxlab.validate.report import ReportInputs, build_report
from fake_box import BANDS, SURFACES, FakeBox, fake_run, fake_weights
from PIL import Image

BOX = FakeBox(size=64)
ASSUMPTIONS = ["The lamp's scale was refitted within its stated 2 %.", "Paints are Lambertian & <opaque>."]


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Reports of pure noise, and of a 3% error with a section added."""
    folder = tmp_path_factory.mktemp("reports")
    noise = Scale(-3, 3, "residual / σ", "RdBu_r")
    step = ReportSection(
        "Diagnosis", ("Effects added one at a time.",),
        (
            falling_curve(["as given", "+ veiling-glare"], [7.3, 1.02], [1.9, 0.3]),
            map_row({"before": np.ones((8, 8)), "after": np.zeros((8, 8))}, noise),
            Table(("effect", "fraction"), [("veiling-glare", Cell("0.031", "± 0.001", True))]),
        ),
        finding="Glare is missing.",
    )  # fmt: skip
    inputs = {
        "noise": ReportInputs(BOX.compare(seed=1), fake_run(), ASSUMPTIONS, *fake_weights()),
        "error": ReportInputs(
            BOX.compare(seed=2, factor=1.03), fake_run(lamp_scale=1.05), ASSUMPTIONS, sections=(step,),
            further_warnings=("A hand-written warning.",),
        ),
    }  # fmt: skip
    pages = {}
    for name, given in inputs.items():
        build_report(folder / f"{name}.html", given)
        pages[name] = (folder / f"{name}.html").read_text(encoding="utf-8")
    return pages


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
    assert pages["error"].index("Glare is missing.") < pages["error"].index("<img")
    assert 'class="finding"' not in pages["noise"]


def test_pictures_are_there(pages):
    """Slider, trio, maps and one residual map per band decode as pictures of the capture's size."""
    uris = re.findall(r'src="data:image/png;base64,([^"]+)"', pages["noise"])
    assert len(uris) == 2 + 3 + 2 + 1 + 3 + len(BANDS)
    for uri in uris:
        assert Image.open(io.BytesIO(base64.b64decode(uri))).size == (BOX.size, BOX.size)
    assert pages["noise"].count("<svg") == 3  # residuals, scatter, weights
    assert 'type="range"' in pages["noise"]


def test_verdict_in_words(pages):
    assert "Noise explains the difference." in pages["noise"]
    assert "Noise does not explain the difference." in pages["error"]
    assert "of the excess sits less than 3 pixels" in pages["error"]
    for text in (*SURFACES, *BANDS):
        assert text in pages["noise"]


def test_order_of_the_report_is_fixed(pages):
    titles = re.findall(r"<h2>(.*?)</h2>", pages["error"])
    assert titles == [
        "Noise does not explain the difference.", "Before you trust the figures", "Photograph and render",
        "Where they differ", "Residual over noise, band by band", "Measured against rendered",
        "By surface, by band, edges and interiors", "Diagnosis", "Camera and lamp", "Pixels left out",
        "What was assumed",
    ]  # fmt: skip
    assert "From bands to colour" in pages["noise"]


def test_warnings_and_assumptions(pages):
    assert "Before you trust the figures" not in pages["noise"]
    assert "A hand-written warning." in pages["error"]
    assert "2.5 of its stated standard deviations" in pages["error"]
    assert "Lambertian &amp; &lt;opaque&gt;" in pages["error"]


def test_scales():
    """A diverging scale is centred on 0, a sequential one starts there; ends are round; NaN is clear."""
    values = np.array([[-3.3, 0.0], [np.nan, 1.2]])
    scale = diverging_scale(values, "%")
    assert (scale.low, scale.high) == (-5.0, 5.0)
    painted = scale.paint(values)
    assert painted[1, 0, 3] == 0 and painted[0, 1, :3].min() > 240
    assert painted[0, 0, 2] > painted[0, 0, 0] and painted[1, 1, 0] > painted[1, 1, 2]
    assert scale.ticks[0][1].startswith("−") and any(abs(p - 50) < 1e-9 and t == "0" for p, t in scale.ticks)
    assert sequential_scale(np.array([0.0, 1.7]), "ΔE").high == 2.0
    assert diverging_scale(np.full((2, 2), np.nan), "%", 1.0).high == 1.0


def test_numbers():
    assert [number(v, 2, True) for v in (0.001, -0.001, -1.5, 1.5, np.nan)] == [
        "0.00",
        "0.00",
        "−1.50",
        "+1.50",
        "–",
    ]


@pytest.mark.parametrize(
    ("value", "sigma", "shown"),
    [
        (0.004031, 1.2e-5, "0.004031 ± 0.000012"), (3.94e-8, 1.53e-9, "3.94e−08 ± 1.5e−09"),
        (-0.6428, 0.91, "−0.64 ± 0.91"), (524.4, 12.0, "524 ± 12"), (1.0, 0.0, "1"), (0.25, np.nan, "0.25"),
    ],
)  # fmt: skip
def test_a_number_is_shown_as_good_as_its_error(value, sigma, shown):
    assert with_error(value, sigma) == shown
