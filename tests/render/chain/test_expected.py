"""Expected corrected signals: those of the render without effects, those that a laboratory finds with them.

The laboratory here is the fake capture: an independent forward model that writes raw frames with the effect
in them, which the calibration then reduces. Chi-square of measured minus expected, 3 bands of 40 x 56 pixels,
is 1 +- 0.017 per degree of freedom by noise alone. 4 sigma are allowed (one false alarm in 16,000), and
without the effect in the prediction it must lie 20 sigma away, so that the test has power.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.result.calibrate import calibrate_capture
from cboxlab.rendering.chain.bands import render_bands
from cboxlab.rendering.chain.expected import expected_signal
from cboxlab.rendering.chain.projection import scene_light
from cboxlab.rendering.chain.stages import after_stage
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.scenes.camera import REFERENCE_ROTATION, Camera
from cboxlab.utils.errors import InputError
from cboxlab.validation.predict.sensing import sensing
from helpers.fakes.capture import DEPTH, GAIN, GRID, READ_NOISE, FakeCapture, bell, response, sphere
from scipy.ndimage import correlate

BANDS = (450, 550, 650)
CAMERA = Camera(56, 40, 60.0, np.array([27.0, 20.0]), 0.02, REFERENCE_ROTATION, np.zeros(3))


def effect(identifier: str, **values: float | str):
    return apply_checked(identifier, values, "test")


def image(fake: FakeCapture, batches: int = 2) -> RenderedImage:
    """The fake capture's scene as a rendered image of one spectrum."""
    coefficients = np.repeat(fake.light[None, ..., None], batches, axis=0)
    coverage = np.zeros((fake.height, fake.width, 2), np.float32)
    coverage[..., 0] = 1
    return RenderedImage(coefficients, fake.spectrum[None], GRID, coverage, np.array([0]), ("wall",))


