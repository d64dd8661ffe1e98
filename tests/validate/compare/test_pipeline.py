"""From a capture to a comparison, end to end: on one whose truth is known, and on somebody else's.

The small capture is photographed without any effect: then noise must explain the difference. Another one (in the
folder ``shared``) was made by another simulator, with an effect that its answers state.
"""

import json
import shutil
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain.bands import render_bands
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.precision import render_to_precision
from cboxlab.rendering.model.model_file import Model
from cboxlab.rendering.photometry import tristimulus_weights
from cboxlab.rendering.synthetic.photographer import CaptureSettings
from cboxlab.scenes import Camera, cornell_box, cornell_camera
from cboxlab.scenes.camera import REFERENCE_ROTATION
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import ProgressReporter
from cboxlab.validation.compare import pipeline
from cboxlab.validation.compare.maps import read_map
from cboxlab.validation.compare.nuisances import NuisanceFit, fit_lamp_scale
from cboxlab.validation.compare.pipeline import Predicted, rendered_from, validate_capture, validate_prepared
from cboxlab.validation.compare.prepared import prepare
from cboxlab.validation.diagnose.diagnosis import diagnose_validation
from cboxlab.validation.diagnose.hypotheses import hypotheses
from cboxlab.validation.diagnose.linearised_fit import linearised_fit
from cboxlab.validation.diagnose.stepwise import refitted
from cboxlab.validation.report.write import write_validation
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photograph_image, photographed_scene
from helpers.captures.glare_capture import glare_capture
from helpers.captures.large_patches import large_patches
from helpers.pages.browser import open_browser
from scipy import stats

SIZE = 64
SEED = 5

#: 99.9% point of chi-square with the camera's ten parameters.
LARGEST_DISTANCE = float(stats.chi2.isf(1e-3, 10))


def test_a_refitted_picture_is_moved_to_its_camera_before_the_lamp_is_fitted(monkeypatch):
    """The measured picture is 1.1 times the moved one: the lamp's factor, and the picture at its stated power."""
    random, shape = np.random.default_rng(4), (2, 6, 8)
    signal, change = random.uniform(100, 200, shape), random.uniform(-20, 20, shape)
    empty = dict.fromkeys(field.name for field in fields(Predicted))
    predictor = SimpleNamespace(warp="warp", signal=lambda effects: signal, at_lamp=lambda scale: scale)
    rendered = Predicted(
        **{
            **empty,
            "variance": 0 * signal,
            "used": np.ones(shape, bool),
            "predictor": predictor,
        }
    )
    camera = cornell_camera(8)
    monkeypatch.setattr(pipeline, "refitted", lambda *_, settled: NuisanceFit(camera, 1.0, 0.1))
    monkeypatch.setattr(pipeline, "warp_change", lambda warp, new_camera: change if new_camera is camera else None)
    measured = 1.1 * (signal + change)
    prepared = SimpleNamespace(
        calibration=SimpleNamespace(predicted_variance=lambda expected: expected),
        lamp_scale=lambda values, variance, used: fit_lamp_scale(measured, values, variance, used, None),
    )
    refitted = pipeline.refitted_picture(prepared, rendered, ())
    np.testing.assert_allclose(refitted.signal, signal + change)
    assert refitted.fit.lamp_scale == refitted.predictor == pytest.approx(1.1) and refitted.fit.camera is camera


