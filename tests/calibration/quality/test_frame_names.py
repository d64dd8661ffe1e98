"""Exposures in the names of frames, and in their files."""

from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.calibration.quality.content import check_names, check_stated_exposures
from helpers.files.frame_files import write_fits


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


@pytest.mark.parametrize(
    ("exposures_s", "where"),
    [((250.0, 500.0), ["band[0].exposure_s and 1 others"]), ((0.26, 5.0), ["band[1].exposure_s"]), ((0.25, 0.5), [])],
)
def test_an_exposure_that_its_file_contradicts_is_named(tmp_path, exposures_s, where):
    stacks = []
    for k, seconds in enumerate(exposures_s):
        write_fits(tmp_path / f"{k}.fits", np.full((12, 16), 7, np.uint16), EXPTIME=0.25 * (1 + k))
        stacks.append(SimpleNamespace(paths=(f"{k}.fits",), key=f"band[{k}]", exposure_s=seconds))
    mistakes = list(check_stated_exposures(SimpleNamespace(folder=tmp_path), stacks))
    assert [mistake.where for mistake in mistakes] == where
    assert all(("in ms" in mistake.why) == (len(stacks) == 2 and exposures_s[0] == 250) for mistake in mistakes)
