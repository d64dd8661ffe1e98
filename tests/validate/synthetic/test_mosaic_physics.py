"""Effects behind a mosaic: the raw frames that are simulated are those that the prediction expects.

The simulation interleaves the channels before the counts' effects act on each frame. The prediction does so for all
bands at once. Crosstalk is compared besides with its formula, applied to the interleaved picture by hand.
"""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.calibration.capture import channel_mask
from cboxlab.calibration.instrument.band_response import ResponseFactors
from cboxlab.rendering.chain import (
    Interleaving,
    Sensing,
    UnseenChannel,
    after_stage,
    expected_counts,
    expected_signal,
    over_field,
    scene_light,
)
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.synthetic import CaptureSettings, Frame, behind_mosaic, sphere_spectrum, unit_factors
from cboxlab.rendering.synthetic.photographer import pixel_maps
from cboxlab.scenes.wavelength_grid import FILTER_GRID, WAVELENGTH_NM
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photographed_light

SIZE = 24
CAMERA = perturbed_camera(SIZE, 3)
PATTERNS = {
    "RGGB": "RGGB",
    "GBRG": "GBRG",
    "X-Trans": "GGRGGB GGBGGR BRGRBG GGBGGR GGRGGB RBGBRG",
    "RGBW": "RGBW",
    "RCCB": "RCCB",
    "4 x 4": "ABCD EFGH IJKL MNOP",
    "5 x 5": "ABCDE FGHIJ KLMNO PQRST UVWXY",
}
#: s, of the scene, the flat and the reference.
EXPOSURES = {"band": 2.0, "flat": 0.7, "reference": 1.1}
EFFECTS = {
    "crosstalk": {"fraction": 0.1},
    "smear": {"fraction": 0.05},
    "nonlinearity": {"b": 0.05},
    "shutter-offset": {"seconds": 0.05},
    "dark-offset": {"dn": 20.0},
    "defocus": {"sigma_px": 1.0},
    "veiling-glare": {"fraction": 0.05},
    "ghost": {"fraction": 0.05},
}


def picture(uniform=False):
    """Three spectra in random proportions."""
    generator = np.random.default_rng(5)
    coefficients = np.full((2, SIZE, SIZE, 3), 0.007) if uniform else generator.uniform(1e-3, 0.02, (2, SIZE, SIZE, 3))
    spectra = 1e-3 * np.stack([np.full(301, 0.7), np.linspace(0.1, 0.8, 301), np.linspace(0.6, 0.1, 301)])
    coverage = np.ones((SIZE, SIZE, 2), np.float32)
    return RenderedImage(coefficients, spectra, WAVELENGTH_NM, coverage, np.array([0]), ("wall",))


def flat_of(settings):
    """(y, x) response, 1 on average over each channel: a flat field determines no more."""
    flat = pixel_maps(CAMERA, settings, np.random.default_rng(1)).flat
    for channel in settings.mosaic.dyes:
        mask = channel_mask(settings.mosaic.pattern, flat.shape, channel)
        flat[mask] /= flat[mask].mean()
    return flat


def sensing_of(settings, flat, frame_bands=None):
    """What a calibration without any error knows of a simulated sensor behind one filter."""
    unit = unit_factors(settings, SIZE, grid=FILTER_GRID)
    bands = range(len(unit.bands)) if frame_bands is None else frame_bands
    pick = list(bands)
    pattern, channels = settings.mosaic.pattern, [settings.bands[i].channel for i in pick]
    pixels = np.stack([channel_mask(pattern, (SIZE, SIZE), channel) for channel in channels])
    factors = ResponseFactors(
        tuple(unit.bands[i] for i in pick),
        unit.grid,
        unit.transmittance[pick],
        unit.rest[pick],
        unit.factor[pick] * EXPOSURES["band"],
    )
    count = len(pick)
    light = photographed_light(picture(), [], None, CAMERA, settings)[1][pick] * flat
    level = np.array([plane[mask].mean() for plane, mask in zip(light, pixels, strict=True)])
    current = settings.dark_current_e_s / settings.gain_e_per_dn
    dark = {kind: np.full(count, settings.bias_dn + current * t) for kind, t in EXPOSURES.items()}
    seconds = {kind: np.full(count, t) for kind, t in EXPOSURES.items()}
    sphere = np.tile(sphere_spectrum().at(WAVELENGTH_NM), (count, 1))
    return Sensing(
        over_field(factors, CAMERA), sphere, sphere, light / level[:, None, None], pixels, pixels,
        level * EXPOSURES["flat"], unit.factor[pick] * EXPOSURES["reference"], np.ones(count),
        dark["band"], dark["flat"], dark["reference"], seconds["band"], seconds["flat"], seconds["reference"],
        np.zeros(count), float(settings.full_scale_dn), Interleaving(pixels, (tuple(range(count)),)),
    )  # fmt: skip


