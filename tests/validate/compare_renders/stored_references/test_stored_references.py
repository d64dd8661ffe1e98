"""Stored references: judged by their statistics, written by an explicit command alone, a missing one is an error."""

import json
import re
from dataclasses import replace

import cboxlab
import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.files import write_cube
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders.regress import Side, SurfaceIndices, side_of
from cboxlab.validation.compare_renders.stored_references import (
    measured_reference,
    read_reference,
    require_same_light,
    write_reference,
)
from helpers.programs.other_suite import run_suite

BANDS, SIZE, SEEDS = np.array([450.0, 550.0, 650.0]), 32, 200
CLEAN = np.linspace(1, 2, SIZE)[:, None, None] * np.array([1.0, 2.0, 3.0]) * np.ones((SIZE, SIZE, 1))
SURFACES = SurfaceIndices(
    (np.arange(SIZE)[:, None] // 16 + np.zeros(SIZE, int)), ("back", "floor"), np.zeros((SIZE, SIZE), bool)
)


def picture(seed, clean=CLEAN, noise=0.004):
    """Noise of a pixel, the same in all bands, stated as such."""
    rng = np.random.default_rng(seed)
    radiance = clean * (1 + noise * rng.standard_normal((SIZE, SIZE, 1)))
    return Side("a", BANDS, radiance, (noise * clean) ** 2, 100.0, SURFACES)


def reference(seed, **options):
    return measured_reference(picture(seed, **options), seed, 64, {})


def test_false_alarms_are_as_rare_as_stated():
    """At a stated 5 %: 200 pairs have more than 22 with probability 2e-4 (binomial)."""
    alarms = 0
    for seed in range(SEEDS):
        try:
            require_same_light(reference(2 * seed), reference(2 * seed + 1), 0.05)
        except AssertionError:
            alarms += 1
    assert alarms <= 22


def test_standard_deviations_are_those_of_repeated_pictures():
    """rms of 200 differences over the stated sigma: 1 within four of its standard deviations, 4 / sqrt(400)."""
    pairs = [(reference(2 * s), reference(2 * s + 1)) for s in range(SEEDS)]
    for name in pairs[0][0].means:
        z = [(a.means[name] / b.means[name] - 1) / np.hypot(a.sigma[name], b.sigma[name]) for a, b in pairs]
        assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.2), name


def test_one_changed_surface_is_named():
    changed = CLEAN * np.where(np.arange(SIZE)[:, None, None] < 16, 1.003, 1.0)
    with pytest.raises(AssertionError, match=r"surface: back: \+0\.[23]") as failure:
        require_same_light(reference(0), reference(1, clean=changed))
    assert "surface: floor" not in str(failure.value)
    assert "seed 0, 64 samples" in str(failure.value)


def with_lamp(shift_px=0.0):
    """A gradient and a bright lamp whose upper edge lies inside a pixel."""
    clean = CLEAN.copy()
    clean[6, 12:20] = 60.0 * (0.5 + shift_px)
    clean[7:10, 12:20] = 60.0
    clean[10, 12:20] = 60.0 * (0.5 - shift_px)
    return clean


SPOILT = {
    "mirrored": lambda p: p[:, ::-1],
    "upside down": lambda p: p[::-1],
    "rolled": lambda p: np.roll(p, 1, axis=0),
    "checkered": lambda p: p * (1 + 0.002 * np.where(np.indices((SIZE, SIZE)).sum(axis=0) % 2, 1, -1))[..., None],
    "lamp moved": None,
}


@pytest.mark.parametrize("mapped", [True, False], ids=["with surfaces", "without surfaces"])
@pytest.mark.parametrize("spoilt", SPOILT)
def test_a_picture_of_the_same_means_is_seen(spoilt, mapped):
    """Light from the left, so that a mirrored picture is another one."""
    aside = np.linspace(1.1, 1, SIZE)[None, :, None]
    clean = with_lamp() * aside
    changed = with_lamp(0.1) * aside if spoilt == "lamp moved" else SPOILT[spoilt](clean)
    sides = [picture(0, clean), picture(1, changed), picture(2, clean)]
    if not mapped:
        sides = [replace(side, surfaces=None) for side in sides]
    stored, changed, same = (measured_reference(side, 0, 64, {}) for side in sides)
    require_same_light(stored, same)
    with pytest.raises(AssertionError):
        require_same_light(stored, changed)


