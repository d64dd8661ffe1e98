"""Explanations by light between surfaces take most time here: larger patches, and no solution is computed twice."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def large_patches():
    """Patches of 120 mm in place of 69, whose light under each change stays for later tests, in these tests alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cboxlab.validation.compare_renders.regress.variants._PATCHES_PER_DIAGONAL", 8)
        patch.setattr("cboxlab.rendering.perturbation.patch_transport._MAX_RESULTS", 10_000)
        yield
