"""An event in one frame of a band against an effect that acts in all frames."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.diagnose.explain import flicker_of, frame_amplitudes, lead_of_frames
from cboxlab.validation.diagnose.unexplained import frames_note, lead_of_single_frames
from helpers.captures.small_excess import SIGNAL
from scipy.ndimage import gaussian_filter

#: Chi2 that one number must gain.
PRICE = 4.6

NOISE_DN = 4.0


def _lead(changes, effect, frames=2, flicker=0.0):
    """Lead of events over an effect: changes (band, frame) of each frame's signal, effect (band,) of the mean, DN."""
    draw = np.random.default_rng(7)
    each = []
    for band, (signal, of_frames) in enumerate(zip(SIGNAL, changes, strict=True)):
        levels = 1 + flicker * draw.standard_normal((frames, 1, 1))
        noise = NOISE_DN * draw.standard_normal((frames, *signal.shape))
        pictures = levels * (signal + np.array(of_frames)) + noise
        weight = np.full(signal.shape, np.sqrt(frames) / NOISE_DN)
        each.append(frame_amplitudes(f"b{band}", pictures, effect[band], signal, weight, flicker))
    return lead_of_frames(each, PRICE)


def _in_band(change, band=1):
    """(band, y, x) a change in one band."""
    return np.where((np.arange(len(SIGNAL)) == band)[:, None, None], change, 0.0)


def _by_frame(change, factors):
    """(band, frame, y, x) a change (band, y, x) times a factor for each frame."""
    return change[:, None] * np.array(factors)[:, None, None]


def test_one_dim_frame_of_two_is_no_gain_of_the_band():
    """The mean of a frame that is 2.6 % darker and of a sound one is 1.3 % darker, as by a filter."""
    gain = _in_band(-0.013 * SIGNAL)
    lead = _lead(_by_frame(gain, (0, 2)), gain)
    assert lead.lead == pytest.approx(PRICE + 2 * np.log(5), abs=0.1)
    assert "frame 2 of 2 of band b1" in lead.form
    assert "band b1" in lead.advice.experiment


def test_a_gain_that_all_frames_have_is_no_event():
    gain = _in_band(-0.013 * SIGNAL)
    assert _lead(_by_frame(gain, (1, 1)), gain) is None


@pytest.mark.parametrize("flicker", [0.002, 0.005])
def test_a_lamp_that_flickers_makes_no_event_of_a_gain(flicker):
    """All bands flicker: frames of the band differ by no more than those of the others."""
    gain = _in_band(-0.013 * SIGNAL)
    lead = _lead(_by_frame(gain, (1, 1)), gain, flicker=flicker)
    assert lead is None or lead.lead < 0


def test_the_flicker_is_an_error_of_a_gain_in_each_frame():
    frames = np.stack([SIGNAL[1], SIGNAL[1]]) + NOISE_DN * np.random.default_rng(2).standard_normal(
        (2, *SIGNAL[1].shape)
    )
    weight = np.full(SIGNAL[1].shape, 1 / NOISE_DN)
    quiet, flickering = (frame_amplitudes("b1", frames, 0.02 * SIGNAL[1], SIGNAL[1], weight, f) for f in (0.0, 0.003))
    np.testing.assert_allclose(flickering.sigma**2, quiet.sigma**2 + 0.15**2)


def _blurred():
    return gaussian_filter(SIGNAL, (0, 0.7, 0.7)) - SIGNAL


def test_a_blur_of_all_bands_stays_although_one_frame_shook():
    """An event in one frame of one band does not stand for what all other frames show."""
    blur = _blurred()
    changes = _by_frame(blur, (1, 1))
    changes[2, 1] *= 2.5
    assert _lead(changes, blur).lead < -20


def test_one_frame_that_shook_is_no_blur_of_its_band():
    blur = _in_band(_blurred())
    assert _lead(_by_frame(blur, (0, 0, 3)), blur, frames=3).lead > 0


def test_levels_of_frames_do_not_move_a_blur():
    """A lamp that flickers by 1 % changes no amplitude of a blur."""
    blur = _blurred()
    assert _lead(_by_frame(blur, (1, 1)), blur, flicker=0.01) is None


def test_an_event_in_one_band_is_no_flicker():
    draw = np.random.default_rng(3)
    levels = 0.001 * draw.standard_normal((6, 1)) * np.array([1, -1])
    levels[2] = 0.013, -0.013
    assert flicker_of(levels) < 0.003
    assert flicker_of(np.full((3, 1), np.nan)) == 0


@pytest.mark.parametrize("frame", [0, 1])
def test_frames_of_a_capture_are_compared_behind_their_flat(frame):
    """Counts of a frame are divided by the flat before they are compared; the change is one of corrected signals."""
    draw, flat = np.random.default_rng(5), np.broadcast_to(np.linspace(0.4, 1.0, SIGNAL.shape[2]), SIGNAL.shape)
    stain = np.where(SIGNAL[0] > np.median(SIGNAL[0]), -0.01 * SIGNAL[0], 0.0)
    counts = {f"b{band}": np.repeat((flat[band] * SIGNAL[band])[None], 2, axis=0) for band in range(len(SIGNAL))}
    counts["b2"][frame] += 2 * flat[2] * stain
    counts = {band: 100 + pictures + draw.standard_normal(pictures.shape) for band, pictures in counts.items()}
    capture = SimpleNamespace(
        band_ids=tuple(counts),
        band=lambda name: SimpleNamespace(name=name, frames=("1", "2")),
        frames=lambda table: counts[table.name],
        saturation_dn=1e6,
    )
    linearised = SimpleNamespace(
        scale=1.0,
        rendered=SimpleNamespace(signal=SIGNAL),
        predictor=SimpleNamespace(sensing=SimpleNamespace(flat=flat)),
        model=SimpleNamespace(used=np.ones(SIGNAL.shape, bool), sigma=(1 / flat).ravel()),
    )
    lead = lead_of_single_frames(linearised, _in_band(stain, 2), PRICE, capture)
    assert lead.lead > 0
    assert f"frame {frame + 1} of 2 of band b2" in lead.form
    explanation = SimpleNamespace(change=_in_band(stain, 2))
    assert "Photograph band b2 again" in frames_note(linearised, explanation, capture)[0]
    assert frames_note(linearised, SimpleNamespace(change=_in_band(stain, 1)), capture) == ()
