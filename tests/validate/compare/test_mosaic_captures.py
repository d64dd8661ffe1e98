"""A published box behind a mosaic, nothing hidden: noise explains the difference in every channel.

One frame stands in three bands. Each sees the pixels of its channel only: compared with all pixels, red and blue ones
would be taken for green (reduced chi-square 838).
"""

import base64
import zlib

import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.calibration.instrument import Mask
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.precision import render_to_precision
from cboxlab.rendering.model.model_file import Model
from cboxlab.scenes import cornell_box
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.validation.compare.pipeline import validate_capture
from cboxlab.validation.diagnose import stepwise
from cboxlab.validation.diagnose.diagnosis import diagnose_validation
from cboxlab.validation.report.viewer.payload import picture_data
from cboxlab.validation.report.write import write_validation
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photographed_scene
from helpers.captures.mosaic_capture import write_mosaic_capture

pytestmark = pytest.mark.usefixtures("large_patches")

SIZE, SEED = 64, 11
#: Stages of effects that channels may show.
OF_CAMERA = ("camera", "filter", "optics", "counts")
#: Effects of scene and transport tried in the larger cell: a coat, light between surfaces, the lamp's direction. Each
#: other one costs half a second, and acts before the mosaic as these do.
BEFORE_CAMERA = ("gloss", "haze", "lamp-directional")
PATTERNS = {"Bayer": "RGGB", "X-Trans": "GGRGGB GGBGGR BRGRBG GGBGGR GGRGGB RBGBRG"}


@pytest.fixture(scope="module")
def box():
    model = Model(scene=cornell_box(), render=RenderSettings(seed=SEED))
    scene, camera = photographed_scene(model), perturbed_camera(SIZE, SEED)
    image = render_to_precision(RenderJob(scene, camera, WAVELENGTH_NM, seed=SEED), 1.5e-3)
    return model, scene, camera, image


@pytest.fixture(scope="module", params=PATTERNS.values(), ids=PATTERNS)
def validated(request, box, tmp_path_factory):
    model, scene, camera, image = box
    folder = tmp_path_factory.mktemp("mosaic") / "capture"
    folder, constant = write_mosaic_capture(folder, request.param, image, scene, camera, SEED)
    return request.param, validate_capture(load_capture(folder), model), constant


def test_nothing_is_suspected(validated):
    _, result, _ = validated
    calibration = result.prepared.calibration
    assert not calibration.suspicions, [s.what for s in calibration.suspicions]
    assert calibration.channels == {"r": "R", "g": "G", "b": "B"}
    assert not any("no channel of the mosaic is stated" in note for note in calibration.notes)
    assert any("a cell of" in note for note in calibration.notes)


def test_noise_explains_every_channel(validated):
    _, result, _ = validated
    c = result.comparison
    assert 0.9 < c.chi2.per_dof < 1.1
    used = np.isfinite(c.maps["residual_over_sigma"].values)
    measured, rendered = (np.where(used, c.maps[name].values, 0.0) for name in ("measured", "rendered"))
    for index, row in enumerate(c.by_band.values()):
        assert 0.85 < row.chi2.per_dof < 1.15
        assert measured[index].sum() / rendered[index].sum() == pytest.approx(1.0, abs=3e-3)


def test_the_constant_of_the_sensor_is_the_true_one(validated):
    _, result, constant = validated
    radiometry = result.prepared.calibration.radiometry
    for band_constant in radiometry.by_band:
        assert band_constant.constant == pytest.approx(constant, rel=3e-3)


def test_every_pixel_belongs_to_one_band(validated):
    _, result, _ = validated
    images = result.prepared.calibration.images
    other = images["mask"].values & Mask.OTHER_CHANNEL > 0
    assert np.all(np.count_nonzero(~other, axis=0) == 1)
    assert np.isnan(result.comparison.maps["residual_over_sigma"].values[other]).all()
    assert result.comparison.chi2.count <= SIZE**2
    assert "other_channel" not in result.comparison.masked


def test_colours_are_those_of_cells_and_noise_explains_them(validated):
    pattern, result, _ = validated
    c = result.comparison
    rows = pattern.split(" ") if " " in pattern else [pattern[:2], pattern[2:]]
    height, width = len(rows), len(rows[0])
    cell = c.maps["xyz_measured"].values[:height, :width]
    assert np.ptp(cell, axis=(0, 1)).max() == 0
    assert c.colour["delta_e_ab"].mean == pytest.approx(c.colour_noise["delta_e_ab"].mean, rel=0.15)
    assert abs(c.luminance.mean) < 0.003
    xyz = result.prepared.calibration.xyz()
    np.testing.assert_allclose(np.moveaxis(xyz["xyz"].values, 0, -1)[:height, :width], cell, rtol=1e-6)


def test_the_report_and_the_diagnosis_say_what_holds(validated, tmp_path, monkeypatch):
    """Effects of camera and filters are tried on both cells, a few of scene and transport on the larger one."""
    pattern, result, _ = validated
    every, others = stepwise.hypotheses, BEFORE_CAMERA if pattern == PATTERNS["X-Trans"] else ()
    monkeypatch.setattr(
        stepwise,
        "hypotheses",
        lambda *a: [h for h in every(*a) if h.effect.stage in OF_CAMERA or h.effect.id in others],
    )
    diagnosis = diagnose_validation(result)
    assert diagnosis.selected == () and diagnosis.adequate
    write_validation(result, tmp_path, diagnosis)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "a cell of" in report
    data = picture_data(result.comparison)
    mask = zlib.decompress(base64.b64decode(data["mask"]["data"]))
    lacking = np.frombuffer(mask, np.uint8) & Mask.OTHER_CHANNEL > 0
    assert lacking.mean() < 0.05  # cells whose red, green or blue pixels are all saturated
