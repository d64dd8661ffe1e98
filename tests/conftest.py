"""What all tests share: where the measurements lie, and a strict but patient hypothesis."""

import gc
import os
import shutil
import tempfile
from pathlib import Path

# before NumPy: matrix products' waiting threads would take the cores from ray tracing
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from helpers.places import SHARED
from hypothesis import HealthCheck, settings

# derandomize: the same examples on every run, so that a failure can be repeated
settings.register_profile("repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")


def pytest_configure(config: pytest.Config) -> None:
    """One cache of pictures for all processes of a run, empty at first; the user's own is left alone."""
    if not hasattr(config, "workerinput"):
        os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="cboxlab-tests-")


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ["XDG_CACHE_HOME"], ignore_errors=True)


def pytest_collection_finish() -> None:
    """Modules and tests stay to the end: the collector need not visit them again and again."""
    gc.freeze()


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measurements and published data next to the repository."""
    if not SHARED.is_dir():
        pytest.skip("needs the folder 'shared' next to the repository (captures, measurements); it is absent")
    return SHARED
