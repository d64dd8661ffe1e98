"""The commands that ``faults.py`` disturbs, and what they read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

SMALL = ("--size", "16")
COARSE = (*SMALL, "--wavelengths", "400:700:50", "--noise", "5%")
#: What another renderer is given.
BOX = ("cornell-box", "--with", "mitsuba", *SMALL, "--wavelengths", "500,600,700", "--samples", "16")
#: What the workbench writes at "save".
STUDY = """
import cboxlab
from cboxlab.validation.predict import default_cache
study = cboxlab.Study.open("../../input/capture", cache=default_cache()).add("veiling-glare", fraction=0.01)
study.write("out/study")
study.write_report("out/study/report")
"""
#: A diagnosis that ends with the unknown, as `effects --new` reads it.
UNKNOWN = f"""
import json, sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[2] / "tests")!r})
import numpy as np
from cboxlab.validation.diagnose.explain import explain
from cboxlab.validation.report.explanation import explanation_record
from helpers.captures.small_excess import BANDS, SIGMA, SIZE, small_excess
rows = SIGMA * np.random.default_rng(2).normal(0, 1.5, (1, SIZE, 1)) * np.ones((BANDS, 1, 1))
record = {{"selected": ["unknown"], "explanation": explanation_record(explain(small_excess(rows)))}}
open("unknown.json", "w").write(json.dumps(record))
"""
#: A capture of three bands, for what would take long with seven.
FEW_BANDS = """
from pathlib import Path
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture
filters = dict(list(CaptureSettings().filters.items())[1::2])
camera = perturbed_camera(16, 3)
write_model_capture(Path("few"), Model(), camera, CaptureSettings(filters=filters), 3, relative_error=0.05)
"""
#: A data set of two boxes.
RECIPE = f"""
import sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[2] / "tests")!r})
from pathlib import Path
from helpers.scenes.recipes import write_recipe
write_recipe(Path("."))
"""


@dataclass(frozen=True)
class Command:
    """Words after ``cbox`` (after ``python`` where the first is "-c"); what of WORK/input is laid into "out" before."""

    arguments: tuple[str, ...]
    laid: tuple[str, ...] = ()


def _cbox(*arguments: str, laid: tuple[str, ...] = ()) -> Command:
    return Command(tuple(word.replace("@", "../../input/") for word in arguments), laid)


COMMANDS = {
    "capture": _cbox("capture", "cornell-box", "--out", "out", *SMALL, "--seed", "1", "--noise", "5%"),
    "sealed": _cbox("capture", "cornell-box", "--out", "out", *SMALL, "--seed", "1", "--noise", "5%", "--hide"),
    "render": _cbox(
        "render", "cornell-box", "--out", "out/cube.nc", *SMALL, "--wavelengths", "500,600", "--noise", "0.3%"
    ),
    "simulate": _cbox("simulate", "@cube.nc", "--out", "out/frame.tif", "--seed", "1"),
    "photograph": _cbox("simulate", "@cube.nc", "--out", "out/folder", "--seed", "1"),
    "export": _cbox("export", "cornell-box", "--to", "out/export", *SMALL),
    "calibrate": _cbox("calibrate", "@capture", "--out", "out"),
    "init": _cbox("calibrate", "--init", "out/frames", laid=("frames",)),
    "validate": _cbox("validate", "@capture", "--out", "out"),
    "diagnose": _cbox("diagnose", "@few", "--out", "out", "--json", "out/found.json"),
    "batch": _cbox("batch", "@boxes", "--out", "out", "--what", "validate"),
    "hyperspectral": _cbox(
        "hyperspectral",
        "@capture",
        "--reading",
        "@reading.csv:radiance",
        "--region",
        "4,4,7,7",
        "--unaligned",
        "--out",
        "out/cube.nc",
        "--json",
        "out/found.json",
    ),
    "add": _cbox("add", "out/model.toml", "dark-offset", "dn=3", "--json", "out/added.json", laid=("model.toml",)),
    "compare": _cbox("compare", "@cube.nc", "@other.nc", "--out", "out", "--json", "out/found.json"),
    "regress": _cbox("regress", "@cube.nc", "@other.nc", "--json", "out/found.json", "--junit", "out/found.xml"),
    "renderers": _cbox("renderers", *BOX, "--out", "out/box"),
    "collect": _cbox("renderers", "--collect", "out/rendered", laid=("rendered",)),
    "picture": _cbox("effects", "veiling-glare", "--picture", "out/effect.png"),
    "new": _cbox("effects", "--new", "out/rows", "--from", "@unknown.json"),
    "study": Command(("-c", STUDY)),
    "dataset": _cbox("dataset", "@recipe.toml", "--out", "out/boxes", "--json", "out/made.json"),
    "demo": _cbox("demo", "--out", "out"),
}
#: What they read, by what makes it, in order, in the folder of inputs.
MADE = {
    "capture": ("capture", "cornell-box", "--out", "capture", *SMALL, "--seed", "7", "--noise", "5%"),
    "cube.nc": ("render", "cornell-box", "--out", "cube.nc", *COARSE),
    "other.nc": ("render", "cornell-box", "--out", "other.nc", *COARSE, "--seed", "2"),
    "model.toml": ("add", "model.toml", "veiling-glare", "fraction=0.004"),
    "rendered": ("renderers", *BOX, "--out", "rendered"),
    "unknown.json": ("-c", UNKNOWN),
    "recipe.toml": ("-c", RECIPE),
    "few": ("-c", FEW_BANDS),
}