@dataclass
class AffectedCapture(FakeCapture):
    """Frames with an effect in them, of a box of bright and dark stripes.

    flat_source : "sphere", or "even" for a flat field of the same radiance at all wavelengths.
    """

    centres: tuple[int, ...] = BANDS
    repeats: int = 4
    leak: float = 0.0
    index: float = np.inf
    offset_dn: float = 0.0
    bend: float = 0.0
    late_s: float = 0.0
    crosstalk: float = 0.0
    smear: float = 0.0
    drift_per_minute: float = 0.0
    flat_source: str = "sphere"

    def __post_init__(self) -> None:
        super().__post_init__()
        v, u = np.indices((self.height, self.width))
        self.light = np.where((u // 4 + v // 5) % 2, 1.0, 0.2) * np.where((v < 20) & (u > 30), 1.5, 0.7)

    def throughput(self, band: str, light: np.ndarray) -> np.ndarray:
        """(y, x) signal over that of the filter as stated."""
        directions = CAMERA.directions(*np.meshgrid(np.arange(56), np.arange(40)))
        sine_squared = 1 - directions[..., 2:] ** 2
        centre = float(band[1:])
        path_nm = GRID / np.sqrt(1 - sine_squared / self.index**2)
        # The filters' table ends at 700 nm, and is 0 from the next wavelength on.
        passed = np.interp(path_nm, np.append(GRID, 701.0), np.append(bell(centre), 0.0))
        weights = response(centre) / bell(centre) * light
        weights[[0, -1]] /= 2
        return (passed + self.leak * (0.7 - passed)) @ weights / (bell(centre) @ weights)

    def minutes(self, band: str) -> float:
        """The middle of the band's frames, 1.2 s of readout after each."""
        begun = sum(self.repeats * (self.exposure[b] + 1.2) for b in self.bands[: self.bands.index(band)])
        return (begun + (self.repeats - 1) / 2 * (self.exposure[band] + 1.2) + self.exposure[band] / 2) / 60

    def _frames(self, stem: str, signal: np.ndarray, exposure_s: float, repeats: int) -> str:
        kind, _, band = stem.rpartition("-")
        late = exposure_s + self.late_s
        self.added = 0.0 if kind == "dark" else self.offset_dn
        if kind != "dark":
            source = {"": "scene", "sphere": "sphere", "flat": self.flat_source}[kind]
            lights = {"scene": self.spectrum, "sphere": sphere(), "even": np.ones(GRID.size)}
            signal = signal * self.throughput(band, lights[source]) * late / exposure_s
            if kind == "":
                signal = signal * (1 + self.drift_per_minute * self.minutes(band))
            q = self.crosstalk / 4
            signal = correlate(signal, np.array([[0, q, 0], [q, 1 - 4 * q, q], [0, q, 0]]), mode="nearest")
            signal = signal + self.smear * signal.mean(axis=0)
        return super()._frames(stem, signal, late, repeats)

    def counts(self, signal: np.ndarray, exposure_s: float) -> np.ndarray:
        electrons: np.ndarray = self.rng.poisson(GAIN * (signal + self.rate * exposure_s))
        electrons = electrons + READ_NOISE * self.rng.standard_normal(signal.shape)
        dn = electrons / GAIN + self.bias + self.added
        return np.clip(np.rint(dn * (1 + self.bend * dn / 4095)), 0, 2**DEPTH - 1).astype(np.uint16)


def chi2(folder, fake: FakeCapture, effects) -> float:
    """Per degree of freedom, of measured minus expected."""
    calibration = calibrate_capture(load_capture(folder))
    signal = expected_signal(image(fake), sensing(calibration, CAMERA), effects, CAMERA)
    used = calibration.images["mask"].values == 0
    residual = (calibration.images["signal"].values - signal) / np.sqrt(calibration.predicted_variance(signal))
    assert used.mean() > 0.95
    return float(np.mean(residual[used] ** 2))


CASES: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "filter-leak": ({"leak": 0.02}, {"fraction": 0.02}),
    "filter-shift": ({"index": 1.5}, {"effective_index": 1.5}),
    "dark-offset": ({"offset_dn": 8.0}, {"dn": 8.0}),
    "nonlinearity": ({"bend": 0.05}, {"b": 0.05}),
    "shutter-offset": ({"late_s": 0.005}, {"seconds": 0.005}),
    "crosstalk": ({"crosstalk": 0.2}, {"fraction": 0.2}),
    "smear": ({"smear": 0.05}, {"fraction": 0.05}),
    "lamp-drift": ({"drift_per_minute": -0.05}, {"per_minute": -0.05}),
}
NOISE = 4 * np.sqrt(2 / (3 * 40 * 56))


@pytest.mark.parametrize("identifier", CASES)
def test_a_laboratory_finds_what_is_expected(tmp_path, identifier):
    capture_kind, values = CASES[identifier]
    fake = AffectedCapture(tmp_path / "c", seed=3, **capture_kind)
    folder = fake.write()
    explained, unexplained = (chi2(folder, fake, e) for e in ([effect(identifier, **values)], []))
    assert abs(explained - 1) < NOISE
    assert unexplained > 1 + 5 * NOISE


def test_a_laboratory_without_effects_finds_the_render(tmp_path):
    fake = AffectedCapture(tmp_path / "c", seed=3)
    assert abs(chi2(fake.write(), fake, []) - 1) < NOISE


def test_a_flat_with_another_spectrum_counts(tmp_path):
    """Where the flat's light is stated, the shift of the filters is divided out with that spectrum."""
    fake = AffectedCapture(tmp_path / "c", seed=5, index=1.4, flat_source="even")
    path = fake.write() / "capture.toml"
    shift = [effect("filter-shift", effective_index=1.4)]
    wrong = chi2(path.parent, fake, shift)
    text = path.read_text().replace("[[flat]]\n", '[[flat]]\nradiance = "spectra/all.csv:lens"\n')
    path.write_text(text)
    assert abs(chi2(path.parent, fake, shift) - 1) < NOISE < wrong - 1


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """(fake, calibration, sensing) of a capture without effects."""
    fake = FakeCapture(tmp_path_factory.mktemp("plain"), centres=BANDS)
    calibration = calibrate_capture(load_capture(fake.write()))
    return fake, calibration, sensing(calibration, CAMERA)


def random_image(shape: tuple[int, int]) -> RenderedImage:
    """Three spectra in random proportions, in single precision as renders are."""
    generator = np.random.default_rng(4)
    coefficients = generator.random((2, *shape, 3)).astype(np.float32)
    spectra = 1e-4 * np.stack([GRID / 700, (700 - GRID) / 300 + 0.1, 1 + np.sin(GRID / 20)])
    coverage = np.ones((*shape, 2), np.float32)
    return RenderedImage(coefficients, spectra, GRID, coverage, np.array([0]), ("wall",))


def test_without_effects_it_is_the_render(plain):
    _, calibration, constants = plain
    render = random_image((40, 56))
    expected = render_bands(render, calibration.responses).signal.values
    np.testing.assert_allclose(expected_signal(render, constants, [], CAMERA), expected, rtol=1e-10)
    nulls = [effect(i) for i in ("filter-shift", "filter-leak", "ghost", "crosstalk", "nonlinearity")]
    np.testing.assert_allclose(expected_signal(render, constants, nulls, CAMERA), expected, rtol=1e-10)
    for predicted_response, reference_response in zip(constants.curves.responses(), calibration.responses, strict=True):
        np.testing.assert_allclose(predicted_response.weights, reference_response.weights, rtol=1e-12)
        assert predicted_response.band == reference_response.band


def test_optics_act_on_the_picture_alone(plain):
    """Flat and reference, which fill the field evenly, know nothing of glare, ghost and vignetting."""
    fake, calibration, constants = plain
    expected = render_bands(image(fake), calibration.responses).signal.values
    signal = expected_signal(image(fake), constants, [effect("veiling-glare", fraction=0.1)], CAMERA)
    np.testing.assert_allclose(signal, 0.9 * expected + 0.1 * expected.mean(axis=(1, 2), keepdims=True), rtol=1e-9)
    signal = expected_signal(image(fake), constants, [effect("ghost", fraction=0.1)], CAMERA)
    np.testing.assert_allclose(signal, 0.9 * expected + 0.1 * expected[:, ::-1, ::-1], rtol=1e-9)
    signal = expected_signal(image(fake), constants, [effect("vignetting", edge_loss=0.2)], CAMERA)
    assert (signal / expected)[1, 0, 0] == pytest.approx(0.8)


def test_effects_of_one_stage_act_in_their_order(plain):
    fake, _, constants = plain
    blur, glare = effect("defocus", sigma_px=2.0), effect("vignetting", edge_loss=0.5)
    first, other = (expected_signal(image(fake), constants, e, CAMERA) for e in ([blur, glare], [glare, blur]))
    assert np.abs(first / other - 1).max() > 1e-4


def test_light_given_saves_the_projection_and_changes_nothing(plain):
    """Also with a filter effect, when the light went through it, and for a projection that is a function."""
    fake, _, constants = plain
    for effects in ([effect("smear", fraction=0.1)], [effect("filter-shift", effective_index=1.5)]):
        light = scene_light(image(fake), after_stage(constants.curves, effects, "filter"), CAMERA)
        expected = expected_signal(image(fake), constants, effects, CAMERA)
        np.testing.assert_array_equal(expected_signal(light, constants, effects, CAMERA), expected)
        function = expected_signal(lambda w: image(fake).project(w)[0], constants, effects, CAMERA)
        np.testing.assert_allclose(function, expected, rtol=1e-12)


def test_nine_field_angles_are_as_good_as_every_pixels_own(plain):
    """Against the filter looked up at each pixel's own angle, before the flat is divided out."""
    fake, _, constants = plain
    curves = effect("filter-shift", effective_index=1.3).apply(constants.curves)
    light = scene_light(image(fake), curves, CAMERA)
    shifted = AffectedCapture(fake.folder, index=1.3)
    for index, band in enumerate(fake.bands):
        ratio = light.signal[index] / fake.expected(band)
        truth = shifted.throughput(band, fake.spectrum)
        np.testing.assert_allclose(ratio / ratio[20, 27] * truth[20, 27], truth, rtol=2e-4)
        assert np.ptp(truth) > 0.01


def test_effective_wavelength_is_that_of_the_signal(plain):
    fake, calibration, constants = plain
    light = scene_light(image(fake), constants.curves, CAMERA)
    for band, centre_nm in zip(calibration.responses, light.effective_nm, strict=True):
        density = band.weights * fake.spectrum
        assert centre_nm == pytest.approx(float(GRID @ density / density.sum()), abs=1e-6)


def test_a_change_of_the_reference_rescales_the_prediction(plain):
    """C is one for all bands: exposures alike in all frames but longer by 10% in the reference give 1 / 1.1.

    By the weighted mean of the bands, as C is measured.
    """
    fake, calibration, constants = plain
    seconds = constants.exposure_scene * 10  # reference ten times as long: the offset weighs a tenth there
    longer = replace(constants, exposure_reference=seconds)
    expected = render_bands(image(fake), calibration.responses).signal.values
    signal = expected_signal(image(fake), longer, [effect("shutter-offset", seconds=0.05)], CAMERA)
    weights = 1 / np.array([c.sigma for c in calibration.radiometry.by_band]) ** 2
    changed = np.average(1 + 0.05 / seconds, weights=weights)
    scale = (1 + 0.05 / constants.exposure_scene) / changed
    np.testing.assert_allclose(signal, expected * scale[:, None, None], rtol=1e-9)


def test_levels_of_darks_that_are_subtracted_change_nothing(plain):
    """An offset of the counts, with darks of three other levels for scene, flat and reference."""
    fake, _, constants = plain
    levels = {
        f"dark_{frame}": np.full(3, level) for frame, level in (("scene", 90.0), ("flat", 60.0), ("reference", 40))
    }
    before, after = (
        expected_signal(image(fake), c, [effect("dark-offset", dn=3.0)], CAMERA)
        for c in (constants, replace(constants, **levels))
    )
    np.testing.assert_allclose(after, before, rtol=1e-9)


def test_minutes_come_from_the_manifest(tmp_path):
    """start_s 90 and 4 frames of t s with 1.2 s between: the middle is 90 + 2 t + 1.8 s."""
    fake = AffectedCapture(tmp_path / "c", centres=(450, 550))
    path = fake.write() / "capture.toml"
    path.write_text(path.read_text().replace('id = "f550"', 'id = "f550"\nstart_s = 90.0'))
    minutes = sensing(calibrate_capture(load_capture(path.parent)), CAMERA).minutes
    first, second = fake.exposure.values()
    np.testing.assert_allclose(minutes, [(2 * first + 1.8) / 60, (90 + 2 * second + 1.8) / 60])


def test_captures_without_flats_darks_and_reference_can_be_predicted(tmp_path):
    fake = FakeCapture(tmp_path / "c", centres=BANDS)
    calibration = calibrate_capture(load_capture(fake.write(darks=False, flats=False, references=False)))
    constants = sensing(calibration, CAMERA)
    expected = render_bands(image(fake), calibration.responses).signal.values
    np.testing.assert_allclose(expected_signal(image(fake), constants, [], CAMERA), expected, rtol=1e-9)
    offset = expected_signal(image(fake), constants, [effect("dark-offset", dn=5)], CAMERA)
    nominal = np.stack([calibration.bands.flats[band].response for band in calibration.capture.band_ids])
    np.testing.assert_allclose(offset, expected + 5 / nominal, rtol=1e-9)


def test_missing_tables_and_other_grids_are_refused(tmp_path, plain):
    fake = FakeCapture(tmp_path / "c", centres=BANDS)
    path = fake.write() / "capture.toml"
    path.write_text(path.read_text().replace('transmittance = "spectra/all.csv:f550"\n', ""))
    with pytest.raises(InputError, match=r"band\[1\] \(f550\)\.transmittance"):
        sensing(calibrate_capture(load_capture(path.parent)), CAMERA)
    coarse = replace(image(fake), wavelength_nm=GRID[::10], spectra=fake.spectrum[None, ::10])
    with pytest.raises(ValueError, match="400 to 700"):
        expected_signal(coarse, plain[2], [], CAMERA)
