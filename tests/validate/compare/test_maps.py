"""Maps survive the way to the disk and back; figures stand under their stable keys."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.validation.compare.maps import read_map, write_map, write_maps
from cboxlab.validation.report.metrics import PathStep, metrics, write_metrics
from helpers.fakes.box import BANDS, SURFACES, FakeBox, fake_run
from PIL import Image

BOX = FakeBox(size=48)


@pytest.fixture(scope="module")
def comparison():
    return BOX.compare(seed=1, factor=1.01)


def test_round_trip_keeps_values_order_units_and_nan(tmp_path):
    values = np.random.default_rng(1).normal(size=(4, 5, 7)).astype(np.float32)
    values[0, 2, 3] = np.nan
    names = ["Z", "B", "R", "f400.left"]
    array = xr.DataArray(values, dims=("channel", "y", "x"), coords={"channel": names}, attrs={"description": "tést"})
    write_map(tmp_path / "a.exr", array, {name: f"unit of {name}" for name in names})
    back, units = read_map(tmp_path / "a.exr")
    np.testing.assert_array_equal(back.values, values)
    assert list(back.channel.values) == names
    assert units == {name: f"unit of {name}" for name in names}
    assert back.attrs["description"] == "tést"
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


def test_maps_of_a_comparison(tmp_path, comparison):
    written = write_maps(tmp_path / "maps", comparison, {"seed": "5"})
    assert sorted(p.name for p in (tmp_path / "maps").iterdir()) == sorted(p.name for p in written)
    measured, units = read_map(tmp_path / "maps" / "measured.exr")
    assert list(measured.channel.values) == list(BANDS) and units["f500"] == "DN"
    assert measured.attrs["seed"] == "5" and "dark and flat" in measured.attrs["description"]
    np.testing.assert_allclose(measured.values, comparison.maps.measured.values, rtol=1e-6)
    difference, units = read_map(tmp_path / "maps" / "difference.exr")
    assert list(difference.channel.values) == ["dX", "dY", "dZ", "dY_relative", "dE76", "dE2000"]
    assert units["dY"] == "cd m^-2"
    expected = comparison.maps.xyz_measured - comparison.maps.xyz_rendered
    floor = BOX.surface == 0
    np.testing.assert_allclose(difference.values[1][floor], expected.values[floor, 1], rtol=1e-5, atol=1e-6)
    assert np.isnan(difference.values[:, BOX.lamp]).all()
    mask, _ = read_map(tmp_path / "maps" / "mask.exr")
    np.testing.assert_array_equal(mask.values, BOX.mask)


def test_previews_share_one_exposure(tmp_path, comparison):
    """The photograph is 1% brighter than the render, so its preview is on average brighter by a little."""
    write_maps(tmp_path, comparison, {})
    measured, rendered = (np.asarray(Image.open(tmp_path / f"{n}.png"), float) for n in ("measured", "rendered"))
    ratio = measured[BOX.surface == 2].mean() / rendered[BOX.surface == 2].mean()
    assert 1.001 < ratio < 1.01


def test_unreadable_map_is_one_error(tmp_path):
    (tmp_path / "broken.exr").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"broken\.exr"):
        read_map(tmp_path / "broken.exr")


def test_nothing_half_written(tmp_path):
    (tmp_path / "a.txt").write_text("old")

    def interrupted():
        with replacing(tmp_path / "a.txt") as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (tmp_path / "a.txt").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_stable_keys(tmp_path, comparison):
    """The keys that other programs rely on, as the plan of the house states them."""
    write_metrics(tmp_path / "metrics.json", comparison, fake_run(), {"adequate": False})
    m = json.loads((tmp_path / "metrics.json").read_text())
    for key in (
        "capture",
        "model",
        "version",
        "chi2_per_dof",
        "pixels_used",
        "render_sigma_over_sensor_sigma_median",
    ):
        assert key in m
    assert set(m["camera"]) == {
        "reprojection_rms_px",
        "position_mm",
        "position_sigma_mm",
        "rotation_deg",
        "focal_length_px",
        "principal_point_px",
        "k1",
        "covariance",
    }
    assert len(m["camera"]["position_mm"]) == len(m["camera"]["position_sigma_mm"]) == 3
    assert np.shape(m["camera"]["covariance"]) == (10, 10)
    assert m["lamp_scale"]["value"] == 1.004 and m["lamp_scale"]["sigma"] == 0.001
    assert m["masked"]["lamp"] == m["masked"]["saturated"] == BOX.lamp.sum()
    for band in BANDS:
        assert {"chi2_per_dof", "mean_relative_difference", "rms_relative_difference"} <= set(m["bands"][band])
    assert list(m["surfaces"]) == list(SURFACES)
    for surface in m["surfaces"].values():
        assert list(surface["relative_difference"]) == list(BANDS)
        assert {"delta_e_ab", "delta_e_2000"} <= set(surface)
    for key in ("delta_e_ab", "delta_e_2000"):
        assert {"mean", "p95", "max"} <= set(m[key])
        assert m[key]["mean"] <= m[key]["p95"] <= m[key]["max"]
    assert {"mean_relative_difference", "rms_relative_difference"} <= set(m["luminance"])
    assert 0 <= m["edges"]["share_of_excess"] <= 1
    assert {"chi2_per_dof"} <= set(m["edges"]) & set(m["interiors"])
    assert m["path"] == [{"effects": [], "chi2_per_dof": m["chi2_per_dof"], "delta_e_ab_mean": m["delta_e_ab"]["mean"]}]
    assert m["adequate"] is False
    run = fake_run()
    assert run.calibrated_camera is not None
    for key, camera in (("camera", run.calibrated_camera), ("camera_refitted", run.camera)):
        assert m[key]["position_mm"] == list(camera.position_mm)
        assert set(m[key]) == set(m["camera"])
    assert m["camera_refitted"]["position_mm"] != m["camera"]["position_mm"]


def test_unknown_figures_are_null_and_extra_hides_nothing(comparison):
    camera = replace(fake_run().camera, covariance=None)
    run = fake_run(camera=camera, calibrated_camera=None, path=[PathStep(("veiling-glare",), 1.02, 0.3)])
    m = metrics(comparison, run)
    json.dumps(m, allow_nan=False)
    assert m["camera_refitted"] is None
    assert m["camera"]["covariance"] == [] and m["camera"]["position_sigma_mm"] == [None] * 3
    assert m["path"][0]["effects"] == ["veiling-glare"]
    with pytest.raises(ValueError, match="chi2_per_dof"):
        metrics(comparison, run, {"chi2_per_dof": 1.0})
