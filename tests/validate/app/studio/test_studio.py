"""The workbench: who may ask, what a step answers, and the page in a real browser, on a capture of 32 pixels a side."""

import json
import shutil
import threading
import time
import urllib.request

import numpy as np
import pytest
from cboxlab.calibration.instrument import band_centres
from cboxlab.rendering.chain import STAGES
from cboxlab.rendering.model import load_model
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.app.studio import Workbench
from cboxlab.validation.diagnose import stepwise
from helpers.captures.glare_capture import GLARE
from helpers.pages.page_faults import FAULTS
from helpers.pages.server import served
from helpers.pages.studio import add, chi2, finished, present, press, record_of, step

#: Effects that the diagnosis tries here; each costs seconds.
TRIED = ("veiling-glare", "ghost", "lamp-drift")


def test_only_this_machines_pages_with_the_token_are_answered(client):
    assert client.get("/secret/").status_code == 200
    assert client.get("/").status_code == client.get("/Secret/").status_code == 404
    assert client.get("/secret/api/state", headers={"host": "evil.example"}).status_code == 403
    origin = {"origin": "http://evil.example"}
    assert client.post("/secret/api/step/undo", json={}, headers=origin).status_code == 403
    assert client.get("/secret/", headers={"origin": "http://127.0.0.1"}).status_code == 200
    for path in (
        "../../app.py",
        "..%2f..%2fapp.py",
        "%2e%2e/app.py",
        "app.py",
        "page/index.html",
        "/etc/passwd",
    ):
        assert client.get(f"/secret/{path}").status_code == 404


PAGES = ["", "index.html", "first.html", "points.html"]
SCRIPTS = ["studio.js", "controls.js", "first.js", "points.js", "arrays.js", "viewer.js", "studio.css", "viewer.css"]


@pytest.mark.parametrize("name", [*PAGES, *SCRIPTS])
def test_the_pages_files_are_its_own(client, name):
    answer = client.get(f"/secret/{name}")
    assert answer.status_code == 200 and answer.headers["cache-control"] == "no-store"
    assert "http://" not in answer.text.replace("http://www.w3.org/", "") and "https://" not in answer.text


def test_a_moved_effect_is_answered_with_its_prediction(client, bench):
    record, _ = step(client, "add", effect="veiling-glare")
    before = record["chi2_per_dof"]
    record, numbers = step(client, "change", which=0, values={"fraction": 0.01}, commit=False)
    assert record["chi2_per_dof"] < before and record["effects"][0]["values"]["fraction"] == 0.01
    expected = bench.study_in_view.predictions()[0]
    order = np.argsort(band_centres(bench.study.prepared[0].responses))
    np.testing.assert_array_equal(numbers.reshape(2, 7, 32, 32)[0], expected.signal[order].astype("f4"))
    np.testing.assert_array_equal(numbers.reshape(2, 7, 32, 32)[1], expected.sigma[order].astype("f4"))
    assert bench.study.effects[0].values["fraction"] == 0.0  # a trial is no step
    record, _ = step(client, "change", which=0, values={"fraction": 0.01}, commit=True)
    record, _ = step(client, "undo")
    assert record["effects"][0]["values"]["fraction"] == 0.0 and record["can_redo"]
    assert step(client, "redo")[0]["effects"][0]["values"]["fraction"] == 0.01
    assert step(client, "remove", which=0)[0]["effects"] == []


@pytest.mark.parametrize(
    ("path", "body", "line"),
    [
        ("step/add", {"effect": "veiling-glar"}, "Did you mean 'veiling-glare'"),
        ("step/add", {"effect": "veiling-glare", "values": {"fraction": 9}}, "from 0 to 0.5"),
        ("step/add", {}, "found nothing; expected a name"),
        ("step/change", {"which": 3, "values": {}}, "found 3"),
        ("step/change", {"which": "x"}, "an index from 0"),
        ("step/adopt", {}, "no diagnosis"),
        ("step/dance", {}, "one of add"),
        ("pattern", {"effect": "veiling-glar"}, "Did you mean 'veiling-glare'"),
        ("job/profile", {"effect": 3, "parameter": "fraction"}, "found 3"),
        ("job/open", {"capture": "../other"}, "leaves the folder"),
        ("pattern", {"effect": "../other.toml"}, "leaves the folder"),
        ("pattern", {"effect": "/etc/passwd.toml"}, "an effect below"),
        ("step/add", {"effect": "veiling-glare", "values": {"\ud800": 1}}, "a JSON object"),
        ("step/add", {"effect": "veiling-glare", "values": {"fraction": 10**400}}, "from 0 to 0.5"),
    ],
)
def test_every_mistake_is_one_line(client, path, body, line):
    content = json.dumps({"revision": present(client), **body})
    answer = client.post(f"/secret/api/{path}", content=content, headers={"content-type": "application/json"})
    message = answer.json().get("error")
    if message is None:
        while (state := client.get("/secret/api/state").json())["job"]:
            time.sleep(0.02)
        message = state["error"]
    assert line in message and "\n" not in message


