"""The bundled capture is what it is said to be, and the demo tells its story with it."""

import json
import re

import numpy as np
import pytest
from cboxlab.calibration.calibrate import calibrate
from cboxlab.calibration.capture import load_capture
from cboxlab.render.laboratory import CaptureSettings
from cboxlab.render.raw_files import read_raw
from cboxlab.validate.blind import open_seal
from cboxlab.validate.demo import DEMO_CAPTURE, run_demo
from cboxlab.validate.effects import apply_checked
from cboxlab.validate.model import Model, RenderSettings
from cboxlab.validate.synthetic import perturbed_camera, write_model_capture
from PIL import Image

README = DEMO_CAPTURE.parent / "README.md"


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """Folder and terminal text of a demo with a rougher render than a user's, to save time."""
    from cboxlab.validate import console

    folder = tmp_path_factory.mktemp("demo") / "report"
    with console.console.capture() as text:
        run_demo(folder, Model(render=RenderSettings(noise=2.0)))
    return folder, text.get()


def test_the_bundled_capture_is_the_one_that_was_sealed():
    """The seal covers every file; its hash stands in the README."""
    answer = open_seal(DEMO_CAPTURE)
    assert answer.effects == (("veiling-glare", {"fraction": 0.004}),)
    stated = json.loads((DEMO_CAPTURE / "sealed.json").read_text())["sha256_of_salt_and_answer"]
    assert stated in README.read_text()


def test_the_bundled_capture_is_small():
    size = sum(path.stat().st_size for path in DEMO_CAPTURE.rglob("*") if path.is_file())
    assert size < 1.2e6
    assert load_capture(DEMO_CAPTURE).shape == (128, 128)


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
    model = Model().with_effect(apply_checked("veiling-glare", {"fraction": fraction}, "test"))
    camera = perturbed_camera(128, int(seed))
    write_model_capture(tmp_path / "again", model, camera, CaptureSettings(), int(seed), 0.01)
    for name in (
        "capture.toml",
        "points.csv",
        *(f"spectra/{n}.csv" for n in ("camera", "filters", "lamp", "sphere")),
    ):
        assert (tmp_path / "again" / name).read_bytes() == (DEMO_CAPTURE / name).read_bytes(), name
    again, bundled = (calibrate(load_capture(folder)).images for folder in (tmp_path / "again", DEMO_CAPTURE))
    used = (again["mask"].values == 0) & (bundled["mask"].values == 0)
    for band in range(again.sizes["band"]):
        means = [images["signal"].values[band][used[band]].mean() for images in (again, bundled)]
        assert means[0] == pytest.approx(means[1], rel=2e-3)


def test_the_demo_leaves_a_report_and_a_raw_frame(told):
    folder, _ = told
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["chi2_per_dof"] > 2  # the hidden glare
    assert metrics["camera"]["reprojection_rms_px"] < 1.15 * 0.15
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "<html" in page and "The same light in another camera: Kodak DCS-200" in page
    counts, notes = read_raw(folder / "raw.tif")
    assert counts.shape == (128, 128) and counts.dtype == np.uint16
    assert notes["camera"] == "Kodak DCS-200"
    preview = np.asarray(Image.open(folder / "raw.png"))
    assert preview.shape == (128, 128, 3)
    # The red wall stands on the left, the green one on the right.
    left, right = preview[40:90, 4:12].mean(axis=(0, 1)), preview[40:90, -12:-4].mean(axis=(0, 1))
    assert left[0] > 1.5 * left[1] and right[1] > 1.2 * right[0]


def test_the_demo_tells_its_story_in_order(told):
    _, text = told
    steps = [text.index(f"{number}. ") for number in range(1, 6)]
    assert steps == sorted(steps)
    for words in (
        "reprojection rms",
        "rendered through it",
        "per degree of freedom",
        "of the excess sits",
        "DCS-200",
    ):
        assert words in text
    assert "Noise does not explain the difference." in text
