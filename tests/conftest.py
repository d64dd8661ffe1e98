"""What all tests share: where the measurements lie, and a strict but patient hypothesis."""

import gc
import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

# before NumPy: matrix products' waiting threads would take the cores from ray tracing
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from cboxlab.utils.files import temporary_folder
from helpers.captures.large_patches import large_patches as with_large_patches
from helpers.places import ROOT, SHARED
from hypothesis import HealthCheck, settings

# with Python's 700 new objects, searches for unreachable ones take a tenth of the time of quick tests
gc.set_threshold(50_000, *gc.get_threshold()[1:])

# derandomize: the same examples on every run, so that a failure can be repeated
settings.register_profile("repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")

#: Where these tests lie.
TESTS = ROOT / "tests"


#: Modules that take longest alone, half a minute or more of processor time. They run first, so that no worker ends long
#: before the other; the rest follows in its order.
SLOWEST = (
    "validate/compare/test_pipeline.py",
    "validate/diagnose/test_diagnosis.py",
    "validate/compare/test_mosaic_captures.py",
    "validate/compare_renders/regress/test_naming.py",
    "validate/compare_renders/regress/test_unlisted_changes.py",
    "validate/app/studio/test_studio.py",
    "validate/app/commands/test_environment.py",
    "validate/dataset/test_data_set.py",
    "validate/study/test_study.py",
    "calibration/geometry/test_geometry.py",
    "calibration/geometry/test_targets.py",
    "render/integrators/test_integrators.py",
    "render/integrators/test_precision.py",
    "test_api.py",
    "test_manual.py",
    "test_benchmarks.py",
    "validate/diagnose/test_external_render.py",
    "validate/predict/test_traced_picture.py",
    "validate/compare/test_missing_light.py",
    "render/effects/test_transport_references.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the slowest modules first."""
    ranks = {TESTS / name: number for number, name in enumerate(SLOWEST)}
    assert all(path.is_file() for path in ranks), "a module of SLOWEST is absent"
    items.sort(key=lambda item: ranks.get(item.path, len(ranks)))


#: Ends at the end of the run.
_UNTIL_END = ExitStack()


def pytest_configure(config: pytest.Config) -> None:
    """One cache of pictures for all processes of a run, empty at first; the user's own is left alone.

    The folder is removed at the end, or by the next run if this one is killed. Dask's files are in it, too.
    """
    if not hasattr(config, "workerinput"):
        folder = str(_UNTIL_END.enter_context(temporary_folder()))
        os.environ |= {"XDG_CACHE_HOME": folder, "DASK_TEMPORARY_DIRECTORY": folder}


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        _UNTIL_END.close()


def pytest_collection_finish() -> None:
    """Modules and tests stay to the end: the collector need not visit them again and again."""
    gc.freeze()


@pytest.fixture(scope="module")
def large_patches() -> Iterator[None]:
    """The light of tests that compare pictures of one integrator with each other, or none."""
    with with_large_patches():
        yield


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measurements and published data next to the repository."""
    if not SHARED.is_dir():
        pytest.skip("needs the folder 'shared' next to the repository (captures, measurements); it is absent")
    return SHARED
