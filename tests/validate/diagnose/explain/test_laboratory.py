"""Words for the laboratory: everyday causes have the sign of what remains."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace

import pytest
from cboxlab.validation.diagnose.explain import Registration, advice, appearance


def without_family(**shares):
    values = {field.name: 0.0 for field in fields(Registration)}
    return SimpleNamespace(family_record=None, registration=Registration(**{**values, **shares}))


@pytest.mark.parametrize(("in_bands", "fixed"), [(0.7, "single bands"), (0.3, "surfaces")])
def test_levels_of_bands_are_not_of_surfaces(in_bands, fixed):
    """Levels of each surface contain levels of each band: the simpler one is named where it explains as much."""
    assert fixed in advice(without_family(on_surfaces=0.8, in_bands=in_bands)).fixed


@pytest.mark.parametrize("where", ["in_places", "on_surfaces"])
def test_dirt_brings_no_light_and_a_reflex_takes_none(where):
    many, missing = (without_family(**{where: 0.7}, missing=part, by_signal=1.0) for part in (0.05, 0.95))
    assert "too many" in appearance(many.registration)
    assert "missing" in appearance(missing.registration)
    assert not any("dirt on" in cause or "shades" in cause for cause in advice(many).causes)
    assert not any("reflex" in cause or "light from" in cause for cause in advice(missing).causes)


@pytest.mark.parametrize(
    ("shares", "end"),
    [
        ((0.3, 0.9, 0.5), "the same number in all bands"),
        ((0.9, 0.3, 0.5), "in proportion to the signal"),
        ((0.5, 0.3, 0.501), "either in proportion to the exposure time or in proportion to the signal"),
        ((0.1, 0.19, 0.05), "differently in each band"),
    ],
)
def test_a_residual_grows_with_what_explains_most_of_it(shares, end):
    """The two largest where they explain as much, and none below a fifth."""
    signal, count, exposure = shares
    registration = without_family(by_signal=signal, by_count=count, by_exposure=exposure, missing=1.0).registration
    assert appearance(registration) == f"counts are missing, {end}"
