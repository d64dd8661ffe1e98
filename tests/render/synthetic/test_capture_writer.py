"""A written capture is what a laboratory hands over: its calibration gives back the truth within noise."""

import itertools
import tomllib

import numpy as np
import pytest
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.result.calibrate import calibrate_capture
from cboxlab.rendering.chain.bands import render_bands
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.synthetic.capture_writer import (
    sphere_spectrum,
    toml_table,
    tungsten_lamp,
    unit_factors,
    write_photographs,
)
from cboxlab.rendering.synthetic.photographer import (
    EXPOSURE_STEPS,
    CaptureSettings,
    FrameHooks,
    Shot,
    band_filters,
    chosen_exposure,
    frames_of,
    pixel_maps,
)
from cboxlab.rendering.synthetic.survey import visible_points
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.validation.synthetic.model_capture import photograph_image
from scipy import stats

SIZE = 64
SETTINGS = CaptureSettings()
#: One false alarm in a thousand repetitions with another seed.
FALSE_ALARM = 1e-3


def true_camera():
    camera = cornell_camera(SIZE)
    shift = [3.0, -2.0, 4.0, 0.2, -0.1, 0.15, 0.13, 0.4, -0.3, 0.01]
    return camera.with_parameters(camera.parameters + shift)


def smooth_image(scene) -> RenderedImage:
    """White paint under light that varies over the image by a factor of four, and a patch of lamp."""
    v, u = np.indices((SIZE, SIZE)) / SIZE
    light = 0.008 * (0.25 + 0.75 * np.exp(-((u - 0.6) ** 2 + (v - 0.4) ** 2) / 0.2))
    lamp = (v < 0.1) & (np.abs(u - 0.5) < 0.1)
    coefficients = np.stack([np.where(lamp, 1.0, 0.0), np.where(lamp, 0.0, light)], axis=-1)
    emission = scene.lamp.radiance.at(WAVELENGTH_NM)
    white = scene.materials["white"].reflectance.at(WAVELENGTH_NM)
    return RenderedImage(
        coefficients=np.stack([coefficients, coefficients]).astype(np.float32),
        spectra=np.stack([emission, emission * white]),
        wavelength_nm=WAVELENGTH_NM,
        coverage=np.stack([~lamp, lamp], axis=-1).astype(np.float32),
        facet_surface=np.array([0, 1]),
        surface_names=("wall",),
    )


def expected_rates(image) -> np.ndarray:
    """(band, y, x) DN/s, by the sensor equation as the calibration knows it."""
    return render_bands(image, unit_factors(SETTINGS, SIZE).responses()).signal.values


@pytest.fixture(scope="module")
def scene():
    return cornell_box().with_lamp(tungsten_lamp())


@pytest.fixture(scope="module")
def image(scene):
    return smooth_image(scene)


@pytest.fixture(scope="module")
def folder(scene, image, tmp_path_factory):
    path = tmp_path_factory.mktemp("captures") / "box"
    photograph_image(path, image, (), None, scene, true_camera(), settings=SETTINGS, seed=11)
    return path


@pytest.fixture(scope="module")
def calibration(folder):
    return calibrate_capture(load_capture(folder))


def test_signals_differ_from_the_truth_by_their_stated_noise_only(calibration, image):
    """Chi-square per degree of freedom is 1; its error has two parts, chance and the gain's uncertainty."""
    capture = calibration.capture
    rates = dict(zip(band_filters(), expected_rates(image), strict=True))
    truth = np.stack([rates[band.id] * band.exposure_s for band in capture.manifest.band])
    used = calibration.images["mask"].values == 0
    residual = calibration.images["signal"].values - truth
    chi2 = (residual**2 / calibration.predicted_variance(truth))[used]
    assert 0.95 < used.mean() < 1
    gain = calibration.noise
    error = np.hypot(np.sqrt(2 / chi2.size), gain.gain_sigma / gain.gain_e_per_dn)
    assert chi2.mean() == pytest.approx(1, abs=stats.norm.isf(FALSE_ALARM / 2) * error)


def test_gain_read_noise_and_absolute_scale_come_back(calibration):
    sigmas = stats.norm.isf(FALSE_ALARM / 2)
    noise, scale = calibration.noise, calibration.radiometry
    assert noise.gain_e_per_dn == pytest.approx(SETTINGS.gain_e_per_dn, abs=sigmas * noise.gain_sigma)
    assert noise.read_noise_e == pytest.approx(SETTINGS.read_noise_e, abs=sigmas * noise.read_noise_sigma)
    assert scale.constant == pytest.approx(scale.nominal, abs=sigmas * scale.sigma)
    assert scale.probability > FALSE_ALARM


