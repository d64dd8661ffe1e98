"""Channels that see little through a narrow filter do not decide the scale."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.correction.corrected_bands import _faint_bands

CHANNELS = {"r": "R", "g": "G", "b": "B"}


def faint(levels, noise, frames=("0", "0", "0")):
    """Bands left out, by the mean counts and the relative noise of their flats."""
    bands = [SimpleNamespace(id=band, frames=(name,)) for band, name in zip(CHANNELS, frames, strict=True)]
    by_id = {band.id: band for band in bands}
    manifest = SimpleNamespace(band=tuple(bands), mosaic=SimpleNamespace(pattern="RGGB"))
    capture = SimpleNamespace(manifest=manifest, band_ids=tuple(CHANNELS), band=by_id.__getitem__)
    flats = {
        band: SimpleNamespace(mean_dn=level, relative_variance=np.full((4, 4), spread**2))
        for band, level, spread in zip(CHANNELS, levels, noise, strict=True)
    }
    return _faint_bands(capture, CHANNELS, flats, dict.fromkeys(CHANNELS))


@pytest.mark.parametrize(
    ("levels", "noise", "expected"),
    [
        ((2000.0, 900.0, 400.0), (0.01, 0.01, 0.02), set()),
        ((2000.0, 900.0, 60.0), (0.01, 0.01, 0.05), {"b"}),  # 1 % of crosstalk brings 20 of its 60 counts
        ((2000.0, 900.0, 400.0), (0.01, 0.01, 0.2), {"b"}),
        ((60.0, 50.0, 40.0), (0.05, 0.05, 0.05), set()),
    ],
)
def test_a_channel_of_stray_light_or_noise_is_left_out(levels, noise, expected):
    assert faint(levels, noise) == expected


def test_channels_of_other_frames_are_no_measure():
    assert faint((2000.0, 1500.0, 60.0), (0.01, 0.01, 0.05), ("0", "0", "1")) == set()
