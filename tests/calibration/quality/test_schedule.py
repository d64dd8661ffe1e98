"""Times that exposures take, and signals through a filter that is not where its table says, by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.quality.filters import _change_of_constant
from cboxlab.calibration.quality.frame_checks.schedule import check_schedule
from cboxlab.calibration.quality.frame_checks.stacks import Stack
from cboxlab.scenes import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM


def stack(band, start_s, exposure_s, repeats):
    paths = tuple(f"frames/{band}-{index}.tif" for index in range(repeats))
    return Stack("band", f"band ({band})", band, exposure_s, start_s, paths, np.zeros((repeats, 2, 2), np.uint16), None)


@pytest.mark.parametrize(("start_s", "overlaps"), [(27.3, True), (27.5, False)])
def test_a_table_may_not_begin_before_the_one_before_it_ends(start_s, overlaps):
    """Three exposures of 10 s end 30 s after their begin; a clock may be wrong by 2 s and a fiftieth of that."""
    stacks = [stack("first", 100.0, 10.0, 3), stack("second", 100.0 + start_s, 1.0, 1)]
    suspicions = [each.what for each in check_schedule(stacks)]
    assert any("contradict each other" in text for text in suspicions) is overlaps


def test_a_shift_of_a_filter_changes_its_signal_as_the_light_does():
    """Light like wavelength squared through a narrow triangle: the centre counts, and the square of its width a bit."""
    curves = {
        "light": Spectrum(WAVELENGTH_NM, WAVELENGTH_NM**1.0),
        "filter": Spectrum(np.array([500.0, 510.0, 520.0]), np.array([0.0, 0.8, 0.0])),
        "flat": Spectrum(WAVELENGTH_NM, np.full(WAVELENGTH_NM.shape, 0.5)),
    }
    manifest = SimpleNamespace(
        camera=SimpleNamespace(quantum_efficiency="flat"), lens=SimpleNamespace(transmittance="flat")
    )
    capture = SimpleNamespace(
        manifest=manifest, references=lambda _: [SimpleNamespace(radiance="light")], light=curves.__getitem__
    )
    for shift_nm in (-30.0, 40.0):
        change = _change_of_constant(capture, SimpleNamespace(id="f510", transmittance="filter"), shift_nm)
        # mean of the square over a triangle of half width w: centre squared + w^2 / 6
        signals = [(510 + s) ** 2 + 100 / 6 for s in (shift_nm, 0.0)]
        assert change == pytest.approx(np.log(signals[0] / signals[1]), abs=2e-5)
