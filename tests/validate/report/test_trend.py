"""Several results side by side: the numbers of their files, on a page without faults."""

import json

import pytest
from cboxlab.utils.errors import InputError
from cboxlab.validation.report import read_trend_result, trend, trend_record, write_trend
from cboxlab.validation.report.metrics import metrics
from helpers.fakes.box import FakeBox, fake_run
from helpers.pages.axe import nameless, violations
from helpers.pages.browser import open_browser
from helpers.pages.page_faults import FAULTS

BOX = FakeBox(size=32)


@pytest.fixture
def folders(tmp_path):
    """A result before and after a change, the second one with a diagnosis."""
    for name, factor in (("before", 1.03), ("after", 1.0)):
        (tmp_path / name).mkdir()
        record = metrics(BOX.compare(seed=1, factor=factor), fake_run())
        (tmp_path / name / "metrics.json").write_text(json.dumps(record))
    diagnosis = {
        "selected": ["veiling-glare"],
        "selected_parameters": [{"fraction": 0.004}],
        "ranking": [{"effect": "veiling-glare", "sigma": {"fraction": 0.0001}}],
        "final_chi2_per_dof": 1.01,
    }
    (tmp_path / "after" / "diagnosis.json").write_text(json.dumps(diagnosis))
    return tmp_path / "before", tmp_path / "after"


def test_every_number_stands_in_the_table_and_on_the_page(folders, tmp_path):
    results = [read_trend_result(folder) for folder in folders]
    record = trend_record(results)
    written = [json.loads((folder / "metrics.json").read_text()) for folder in folders]
    assert record["results"] == ["before", "after"]
    assert record["numbers"]["χ² per degree of freedom"]["value"] == [each["chi2_per_dof"] for each in written]
    assert record["numbers"]["lamp scale"]["value"] == [each["lamp_scale"]["value"] for each in written]
    assert record["numbers"]["veiling-glare, fraction"] == {"value": [None, 0.004], "sigma": [None, 0.0001]}
    write_trend(tmp_path / "trend.html", results)
    with open_browser() as page:
        page.open(tmp_path / "trend.html")
        assert page.run("document.querySelectorAll('tbody tr').length") == len(record["numbers"])
        widths = page.run("[...document.querySelectorAll('.drawing svg')].map((e) => e.getBoundingClientRect().width)")
        assert len(widths) == len(record["numbers"]) and max(widths) - min(widths) < 1
        text = page.run("document.querySelector('table').innerText")
        assert "0.00400 ± 0.00010" in text and "–" in text
        for width in (1280, 400):
            page.size(width)
            assert page.run("document.documentElement.scrollWidth") <= width
            # text of plots is scaled with them
            assert [fault for fault in page.run(FAULTS) if not fault.startswith("small: <text")] == []
            sizes = "[...document.querySelectorAll('svg text')].map((e) => 10 * e.getScreenCTM().a)"
            assert min(page.run(sizes)) > 11
            assert violations(page) == [] == nameless(page)
        assert page.errors == []


def test_what_is_no_result_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"metrics\.json"):
        read_trend_result(tmp_path)
    for content in ("[]", "{}", '{"chi2_per_dof": 1, "bands": 3}', '{"chi2_per_dof": 1, "camera_refitted": 7}'):
        (tmp_path / "metrics.json").write_text(content)
        with pytest.raises(InputError):
            read_trend_result(tmp_path)


def test_the_most_significant_change_is_the_finding():
    def result(name, **numbers):
        return trend.TrendResult(name, "box", numbers)

    first = result("a", x=(1.0, 0.3), y=(5.0, 0.1), z=(9.0, float("nan")))
    second = result("b", x=(2.0, 0.4), y=(4.0, 0.1), z=(1.0, 0.1))
    assert trend.trend_finding([first, second, second]) == (
        "The most significant change is that of 'y': from 5.00 ± 0.10 (a) to 4.00 ± 0.10 (b), 7.1 standard deviations."
    )
    # two of x alone: 2.0 sigma, and 2.8 are needed
    alone = [result(name, x=value) for name, value in (("a", (1.0, 0.3)), ("b", (2.0, 0.4)), ("c", (2.0, 0.4)))]
    assert trend.trend_finding(alone) == (
        "No number changes significantly: none of 2 by more than 2.8 standard deviations."
    )
    assert "known standard deviation" in trend.trend_finding([result("a", z=(1.0, float("nan")))] * 2)


def test_values_without_standard_deviation_have_the_decimals_that_differ():
    unknown = float("nan")
    assert trend._texts([(284.994, unknown), (285.020, unknown)]) == ["284.994", "285.020"]
    assert trend._texts([(-784.5, unknown), (-784.7, unknown), (unknown, unknown)]) == ["−784.50", "−784.70", "–"]
    assert trend._texts([(2.0, 0.011), (2.0, 0.011)]) == ["2.000 ± 0.011"] * 2
