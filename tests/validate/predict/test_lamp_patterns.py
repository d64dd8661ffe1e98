"""Light of a lamp between traced patterns, as a mixture of theirs."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.scenes import load_scene
from cboxlab.validation.predict.predictor import _TRACED_EXPONENTS, _traced_patterns

#: Places across half of the lamp, and angles from its normal.
_X, _ANGLE = np.meshgrid(np.linspace(0, 1, 5), np.radians([0, 20, 45, 70, 85]))


def _radiance(lamp):
    """Radiance of a lamp over its mean, by the formula of its docstring; along z it is that of the middle."""
    e = lamp.edge_ratio
    return (e + (1 - e) * (1 - _X**2)) / (e + (1 - e) * 4 / 9) * np.cos(_ANGLE) ** lamp.exponent


def _box(edge_ratio, exponent):
    return load_scene("cornell-box").with_lamps(
        lambda lamp: replace(lamp, edge_ratio=edge_ratio, exponent=exponent),
    )


@pytest.mark.parametrize("edge_ratio", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("exponent", [0.003, 0.024, 0.07, 0.31, 1.1, 5.0, 20.0])
def test_a_mixture_of_traced_patterns_is_the_lamps_pattern(edge_ratio, exponent):
    """Within a fortieth of the change by the exponent."""
    scene = _box(edge_ratio, exponent)
    mixture = sum(share * _radiance(traced.lamp) for share, traced in _traced_patterns(scene))
    plain = _radiance(_box(edge_ratio, 0.0).lamp)
    change = np.abs(_radiance(scene.lamp) - plain)
    assert np.all(np.abs(mixture - _radiance(scene.lamp)) <= change / 40 + 1e-12)


def test_small_exponents_share_three_transports():
    """The fit of a lamp's direction traces no rays for every trial."""
    traced = {each.lamp.exponent for n in (0.01, 0.02, 0.034, 0.05) for _, each in _traced_patterns(_box(1.0, n))}
    assert traced == set(_TRACED_EXPONENTS[:3])
