"""What all tests share: where the measurements lie, and a strict but patient hypothesis."""

import os
from pathlib import Path

# before NumPy: matrix products' waiting threads would take the cores from ray tracing
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from helpers.places import SHARED
from hypothesis import HealthCheck, settings

# derandomize: the same examples on every run, so that a failure can be repeated
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measurements and published data beside the repository."""
    if not SHARED.is_dir():
        pytest.skip("needs the folder 'shared' beside the repository (captures, measurements); it is absent")
    return SHARED
