"""A photographed effect is the effect that the prediction chain knows: two programs, one physics.

The capture goes forwards through light, charge, shot noise, read noise and rounding; the prediction goes
through the expected frames and the laboratory's own correction. With the effect in the prediction the
residual is noise, with the model's chi-square allowance for the uncertainty of the measured gain; without
it the effect stands out.
"""

import numpy as np
import pytest
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.result.calibrate import calibrate_capture
from cboxlab.rendering.chain.expected import expected_signal
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.model.model_file import Model
from cboxlab.rendering.synthetic.capture_writer import tungsten_lamp
from cboxlab.rendering.synthetic.photographer import CaptureSettings
from cboxlab.scenes import cornell_box
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.validation.predict.sensing import sensing
from cboxlab.validation.synthetic.model_capture import (
    perturbed_camera,
    photograph_image,
    photographed_scene,
    write_model_capture,
)
from scipy import stats

SIZE = 48
SEED = 3
#: One false alarm in a thousand repetitions with another seed, over all cases below.
FALSE_ALARM = 1e-3

# Effect, parameters. Strong enough to stand out ten times beyond the noise of chi-square.
CASES = [
    ("veiling-glare", {"fraction": 0.02}),
    ("ghost", {"fraction": 0.02}),
    ("defocus", {"sigma_px": 1.0}),
    ("chromatic-focus", {"sigma_px_per_100nm": 0.8}),
    ("lateral-colour", {"ppm_per_nm": 60.0}),
    ("vignetting", {"edge_loss": 0.1}),
    ("filter-leak", {"fraction": 0.02}),
    ("filter-shift", {"effective_index": 1.5}),
    ("band-gain", {"band": "f550", "scale": 1.05}),
    ("dark-offset", {"dn": 20.0}),
    ("nonlinearity", {"b": 0.05}),
    ("shutter-offset", {"seconds": 0.02}),
    ("lamp-drift", {"per_minute": 0.02}),
    ("crosstalk", {"fraction": 0.1}),
    ("smear", {"fraction": 0.02}),
]


@pytest.fixture(scope="module")
def scene():
    return cornell_box().with_lamp(tungsten_lamp())


@pytest.fixture(scope="module")
def image(scene) -> RenderedImage:
    """Stripes of three paints under uneven light, and a lamp: colours, edges, gradients for every effect."""
    v, u = np.indices((SIZE, SIZE)) / SIZE
    light = 0.008 * (0.2 + 0.8 * np.exp(-((u - 0.6) ** 2 + (v - 0.4) ** 2) / 0.2))
    lamp = (v < 0.1) & (np.abs(u - 0.5) < 0.1)
    paint = (np.floor(u * 9) % 3).astype(int)
    emission = scene.lamp.radiance.at(WAVELENGTH_NM)
    paints = [material.reflectance.at(WAVELENGTH_NM) for material in scene.materials.values()]
    shares = [np.where(lamp, 0.0, np.where(paint == i, light, 0.0)) for i in range(3)]
    coefficients = np.stack([np.where(lamp, 1.0, 0.0), *shares], axis=-1)
    return RenderedImage(
        coefficients=np.stack([coefficients, coefficients]).astype(np.float32),
        spectra=np.stack([emission, *(emission * p for p in paints)]),
        wavelength_nm=WAVELENGTH_NM,
        coverage=np.stack([~lamp, lamp], axis=-1).astype(np.float32),
        facet_surface=np.array([0, 1]),
        surface_names=("wall",),
    )


def photographed(folder, image, scene, effects, **settings):
    photograph_image(
        folder,
        image,
        effects,
        None,
        scene,
        perturbed_camera(SIZE, SEED),
        settings=CaptureSettings(**settings),
        seed=SEED,
    )
    return calibrate_capture(load_capture(folder))


def chi2_per_dof(calibration, image, effects) -> tuple[float, float]:
    """Of measured against predicted signals, and its standard deviation (chance, and that of the gain)."""
    camera = perturbed_camera(SIZE, SEED)
    expected = expected_signal(image, sensing(calibration, camera), effects, camera)
    used = (calibration.images["mask"].values == 0) & ~image.sees_lamp
    residual = calibration.images["signal"].values - expected
    chi2 = (residual**2 / calibration.predicted_variance(expected))[used]
    gain = calibration.noise
    return float(chi2.mean()), float(np.hypot(np.sqrt(2 / chi2.size), gain.gain_sigma / gain.gain_e_per_dn))


