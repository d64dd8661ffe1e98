"""Many captures by one command: one summary, no capture stops another, and what is done is not done again."""

import csv
import shutil

import pytest
from cboxlab.validation.api import is_current, write_manifest
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE


@pytest.fixture
def captures(tmp_path):
    """A sound capture, and one in a deeper folder that must be refused."""
    folder = tmp_path / "captures"
    shutil.copytree(DEMO_CAPTURE, folder / "sound")
    refused = shutil.copytree(DEMO_CAPTURE, folder / "more" / "refused")
    (refused / "capture.toml").write_text("format = 'capture/1'\n")
    return folder


def rows_of(out):
    with (out / "summary.csv").open(newline="") as file:
        return {row["capture"]: row for row in csv.DictReader(file)}


def test_a_batch_ends_with_a_summary_and_goes_on_where_it_stopped(captures, tmp_path, cbox):
    out = tmp_path / "out"
    code, text, _ = cbox("batch", captures, "--out", out, "--what", "calibrate", "--jobs", "2")
    assert code == 2 and "1 done, 1 refused" in text and "more/refused" in text
    rows = rows_of(out)
    assert (rows["sound"]["status"], rows["sound"]["suspicions"]) == ("done", "0")
    assert rows["more/refused"]["status"] == "refused" and "capture.toml" in rows["more/refused"]["message"]
    assert "2 faults; expected no faults. The first is: " in rows["more/refused"]["message"]
    assert rows["more/refused"]["message"].endswith("camera: found nothing; expected this key. Add it.")
    result = out / "sound" / "calibration.json"
    before = result.stat().st_mtime_ns
    shutil.rmtree(captures / "more")
    code, *_ = cbox("batch", captures, "--out", out, "--what", "calibrate")
    assert code == 0
    assert rows_of(out)["sound"]["status"] == "kept"
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, processes=False, protocol="tcp", dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        code, *_ = cbox("batch", captures, "--out", out, "--what", "calibrate", "--scheduler", address)
    assert code == 0
    assert rows_of(out)["sound"]["status"] == "kept"
    assert result.stat().st_mtime_ns == before


def test_results_are_current_while_command_inputs_and_results_are(captures, tmp_path, monkeypatch):
    path = tmp_path / "out"
    path.mkdir()
    (path / "calibration.json").write_text("{}")
    monkeypatch.setattr("sys.argv", ["cbox", "calibrate", "sound"])
    write_manifest(path, [path / "calibration.json"], [captures / "sound"])
    assert is_current(path, "cbox calibrate sound")
    assert not is_current(path, "cbox calibrate sound --model other.toml")
    assert not is_current(tmp_path, "cbox calibrate sound")
    with (captures / "sound" / "capture.toml").open("a") as file:
        file.write("# changed\n")
    assert not is_current(path, "cbox calibrate sound")


def test_a_folder_without_captures_is_refused(tmp_path, cbox):
    code, _, err = cbox("batch", tmp_path, "--out", tmp_path / "out")
    assert code == 2 and "no capture.toml below it" in err