def test_a_step_on_an_earlier_state_changes_nothing(client, bench):
    """Two tabs show three effects; one of them removes the first, then the other one the second of its list."""
    for effect in ("veiling-glare", "ghost", "lamp-drift"):
        step(client, "add", effect=effect)
    earlier = present(client)
    step(client, "remove", which=0)
    for name, body in (("remove", {"which": 1}), ("change", {"which": 0, "values": {}}), ("undo", {})):
        answer = client.post(f"/secret/api/step/{name}", json={"revision": earlier, **body})
        assert answer.status_code == 409 and "earlier state" in answer.json()["error"]
    assert client.post("/secret/api/job/fit", json={"which": [0], "revision": earlier}).status_code == 409
    assert [effect.id for effect in bench.study.effects] == ["ghost", "lamp-drift"]


def test_unsaved_work_is_offered_again_until_it_is_saved(client, bench):
    step(client, "add", effect="veiling-glare", values={"fraction": 0.01})
    record = client.get("/secret/api/state").json()
    assert not record["saved"] and len(record["moves"]) >= 2
    (unsaved,) = client.get("/secret/api/places").json()["unsaved"]
    again = Workbench(bench.root, bench.cache, noise=3.0, seed=1)  # after a crash
    again.open(unsaved["path"], None, NO_PROGRESS)
    assert again.study.effects[0].values["fraction"] == 0.01 and again.study.history.can_undo and not again.is_saved
    shutil.rmtree(bench.root / "kept", ignore_errors=True)
    finished(client, "save", folder="kept")
    assert client.get("/secret/api/state").json()["saved"]
    assert client.get("/secret/api/places").json()["unsaved"] == []
    shutil.rmtree(bench.root / "kept")


def test_unsaved_work_stays_when_its_capture_is_opened_again(client, bench):
    step(client, "add", effect="ghost")
    finished(client, "open", capture="capture")
    step(client, "add", effect="lamp-drift")
    new, old = client.get("/secret/api/places").json()["unsaved"]
    assert new["name"] == old["name"] == "capture" and new["changed"] >= old["changed"]
    finished(client, "open", capture=old["path"])
    assert [effect.id for effect in bench.study.effects] == ["ghost"]
    step(client, "add", effect="smear")  # goes on in the same folder
    assert {each["path"] for each in client.get("/secret/api/places").json()["unsaved"]} == {new["path"], old["path"]}
    assert client.post("/secret/api/discard", json={"study": "capture"}).status_code == 400
    for each in (new, old):
        assert client.post("/secret/api/discard", json={"study": each["path"]}).status_code == 200
    assert client.get("/secret/api/places").json()["unsaved"] == []
    assert (bench.root / "capture" / "capture.toml").exists()
    finished(client, "open", capture="capture")


def test_what_is_no_json_is_refused(client):
    assert client.post("/secret/api/step/undo", content=b"{}").status_code == 400
    kind = {"content-type": "application/json"}
    for content in (b"[]", b"{", b" " * 70000):
        answer = client.post("/secret/api/step/undo", content=content, headers=kind)
        assert answer.status_code == 400 and "the request" in answer.json()["error"]


def test_a_fit_is_saved_and_opened_again(client, bench):
    step(client, "add", effect="veiling-glare")
    finished(client, "fit")
    fitted, _ = record_of(client.get("/secret/api/view"))
    assert fitted["effects"][0]["values"]["fraction"] == pytest.approx(GLARE, abs=0.003)
    shutil.rmtree(bench.root / "out", ignore_errors=True)
    assert not finished(client, "save", folder="out")["error"]
    assert load_model(bench.root / "out" / "model.toml").effects[0].id == "veiling-glare"
    folders = client.get("/secret/api/places").json()
    assert folders["captures"] == ["capture"] and folders["studies"] == ["out"]
    assert "cornell-box" in folders["models"] and "out/model.toml" in folders["models"]
    assert "leaves the folder" in finished(client, "save", folder="../out")["error"]
    assert "below" in finished(client, "open", capture="nowhere")["error"]
    assert "'/elsewhere'" in finished(client, "save", folder="/elsewhere")["error"]


