"""[defaults] and the claim of a scale in capture.toml."""

import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.utils.errors import InputError
from helpers.fakes.capture import DISTANCE_MM, F_NUMBER, FakeCapture


@pytest.fixture
def folder(tmp_path):
    return FakeCapture(tmp_path / "c", centres=(450, 550)).write()


def rewrite(folder, defaults, *without):
    """The manifest with [defaults], and without lines that begin with one of ``without``."""
    path = folder / "capture.toml"
    lines = [line for line in path.read_text().splitlines() if not line.startswith(without)]
    path.write_text("\n".join([*lines, "[defaults]", *defaults, ""]))


def test_common_values_stand_once(folder):
    before = load_capture(folder).manifest
    optics = (f"f_number = {F_NUMBER}", f"image_distance_mm = {DISTANCE_MM}")
    rewrite(folder, (*optics, 'radiance = "spectra/all.csv:sphere"'), "f_number", "image_distance_mm", "radiance")
    capture = load_capture(folder)
    after = capture.manifest
    assert [band.model_dump() for band in after.band] == [band.model_dump() for band in before.band]
    assert [r.radiance for r in after.reference] == [r.radiance for r in before.reference]
    assert {flat.radiance for flat in after.flats} == {"spectra/all.csv:sphere"}
    assert all(capture.f_number(flat) == F_NUMBER for flat in after.flats)


def test_a_default_replaces_no_value_of_a_table(folder):
    rewrite(folder, ("exposure_s = 7.0", "f_number = 2.8"))
    manifest = load_capture(folder).manifest
    assert all(band.f_number == F_NUMBER and band.exposure_s != 7.0 for band in manifest.band)


def test_the_band_of_a_flat_comes_before_the_defaults(folder):
    path = folder / "capture.toml"
    head, *tables = path.read_text().split("[[")
    remaining = [t if t.startswith("band") else t.replace(f"f_number = {F_NUMBER}\n", "") for t in tables]
    path.write_text("[[".join([head, *remaining]) + "[defaults]\nf_number = 2.8\n")
    capture = load_capture(folder)
    assert capture.manifest.flats and all(capture.f_number(flat) == F_NUMBER for flat in capture.manifest.flats)


def test_a_default_exposure_fills_every_table_of_frames(folder):
    path = folder / "capture.toml"
    head, *tables = path.read_text().split("[[")
    tables = [t for t in tables if not t.startswith("dark")]
    tables.append('dark]]\nframes = ["frames/flat-f450-0.tif"]\n')
    lines = [line for line in "[[".join([head, *tables]).splitlines() if not line.startswith("exposure_s")]
    path.write_text("\n".join([*lines, "[defaults]", "exposure_s = 0.5", ""]))
    manifest = load_capture(folder).manifest
    rows = (*manifest.band, *manifest.darks, *manifest.flats, *manifest.reference)
    assert len(rows) == 7 and {row.exposure_s for row in rows} == {0.5}


def test_a_wrong_default_is_one_fault(folder):
    rewrite(folder, ("f_number = -8.0",), "f_number")
    with pytest.raises(InputError) as error:
        load_capture(folder)
    message = str(error.value)
    assert "defaults.f_number" in message and "-8" in message and "band[0]" not in message


@pytest.mark.parametrize(
    ("line", "key"), [("gain_e_per_dn = 3.0", "defaults.gain_e_per_dn"), ('frames = ["a.tif"]', "defaults.frames")]
)
def test_other_keys_have_no_default(folder, line, key):
    rewrite(folder, (line,))
    with pytest.raises(InputError, match="an unknown key") as error:
        load_capture(folder)
    assert key in str(error.value)


@pytest.mark.parametrize("scale", ["free", "free-by-band"])
def test_a_scale_is_free_where_stated(folder, scale):
    path = folder / "capture.toml"
    path.write_text(f'scale = "{scale}"\n' + path.read_text())
    manifest = load_capture(folder).manifest
    assert manifest.scale == scale and not manifest.is_absolute


def test_another_scale_is_an_error(folder):
    path = folder / "capture.toml"
    path.write_text('scale = "relative"\n' + path.read_text())
    with pytest.raises(InputError) as error:
        load_capture(folder)
    assert "scale" in str(error.value) and "free-by-band" in str(error.value)
