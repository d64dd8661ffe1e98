"""Explanations by light between surfaces take most time here: larger patches make a solution four times as fast."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def large_patches():
    """Patches of 96 mm in place of 69, in these tests alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cboxlab.validation.compare_renders.regress.variants._PATCHES_PER_DIAGONAL", 10)
        yield
