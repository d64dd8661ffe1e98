"""Short kernel calls: no result changes, and a cancelled computation ends within one."""

import numpy as np
import pytest
from cboxlab.rendering.device import calls
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.perturbation import build_patch_transport
from cboxlab.rendering.radiosity import build_patched_scene, gather, solve_light
from cboxlab.rendering.radiosity.direct_cells import build_direct_cells
from cboxlab.rendering.radiosity.lamp import build_lamp_samplers
from cboxlab.rendering.visibility.tracer import build_tracer
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils.progress import Cancelled, ProgressReporter, checkpoint, stoppable, stops_promptly
from helpers.scenes.boxes import BANDS

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")


class Counted(ProgressReporter):
    """Receiver that counts the checkpoints, and cancels itself at one of them."""

    def __init__(self, last=None):
        super().__init__()
        self.number, self.last = 0, last

    def check(self):
        self.number += 1
        if self.number == self.last:
            self.cancel()
        super().check()


@pytest.fixture(autouse=True)
def tiny_calls(monkeypatch):
    monkeypatch.setattr(calls, "_PROMPT_SAMPLES", 2**10)
    monkeypatch.setattr(calls, "_FEWEST_LANES", 37)


def traced():
    """Every kernel that traces by lanes, on the published box through a camera of 12 x 12 pixels."""
    scene, camera = cornell_box(), cornell_camera(12)
    light = solve_light(scene, BANDS, patch_edge_mm=250.0, patch_samples=32)
    tracer = build_tracer(scene)
    cells = build_direct_cells(tracer, build_lamp_samplers(tracer), 150.0, 16, 3)
    transport = build_patch_transport(build_patched_scene(scene, 250.0, 32, 1), camera, 16, 1)
    return {
        "form factors": light.exchange.form_factors,
        "direct light of patches": light.exchange.direct,
        "direct light of cells": np.array(cells[0].planes),
        "gather": transport.gather.toarray(),
        "direct light of pixels": transport.direct,
        "picture": gather(light, camera, 16, 3).coefficients,
    }


def test_short_calls_change_no_bit():
    complete, reporter = traced(), Counted()
    with stoppable(reporter, promptly=True):
        assert stops_promptly()
        parts = traced()
    assert reporter.number > 30
    for name, expected in complete.items():
        assert parts[name].dtype == expected.dtype, name
        np.testing.assert_array_equal(parts[name], expected, name)


def test_a_cancelled_computation_ends_at_its_next_checkpoint():
    reporter = Counted(last=5)
    with pytest.raises(Cancelled), stoppable(reporter, promptly=True):
        traced()
    assert reporter.number == 5
    checkpoint()  # outside, nothing is cancelled
    assert not stops_promptly()
