"""What all tests share: where the measurements lie, and a strict but patient hypothesis."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# derandomize: the same examples on every run, so that a failure can be repeated
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measurements and published data beside the repository."""
    folder = Path(__file__).resolve().parents[2] / "shared"
    if not folder.is_dir():
        pytest.skip("needs the folder 'shared' beside the repository (captures, measurements); it is absent")
    return folder
