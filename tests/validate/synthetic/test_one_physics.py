"""The raw frames of a synthetic capture without noise are those that the prediction expects: one physics, not two.

The capture is made frame by frame: light per second, the camera's flat, exposure, effects on charge, dark level,
effects on what is read out. The prediction makes all frames at once from the capture's constants. Both must come to
the same counts, to the digits of double precision, for every effect behind the scene.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cboxlab.calibration.instrument.band_response import ResponseFactors
from cboxlab.rendering.chain.band_curves import over_field
from cboxlab.rendering.chain.expected import expected_counts, expected_signal
from cboxlab.rendering.chain.projection import scene_light
from cboxlab.rendering.chain.sensing import MergedExposure, Sensing
from cboxlab.rendering.chain.stages import after_stage, stages_between
from cboxlab.rendering.effects import AppliedEffect, apply_checked, catalogue
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.synthetic.capture_writer import sphere_spectrum, tungsten_lamp, unit_factors
from cboxlab.rendering.synthetic.photographer import CaptureSettings, Frame, band_filters, pixel_maps
from cboxlab.scenes.wavelength_grid import FILTER_GRID, WAVELENGTH_NM
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photographed_light

SIZE = 24
BANDS = tuple(band_filters())
CAMERA = perturbed_camera(SIZE, 3)
SETTINGS = CaptureSettings()
DARK_DN_S = SETTINGS.dark_current_e_s / SETTINGS.gain_e_per_dn
#: s, by band, of the scene, the flat and the reference; s from the first frame's beginning to each band's.
EXPOSURES = {
    kind: base * np.linspace(1, 3, len(BANDS)) for kind, base in (("band", 2.0), ("flat", 0.7), ("reference", 1.1))
}
STARTS = 30.0 * np.arange(len(BANDS))[::-1]

VALUES: dict[str, dict[str, Any]] = {
    "filter-leak": {"fraction": 0.02},
    "filter-shift": {"effective_index": 1.4},
    "chromatic-focus": {"sigma_px_per_100nm": 0.8},
    "defocus": {"sigma_px": 1.0},
    "ghost": {"fraction": 0.05},
    "lateral-colour": {"ppm_per_nm": 60.0},
    "veiling-glare": {"fraction": 0.05},
    "vignetting": {"edge_loss": 0.2},
    "band-gain": {"band": "f550", "scale": 1.1},
    "crosstalk": {"fraction": 0.1},
    "dark-offset": {"dn": 20.0},
    "lamp-drift": {"per_minute": 0.02},
    "nonlinearity": {"b": 0.05},
    "shutter-offset": {"seconds": 0.05},
    "smear": {"fraction": 0.05},
}


def image() -> RenderedImage:
    """Three spectra in random proportions, a lamp a hundred times as bright."""
    generator = np.random.default_rng(5)
    coefficients = generator.uniform(0.005, 0.01, (2, SIZE, SIZE, 3))
    coefficients[:, 2:4, 10:14] *= 100
    lamp = tungsten_lamp().at(WAVELENGTH_NM)
    spectra = lamp * np.stack([np.full(301, 0.7), np.linspace(0.1, 0.8, 301), np.linspace(0.6, 0.1, 301)])
    coverage = np.ones((SIZE, SIZE, 2), np.float32)
    return RenderedImage(coefficients, spectra, WAVELENGTH_NM, coverage, np.array([0]), ("wall",))


def photographed(effects: list[AppliedEffect], flat: np.ndarray) -> dict[str, np.ndarray]:
    """(band, y, x) DN of one frame a kind and band, without noise; "dark-band" etc. are (band,) of dark frames."""
    signals, field, hooks = photographed_light(image(), effects, None, CAMERA, SETTINGS)
    frames: dict[str, list] = {}
    for kind, rates in (("band", signals), ("flat", field), ("reference", field)):
        for index, (band, rate) in enumerate(zip(BANDS, rates, strict=True)):
            seconds = float(EXPOSURES[kind][index])
            dark = SETTINGS.bias_dn + DARK_DN_S * seconds
            start = float(STARTS[index]) if kind == "band" else None
            frame = Frame(kind, band, seconds, 0, start)  # type: ignore[arg-type]
            counts = hooks.counts(frame, hooks.light(frame, rate * flat * seconds) + dark)
            frames.setdefault(kind, []).append(counts)
            capped = hooks.counts(Frame("dark", None, seconds, 0, None), np.full((SIZE, SIZE), dark))
            frames.setdefault(f"dark-{kind}", []).append(capped.mean())
    return {kind: np.array(stack) for kind, stack in frames.items()}


def constants(effects: list[AppliedEffect], flat: np.ndarray) -> Sensing:
    """What a calibration without any error finds before the counts' effects act."""
    _, field, _ = photographed_light(image(), [e for e in effects if e.stage == "filter"], None, CAMERA, SETTINGS)
    unit = unit_factors(SETTINGS, SIZE, grid=FILTER_GRID)
    signal = field * flat
    sphere = np.tile(sphere_spectrum().at(WAVELENGTH_NM), (len(BANDS), 1))
    level = signal.mean(axis=(1, 2)) * EXPOSURES["flat"]
    everywhere = np.ones(signal.shape, bool)
    dark = {kind: SETTINGS.bias_dn + DARK_DN_S * seconds for kind, seconds in EXPOSURES.items()}
    scene = ResponseFactors(unit.bands, unit.grid, unit.transmittance, unit.rest, unit.factor * EXPOSURES["band"])
    return Sensing(
        curves=over_field(scene, CAMERA),
        flat_radiance=sphere,
        reference_radiance=sphere,
        flat=signal / signal.mean(axis=(1, 2), keepdims=True),
        usable=everywhere,
        good=everywhere,
        flat_level=level,
        reference_factor=unit.factor * EXPOSURES["reference"],
        reference_weight=np.ones(len(BANDS)),
        dark_scene=dark["band"],
        dark_flat=dark["flat"],
        dark_reference=dark["reference"],
        exposure_scene=EXPOSURES["band"],
        exposure_flat=EXPOSURES["flat"],
        exposure_reference=EXPOSURES["reference"],
        minutes=(STARTS + EXPOSURES["band"] / 2) / 60,
        full_scale=float(SETTINGS.full_scale_dn),
    )


