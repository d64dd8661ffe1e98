"""docs/api.md, run from top to bottom as a reader would: every block, on a small capture without any effect.

The capture has 32 pixels a side and a rough render. Diagnosis tries three effects of the catalogue alone, since each
costs seconds; tests/validate/diagnose tries them all.
"""

import json
import re

import cboxlab
import numpy as np
import pytest
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.validation.api import Result
from cboxlab.validation.diagnose import stepwise
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture
from helpers.places import ROOT

PAGE = ROOT / "docs" / "api.md"
EFFECTS = ("veiling-glare", "ghost", "lamp-drift")

pytestmark = pytest.mark.usefixtures("large_patches")


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    """The names that the page's code leaves, and the folder it ran in."""
    folder = tmp_path_factory.mktemp("api")
    write_model_capture(folder / "capture", Model(), perturbed_camera(32, 3), CaptureSettings(), 3, relative_error=0.05)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 8
    names_by_module: dict = {}
    hypotheses = stepwise.hypotheses
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(stepwise, "hypotheses", lambda *a: [h for h in hypotheses(*a) if h.effect.id in EFFECTS])
        exec("\n".join(blocks), names_by_module)
        yield {**names_by_module, "folder": folder}


RESULTS = ("calibration", "validation", "diagnosis", "study", "cube", "raw")


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_prints_becomes_a_dict_and_files(name, names, tmp_path):
    result = names[name]
    assert isinstance(result, Result)
    lines = str(result).splitlines()
    assert 1 <= len(lines) <= 12 and all(lines) and "object at 0x" not in str(result)
    content = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert content == result.to_dict()
    written = result.write(tmp_path / "new" / name)
    assert written and all(path.exists() and tmp_path in path.parents for path in written)


@pytest.mark.parametrize(
    ("name", "file"), [("validation", "validation/metrics.json"), ("diagnosis", "diagnosis/diagnosis.json")]
)
def test_the_dict_is_the_files_content(name, file, names):
    written = json.loads((names["folder"] / file).read_text())
    assert names[name].to_dict() == written


def test_the_calibrations_dict_is_its_file(names, tmp_path):
    path = names["calibration"].write(tmp_path)[0]
    assert path.name == "calibration.json"
    assert json.loads(path.read_text()) == names["calibration"].to_dict()


def test_a_raw_frame_repeats_by_its_seed(names):
    again = cboxlab.simulate(names["cube"].cube, "dcs200", exposure_s=0.004, seed=1)
    other = cboxlab.simulate(names["folder"] / "cube.exr", "dcs200", exposure_s=0.004, seed=2)
    assert np.array_equal(again.counts, names["raw"].counts)
    assert not np.array_equal(other.counts, names["raw"].counts)


def test_a_box_changed_in_memory_is_validated_plotted_and_written(names):
    """Below 20 lines: load, give a paint a measured reflectance, validate, plot, try five glares, write."""
    block = re.search(r"in memory\n\n```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    assert len(block.splitlines()) < 20
    red = cboxlab.load_scene(names["folder"] / "my-box.toml").materials["red"].reflectance
    assert red.at(600.0) == 0.3 and (names["folder"] / "difference.png").stat().st_size > 1000
    assert names["result"].maps["residual"].dims == ("band", "y", "x")