@pytest.mark.parametrize(("motions_px", "drafts"), [((0.09, 9.0), 1), ((0.11, 0.01), 2), ((0.5, 0.5), 2)])
def test_another_draft_is_rendered_only_where_the_first_one_moved_the_camera_far(monkeypatch, motions_px, drafts):
    """The final picture is rendered through the last fitted camera, which is settled if that draft hardly moved it."""
    cameras = [cornell_camera(64)]
    for motion in motions_px:
        moved = replace(cameras[-1], principal_point_px=cameras[-1].principal_point_px + motion)
        cameras.append(moved)
    prepared = SimpleNamespace(expected_camera=lambda effects: cameras[0], scene=cornell_box(), free_scale=None)
    started = []

    def fitted(prepared, model, light, camera, pilot, progress):
        started.append(camera)
        return prepared, cameras[len(started)], 0.5

    final = []
    monkeypatch.setattr(pipeline, "solved_light", lambda *_: None)
    monkeypatch.setattr(pipeline, "_fitted_to_draft", fitted)
    monkeypatch.setattr(pipeline, "rendered_from", lambda *arguments: final.append(arguments[2]))
    monkeypatch.setattr(pipeline, "refitted_picture", lambda *_, settled: final.append(settled) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        validate_prepared(prepared, Model())
    assert started == cameras[:drafts] and final == [cameras[drafts], motions_px[drafts - 1] < 0.1]


@pytest.fixture(scope="session")
def truth():
    """A render of the published box through a camera a little off, and that camera."""
    camera = perturbed_camera(SIZE, SEED)
    scene = photographed_scene(Model())
    with large_patches():
        image = render_to_precision(RenderJob(scene, camera, WAVELENGTH_NM, seed=SEED), 2.5e-3)
    return image, camera, scene


@pytest.fixture(scope="session")
def small_capture(truth, tmp_path_factory):
    folder = tmp_path_factory.mktemp("captures") / "small"
    image, camera, scene = truth
    photograph_image(folder, image, (), None, scene, camera, settings=CaptureSettings(), seed=SEED)
    return folder


@pytest.fixture(scope="session")
def result(small_capture):
    messages = []
    progress = ProgressReporter(lambda stage, done: messages.append((stage, done)))
    with large_patches():
        validation = validate_capture(load_capture(small_capture), Model(render=RenderSettings(noise=0.8)), progress)
    stages, parts = zip(*messages, strict=True)
    assert list(dict.fromkeys(stages)) == ["calibrating", "rendering", "comparing"]
    assert parts[-1] == 1 and np.all(np.diff(parts) >= 0)
    return validation


@pytest.fixture(scope="session")
def written(result, tmp_path_factory):
    folder = tmp_path_factory.mktemp("validation") / "out"
    write_validation(result, folder)
    return folder


def test_a_picture_within_noise_is_not_far_off():
    """Twelve standard deviations are a reduced chi2 of 144, and none is 0."""
    signal, used = np.full((1, 2, 2), 100.0), np.ones((1, 2, 2), bool)
    fit = SimpleNamespace(lamp_scale=1.0)
    rendered = SimpleNamespace(signal=signal, used=used, variance=np.full((1, 2, 2), 2.0), fit=fit)
    for offset_dn, far in ((0.0, False), (8.0, False), (12.0 * np.sqrt(102), True)):
        prepared = SimpleNamespace(
            measured=signal + offset_dn, calibration=SimpleNamespace(predicted_variance=lambda expected: expected)
        )
        assert pipeline._is_far_off(prepared, rendered) == far


def test_a_click_in_the_report_shows_the_values_of_metrics_and_maps(result, written):
    """Of a written report, in a browser: signals of a pixel, mean colour difference, spectrum, light in parts."""
    metrics = json.loads((written / "metrics.json").read_text())
    x, y = 20, 44
    with open_browser() as page:
        page.open(written / "report.html")
        page.run("globalThis.v = document.getElementById('viewer').viewer; v.ready.then(() => null)")
        page.run("document.getElementById('viewer').scrollIntoView()")
        x_px, top, width = page.run(
            "(() => {const b = document.querySelector('canvas').getBoundingClientRect();"
            "return [b.left, b.top, b.width]})()"
        )
        page.run("globalThis.received = null; addEventListener('cbox-pixel', (e) => { received = e.detail; })")
        page.click(x_px + (x + 0.5) * width / SIZE, top + (y + 0.5) * width / SIZE)
        record = page.run("received")
        outcome = page.run("v.set({c: 'delta_e_ab'}), Array.from(v._paintedLayer('delta_e_ab').values)")
        assert page.errors == []
    maps, image = result.comparison.maps, result.image
    assert (record["x"], record["y"]) == (x, y)
    assert record["surface"] == image.surface_names[int(image.surface[y, x])]
    for band in record["bands"]:
        index = result.comparison.bands.index(band["id"])
        for name in ("measured", "rendered", "sigma"):
            assert band[name] == pytest.approx(maps[name].values[index, y, x], rel=1e-6)
    assert np.mean([v for v in outcome if v is not None]) == pytest.approx(metrics["delta_e_ab"]["mean"], rel=1e-4)
    spectrum = result.fit.lamp_scale * image.project(np.eye(len(image.wavelength_nm)))[0][y, x]
    np.testing.assert_allclose(record["spectrum"]["values"], spectrum, atol=2e-3 * spectrum.max())
    shares = [part["share"] for part in record["light"]]
    assert sum(shares) == pytest.approx(1, abs=1e-3) and min(shares) > 0


def test_shares_of_the_excess_by_region_sum_to_one(written):
    regions = json.loads((written / "metrics.json").read_text())["regions"]
    for rows in regions.values():
        shares = [row["share_of_excess"] for row in rows.values()]
        assert all(share is None for share in shares) or sum(shares) == pytest.approx(1)
        assert sum(row["share_of_residuals"] for row in rows.values()) == pytest.approx(1)


def distance(camera: Camera, true: Camera) -> float:
    """Mahalanobis square of the true parameters."""
    offset = camera.parameters - true.parameters
    return float(offset @ np.linalg.solve(camera.covariance, offset))


def test_a_cache_changes_no_bit_of_a_validation(tmp_path):
    """The same input, without a cache, with one that is empty, and with one that holds every picture."""
    model, cache = Model(render=RenderSettings(noise=4.0)), tmp_path / "cache"
    prepared = prepare(load_capture(glare_capture(tmp_path / "capture")), model)
    with large_patches():
        runs = [validate_prepared(replace(prepared, cache=folder), model) for folder in (None, cache, cache)]
    times = {path: path.stat().st_mtime_ns for path in cache.iterdir()}
    first = runs[0]
    assert len(times) >= 3
    for other in runs[1:]:
        assert other.fit.camera.parameters.tobytes() == first.fit.camera.parameters.tobytes()
        assert other.fit.lamp_scale == first.fit.lamp_scale
        assert other.image.coefficients.tobytes() == first.image.coefficients.tobytes()
        for name, values in first.comparison.maps.items():
            assert other.comparison.maps[name].values.tobytes() == values.values.tobytes(), name


def test_noise_explains_a_capture_without_effect(result, truth):
    """chi2 per degree of freedom is 1 within 5 standard deviations and the error of the photographed render.

    That render's variance over the variance that is stated adds to chi2, as the capture cannot state it.
    """
    responses = result.prepared.calibration.responses
    sigma_squared = result.comparison.maps["sigma"].values ** 2
    used = np.isfinite(result.comparison.maps["residual_over_sigma"].values)
    allowance = float(np.mean((render_bands(truth[0], responses)["variance"].values / sigma_squared)[used]))
    chi2 = result.comparison.chi2
    assert 0 < allowance < 0.2
    assert abs(chi2.per_dof - 1) < 5 * chi2.per_dof_sigma + allowance


def test_nothing_is_missing_where_nothing_is_hidden(result, monkeypatch):
    """The diagnosis invents no cause. Those in the scene, which take long to screen, do not compete here."""
    stages = ("camera", "filter", "optics", "counts")
    monkeypatch.setattr(
        "cboxlab.validation.diagnose.stepwise.hypotheses",
        lambda *names, **how: [h for h in hypotheses(*names, **how) if h.effect.stage in stages],
    )
    assert diagnose_validation(result).adequate


def test_a_camera_pulled_away_by_pixels_comes_back(result):
    """From 2 px aside, further than one picture can be warped, to within 0.01 px of the fit from nearby."""
    near, corners = result.fit.camera, np.concatenate([s.vertices_mm for s in cornell_box().surfaces])
    aside = near.with_parameters(near.parameters + np.array([0, 0, 0, 1.4, 1.4, 0, 0, 0, 0, 0]))
    settings = RenderSettings(noise=2.0)
    moved = rendered_from(result.prepared, result.light, aside, settings, ())

    assert near.motion_px(aside, corners) > 2
    rough = replace(result, model=Model(render=settings))
    linearised = linearised_fit(result.prepared, replace(moved, used=result.rendered.used), ())
    assert near.motion_px(refitted(rough, linearised, []).rendered.fit.camera, corners) < 0.01


def test_the_true_camera_lies_within_the_survey(result, truth):
    calibrated = result.prepared.calibrated_camera
    assert distance(calibrated, truth[1]) < LARGEST_DISTANCE
    assert result.prepared.calibration.camera_fit.reprojection_rms_px <= 1.15 * 0.15


def test_the_refit_brings_the_camera_closer(result, truth):
    """Thousands of pixels along edges know the camera better than fifty surveyed points."""
    corners = np.concatenate([surface.vertices_mm for surface in truth[2].surfaces])
    error = [truth[1].motion_px(camera, corners) for camera in (result.fit.camera, result.prepared.calibrated_camera)]
    assert error[0] < error[1] / 2
    assert error[0] < 0.03


def test_the_lamps_power_comes_back_within_its_uncertainty(result, truth):
    """lamp.csv was written with an error, which the fit undoes; 0.1% are allowed for C and the render."""
    true_power = result.prepared.scene.lamp.radiance.at(550.0)
    error = truth[2].lamp.radiance.at(550.0) / true_power
    assert result.fit.lamp_scale == pytest.approx(float(error), abs=1e-3 + 5 * result.fit.lamp_scale_sigma)
    assert abs(float(error) - 1) < 0.1


def test_surfaces_agree(result):
    for row in result.comparison.by_surface.values():
        if row.interior_pixels > 20:
            assert np.all(np.abs(row.relative) < 5 * row.relative_sigma + 0.003)
            assert row.colour["delta_e_ab"] < 0.5


def test_luminances_are_those_of_the_light_that_was_photographed(written, result, truth):
    """Of the true spectra, integrated with the observer itself, on the same pixels: within 1 % and 0.005,
    what the filter weights leave (0.4 % and 0.004 were found)."""
    image, maps = truth[0], result.comparison.maps
    true = image.project(tristimulus_weights(WAVELENGTH_NM))[0]
    content = json.loads((written / "metrics.json").read_text())["surfaces"]
    mask = (maps["edge_distance_px"].values >= 3) & (maps["mask"].values == 0).all(axis=0)
    compared = 0
    for index, row in enumerate(content.values()):
        where = mask & (maps["surface"].values == index)
        assert row["interior_pixels"] == where.sum()
        if where.sum() < 20:
            continue
        compared += 1
        xyz = true[where].mean(axis=0)
        for side in ("measured", "rendered"):
            assert row[side]["luminance_cd_m2"] == pytest.approx(xyz[1], rel=0.01)
            assert [row[side][key] for key in "xy"] == pytest.approx(xyz[:2] / xyz.sum(), abs=0.005)
    assert compared >= 4


def test_metrics_have_every_key_of_the_plan(written, result):
    content = json.loads((written / "metrics.json").read_text())
    bands, surfaces = result.comparison.bands, result.comparison.by_surface
    number = (int, float)
    assert "seconds" not in content  # two runs write the same bytes; the manifest has the time
    expected = {
        "capture": str,
        "model": str,
        "version": str,
        "camera": {
            "reprojection_rms_px": number,
            "position_mm": list,
            "position_sigma_mm": list,
            "rotation_deg": list,
            "focal_length_px": number,
            "principal_point_px": list,
            "k1": number,
            "covariance": list,
        },
        "lamp_scale": {"value": number, "sigma": number},
        "chi2_per_dof": number,
        "render_sigma_over_sensor_sigma_median": number,
        "pixels_used": int,
        "masked": {"saturated": int, "lamp": int},
        "bands": {
            band: {
                "chi2_per_dof": number,
                "mean_relative_difference": number,
                "rms_relative_difference": number,
            }
            for band in bands
        },
        "surfaces": {
            name: {
                "relative_difference": dict.fromkeys(bands, number),
                "delta_e_ab": number,
                "delta_e_2000": number,
                **{side: {"luminance_cd_m2": number, "x": number, "y": number} for side in ("measured", "rendered")},
            }
            for name in surfaces
        },
        "delta_e_ab": {"mean": number, "p95": number, "max": number},
        "delta_e_2000": {"mean": number, "p95": number, "max": number},
        "luminance": {"mean_relative_difference": number, "rms_relative_difference": number},
        "edges": {"share_of_excess": (int, float, type(None)), "chi2_per_dof": number},
        "interiors": {"chi2_per_dof": number},
    }

    def check(record, expected_record, path):
        if isinstance(expected_record, dict):
            assert set(expected_record) <= set(record), path
            for key in expected_record:
                check(record[key], expected_record[key], f"{path}.{key}")
        else:
            assert isinstance(record, expected_record), path

    check(content, expected, "metrics")
    assert np.shape(content["camera"]["covariance"]) == (10, 10)
    assert set(content["path"][0]) == {"effects", "chi2_per_dof", "delta_e_ab_mean"}
    assert content["chi2_per_dof"] == pytest.approx(result.comparison.chi2.per_dof)


def test_maps_read_back(written, result):
    names = {path.stem for path in (written / "maps").glob("*.exr")}
    assert {"measured", "rendered", "sigma", "residual_over_sigma", "difference", "regions", "mask"} <= names
    for name in names:
        channels, units = read_map(written / "maps" / f"{name}.exr")
        assert channels.shape[1:] == (SIZE, SIZE)
        assert all(units.values()) and np.isfinite(channels.values).any()
    residual = read_map(written / "maps" / "residual_over_sigma.exr")[0]
    used = np.isfinite(residual.values)
    assert np.mean(residual.values[used] ** 2) == pytest.approx(result.comparison.chi2.per_dof, rel=1e-2)


def test_the_report_needs_no_other_file(written):
    page = (written / "report.html").read_text(encoding="utf-8")
    assert "<html" in page and "data:image/png;base64," in page
    assert 'src="http' not in page and 'href="http' not in page


def test_what_cannot_be_rendered_is_said(small_capture, tmp_path):
    folder = shutil.copytree(small_capture, tmp_path / "capture")
    path = folder / "capture.toml"
    text = path.read_text()
    path.write_text(text[: text.index("[geometry]")])
    with pytest.raises(InputError, match=r"capture\.toml.*no \[geometry\] with points"):
        validate_capture(load_capture(folder), Model())


def test_the_promised_figures_are_met(shared):
    """On a capture by another simulator, the effect that it hides in the model; its answers have the true camera."""
    answer = json.loads((shared / "captures" / "answers.json").read_text())["mystery-2"]
    effect = apply_checked(answer["effect"], answer["params"], "answers.json")
    result = validate_capture(
        load_capture(shared / "captures" / "mystery-2"), Model(effects=(effect,), render=RenderSettings(noise=0.8))
    )
    fit, c, true_camera = result.prepared.calibration.camera_fit, result.comparison, answer["true_camera"]
    true = Camera(
        fit.camera.width_px,
        fit.camera.height_px,
        true_camera["fx_px"],
        np.array([true_camera["cx_px"], true_camera["cy_px"]]),
        true_camera["k1"],
        np.array(true_camera["R"]),
        np.array(true_camera["position_mm"]),
    )
    assert np.trace(true.rotation @ REFERENCE_ROTATION.T) > 2.99
    assert fit.reprojection_rms_px <= 1.15 * 0.15
    assert distance(result.prepared.calibrated_camera, true) <= 29.6
    for name, row in c.by_surface.items():
        assert np.all(np.abs(row.relative) < 0.01), name
        assert row.colour["delta_e_ab"] < 0.5, name
    assert 0.9 <= c.chi2.per_dof <= 1.1
    assert c.render_sigma_over_sensor_sigma <= 1
