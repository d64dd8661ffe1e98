"""What the user says of frames whose names say nothing does the same as names that say it."""

import shutil
import tomllib

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import FrameRole, ManifestEntry, draft_manifest, write_first_manifest
from cboxlab.utils.errors import InputError

#: By number of the photograph, its name by the table of the manual, and its role.
FRAMES = {
    1: ("f550-4s-0", "band", "f550", 4.0),
    2: ("f550-4s-1", "band", "f550", 4.0),
    3: ("f450-2.5s-0", "band", "f450", 2.5),
    4: ("f450-10s-0", "band", "f450", 10.0),
    5: ("dark-4s-0", "dark", "", 4.0),
    6: ("dark-4s-1", "dark", "", 4.0),
    7: ("flat-f550-1s-0", "flat", "f550", 1.0),
    8: ("sphere-f550-2s-0", "reference", "f550", 2.0),
}


def counts(seed):
    return np.random.default_rng(seed).integers(0, 4096, (16, 24)).astype(np.uint16)


def listed(number):
    return f"IMG_{number:04d}.tif"


@pytest.fixture
def numbered(tmp_path):
    """Frames numbered by a camera, and their roles."""
    folder = tmp_path / "box"
    folder.mkdir()
    for number in FRAMES:
        tifffile.imwrite(folder / listed(number), counts(number))
    return folder, [FrameRole(listed(number), *role) for number, (_, *role) in FRAMES.items()]


def test_roles_write_the_file_that_names_write(tmp_path, numbered):
    folder, roles = numbered
    renamed = tmp_path / "renamed" / "box"
    renamed.mkdir(parents=True)
    for number, (name, *_) in FRAMES.items():
        shutil.copy(folder / listed(number), renamed / f"{name}.tif")
    entry = [ManifestEntry("[camera]", "bit_depth", "12")]
    write_first_manifest(folder, entry, roles)
    write_first_manifest(renamed, entry)
    text = (renamed / "capture.toml").read_text()
    for number, (name, *_) in FRAMES.items():
        text = text.replace(f'"{name}.tif"', f'"{listed(number)}"')
    assert (folder / "capture.toml").read_text() == text
    tables = tomllib.loads(text)
    assert {band["id"]: len(band["frames"]) for band in tables["band"]} == {"f450": 1, "f550": 2}
    assert [bracket["exposure_s"] for bracket in tables["bracket"]] == [10.0]


def test_frames_without_a_filter_keep_their_names_and_unused_ones_are_listed(numbered):
    folder, _ = numbered
    roles = [FrameRole(listed(1), "none"), FrameRole(listed(2), "dark", "", 4.0)]
    text, first, _ = draft_manifest(folder, (), roles)
    assert [item.file for item in first.left_out if item.why == "not used, as you said"] == [listed(1)]
    assert all(item.is_frame for item in first.left_out)
    assert first.tables == {"band": 6, "dark": 1}
    assert 'id = "IMG_0003"' in text and listed(1) not in text


@pytest.mark.parametrize(
    ("role", "fault"),
    [
        (FrameRole("no.tif", "dark"), "found no frame of the folder"),
        (FrameRole(listed(1), "photo"), "found the kind 'photo'"),
        (FrameRole(listed(1), "band", "f 550\n"), "found the filter"),
        (FrameRole(listed(1), "band", "", -1.0), "found the exposure -1 s"),
        (FrameRole(listed(1), "band", "", float("nan")), "found the exposure nan s"),
    ],
)
def test_faulty_roles_are_refused_in_a_line(numbered, role, fault):
    with pytest.raises(InputError, match=fault):
        write_first_manifest(numbered[0], (), [role])
    assert not (numbered[0] / "capture.toml").exists()


def test_a_frame_that_changes_is_read_again(numbered):
    folder, roles = numbered
    assert "largest count found is 5000" not in draft_manifest(folder, (), roles)[0]
    tifffile.imwrite(folder / listed(1), np.full((16, 24), 5000, np.uint16))
    assert "largest count found is 5000" in draft_manifest(folder, (), roles)[0]


def test_entries_that_are_no_values_are_faults_next_to_the_others(numbered):
    folder, roles = numbered
    entries = [ManifestEntry("[camera]", "bit_depth", "twelve"), ManifestEntry("every [[band]]", "f_number", "8")]
    text, _, faults = draft_manifest(folder, entries, roles)
    assert "f_number = 8" in text
    assert [fault.where for fault in faults][:2] == ["[camera]: bit_depth", "camera.bit_depth"]
    with pytest.raises(InputError, match="bit_depth: found 'twelve'"):
        write_first_manifest(folder, entries, roles)
