"""Channels of a colour sensor behind narrow filters: joined by their noise, left out where they see other light."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.capture import chosen_channel_notes
from cboxlab.calibration.colour.joined_channels import BandColumns, joined_channels
from cboxlab.calibration.colour.patches import _relative_signals
from cboxlab.calibration.colour.shading import PatchPixels
from cboxlab.calibration.correction.corrected_bands import _faint_bands
from cboxlab.scenes.spectra import Spectrum

NM = np.arange(380.0, 731.0)
PEAKS_NM = {"R": 600.0, "G": 540.0, "B": 460.0}


def bell(centre, width):
    return Spectrum(NM, np.exp(-(((NM - centre) / width) ** 2)), "zero")


def capture_of(*bands, pattern="RGGB"):
    """Bands (id, filter in nm or None, channel or None); the bands of one filter have the same frames."""
    tables = [
        SimpleNamespace(
            id=name,
            transmittance=None if nm is None else str(nm),
            channel=channel,
            frames=(f"{name if nm is None else nm}.tif",),
        )
        for name, nm, channel in bands
    ]
    camera = SimpleNamespace(quantum_efficiency={letter: letter for letter in PEAKS_NM})
    return SimpleNamespace(
        manifest=SimpleNamespace(band=tables, camera=camera, mosaic=SimpleNamespace(pattern=pattern)),
        band_ids=tuple(table.id for table in tables),
        band=lambda name: next(table for table in tables if table.id == name),
        light=lambda name: bell(float(name), 10.0),
        quantum_efficiency=lambda letter: bell(PEAKS_NM[letter], 50.0),
    )


def test_channels_of_one_filter_are_weighted_by_their_squared_signals():
    """Noise of 1 DN at 33 and 50 DN, 0.03 and 0.02: one column of sigma 0.0166. A third channel sees a leak."""
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.05, 0.9, 500)
    sigma = np.array([0.03, 0.02, 0.01, 0.05])
    columns = truth[:, None] + sigma * rng.standard_normal((500, 4))
    columns[:, 2] += 0.1 * rng.uniform(-1, 1, 500)
    capture = capture_of(("500b", 500, "B"), ("500g", 500, "G"), ("500r", 500, "R"), ("w", None, "G"))
    spread = np.broadcast_to(sigma, columns.shape)
    joined = joined_channels(capture, BandColumns(capture.band_ids, columns, spread, np.eye(4), np.ones(4), 1 / sigma))
    assert joined.bands == ("500g", "w")
    expected = (sigma[0] ** -2 + sigma[1] ** -2) ** -0.5
    np.testing.assert_allclose(joined.sigma[:, 0], expected)
    assert np.std(joined.reflectance[:, 0] - truth) == pytest.approx(expected, rel=0.13)  # standard error 3 %
    np.testing.assert_allclose(joined.filters[0], [4 / 13, 9 / 13, 0, 0])
    np.testing.assert_array_equal(joined.reflectance[:, 1], columns[:, 3])
    assert "500r differ by more and are left out" in joined.notes[0]


def test_a_dim_channel_with_stray_light_has_little_weight():
    """5 DN of stray light on 200 and on 40 DN: errors of 0.025 and 0.12 become one of 0.028."""
    capture = capture_of(("500g", 500, "G"), ("500b", 500, "B"))
    truth, level = np.linspace(0.05, 0.9, 24), np.array([200.0, 40.0])
    columns = (truth[:, None] + 5 / level) / (1 + 5 / level)
    spread = np.full(columns.shape, 0.1)
    joined = joined_channels(capture, BandColumns(capture.band_ids, columns, spread, np.eye(2), np.ones(2), level))
    error = np.abs(joined.reflectance[:, 0] - truth).max()
    single = np.abs(columns - truth[:, None]).max(axis=0)
    assert single[0] < error < 0.15 * single[1] + 0.85 * single[0] < single.mean()


@pytest.mark.filterwarnings("error")
def test_a_channel_in_which_white_has_no_light_says_nothing_of_a_patch():
    """Its signals have no ratio to white: 500r is left out of 500g's column, and 700 stays a column alone."""
    capture = capture_of(("500g", 500, "G"), ("500r", 500, "R"), ("700", None, "R"))
    rows, columns = np.indices((5, 5)).reshape(2, -1).astype(float)
    ratios, spreads, levels = zip(
        *(
            _relative_signals([PatchPixels(columns, rows, np.full(25, dn), 1.0) for dn in signals], None, 0)
            for signals in ((200.0, 80.0), (0.0, 3.0), (-1.0, 3.0))
        ),
        strict=True,
    )
    measured = BandColumns(
        capture.band_ids, np.stack(ratios, 1), np.stack(spreads, 1), np.eye(3), np.ones(3), np.array(levels)
    )
    joined = joined_channels(capture, measured)
    np.testing.assert_allclose(joined.reflectance, [[1.0, np.nan], [0.4, np.nan]])
    np.testing.assert_allclose(joined.sigma, [[1 / 1000, np.nan], [np.hypot(1, 0.4) / 1000, np.nan]])
    assert "500r differ by more and are left out" in joined.notes[0]


def test_bands_without_a_stated_channel_stay_as_they_are_and_further_channels_are_named():
    """The filter at 500 nm lies between blue and green: both see it, and one alone is chosen as before."""
    capture = capture_of(("500", 500, None), ("600", 600, None))
    columns = BandColumns(capture.band_ids, np.ones((3, 2)), np.ones((3, 2)), np.eye(2), np.ones(2), np.ones(2))
    joined = joined_channels(capture, columns)
    assert joined.bands == columns.bands and not joined.notes
    notes = chosen_channel_notes(capture, {"500": "G", "600": "R"})
    assert "500 B" in notes[1] and "600" in notes[0] and "R" not in notes[1]


def test_a_channel_whose_flat_is_noise_is_faint_where_another_one_of_its_frames_is_not():
    capture = capture_of(("500b", 500, "B"), ("500r", 500, "R"), ("600b", 600, "B"), ("one", None, "G"))
    relative = {"500b": 0.02, "500r": 0.3, "600b": 0.3, "one": 0.3}
    flats = {
        name: SimpleNamespace(mean_dn=100.0, relative_variance=np.full((2, 2), value**2))
        for name, value in relative.items()
    }
    channels = {"500b": "B", "500r": "R", "600b": "B", "one": "G"}
    assert _faint_bands(capture, channels, flats, dict.fromkeys(flats)) == {"500r"}