def test_an_effect_is_added_moved_fitted_undone_in_the_browser(page, bench):
    before = chi2(page)
    assert page.run("document.getElementById('undo').disabled")
    pixel = page.run("page.viewer.values(16, 20).bands.map((b) => b.rendered)")
    press(page, "refit")
    page.until("!page.record.refit")
    add(page, "veiling-glare")
    assert chi2(page) == before  # a glare of nothing, camera and lamp held
    press(page, "refit")
    page.until("page.record.refit")
    assert (
        chi2(page) <= before
    )  # the camera's fit ends where a round gains less than a thousandth, and goes on from there
    page.run("document.getElementById('p-0-fraction').focus()")
    for _ in range(30):
        page.key("ArrowRight")
    page.until("!page.asking")
    moved = page.run("page.record.effects[0].values.fraction")
    assert moved == pytest.approx(0.5 * 0.3**3, rel=0.01)  # 30 keys of 1 % of the slider, fine near null
    assert chi2(page) < before
    other = page.run("page.viewer.values(16, 20).bands.map((b) => b.rendered)")
    assert other != pixel
    expected = bench.study.predictions()[0].signal[:, 20, 16]
    assert sorted(other) == pytest.approx(sorted(expected), rel=1e-5)
    at = chi2(page)
    page.run("document.querySelector('[data-effect] .row button').click()")
    page.until(f"Number(document.getElementById('chi2').textContent) < {at} && !page.job")
    assert page.run("page.record.effects[0].values.fraction") == pytest.approx(GLARE, abs=0.003)
    number = page.run("document.querySelector('.parameter input[type=text]').value")
    assert page.run("document.querySelector('.bounds').innerText").startswith(f"fitted {number} ±")
    press(page, "undo")
    page.until(f"document.getElementById('chi2').textContent == '{at:g}'")
    press(page, "redo")
    page.until(f"Number(document.getElementById('chi2').textContent) < {at}")
    shutil.rmtree(bench.root / "from-page", ignore_errors=True)
    press(page, "show-save")
    page.run("document.getElementById('save-folder').value = 'from-page'")
    page.run("document.getElementById('save').requestSubmit()")
    page.until("document.getElementById('saved').textContent.includes('model.toml')")
    fitted = load_model(bench.root / "from-page" / "model.toml").effects[0]
    assert fitted.values == bench.study.effects[0].values
    fitted_chi2 = chi2(page)
    press(page, "undo")
    page.until(f"document.getElementById('chi2').textContent == '{at:g}'")
    press(page, "show-open")
    page.run("document.getElementById('open-capture').value = 'from-page'")
    page.run("document.getElementById('open').requestSubmit()")
    page.until(f"document.getElementById('chi2').textContent == '{fitted_chi2:g}' && !page.job")
    assert bench.study.effects[0].values == fitted.values
    assert not page.run("document.getElementById('undo').disabled")
    assert page.run("page.record.effects[0].values.fraction") == pytest.approx(fitted.values["fraction"])
    page.reload()
    page.until("page.record?.can_undo && page.viewer && page.controls?.length === 1 && !page.job")
    page.until(f"document.getElementById('chi2').textContent == '{fitted_chi2:g}'")
    assert page.run("document.getElementById('mistake').textContent") == ""


def test_the_page_shows_a_mistake_and_goes_on(page):
    add(page, "veiling-glare")
    page.run(
        "(() => {const n = document.querySelector('#effects input[type=text]'); n.value = '7';"
        "n.dispatchEvent(new Event('change'))})()"
    )
    page.until("document.getElementById('mistake').textContent.includes('from 0 to 0.5')")
    assert page.run("document.querySelector('#effects input[type=text]').value") == "0"
    page.errors.clear()  # the browser reports the refused request, too
    press(page, "undo")
    page.until("page.controls.length === 0 && document.getElementById('mistake').textContent === ''")


def test_a_second_tab_is_followed(page, bench):
    add(page, "veiling-glare")
    address = page.run("location.href")
    body = json.dumps({"effect": "ghost", "revision": bench.revision, "tab": "another"}).encode()
    kind = {"Content-Type": "application/json"}
    urllib.request.urlopen(urllib.request.Request(f"{address}api/step/add", body, kind)).read()
    page.until("page.controls.length === 2 && page.record.effects[1].id === 'ghost'")
    page.run("document.querySelector('[data-effect=veiling-glare] .row button:last-child').click()")
    page.until("page.controls.length === 1")
    assert [effect.id for effect in bench.study.effects] == ["ghost"]
    assert page.run("document.querySelector('#moves svg').getAttribute('aria-label')").startswith("χ² over")
    assert "noise alone" in page.run("document.getElementById('moves').innerText")


def test_a_reload_during_a_computation_shows_the_last_state_at_work(page, bench, monkeypatch):
    add(page, "veiling-glare")
    at, go = chi2(page), threading.Event()
    monkeypatch.setattr(bench, "diagnose", lambda progress: (progress.stage("waiting"), go.wait(60)))
    page.questions.clear()
    page.key("Tab")
    press(page, "diagnose")
    page.until("page.job !== null")
    page.reload()
    page.until("page.viewer !== null && page.controls.length === 1 && page.job !== null")
    assert chi2(page) == at and page.run("document.getElementById('add').disabled")
    assert not page.run("document.getElementById('job').hidden") and page.questions == ["beforeunload"]
    go.set()
    page.until("page.job === null && !document.getElementById('add').disabled")


