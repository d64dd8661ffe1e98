"""The verification's own parts: an independent path to the same counts, and the real frames it predicts."""

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.sensor.cameras import load_camera
from cboxlab.rendering.sensor.simulation import noiseless_frame
from oracles import verification_chart as chart
from oracles import verification_frames as frames

#: Standard errors allowed: one false alarm in 1.7 million.
SIGMAS = 5.0


@pytest.mark.parametrize("name", ["dcs200", "dcs420"])
def test_expected_counts_agree_with_an_independent_path_at_full_resolution(name):
    """4000 draws of each patch and channel by the other path: their mean within five standard errors.

    Rounding shifts the mean of counts whose noise is small by less than 0.01 DN.
    """
    independent, camera = chart.IndependentCamera.read(name), load_camera(name)
    light = chart.chart_light(independent)
    radiance = np.repeat(np.repeat(light[:, None], 2, axis=0), 2, axis=1)
    cube = xr.Dataset({"radiance": (("y", "x", "wavelength"), radiance)}, coords={"wavelength": chart.NM})
    draws = 4000
    for seconds in (1 / 30, 1 / 125):
        frame = noiseless_frame(cube, camera, seconds)
        expected = np.stack([frame[::2, 0], frame[::2, 1], frame[1::2, 1]], axis=-1)
        entry = independent.record(light, seconds, draws, np.random.default_rng(1))
        # spread of a count is about 1 DN at most; F bends its mean by a hundredth
        sigma = np.sqrt((1 / 12 + 0.75 + (expected - 10) / 300) / draws)
        np.testing.assert_array_less(np.abs(entry - expected), SIGMAS * sigma + 0.02)


def test_real_frames_are_predicted(shared):
    """Own channels, not clipped: 5.3% on average, as good as the paper's Table I; nearly all of it repeats."""
    cells = frames.predict(shared / "real" / "seven-band-colorchecker", frames.Assumptions())
    assert cells.band.size == 16 * 7 * 7 * 4
    strong = cells.selected_by(cells.strong & ~cells.clipped)
    statistics = frames.statistics(strong)
    assert statistics["count"] > 600
    assert statistics["mean_percent"] < 6.0 and statistics["mean"] < 2.3
    common, rest = frames.split(cells)
    # what changes with the exposure is small: counts are proportional to light and time
    assert rest < 0.03 < common
