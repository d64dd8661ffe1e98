"""Flaws of a base that effects may imitate."""

from __future__ import annotations

import numpy as np
import pytest
from cboxlab.validation.diagnose.base_flaws import Flaw
from cboxlab.validation.diagnose.judgement import BaseFlaws


@pytest.mark.parametrize(
    ("kinds", "imitated"), [((), False), (("pixels",), False), (("pixels", "creases"), True), (("field",), True)]
)
def test_effects_imitate_every_flaw_but_single_pixels(kinds, imitated):
    flaws = BaseFlaws(tuple(Flaw(kind, 0.1, 1.0, 0.8) for kind in kinds), True, np.zeros(3))
    assert flaws.imitated is imitated
