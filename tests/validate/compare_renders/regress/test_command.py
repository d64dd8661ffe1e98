"""``cbox regress`` and ``assert_same_light``: exit codes, the JSON of the plan, an error that says what changed."""

import json

import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.files import (
    COLOUR_SPACES,
    camera_attribute,
    primaries_matrix,
    write_channels,
    write_cube,
)
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image
from cboxlab.rendering.model import labelled_cube
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils.errors import InputError
from cboxlab.validation.app.commands.cli import main
from cboxlab.validation.compare_renders.regress import NamedChange, assert_same_light, change_text
from cboxlab.validation.compare_renders.regress.inputs import regress_inputs
from cboxlab.validation.synthetic import perturbed_camera
from helpers.files.camera_files import write_camera
from helpers.files.rgbe import write_rgbe
from pictures import SIZE, WAVELENGTHS, noisy, rendered


@pytest.fixture(scope="module")
def cubes(tmp_path_factory):
    """Two equal cubes and one of a lamp 5 % brighter, as NetCDF without a surface map."""
    folder = tmp_path_factory.mktemp("cubes")
    clean, _ = rendered()
    for name, side in {"a": noisy(0), "same": noisy(1), "brighter": noisy(2, 1.05 * clean)}.items():
        dims = ("y", "x", "wavelength")
        error = xr.Variable(dims, side.variance**0.5, {"batches": 4})
        data = {"radiance": (dims, side.radiance), "standard_error": error}
        write_cube(folder / f"{name}.nc", xr.Dataset(data, coords={"wavelength": side.wavelength_nm}))
    return folder


