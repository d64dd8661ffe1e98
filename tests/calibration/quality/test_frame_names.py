"""Exposures in the names of frames."""

from types import SimpleNamespace

import pytest
from cboxlab.calibration.quality.content import check_names


@pytest.mark.parametrize(
    ("name", "exposure_s", "count"),
    [
        ("dark-8.6e-06s-0.tif", 8.6e-6, 0),
        ("dark-8.6e-06s-0.tif", 6.0, 1),
        ("dark-1e+06s-0.tif", 1e6, 0),
        ("dark-0.25s-1.tif", 0.25, 0),
        ("dark_250ms_1.tif", 2.5, 1),
        ("f550-3.tif", 2.5, 0),
    ],
)
def test_an_exposure_in_a_name_is_read_with_its_power_of_ten(name, exposure_s, count):
    capture = SimpleNamespace(band_ids=("f550",), manifest=SimpleNamespace(band=()))
    stack = SimpleNamespace(paths=(f"frames/{name}",), band=None, kind="dark", key="dark[0]", exposure_s=exposure_s)
    assert len(list(check_names(capture, [stack]))) == count


@pytest.mark.parametrize(
    ("factors", "count"), [([1000.0] * 4, 1), ([1.0] * 3 + [1000.0], 1), ([0.5, 3.0, 1.0, 2.0], 3)]
)
def test_exposures_off_by_one_factor_are_one_mistake(factors, count):
    capture = SimpleNamespace(band_ids=("f550",), manifest=SimpleNamespace(band=()))
    stacks = [
        SimpleNamespace(
            paths=(f"frames/dark-{seconds}s.tif",),
            band=None,
            kind="dark",
            key="dark",
            exposure_s=factor * seconds,
        )
        for factor, seconds in zip(factors, (0.5, 1.0, 2.0, 4.0), strict=True)
    ]
    mistakes = list(check_names(capture, stacks))
    assert len(mistakes) == count
    assert ("all exposures are 1000 times" in mistakes[0].what) == (factors == [1000.0] * 4)