def simulated(settings, flat, effects, image):
    """(y, x) DN of the scene's frame and of the reference's, without noise."""
    signals, field, hooks = photographed_light(image, effects, None, CAMERA, settings)
    frames = {}
    for kind, planes in (("band", signals), ("reference", field)):
        raw = np.zeros((SIZE, SIZE))
        for band, plane in zip(settings.bands, planes, strict=True):
            mask = channel_mask(settings.mosaic.pattern, raw.shape, band.channel)
            raw[mask] = plane[mask]
        frame = Frame(kind, "grey", EXPOSURES[kind], 0, 0.0)
        dark = settings.bias_dn + settings.dark_current_e_s / settings.gain_e_per_dn * EXPOSURES[kind]
        frames[kind] = hooks.counts(frame, hooks.light(frame, raw * flat * EXPOSURES[kind]) + dark)
    return frames


@pytest.mark.parametrize("pattern", PATTERNS.values(), ids=PATTERNS)
@pytest.mark.parametrize("name", EFFECTS)
def test_the_raw_frames_are_those_expected(pattern, name):
    settings = behind_mosaic(CaptureSettings(), pattern)
    flat = flat_of(settings)
    effects = [apply_checked(name, EFFECTS[name], "test")]
    sensing = sensing_of(settings, flat)
    light = scene_light(picture(), after_stage(sensing.curves, effects, "filter"), CAMERA)
    expected = expected_counts(light, sensing, effects, CAMERA)
    frames_made = simulated(settings, flat, effects, picture())
    for band, mask in enumerate(sensing.mosaic.pixels):
        np.testing.assert_allclose(frames_made["band"][mask], expected.scene[band][mask], rtol=1e-9)
        np.testing.assert_allclose(frames_made["reference"][mask], expected.reference[band][mask], rtol=1e-9)


@pytest.mark.parametrize("pattern", ["RGGB", PATTERNS["X-Trans"]], ids=["RGGB", "X-Trans"])
def test_crosstalk_goes_from_colour_to_colour(pattern):
    """A pixel keeps 1 - f of its charge and receives f / 4 of each neighbour's, whatever their channels are."""
    settings = behind_mosaic(CaptureSettings(prnu=0.0, vignetting=0.0), pattern)
    flat, f = np.ones((SIZE, SIZE)), 0.08
    sensing = replace(sensing_of(settings, flat), reference_weight=np.zeros(3))
    light = scene_light(picture(), sensing.curves, CAMERA)
    raw = sensing.mosaic.light(light.signal)[0]
    around = np.pad(raw, 1, mode="edge")
    shared = (1 - f) * raw + f / 4 * (around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:])
    assert shared.sum() == pytest.approx(raw.sum(), rel=1e-12)
    signal = expected_signal(picture(), sensing, [apply_checked("crosstalk", {"fraction": f}, "test")], CAMERA)
    for band, mask in enumerate(sensing.mosaic.pixels):
        # the flat is divided out channel by channel: where a channel's neighbours are alike it changes the level only
        inner = np.zeros_like(mask)
        inner[1:-1, 1:-1] = mask[1:-1, 1:-1]
        ratio = signal[band][inner] / shared[inner]
        assert ratio.std() / ratio.mean() < (0.03 if " " in pattern else 1e-3)
    means = [light.signal[band][mask].mean() for band, mask in enumerate(sensing.mosaic.pixels)]
    change = [signal[band][mask].mean() / means[band] for band, mask in enumerate(sensing.mosaic.pixels)]
    assert change[int(np.argmin(means))] > 1.01 > 1.0 > change[int(np.argmax(means))]


def test_a_channel_in_no_band_shows_the_band_s_light_times_their_ratio():
    """For light of one spectrum a frame with green alone in a band is predicted as the frame with all channels."""
    settings = behind_mosaic(CaptureSettings(), "RGGB")
    flat = flat_of(settings)
    all_channels, green = sensing_of(settings, flat), sensing_of(settings, flat, [1])
    effects = [apply_checked("crosstalk", {"fraction": 0.1}, "test")]
    light = scene_light(picture(uniform=True), all_channels.curves, CAMERA).signal.mean(axis=(1, 2))
    unseen = tuple(UnseenChannel(0, all_channels.mosaic.pixels[band], light[band] / light[1]) for band in (0, 2))
    green = replace(green, mosaic=Interleaving(green.mosaic.pixels, ((0,),), unseen))
    pixels = all_channels.mosaic.pixels[1]
    alone, together = (
        expected_counts(scene_light(picture(uniform=True), s.curves, CAMERA), s, effects, CAMERA).scene[i][pixels]
        for s, i in ((green, 0), (all_channels, 1))
    )
    np.testing.assert_allclose(alone, together, rtol=1e-3)
