"""Tails and quantiles are those of SciPy's distributions, to the last bit."""

import subprocess
import sys

import numpy as np
import pytest
from cboxlab.utils import distributions as ours
from numpy.testing import assert_array_equal
from scipy import stats

VALUES = np.array([0.0, 1e-9, 0.3, 1.0, 2.5, 9.2, 60.0, 800.0])
TAILS = np.array([1e-12, 1e-6, 0.001, 0.05, 0.3, 0.5, 0.9, 0.999])
DEGREES = np.array([[1], [2], [7], [55.5], [1e6]])


@pytest.mark.parametrize(
    ("function", "reference", "values"),
    [
        (lambda x: ours.chi2_tail(x, DEGREES), lambda x: stats.chi2.sf(x, DEGREES), VALUES),
        (lambda p: ours.chi2_quantile(p, DEGREES), lambda p: stats.chi2.isf(p, DEGREES), TAILS),
        (lambda x: ours.student_tail(x, DEGREES), lambda x: stats.t.sf(x, DEGREES), [*-VALUES, *VALUES]),
        (lambda p: ours.student_quantile(p, DEGREES), lambda p: stats.t.isf(p, DEGREES), TAILS),
        (lambda x: ours.fisher_tail(x, 3, DEGREES), lambda x: stats.f.sf(x, 3, DEGREES), VALUES),
        (lambda p: ours.fisher_quantile(p, 2, DEGREES), lambda p: stats.f.isf(p, 2, DEGREES), TAILS),
        (ours.normal_quantile, stats.norm.isf, TAILS),
        (ours.normal_density, stats.norm.pdf, [*-VALUES, *VALUES]),
    ],
)
def test_as_scipy(function, reference, values):
    assert_array_equal(function(np.asarray(values)), reference(np.asarray(values)))


@pytest.mark.parametrize(
    ("imports", "slow"),
    [
        (
            "cboxlab.validation.compare_renders.regress.inputs",
            "scipy.stats scipy.signal scipy.interpolate matplotlib mitsuba trimesh colour dask",
        ),
        (
            "cboxlab.rendering.model, cboxlab.validation.report",
            "scipy.stats scipy.signal scipy.interpolate colour dask",
        ),
        ("cboxlab.calibration.result", "scipy.stats scipy.signal colour dask"),
    ],
)
def test_commands_do_without_slow_imports(imports, slow):
    """A command that does not need these takes less time than their import."""
    command = f"import sys, {imports}\nprint(*({{*{slow.split()}}} & {{*sys.modules}}))"
    run = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


def test_robust_sigma_is_that_of_normal_deviations_and_outliers_hardly_change_it():
    deviations = stats.norm(0, 3).ppf((np.arange(2001) + 0.5) / 2001)
    assert ours.robust_sigma(deviations) == pytest.approx(3, rel=1e-3)
    assert ours.robust_sigma(np.append(deviations, np.full(20, 1e6))) == pytest.approx(3, rel=0.03)
