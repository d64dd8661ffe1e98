"""The pull request of docs/regress.md, played through: reference, green build, red build, named cause.

The imaginary renderer's pictures are ours with noise of 0.2 % a pixel; the pull request stops paths after 3
reflections, which removes light everywhere and changes no pixel by much.
"""

import json

import pytest
import xarray as xr
from cboxlab.rendering.files import write_cube
from cboxlab.validation.app.commands.cli import main
from helpers.programs.other_suite import run_suite, run_suite_apart
from pictures import noisy, rendered

TEST = """
def test_box(same_light, request):
    picture = request.path.parent / "box.nc"
    same_light("box", picture, seed=1, samples=4096, versions={"ourrenderer": "3.2"})
"""


def build(folder, seed, max_bounces=None):
    """What the renderer's build writes: the picture, with standard errors and its surfaces."""
    side = noisy(seed, rendered(max_bounces)[0], noise=0.002)
    dims, surfaces = ("y", "x", "wavelength"), side.surfaces
    data = {
        "radiance": (dims, side.radiance),
        "standard_error": (dims, side.variance**0.5, {"batches": 4}),
        "surface": (("y", "x"), surfaces.index, {"names": ", ".join(surfaces.names), "lamp": -1}),
    }
    write_cube(folder / "box.nc", xr.Dataset(data, coords={"wavelength": side.wavelength_nm}))


def test_from_reference_to_red_build_to_named_cause(tmp_path):
    (tmp_path / "test_light.py").write_text(TEST)
    build(tmp_path, 1)
    assert run_suite_apart(tmp_path, "--update-light-references")[0] == 0
    (tmp_path / "box.nc").rename(tmp_path / "main.nc")
    build(tmp_path, 2)
    assert run_suite(tmp_path)[0] == 0
    build(tmp_path, 3, max_bounces=3)
    code, printed = run_suite_apart(tmp_path)
    assert code == 1
    assert "surface: floor" in printed
    with pytest.raises(SystemExit) as end:
        main(
            [
                "regress",
                str(tmp_path / "main.nc"),
                str(tmp_path / "box.nc"),
                "--json",
                str(tmp_path / "r.json"),
            ]
        )
    assert end.value.code == 1
    first = json.loads((tmp_path / "r.json").read_text())["named"][0]
    assert (first["change"], first["parameters"]) == ("path-depth", {"max_bounces": 3})