def test_every_effect_behind_the_scene_has_a_case():
    behind = stages_between("filter", "counts")
    assert set(VALUES) == {name for name, effect in catalogue().items() if effect.stage in behind}


@pytest.mark.parametrize("names", [[], *([name] for name in VALUES), ["filter-shift", "ghost", "smear"]], ids="+".join)
def test_the_frames_are_those_expected(names):
    effects = [apply_checked(name, VALUES[name], "test") for name in names]
    flat = pixel_maps(CAMERA, SETTINGS, np.random.default_rng(1)).flat
    frames_made, sensing = photographed(effects, flat), constants(effects, flat)
    light = scene_light(image(), after_stage(sensing.curves, effects, "filter"), CAMERA)
    expected = expected_counts(light, sensing, effects, CAMERA)
    for kind, frame, dark in (
        ("band", expected.scene, expected.dark_scene),
        ("flat", expected.flat, expected.dark_flat),
        ("reference", expected.reference, expected.dark_reference),
    ):
        np.testing.assert_allclose(frames_made[kind], frame, rtol=1e-9, err_msg=kind)
        np.testing.assert_allclose(frames_made[f"dark-{kind}"], dark, rtol=1e-9, err_msg=f"dark of {kind}")
    if names:
        plain = photographed([], flat)
        assert max(np.abs(frames_made[kind] / plain[kind] - 1).max() for kind in EXPOSURES) > 1e-3


@pytest.mark.parametrize("name", ["nonlinearity", "shutter-offset", "dark-offset", "lamp-drift"])
def test_merged_exposures_are_predicted_each_by_itself(name, monkeypatch):
    effects = [apply_checked(name, VALUES[name], "test")]
    flat = pixel_maps(CAMERA, SETTINGS, np.random.default_rng(1)).flat
    short = constants(effects, flat)
    monkeypatch.setitem(EXPOSURES, "band", 4 * EXPOSURES["band"])
    long = constants(effects, flat)
    lights = [scene_light(image(), each.curves, CAMERA) for each in (short, long)]
    alone = [expected_signal(light, each, effects, CAMERA) for light, each in zip(lights, (short, long), strict=True)]
    weight = np.random.default_rng(0).uniform(0, 1, alone[0].shape)
    exposures = (
        MergedExposure(np.ones(len(BANDS)), weight, short.dark_scene, short.minutes),
        MergedExposure(np.full(len(BANDS), 4.0), (1 - weight) / 4, long.dark_scene, long.minutes),
    )
    merged = expected_signal(lights[0], replace(short, merged=exposures), effects, CAMERA)
    np.testing.assert_allclose(merged, weight * alone[0] + (1 - weight) / 4 * alone[1], rtol=1e-9)
    if name != "lamp-drift":
        assert np.abs(merged / alone[0] - 1).max() > 1e-4  # the exposures differ in what the effect does
    plain = expected_signal(lights[0], replace(short, merged=exposures), [], CAMERA)
    np.testing.assert_allclose(plain, expected_signal(lights[0], short, [], CAMERA), rtol=1e-9)
