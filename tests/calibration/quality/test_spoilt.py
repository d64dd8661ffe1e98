"""Mistakes in frames, tables and numbers are named, and nothing else with them."""

import re
import shutil

import frame_mistakes  # noqa: F401  (fills the list)
import further_mistakes  # noqa: F401
import manifest_mistakes  # noqa: F401
import numpy as np
import pytest
from capture_mistakes import MISTAKES, Draft
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.correction import measure_noise, read_darks
from cboxlab.calibration.quality.frame_checks.counts import check_counts
from cboxlab.calibration.quality.frame_checks.stacks import read_stacks
from cboxlab.calibration.quality.tables import check_tables
from cboxlab.calibration.result import calibrate_capture
from helpers.captures.calibrations import quick_calibration
from helpers.places import ROOT


def suspicions(folder):
    return quick_calibration(folder).suspicions


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "colour"), [("filter table in micrometres", False), ("lamp table cut at 600 nm", True)]
)
def test_bands_without_light_leave_a_calibration_and_a_suspicion(tmp_path, name, colour):
    """By their tables they see nothing, or no light of the lamp: no weight can be fitted to them."""
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    mistake = next(m for m in MISTAKES if m.name == name)
    mistake.make(draft, np.random.default_rng(5))
    draft.save()
    calibration = calibrate_capture(load_capture(draft.folder))
    assert any(re.search(mistake.expected, str(suspicion)) for suspicion in calibration.suspicions)
    assert (calibration.weights is not None) == colour


def test_a_suspicion_says_what_where_and_why(tmp_path):
    shutil.copytree(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    table = tmp_path / "capture" / "spectra" / "lamp.csv"
    header, *rows = table.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    table.write_text("\n".join([header, *(f"{float(nm) / 1000},{y}" for nm, y in cells)]) + "\n")
    (suspicion,) = [s for s in suspicions(tmp_path / "capture") if "micromet" in s.record["what"]]
    assert suspicion.where == "spectra/lamp.csv:radiance"
    assert "0.4 to 0.7" in suspicion.why
    assert set(suspicion.record) == {"what", "where", "why"}


def test_exchanged_columns_are_no_micrometres(tmp_path):
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    rows = "".join(f"{1e-6 * nm},{nm}\n" for nm in range(400, 701, 10))
    (draft.folder / "spectra" / "lamp.csv").write_text(f"wavelength_nm,radiance\n{rows}")
    draft.save()
    alarms = [alarm for alarm in check_tables(load_capture(draft.folder)) if "lamp" in alarm.where]
    assert [alarm.what for alarm in alarms] == [
        "the columns of the lamp radiance are exchanged: the wavelengths come second"
    ]


@pytest.mark.parametrize("is_cut", [True, False])
def test_a_table_that_is_cut_short_is_not_too_small(tmp_path, is_cut):
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    band = draft.tables("band")[0]
    band["transmittance"] = "spectra/cut.csv:t"
    rows = ((380, 1e-5), (480, 1e-4), (580, 3e-3 if is_cut else 1e-4), *(() if is_cut else ((780, 1e-4), (700, 3e-3))))
    text = "".join(f"{nm},{value}\n" for nm, value in sorted(rows))
    (draft.folder / "spectra" / "cut.csv").write_text(f"wavelength_nm,t\n{text}")
    draft.save()
    whats = [alarm.what for alarm in check_tables(load_capture(draft.folder)) if "cut.csv" in alarm.where]
    assert any("too small" in what for what in whats) == (not is_cut)
    assert any("cut short" in what for what in whats) == is_cut


@pytest.mark.parametrize("factor", [1, 16])
def test_counts_in_the_upper_bits_are_named(tmp_path, factor):
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    draft.manifest["camera"]["bit_depth"] = 16
    for table in (*draft.tables("band"), *draft.tables("flat"), *draft.tables("dark")):
        for path in table["frames"]:
            draft.put(path, draft.image(path) * np.uint16(factor))
    draft.save()
    capture = load_capture(draft.folder)
    darks = read_darks(capture)
    stacks = [stack for stack in read_stacks(capture) if stack.kind != "reference"]
    whats = [alarm.what for alarm in check_counts(capture, stacks, darks, measure_noise(capture, darks))]
    assert any("multiples of 16" in what for what in whats) == (factor == 16)
    assert not any("gaps" in what or (factor == 16 and "saturation" in what) for what in whats)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("spoilt", ["one copied", "all copied", "all saturated"])
def test_flats_without_noise_are_reported_and_no_band_is_blamed(tmp_path, spoilt):
    """Copied or saturated flats have no noise to measure the gain from."""
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    for table in draft.tables("flat")[: 1 if spoilt == "one copied" else None]:
        first = draft.image(table["frames"][0])
        for path in table["frames"][1:] if "copied" in spoilt else table["frames"]:
            draft.put(path, first if "copied" in spoilt else np.full_like(first, 4095))
    draft.save()
    capture = load_capture(draft.folder)
    noise = measure_noise(capture, read_darks(capture))
    assert (noise.gain_sigma is None) == (spoilt != "one copied")
    alarms = suspicions(draft.folder)
    assert alarms
    assert all("flat" in suspicion.where for suspicion in alarms), alarms


@pytest.mark.parametrize("with_exposures", [False, True])
def test_exchanged_references_are_reported_with_both_bands(tmp_path, with_exposures):
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    first, other = draft.tables("reference")[1], draft.tables("reference")[4]
    for key in ("frames", "exposure_s") if with_exposures else ("frames",):
        first[key], other[key] = other[key], first[key]
    draft.save()
    alarms = [(s.what, s.where) for s in suspicions(draft.folder)]
    for table in (first, other):
        what = f"the references of {first['band']} and {other['band']} are exchanged"
        assert (what, f"reference ({table['band']})") in alarms


@pytest.mark.parametrize("kind", ["flat", "reference"])
def test_exchanged_flats_of_levels_that_differ_little_are_named(tmp_path, kind):
    """Two flats exchanged, 3 % apart: with each other's flat both bands agree with the others again."""
    draft = Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture")
    for name in ("flat", "reference"):
        table = draft.tables(name)[4]
        for path in table["frames"]:
            draft.put(path, 100 + 0.97 * (draft.image(path).astype(float) - 100))
        table["exposure_s"] *= 0.97
    draft.save()
    assert not [s for s in suspicions(draft.folder) if "exchanged" in s.what]
    first, other = draft.tables(kind)[1], draft.tables(kind)[4]
    draft.swap(first, other)
    alarms = [s.what for s in suspicions(draft.folder) if "exchanged" in s.what]
    assert alarms and all(f"the {kind}s of {first['band']} and {other['band']} are exchanged" == a for a in alarms)


def test_noise_of_rows_is_no_encoding_and_no_changed_repeat(tmp_path):
    """Rows with a noise of 8 DN in all frames: larger than shot noise in the dark, smaller in the light."""
    draft, rng = (
        Draft(ROOT / "validate" / "data" / "demo-capture", tmp_path / "capture"),
        np.random.default_rng(5),
    )
    for kind in ("band", "flat", "dark", "reference"):
        for path in (path for table in draft.tables(kind) for path in table["frames"]):
            values = draft.image(path).astype(float)
            draft.put(path, values + rng.normal(0, 8, (values.shape[0], 1)))
    draft.save()
    alarms = [suspicion.what for suspicion in suspicions(draft.folder)]
    assert any("of a row share" in what for what in alarms)
    assert not [what for what in alarms if "gamma" in what or "a repeat of" in what], alarms