def test_pixels_that_are_not_numbers_fail_and_are_in_no_reference(tmp_path):
    side, dims = picture(2), ("y", "x", "wavelength")
    side.radiance[5, 7, 1] = np.nan
    values = {"radiance": (dims, side.radiance), "standard_error": (dims, np.sqrt(side.variance), {"batches": 100})}
    spoilt = measured_reference(side_of([xr.Dataset(values, {"wavelength": BANDS})], ["a"]), 2, 64, {})
    with pytest.raises(
        AssertionError, match=r"1 pixel is not a number in the picture \(NaN in 550 nm\), at row 5, column 7"
    ):
        require_same_light(reference(1), spoilt)
    with pytest.raises(InputError, match="reference of numbers alone"):
        write_reference(tmp_path / "a.json", spoilt)


def test_a_reference_of_the_earlier_format_is_compared_by_its_means(tmp_path):
    write_reference(tmp_path / "a.json", reference(3))
    record = json.loads((tmp_path / "a.json").read_text())
    blocks = [name for name in record["means"] if name.startswith("block")]
    for name in blocks:
        del record["means"][name], record["sigma"][name]
    del record["shapes"], record["shape_sigma"]
    (tmp_path / "a.json").write_text(json.dumps({**record, "format": "light-reference/1"}))
    stored = read_reference(tmp_path / "a.json")
    require_same_light(stored, reference(4))
    other = reference(4, clean=1.05 * CLEAN)
    with pytest.raises(AssertionError):
        require_same_light(stored, other)


def test_a_reference_comes_back_from_its_file(tmp_path):
    write_reference(tmp_path / "a.json", reference(3))
    assert read_reference(tmp_path / "a.json") == reference(3)
    record = json.loads((tmp_path / "a.json").read_text())
    assert {"seed", "samples", "versions", "means", "sigma"} <= set(record)
    assert record["versions"]["cboxlab"] == cboxlab.__version__


def test_a_reference_has_to_be_known_to_a_twentieth_of_a_percent(tmp_path):
    with pytest.raises(InputError, match="times the samples"):
        write_reference(tmp_path / "a.json", reference(3, noise=0.05))
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match="no standard error"):
        measured_reference(replace(picture(1), variance=None), 1, 64, {})


@pytest.mark.parametrize("content", ["{}", '{"format": "light-reference/1", "means": {"a": 1}, "sigma": {}}', "[1]"])
def test_what_is_no_reference_is_refused(tmp_path, content):
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(InputError, match=r"a\.json"):
        read_reference(tmp_path / "a.json")


@pytest.fixture
def suite(tmp_path):
    """Two tests of an imaginary renderer, and its pictures."""
    call = "same_light('{0}', Path(__file__).parent / '{0}.nc', seed=1, samples=64, versions={{'ourrenderer': '3.2'}})"
    tests = (f"def test_{name}(same_light):\n    {call.format(name)}" for name in ("box", "hall"))
    (tmp_path / "test_light.py").write_text("\n\n\n".join(["from pathlib import Path", *tests]))
    rendered(tmp_path / "box.nc", 1)
    rendered(tmp_path / "hall.nc", 1)
    return tmp_path


def rendered(path, seed, clean=CLEAN):
    side, dims = picture(seed, clean), ("y", "x", "wavelength")
    data = {
        "radiance": (dims, side.radiance),
        "standard_error": (dims, np.sqrt(side.variance), {"batches": 101}),
        "surface": (("y", "x"), SURFACES.index, {"names": "back, floor"}),
    }
    write_cube(path, xr.Dataset(data, coords={"wavelength": BANDS}))


def test_an_annotation_carries_file_and_line(suite, monkeypatch):
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    assert run_suite(suite, "--update-light-references")[0] == 0
    rendered(suite / "box.nc", 3, 0.997 * CLEAN)
    _, printed = run_suite(suite)
    assert re.search(
        r"^::error file=test_light\.py,line=4,title=same_light box::.*whole picture", printed, re.MULTILINE
    )


def test_the_plugin_goes_from_no_reference_to_green_and_red(suite):
    code, printed = run_suite(suite)
    assert code == 1
    assert "--update-light-references" in printed
    assert not (suite / "references").exists()
    assert run_suite(suite, "--update-light-references")[0] == 0
    content = (suite / "references" / "box.json").read_bytes()
    rendered(suite / "box.nc", 3, 0.997 * CLEAN)
    rendered(suite / "hall.nc", 2)
    code, printed = run_suite(suite)
    assert code == 1
    assert "1 failed, 1 passed" in printed
    assert re.search(r"whole picture: -0\.[23]", printed)
    assert (suite / "references" / "box.json").read_bytes() == content
