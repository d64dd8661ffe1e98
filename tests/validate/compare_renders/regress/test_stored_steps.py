"""Steps in which a picture was stored: what they do to the baseline's values."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.validation.compare_renders.regress.causes.stored_steps import CAUSE

BASELINE = np.random.default_rng(2).uniform(0.05, 3.0, (40, 50, 3))
LEVELS = np.linspace(0, 3, 200)


def half_cut_off(values):
    """The largest half float that is not above each value."""
    nearest = values.astype(np.float16)
    return np.where(nearest > values, np.nextafter(nearest, np.float16(0)), nearest).astype(float)


def trials(candidate, *others, baseline=BASELINE):
    """Changes by their parameters, of one file or more a side with the same light."""
    files = (np.stack([baseline, *others[: len(others) // 2]]), np.stack([candidate, *others[len(others) // 2 :]]))
    pictures = SimpleNamespace(baseline=files[0].mean(axis=0), candidate=files[1].mean(axis=0), files=files)
    return {tuple(trial.parameters(np.zeros(0)).items()): trial.fixed for trial in CAUSE.trials(pictures)}


@pytest.mark.parametrize("cut_off", [True, False])
def test_half_floats_lower_values_by_half_a_step_on_average_where_they_are_cut_off(cut_off):
    candidate = half_cut_off(BASELINE) if cut_off else BASELINE.astype(np.float16).astype(float)
    name = (("steps", "half float"), ("cut off", True)) if cut_off else (("steps", "half float"),)
    change = candidate - BASELINE
    of_steps = change.mean() / np.sqrt(np.mean(change**2) / change.size)
    assert abs(of_steps) > 50 if cut_off else abs(of_steps) < 4
    expected = trials(candidate)[name]
    assert abs(np.mean(change - expected)) < 4 * np.std(change - expected) / np.sqrt(change.size)


@pytest.mark.parametrize("cut_off", [True, False])
def test_few_levels_put_each_value_of_each_file_on_one(cut_off):
    """The mean of two files is on no level."""
    other = np.random.default_rng(3).uniform(0.05, 3.0, BASELINE.shape)
    stored = [LEVELS[(np.floor if cut_off else np.rint)(p / LEVELS[1]).astype(int)] for p in (BASELINE, other)]
    name = (("steps", "levels"), ("levels", np.unique(stored).size), *((("cut off", True),) if cut_off else ()))
    both = np.stack([BASELINE, other])
    inside = ((both > LEVELS[4]) & (both < LEVELS[-2])).all(axis=0)  # where every level occurs
    change = trials(stored[0], other, stored[1])[name]
    np.testing.assert_allclose(change[inside], (np.stack(stored) - both).mean(axis=0)[inside], atol=1e-9)


def test_steps_of_both_sides_and_few_values_are_no_change():
    both = BASELINE.astype(np.float16).astype(float)
    assert trials(both, baseline=both) == {} and trials(BASELINE) == {}
    few = LEVELS[np.rint(BASELINE[:4, :50] / LEVELS[1]).astype(int)]
    assert trials(few, baseline=BASELINE[:4, :50]) == {}
