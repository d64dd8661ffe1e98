"""When a family of levels beats the effects of the catalogue: both pay for what they may choose."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validate.diagnose.unexplained import beats
from cboxlab.validate.effects import catalogue


@pytest.mark.parametrize("numbers", [0, 1, 3])
@pytest.mark.parametrize("effects", [1, 2])
def test_levels_must_gain_more_than_effects_less_what_those_paid(numbers, effects):
    """Effects explain 1000, and a hundredth more by errors of their shapes. They paid 4.6 for each number, and twice
    the logarithm of the catalogue's length for each choice; the family must be ahead by 9.2."""
    model = SimpleNamespace(chi2=5000.0, count=2000, residual=np.zeros(3), whiten=lambda change: np.zeros(3))
    chosen = [SimpleNamespace(hypothesis=SimpleNamespace(free=(None,) * numbers))] * effects
    paid = effects * (4.6 * numbers + 2 * np.log(len(catalogue())))
    for own, wins in ((1010 - paid + 9.2 - 0.1, False), (1010 - paid + 9.2 + 0.1, True)):
        explanation = SimpleNamespace(
            family="time-order", levels=True, change=None, gain=50.0, evidence=50.0 + own
        )
        assert beats(explanation, model, chosen, 4000.0) == wins
