"""What a validation's result shows: tables, maps with wavelengths, figures."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.utils.errors import InputError
from cboxlab.validation.api import ValidationResult
from cboxlab.validation.report import FIGURES, named_bands
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


@pytest.mark.parametrize("what", FIGURES)
def test_every_figure_has_units_and_can_be_saved(what, tmp_path):
    validation = fake_validation()
    figure = ValidationResult(validation).figure(what)
    figure.draw_without_rendering()
    labels, size = figure.get_tightbbox(), figure.get_size_inches()
    assert labels.x0 >= 0 and labels.y0 >= 0 and (labels.max <= size).all()  # no label is cut
    figure.savefig(tmp_path / "figure.pdf")
    texts = [axis.get_xlabel() + axis.get_ylabel() for axis in figure.axes]
    assert any(unit in text for text in texts for unit in ("σ", "%", "DN", "ΔE"))
    used = {image.get_cmap().name for axis in figure.axes for image in axis.images}
    assert used <= {"RdBu_r", "cividis"}  # can be distinguished with every colour vision


def test_the_figure_of_the_difference_holds_the_maps_by_wavelength():
    validation = fake_validation()
    figure = ValidationResult(validation).plot()
    maps = validation.comparison.maps["residual_over_sigma"].values
    with_images = [axis for axis in figure.axes if axis.images]
    names = [axis.get_title(loc="left") for axis in with_images]
    assert names == sorted(names) and all(name.endswith(" nm") for name in names) and len(names) == len(maps)
    order = [index for index, _ in named_bands(validation.comparison.bands, validation.prepared.responses)]
    for axis, index in zip(with_images, order, strict=True):
        np.testing.assert_array_equal(np.ma.filled(axis.images[0].get_array(), np.nan), maps[index])
    with pytest.raises(InputError, match="one of difference, relative"):
        ValidationResult(validation).figure("diference")
