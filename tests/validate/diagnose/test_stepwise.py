"""Which effects are tried beside the picture's own errors."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validate.diagnose.stepwise import _LEAST_BESIDE_ERRORS, beside_errors


@pytest.mark.parametrize("size", [0.01, 300.0])
@pytest.mark.parametrize(("part", "enough"), [(0.9, False), (1.1, True)])
def test_a_part_of_the_square_of_the_change_must_be_left(size, part, enough):
    """However large a step's change is: of two numbers' changes together the least part, a tenth less and more."""
    changes = size * np.random.default_rng(1).standard_normal((2, 50))
    plain = SimpleNamespace(whiten_used=lambda change: change)
    left = np.sqrt(part * _LEAST_BESIDE_ERRORS)
    counting = SimpleNamespace(whiten_used=lambda change: left * change)
    assert beside_errors(SimpleNamespace(changes=changes), plain, counting) is enough
    assert not beside_errors(SimpleNamespace(changes=None), plain, counting)
