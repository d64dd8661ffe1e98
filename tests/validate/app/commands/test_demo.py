"""The bundled capture is what it is said to be, and its effect stands out. (The demo: diagnose/test_diagnosis.py.)"""

import json
import re
import tomllib

import pytest
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.result.calibrate import calibrate_capture
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.model.model_file import Model
from cboxlab.rendering.synthetic.photographer import CaptureSettings
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.compare.pipeline import validate_capture
from cboxlab.validation.diagnose.evidence import first_significant
from cboxlab.validation.diagnose.hypotheses import hypotheses
from cboxlab.validation.diagnose.linearised_fit import linearised_fit
from cboxlab.validation.diagnose.search import signature
from cboxlab.validation.diagnose.selection import best_singles
from cboxlab.validation.synthetic.blind import open_seal
from cboxlab.validation.synthetic.model_capture import perturbed_camera, write_model_capture

README = DEMO_CAPTURE.parent / "README.md"


def test_the_bundled_capture_is_the_one_that_was_sealed():
    """The seal covers every file; its hash stands in the README."""
    answer = open_seal(DEMO_CAPTURE)
    assert answer.effects == (("veiling-glare", {"fraction": 0.004}),)
    content = json.loads((DEMO_CAPTURE / "sealed.json").read_text())["sha256_of_salt_and_answer"]
    assert content in README.read_text()


def test_the_bundled_capture_is_small():
    size = sum(path.stat().st_size for path in DEMO_CAPTURE.rglob("*") if path.is_file())
    assert size < 1.2e6
    assert load_capture(DEMO_CAPTURE).shape == (128, 128)


@pytest.mark.usefixtures("large_patches")
def test_the_stated_command_makes_the_bundled_capture(tmp_path):
    """A rough render of the same: files that do not hang on it are equal, the signals are so on average.

    The render's 1% per pixel leaves 0.01% in the mean of 16,000 pixels; 0.2% allow for changes of the
    renderer. (With 2%, a band's exposure would hang on the noise.)
    """
    seed, noise, fraction = (
        float(re.search(pattern, README.read_text())[1])
        for pattern in (r"--seed (\d+)", r"--noise ([\d.]+)%", r"fraction=([\d.]+)")
    )
    assert noise == 0.05
    model = Model().with_effect(apply_checked("lamp-reflectance", {"reflectance": 0.0}, "test"))
    model = model.with_effect(apply_checked("veiling-glare", {"fraction": fraction}, "test"))
    camera = perturbed_camera(128, int(seed))
    write_model_capture(tmp_path / "again", model, camera, CaptureSettings(), int(seed), relative_error=0.01)
    manifests = [tomllib.loads((folder / "capture.toml").read_text()) for folder in (tmp_path / "again", DEMO_CAPTURE)]
    assert manifests[0] == manifests[1]
    for name in (
        "points.csv",
        *(f"spectra/{n}.csv" for n in ("camera", "filters", "lamp", "sphere")),
    ):
        assert (tmp_path / "again" / name).read_bytes() == (DEMO_CAPTURE / name).read_bytes(), name
    again, bundled = (calibrate_capture(load_capture(folder)).images for folder in (tmp_path / "again", DEMO_CAPTURE))
    used = (again["mask"].values == 0) & (bundled["mask"].values == 0)
    for band in range(again.sizes["band"]):
        means = [images["signal"].values[band][used[band]].mean() for images in (again, bundled)]
        assert means[0] == pytest.approx(means[1], rel=2e-3)


@pytest.mark.usefixtures("large_patches")
@pytest.mark.filterwarnings("ignore")
def test_the_bundled_captures_glare_is_named_and_sized():
    """Among effects of filters, optics and counts, from a rougher render than a user's: 0.4 % of all light."""
    validation = validate_capture(load_capture(DEMO_CAPTURE), Model(render=RenderSettings(noise=1.0)))
    fit = linearised_fit(validation.prepared, validation.rendered, ())
    model, residual = fit.model, fit.model.residual
    assert model.chi2 / model.count > 1.3
    signatures = [
        signature(fit.predictor, (), model.used, hypothesis)
        for hypothesis in hypotheses(fit.predictor.sensing.curves.bands, fit.predictor.scene, RenderSettings())
        if hypothesis.effect.stage in ("filter", "optics", "counts")
    ]
    singles = best_singles(fit.problem(()), [each for each in signatures if each is not None], residual, 3)
    significant = first_significant(singles, residual, model, residual, residual)
    assert significant.hypothesis.effect.id == "veiling-glare"
    assert significant.numbers["fraction"] == pytest.approx(0.004, rel=0.05)