def ended(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code


def test_equal_cubes_end_with_0(cubes, tmp_path):
    assert ended("regress", cubes / "a.nc", cubes / "same.nc", "--json", tmp_path / "r.json") == 0
    record = json.loads((tmp_path / "r.json").read_text())
    assert record["same"] is True
    assert record["named"] == []
    assert record["would_have_seen"] > 0


def test_equal_pictures_of_no_stated_scene_are_compared_without_rendering_one(cubes, monkeypatch):
    def build_variants(*_):
        raise AssertionError("rendered")

    monkeypatch.setattr(f"{regress_inputs.__module__.rpartition('.')[0]}.variants.build_variants", build_variants)
    assert regress_inputs(str(cubes / "a.nc"), str(cubes / "same.nc")).same
    with pytest.raises(AssertionError, match="rendered"):
        regress_inputs(str(cubes / "a.nc"), str(cubes / "brighter.nc"))


def test_another_lamp_ends_with_1_and_is_named(cubes, tmp_path):
    page = tmp_path / "r.html"
    assert ended("regress", cubes / "a.nc", cubes / "brighter.nc", "--json", tmp_path / "r.json", "--out", page) == 1
    text = page.read_text(encoding="utf-8")
    assert "DIFFERENT: mean light" in text
    assert "<table" in text
    assert text.count('src="data:image/png;base64,') == text.count(' alt="') == 2
    assert 'alt="Baseline, light ' in text.replace("\u00a0", " ")
    assert "(candidate − baseline) / σ" in text.replace("\u00a0", " ")
    record = json.loads((tmp_path / "r.json").read_text())
    assert record["same"] is False
    assert abs(record["mean_relative_difference"] - 0.05) < 5 * record["sigma"]
    assert record["named"][0]["change"] == "lamp-scale"
    assert record["where"]["clear"] is True
    assert record["where"]["relative_difference"] == pytest.approx(0.05, abs=0.02)


def test_the_camera_that_the_cubes_state_is_used(tmp_path):
    """The published box through a camera moved by pixels: recognised with the cubes' camera, not with its own."""
    moved = perturbed_camera(SIZE, 3)
    for name, depth in (("whole", None), ("cut", 3)):
        image = render_image(RenderJob(cornell_box(), moved, WAVELENGTHS, 128, 4, seed=len(name), max_bounces=depth))
        cube = labelled_cube(image)
        write_cube(tmp_path / f"bare-{name}.nc", cube)
        write_cube(tmp_path / f"{name}.nc", cube.assign_attrs(camera=camera_attribute(moved)))
    first = regress_inputs(str(tmp_path / "whole.nc"), str(tmp_path / "cut.nc")).changes[0]
    assert (first.change, first.parameters) == ("path-depth", {"max_bounces": 3})
    bare = regress_inputs(str(tmp_path / "bare-whole.nc"), str(tmp_path / "bare-cut.nc"))
    assert any("the scene is not known" in note for note in bare.notes)


def test_a_missing_cube_ends_with_2(cubes, tmp_path):
    assert ended("regress", cubes / "a.nc", cubes / "none.nc", "--json", tmp_path / "r.json") == 2
    assert not (tmp_path / "r.json").exists()


def test_a_command_makes_a_picture(cubes):
    """It writes to {out}; one that fails is bad input, with its own words."""
    assert ended("regress", cubes / "a.nc", f"cp {cubes / 'same.nc'} {{out}}.nc") == 0
    with pytest.raises(InputError, match="no such thing"):
        assert_same_light(cubes / "a.nc", "echo no such thing >&2; exit 3 # {out}")
    with pytest.raises(InputError, match="without spectral cubes"):
        assert_same_light(cubes / "a.nc", "true {out}")


def test_same_light_is_asserted(cubes):
    assert assert_same_light(cubes / "a.nc", cubes / "same.nc").same
    with pytest.raises(AssertionError, match=r"(?s)whole picture: \+\d+\.\d\d% .*lamp-scale"):
        assert_same_light(cubes / "a.nc", cubes / "brighter.nc")
    with pytest.raises(InputError, match=r"none\.nc"):
        assert_same_light(cubes / "none.nc", cubes / "a.nc")


def test_what_a_cube_does_not_state_is_asked_for_and_may_be_declared(cubes, tmp_path, capsys):
    """The message names the option to use."""
    plain = tmp_path / "plain.nc"
    xr.open_dataset(cubes / "a.nc", engine="h5netcdf").drop_attrs().to_netcdf(plain, engine="h5netcdf")
    assert ended("regress", plain, cubes / "same.nc") == 2
    assert "--declare units=" in capsys.readouterr().err.replace("\n", " ")
    declared = [
        "--declare",
        "units=mW m^-2 sr^-1 nm^-1",
        "--declare",
        "scale=1000",
        "--declare",
        "wavelengths=420:700:40",
    ]
    assert ended("regress", plain, cubes / "same.nc", *declared) == 0
    assert ended("regress", cubes / "a.nc", cubes / "same.nc", *declared) == 2
    assert "states it itself" in capsys.readouterr().err.replace("\n", " ")
    assert ended("regress", plain, cubes / "same.nc", "--declare", "unit=W") == 2


@pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")
def test_a_camera_file_is_the_view(cubes, tmp_path, capsys):
    """As `cbox render --camera` takes it: it gives the surfaces, and one of another size is bad input."""
    write_camera(tmp_path / "camera.json", cornell_camera(SIZE))
    write_camera(tmp_path / "smaller.json", cornell_camera(SIZE // 2))
    view = cubes / "a.nc", cubes / "same.nc", "--json", tmp_path / "r.json", "--camera"
    assert ended("regress", *view, tmp_path / "camera.json", "--model", "cornell-box") == 0
    assert "tall-block" in json.loads((tmp_path / "r.json").read_text())["surfaces"]
    assert ended("regress", *view, tmp_path / "smaller.json") == 2
    assert f"{SIZE} x {SIZE} px, as the cubes" in " ".join(capsys.readouterr().err.split())


def printed(capsys):
    return " ".join(capsys.readouterr().out.split())


@pytest.fixture
def pictures(tmp_path):
    """The same light as X, Y, Z in cd m^-2 (OpenEXR), and as Radiance's, over 179, with and without primaries."""
    rng = np.random.default_rng(6)
    rgb = 0.5 * rendered()[0][..., [6, 3, 1]] / rendered()[0].mean() * (1 + 0.01 * rng.standard_normal((SIZE, SIZE, 1)))
    xyz = 179 * rgb @ primaries_matrix(COLOUR_SPACES["radiance"]).T
    planes = {name: np.ascontiguousarray(xyz[..., i], np.float32) for i, name in enumerate("XYZ")}
    write_channels(tmp_path / "xyz.exr", {}, planes)
    write_rgbe(tmp_path / "bare.hdr", rgb)
    write_rgbe(tmp_path / "stated.hdr", rgb, f"PRIMARIES= {PRIMARIES}\n")
    return tmp_path


PRIMARIES = "0.6400 0.3300 0.2900 0.6000 0.1500 0.0600 0.3333 0.3333"
RECIPE = ("units=cd m^-2", "scale=179", "colour-space=radiance")


def declare(*values):
    return [part for value in values for part in ("--declare", value)]


@pytest.mark.parametrize("name", ["bare", "stated"])
def test_the_documented_declarations_for_radiance_hold_with_stated_primaries(pictures, name, capsys):
    """Radiance 6 states them; what says the same is accepted, what says another is refused with both."""
    assert ended("regress", pictures / f"{name}.hdr", pictures / f"{name}.hdr", *declare(*RECIPE)) == 0
    assert "scale as declared: 179" in printed(capsys)
    other = declare(*RECIPE[:2], "colour-space=rec709")
    assert ended("regress", pictures / f"{name}.hdr", pictures / f"{name}.hdr", *other) == (
        2 if name == "stated" else 0
    )
    if name == "stated":
        error = " ".join(capsys.readouterr().err.split())
        assert "--declare colour-space: found rec709; expected radiance, or none: the file states it itself" in error


def test_one_of_two_files_has_a_separate_declaration(pictures, capsys):
    """A scale of 179 for both makes the other 179 times as bright; for one alone both are the same light."""
    files = pictures / "xyz.exr", pictures / "bare.hdr"
    declaration = declare("units=cd m^-2", "candidate:scale=179", "candidate:colour-space=radiance")
    assert ended("regress", *files, *declaration) == 0
    assert ended("regress", *files, *declare(*RECIPE)) == 1
    capsys.readouterr()
    assert ended("compare", *files, *declare("units=cd m^-2", "B:scale=179", "B:colour-space=radiance")) == 0
    said = printed(capsys)
    assert "Means over X, Y, Z" in said
    assert "one exponent for all three" in said
    assert "scale as declared: 179.0" in said
    assert ended("compare", *files, *declare("units=cd m^-2", "C:scale=179")) == 2
    assert "A: or B: before it" in " ".join(capsys.readouterr().err.split())


def test_a_declaration_of_one_file_is_refused_where_that_file_states_another(pictures, capsys):
    files = pictures / "bare.hdr", pictures / "stated.hdr"
    assert ended("regress", *files, *declare(*RECIPE, "candidate:colour-space=rec709")) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "--declare candidate:colour-space: found rec709; expected radiance" in error
    assert ended("regress", *files, *declare(*RECIPE, "candidate:colour-space=radiance")) == 0


def test_the_change_of_a_dark_picture_is_given_as_a_part(pictures, capsys):
    """Not as -100.000 %."""
    files = pictures / "xyz.exr", pictures / "xyz.exr"
    assert ended("compare", *files, *declare("units=cd m^-2", "A:scale=0.000012345")) == 0
    assert "1.23e-05 of B" in printed(capsys)
    assert ended("regress", *files, *declare("units=cd m^-2", "candidate:scale=0.000012345")) == 1
    assert "mean light 1.23e-05 of the baseline" in printed(capsys)


def test_parameters_are_printed_with_five_digits():
    change = NamedChange("lamp-spectrum", {"factor_by_nm": {"X": 1.0031623456789012, "Y": 1.0}, "order": ["a", 2]}, 1.0)
    assert change_text(change) == "lamp-spectrum (factor_by_nm {X: 1.0032, Y: 1}, order [a, 2])"
