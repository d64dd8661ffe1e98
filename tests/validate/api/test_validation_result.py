"""What a validation's result shows: tables, maps with wavelengths, figures."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from cboxlab.validation.api import ValidationResult
from helpers.fakes.box import SURFACES, FakeBox, fake_weights


def fake_validation():
    """A comparison with a surface that no pixel sees."""
    comparison = FakeBox(size=48).compare(seed=7, surface_names=(*SURFACES, "hidden"))
    capture = SimpleNamespace(folder=Path("a-capture"))
    calibration = SimpleNamespace(suspicions=(), capture=capture)
    prepared = SimpleNamespace(calibration=calibration, responses=fake_weights()[1])
    return SimpleNamespace(comparison=comparison, prepared=prepared)


def test_a_surface_without_pixels_has_dashes():
    (table,) = ValidationResult(fake_validation()).tables()
    rows = {row[0]: row[1:] for row in table.rows}
    assert set(rows["hidden"]) == {"–"}
    assert re.fullmatch(r"[+-]\d+\.\d\d", rows["floor"][0])
    assert all(len(row) == len(table.columns) for row in table.rows)
    assert "<td>hidden</td>" in table._repr_html_()


def test_maps_have_the_bands_in_the_order_of_wavelength():
    validation = fake_validation()
    responses = validation.prepared.responses[::-1]
    shape = (len(responses), 4, 5)
    measured = np.arange(np.prod(shape), dtype=float).reshape(shape)
    used = np.ones(shape, bool)
    used[0, 0, 0] = False
    rendered = SimpleNamespace(
        fit=SimpleNamespace(lamp_scale=2.0), signal=measured / 4, variance=np.zeros(shape), used=used
    )
    calibration = SimpleNamespace(predicted_variance=lambda signal: np.full_like(signal, 4.0))
    prepared = SimpleNamespace(responses=responses, measured=measured, calibration=calibration)
    result = ValidationResult(SimpleNamespace(prepared=prepared, rendered=rendered))
    maps = result.maps
    assert np.all(np.diff(maps["wavelength"]) > 0) and maps["residual"].attrs["units"] == "1"
    assert np.isnan(maps["residual"].values[-1, 0, 0]) and np.isfinite(maps["residual"].values[0]).all()
    last = {name: maps[name].sel(band=responses[0].band).values for name in ("measured", "rendered", "difference")}
    np.testing.assert_array_equal(last["measured"], measured[0])
    np.testing.assert_array_equal(last["rendered"], measured[0] / 2)
    np.testing.assert_allclose(maps["residual"].values, maps["difference"].values / 2)
    figure = result.plot()
    assert len(figure.axes) == len(responses) + 1 and "nm" in figure.axes[0].get_title()