def test_a_diagnosis_that_is_cancelled_after_its_rendering_leaves_a_page_that_goes_on(page, bench, monkeypatch):
    add(page, "block-pose")
    page.run("move({which: 0, values: {dx_mm: 2}, commit: true})")
    page.until("page.record.effects[0].values.dx_mm === 2 && !page.asking")

    def rendered_then_waiting(progress):
        bench.render(progress)
        while True:
            progress.stage("waiting")
            time.sleep(0.02)

    monkeypatch.setattr(bench, "diagnose", rendered_then_waiting)
    press(page, "diagnose")
    page.until("document.getElementById('stage').textContent.includes('waiting')")
    press(page, "cancel")
    page.until("document.getElementById('saved').textContent.startsWith('Cancelled') && page.record.rendered")
    add(page, "ghost")
    assert page.run("document.getElementById('mistake').textContent") == ""


def test_a_page_without_its_program_says_so(browser, bench):
    browser.errors.clear()
    with served(bench) as address:
        browser.open(address)
        browser.until("document.body.dataset.open === 'true' && page.viewer !== null")
    browser.until("document.getElementById('mistake').textContent.includes('Start `cbox studio` again')")
    browser.open("about:blank?")
    browser.errors.clear()  # the browser reports the connection, too


def test_effects_are_grouped_and_searched(page):
    count = "document.querySelectorAll('#new-effect option').length"
    everything = page.run(count)
    groups = page.run("[...document.querySelectorAll('#new-effect optgroup')].map((o) => o.label.split(':')[0])")
    assert groups == list(STAGES)
    page.run(
        "(() => {const s = document.getElementById('search'); s.value = 'glare';s.dispatchEvent(new Event('input'))})()"
    )
    assert 0 < page.run(count) < everything / 4
    assert "veiling-glare" in page.run("document.getElementById('new-effect').innerText")


def test_a_diagnosis_is_watched_and_its_effect_taken(page, monkeypatch):
    hypotheses = stepwise.hypotheses
    monkeypatch.setattr(stepwise, "hypotheses", lambda *a: [h for h in hypotheses(*a) if h.effect.id in TRIED])
    page.run(
        "for (const id of ['stage', 'times']) {const e = document.getElementById(id), all = new Set();"
        "globalThis[id + '_seen'] = all;"
        "new MutationObserver(() => all.add(e.textContent)).observe(e, {childList: true})}"
    )
    before = chi2(page)
    press(page, "diagnose")
    page.until("!document.getElementById('job').hidden && document.getElementById('add').disabled")
    end = time.monotonic() + 300.0  # a stuck computation must not hang the suite
    while page.run("Boolean(page.job)") and time.monotonic() < end:
        time.sleep(0.2)
    assert page.run("document.getElementById('mistake').textContent") == ""
    page.until("!document.getElementById('diagnosis').hidden")
    stages = page.run("[...stage_seen].join('; ')")
    assert "trying every effect" in stages and "choosing among effects" in stages
    times = page.run("[...times_seen]")
    assert len(times) > 3 and all(" elapsed" in line for line in times)
    press(page, "adopt")
    page.until("page.controls.length === 1")
    assert page.run("page.record.effects[0].id") == "veiling-glare" and chi2(page) < before
    # nothing can be added of a cause that is unknown
    page.run(
        "showDiagnosis({selected: ['unknown'], adequate: true, sentences: [], ranking: ['unknown', 'gloss'].map("
        "(id) => ({id, text: '', explained: null, probability: 0.0001, values: {}}))})"
    )
    labels = "[...document.querySelectorAll('#diagnosis button')].map((e) => e.getAttribute('aria-label'))"
    assert page.run(labels) == ["Add gloss"]
    assert "a model that lacks nothing" in page.run("document.getElementById('diagnosis').innerText")
    lines = page.run("[...document.querySelectorAll('#diagnosis li')].map((e) => e.firstChild.textContent.trim())")
    assert lines == [
        "unknown: a cause that is in no list; probability below 0.1\xa0%",
        "gloss: ; probability below 0.1\xa0%",
    ]


@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("dark", [False, True])
def test_it_can_be_read_at_both_widths_in_light_and_dark(page, width, dark):
    add(page, "block-pose")
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    page.call("Emulation.setEmulatedMedia", features=[scheme])
    page.size(width)
    assert page.run("document.documentElement.scrollWidth") <= width
    faults = page.run(FAULTS)
    assert faults == []