def test_the_true_camera_lies_within_the_covariance(calibration):
    fit = calibration.camera_fit
    offset = fit.camera.parameters - true_camera().parameters
    distance = float(offset @ np.linalg.solve(fit.camera.covariance, offset))
    assert stats.chi2.sf(distance, len(offset)) > FALSE_ALARM
    assert fit.p_value > FALSE_ALARM
    assert fit.outliers == ()
    assert len(fit.in_use) == SETTINGS.point_count


def test_surveyed_points_are_corners_and_places_in_sight_at_several_depths(scene):
    camera = true_camera()
    points = visible_points(scene, camera, 60, np.random.default_rng(1))
    corners = np.concatenate([surface.vertices_mm for surface in scene.surfaces]).round(2)
    is_corner = (np.abs(points[:, None] - corners).max(axis=-1) < 0.006).any(axis=1)
    assert 10 <= is_corner.sum() <= 31
    assert np.ptp(points, axis=0).min() > 300
    image = camera.project(points)
    assert image.min() >= 0
    assert image.max() <= SIZE - 1


def test_no_surveyed_point_hides_behind_a_block(scene):
    """The tall block's top edge is at y = 330: what lies behind its front face is out of sight."""
    camera = true_camera()
    points = visible_points(scene, camera, 1500, np.random.default_rng(2))
    front = scene.surface("tall-block").vertices_mm
    # the face towards the camera, as published: (423, 247) to (265, 296) on the floor
    a, b = np.array([423.0, 247.0]), np.array([265.0, 296.0])
    assert np.abs(front[:, [0, 2]] - a).sum(axis=1).min() < 1e-6
    direction = points - camera.position_mm
    normal = np.array([b[1] - a[1], 0.0, a[0] - b[0]])
    reach = ((np.array([a[0], 0, a[1]]) - camera.position_mm) @ normal) / (direction @ normal)
    crossing = camera.position_mm + reach[:, None] * direction
    along = (crossing[:, [0, 2]] - a) @ (b - a) / np.sum((b - a) ** 2)
    through = (along > 0.01) & (along < 0.99) & (crossing[:, 1] > 0) & (crossing[:, 1] < 329)
    assert through.sum() > 20
    assert np.all(reach[through] > 0.999)


def test_exposures_are_on_the_dial_and_expose_well(calibration):
    capture = calibration.capture
    unsaturated = ~(calibration.images["mask"].values[0] & 1).astype(bool)
    for band in capture.manifest.band:
        mark = band.exposure_s / 10 ** np.floor(np.log10(band.exposure_s) + 1e-9)
        assert np.min(np.abs(mark - np.array(EXPOSURE_STEPS))) < 1e-9
        level = np.percentile(capture.frames(band)[:, unsaturated], 99.5) / capture.saturation_dn
        assert 0.5 < level < 0.72
    exposed = [t.exposure_s for t in (*capture.manifest.band, *capture.manifest.flats, *capture.manifest.reference)]
    assert {dark.exposure_s for dark in capture.manifest.darks} == set(exposed)


def test_bands_follow_each_other_without_overlap(calibration):
    bands = calibration.capture.manifest.band
    assert bands[0].start_s == 0
    for before, after in itertools.pairwise(bands):
        end = before.start_s + len(before.frames) * (before.exposure_s + SETTINGS.readout_s)
        assert after.start_s > end + 1


def test_repeats_begin_after_exposure_and_readout():
    frames = frames_of(Shot("band", "f400", 4.0, 3, start_s=10.0), 1.2)
    assert [frame.start_s for frame in frames] == pytest.approx([10.0, 15.2, 20.4])


def test_the_lamp_reading_is_as_uncertain_as_it_says(folder, scene):
    read = load_capture(folder).light("spectra/lamp.csv:radiance").at(WAVELENGTH_NM)
    ratio = read / scene.lamp.radiance.at(WAVELENGTH_NM)
    assert np.ptp(ratio) < 1e-6
    assert 0 < abs(ratio[0] - 1) < 5 * SETTINGS.lamp_relative_uncertainty


def test_a_capture_is_repeatable_small_and_never_overwritten(folder, scene, image, tmp_path):
    again = tmp_path / "again"
    photograph_image(again, image, (), None, scene, true_camera(), settings=SETTINGS, seed=11)
    names = sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(again) for p in again.rglob("*") if p.is_file())
    assert all((folder / name).read_bytes() == (again / name).read_bytes() for name in names)
    assert sum((folder / name).stat().st_size for name in names) < 0.5e6
    with pytest.raises(InputError, match="new or empty folder"):
        photograph_image(folder, image, (), None, scene, true_camera(), settings=SETTINGS, seed=12)


