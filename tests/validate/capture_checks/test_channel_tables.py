"""A colour channel whose table is displaced is named with its size; effects of the sensor and sound tables are not.

The channels see a reference source and four paints under a lamp of another colour. Their light is integrated from
the true tables, and compared with that of the stated ones.
"""

import re

import numpy as np
import pytest
from cboxlab.validation.capture_checks import channel_tables as checks

NM = np.arange(400.0, 701.0)
PEAKS = {"R": (600.0, 40.0), "G": (540.0, 45.0), "B": (460.0, 35.0)}
LETTERS = np.array([*PEAKS])
FRAMES = [("frames/0.tif",)] * 3
BOX = [
    np.full(NM.size, 0.7),
    0.05 + 0.6 / (1 + np.exp((600 - NM) / 12)),
    0.05 + 0.3 * np.exp(-(((NM - 530) / 40) ** 2)),
]
GREYS = [np.full(NM.size, 0.7), np.full(NM.size, 0.3)]


def planck(kelvin):
    return NM**-5.0 / np.expm1(1.4388e7 / (NM * kelvin))


def light_seen(shifts, paints):
    """(quantity, band) light of the source and of the paints, with each channel's table displaced."""
    curves = [np.exp(-0.5 * ((NM - p - s) / w) ** 2) * NM for (p, w), s in zip(PEAKS.values(), shifts, strict=True)]
    lights = [planck(2856.0), *(planck(2700.0) * paint for paint in paints)]
    return np.array([[np.sum(curve * light) for curve in curves] for light in lights])


def suspicions(wrong=None, nm=0.0, change=lambda signal: signal, paints=BOX, seed=1):
    """Suspicions where the stated table of one channel lies nm from the true one, with noise of 0.5 %."""
    errors = np.where(LETTERS == wrong, nm, 0.0)
    signal = light_seen(np.zeros(3), paints)
    signal = change(2000 * signal / signal.max(axis=1, keepdims=True))
    noise = 0.005 * np.random.default_rng(seed).standard_normal(signal.shape)
    values = np.stack([np.log(signal / light_seen(errors + shift, paints)) + noise for shift in checks.SHIFTS_NM])
    sigma = np.full(signal.shape, 0.015)
    as_stated = checks._Ratios(values[checks.SHIFTS_NM == 0], sigma, signal)
    level = checks._best_level(as_stated.values[0], sigma, LETTERS)
    shift = checks._best_shift(checks._Ratios(values, sigma, signal), LETTERS)
    return [*checks._suspicions(as_stated, level, shift, checks._effects(as_stated, LETTERS, FRAMES, ["RG", "GB"]))]


@pytest.mark.parametrize("letter", [*PEAKS])
@pytest.mark.parametrize("nm", [10, -10])
def test_a_displaced_table_is_named_with_its_size(letter, nm):
    (suspicion,) = suspicions(letter, nm)
    assert suspicion.what.startswith(f"the sensitivity of {letter} is displaced")
    assert float(re.search(r"by ([-+]\d+) nm", suspicion.what)[1]) == pytest.approx(nm, abs=3)


def test_grey_surfaces_leave_open_whether_level_or_wavelengths_are_wrong():
    (suspicion,) = suspicions("G", 10, paints=GREYS)
    assert "does not suit" in suspicion.what and "these frames do not decide" in suspicion.why
    assert "level is wrong, or it is displaced by about +" in suspicion.why


def crosstalk(signal):
    """Two of four neighbours of a green pixel are red and two blue; those of red and blue are green, or each other."""
    mixed = signal @ np.array([[0.0, 0.5, 0.0], [1.0, 0.0, 1.0], [0.0, 0.5, 0.0]])
    return signal + 0.05 * (mixed - signal)


EFFECTS = {
    "nothing": lambda signal: signal,
    "counts that darks lack": lambda signal: signal + 40,
    "charge of neighbours": crosstalk,
    "counts that bend": lambda signal: signal * (1 + 0.1 * signal / 4095),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_on_all_channels_are_no_wrong_table(name):
    """Nor where references alone are there."""
    for paints in (BOX, []):
        assert not [s for seed in range(10) for s in suspicions(change=EFFECTS[name], paints=paints, seed=seed)]