@pytest.mark.parametrize(("name", "values"), CASES, ids=[name for name, _ in CASES])
def test_a_photographed_effect_is_the_predicted_one(name, values, image, scene, tmp_path):
    """Allowance beyond chance, 0.02: the absolute scale and the flats are measured, not known."""
    effect = apply_checked(name, values, "test")
    calibration = photographed(tmp_path / "box", image, scene, [effect])
    explained, sigma = chi2_per_dof(calibration, image, [effect])
    assert explained == pytest.approx(1, abs=stats.norm.isf(FALSE_ALARM / 2 / len(CASES)) * sigma + 0.02)
    unexplained, _ = chi2_per_dof(calibration, image, [])
    assert unexplained > 1 + 10 * sigma


def test_several_effects_act_together(image, scene, tmp_path):
    effects = [
        apply_checked("defocus", {"sigma_px": 1.0}, "test"),
        apply_checked("nonlinearity", {"b": 0.02}, "test"),
        apply_checked("shutter-offset", {"seconds": 0.02}, "test"),
    ]
    calibration = photographed(tmp_path / "box", image, scene, effects)
    explained, sigma = chi2_per_dof(calibration, image, effects)
    assert explained == pytest.approx(1, abs=stats.norm.isf(FALSE_ALARM / 2) * sigma + 0.02)


def test_a_sphere_of_any_brightness_leaves_the_signals(image, scene, tmp_path):
    """A hundred times as bright: references take milliseconds or less, which a tenth of one changes."""
    short = apply_checked("shutter-offset", {"seconds": -1e-4}, "test")
    calibration = photographed(tmp_path / "box", image, scene, [short], sphere_brightness=100.0)
    capture = calibration.capture
    assert all(table.exposure_s < 0.1 for band in capture.band_ids for table in capture.references(band))
    explained, sigma = chi2_per_dof(calibration, image, [short])
    assert explained == pytest.approx(1, abs=stats.norm.isf(FALSE_ALARM / 2) * sigma + 0.02)
    unexplained, _ = chi2_per_dof(calibration, image, [])
    assert unexplained > 1 + 10 * sigma


def test_the_survey_and_the_lamp_are_those_before_the_effect(image, scene, tmp_path):
    """What changes after the survey and the lamp's measurement leaves no trace in them."""
    effects = [
        apply_checked("camera-pose", {"rx_deg": 0.5, "tx_mm": 8.0}, "test"),
        apply_checked("lamp-power", {"scale": 1.2}, "test"),
    ]
    for name, effects_of_capture in (("plain", []), ("moved", effects)):
        photograph_image(
            tmp_path / name,
            image,
            effects_of_capture,
            None,
            scene,
            perturbed_camera(SIZE, SEED),
            settings=CaptureSettings(),
            seed=SEED,
        )
    for file in ("points.csv", "spectra/lamp.csv"):
        assert (tmp_path / "plain" / file).read_bytes() == (tmp_path / "moved" / file).read_bytes()


def test_cameras_differ_by_seed_and_repeat():
    first, again, other = (perturbed_camera(SIZE, seed) for seed in (1, 1, 2))
    assert np.array_equal(first.parameters, again.parameters)
    assert np.all(first.parameters != other.parameters)


def test_the_published_box_gets_an_absolute_lamp():
    assert photographed_scene(Model()).lamp.radiance.at(550.0) == tungsten_lamp().at(550.0)


def test_a_models_shortcoming_is_no_property_of_a_capture(tmp_path):
    model = Model().with_effect(apply_checked("interreflection", {"max_bounces": 1}, "test"))
    with pytest.raises(InputError, match=r"interreflection.*settings"):
        write_model_capture(tmp_path / "box", model, perturbed_camera(SIZE, 0), CaptureSettings(), 0)
    assert not list(tmp_path.iterdir())