def test_nothing_is_left_of_a_capture_that_cannot_be_taken(scene, image, tmp_path):
    dark = CaptureSettings(f_number=1e6)
    with pytest.raises(InputError, match="Is the lamp's radiance absolute"):
        photograph_image(tmp_path / "box", image, (), None, scene, true_camera(), settings=dark, seed=1)
    assert not list(tmp_path.iterdir())


def test_pixel_maps_follow_the_lens_and_have_mean_one():
    camera = true_camera()
    maps = pixel_maps(camera, CaptureSettings(prnu=0.0), np.random.default_rng(3))
    assert maps.flat.mean() == pytest.approx(1, abs=1e-12)
    v, u = np.indices((SIZE, SIZE))
    directions = camera.with_parameters([*camera.parameters[:9], 0.0]).directions(u, v)
    cosine = directions @ camera.rotation[2]
    corner = (SIZE - 1) ** 2 / 2
    square = np.sum((np.stack([u, v], -1) - camera.principal_point_px) ** 2, axis=-1)
    ratio = maps.flat / (cosine**4 * (1 - SETTINGS.vignetting * square / corner))
    assert np.ptp(ratio) < 1e-9


@pytest.mark.parametrize(("rate", "seconds"), [(2766.5, 1.0), (2767.0, 0.8), (27.0, 100.0), (1000.0, 2.5)])
def test_the_exposure_is_the_longest_mark_within_the_level(rate, seconds):
    """70% of 4095 less a bias of 100 leaves 2766.5 counts."""
    assert chosen_exposure(rate, SETTINGS) == seconds


def test_hooks_reach_their_place_in_the_camera(scene, image, tmp_path):
    """An open shutter lets more light and dark charge in; an offset is counts."""
    signals = expected_rates(image)
    levels = [r.signal(sphere_spectrum().values) for r in unit_factors(SETTINGS, SIZE).responses()]
    field = np.tile(np.array(levels)[:, None, None], (1, SIZE, SIZE))
    hooks = {
        "plain": FrameHooks(),
        "shutter": FrameHooks(exposure_s=lambda frame: frame.exposure_s * 1.1),
        "light": FrameHooks(light=lambda frame, light: light + 200.0 * (frame.kind == "band")),
        "counts": FrameHooks(counts=lambda frame, counts: counts + 50.0 * (frame.kind != "dark")),
    }
    means: dict[str, dict[str, float]] = {}
    for name, hook in hooks.items():
        write_photographs(
            tmp_path / name,
            signals,
            field,
            image.sees_lamp,
            camera=true_camera(),
            scene=scene,
            settings=SETTINGS,
            seed=5,
            hooks=hook,
        )
        capture = load_capture(tmp_path / name)
        groups = {
            "band": capture.manifest.band,
            "dark": capture.manifest.darks,
            "flat": capture.manifest.flats,
        }
        means[name] = {
            kind: float(np.mean([np.median(capture.frames(table)) for table in tables]))
            for kind, tables in groups.items()
        }
    change = {n: {k: means[n][k] - means["plain"][k] for k in ("band", "dark", "flat")} for n in hooks}
    assert change["shutter"]["flat"] == pytest.approx(0.1 * (means["plain"]["flat"] - 100), rel=0.02)
    assert change["light"]["band"] == pytest.approx(200, abs=5)
    assert abs(change["light"]["flat"]) < 5
    assert change["light"]["dark"] == 0
    assert change["counts"]["band"] == pytest.approx(50, abs=5)
    assert change["counts"]["dark"] == 0


@pytest.mark.parametrize(
    "entries",
    [
        {"name": 'a "box" of µm \\ glass', "frames": ("frames/a-0.tif", "frames/a-1.tif")},
        {"exposure_s": 1e-05, "gain": 12.0, "width_px": 64, "position": 0.1 + 0.2},
        {"text": "two\nlines", "empty": "", "none": None},
        {"scale": np.float64(1 / 3), "quantum efficiency": ["a.csv:R", "a.csv:G"]},
        {"large": 1e300, "small": 5e-324, "sign": -0.0, "on": True},
    ],
)
@pytest.mark.parametrize("header", ["", "[camera]", "[[band]]"])
def test_a_table_reads_back_to_the_same_values(header, entries):
    with np.printoptions(legacy="1.13"):
        text = toml_table(header, **entries)
    content = tomllib.loads(text + "\n[[dark]]\nframes = []\n")
    assert content.pop("dark") == [{"frames": []}]
    table = {"": content, "[camera]": content.get("camera"), "[[band]]": content.get("band", [None])[0]}[header]
    expected = {name: list(v) if isinstance(v, tuple) else v for name, v in entries.items() if v is not None}
    assert table == expected
