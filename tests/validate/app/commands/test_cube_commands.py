"""Commands on spectral cubes: rendered, compared, simulated, in every format, with their origin."""

import json
import re
from importlib.metadata import version

import numpy as np
import pytest
from cboxlab.rendering.files.cube_files import read_cube, write_cube
from cboxlab.rendering.model.model_file import load_model
from cboxlab.validation.app.commands.cli import main
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.compare.maps import read_map
from colour import SpectralDistribution, sd_to_XYZ
from helpers.files.raw_frames import read_raw
from helpers.programs.command_line import assert_one_line_of_help
from helpers.programs.manual_commands import described
from PIL import Image
from scipy.ndimage import binary_erosion

pytestmark = pytest.mark.usefixtures("large_patches")


@pytest.fixture(scope="module")
def cubes(tmp_path_factory):
    """Two renders of a small picture that differ by their seed alone."""
    folder = tmp_path_factory.mktemp("cubes")
    for seed in (1, 2):
        with pytest.raises(SystemExit) as caught:
            main(
                [
                    "render",
                    "cornell-box",
                    "--size",
                    "32",
                    "--wavelengths",
                    "400:700:50",
                    "--samples",
                    "64",
                    "--seed",
                    str(seed),
                    "--out",
                    str(folder / f"{seed}.nc"),
                ]
            )
        assert not caught.value.code
    return folder


def test_renders_with_other_seeds_differ_by_noise(cubes, tmp_path, cbox):
    """The mean of 1024 values of F with 1 and 14 degrees of freedom has a standard deviation of 0.06.

    Pixels share the light field, so twice that is allowed: limits at 5 of these.
    """
    code, out, _ = cbox("compare", cubes / "1.nc", cubes / "2.nc", "--out", tmp_path / "maps")
    assert code == 0 and "550 nm" in out
    record = json.loads((tmp_path / "maps" / "comparison.json").read_text())
    assert record["expected_chi2_per_pixel"] == pytest.approx(14 / 12)
    planes = {row["name"]: row for row in record["planes"]}
    assert planes["400 nm"]["relative_mean"] is None  # the published lamp is dark there
    for name in ("450 nm", "550 nm", "700 nm"):
        assert planes[name]["chi2_per_pixel"] == pytest.approx(14 / 12, abs=0.6)
        assert abs(planes[name]["relative_mean"]) < 0.02
    assert read_map(tmp_path / "maps" / "residual_over_sigma.exr")[0].shape == (7, 32, 32)


def test_a_cube_says_where_it_comes_from(cubes, tmp_path):
    """Model, seed, version, camera and command, in NetCDF and, after a round trip, in OpenEXR."""
    cube = read_cube(cubes / "2.nc")
    write_cube(tmp_path / "2.exr", cube)
    for attributes in (cube.attrs, read_cube(tmp_path / "2.exr").attrs):
        assert attributes["seed"] == "2" and attributes["cboxlab_version"] == version("cboxlab")
        assert attributes["command"].startswith("cbox render cornell-box --size 32 --wavelengths 400:700:50")
        assert json.loads(attributes["camera"])["width_px"] == 32
        (tmp_path / "model.toml").write_text(attributes["model"])
        assert load_model(tmp_path / "model.toml").scene.origin.reference == "cornell-box"


def test_a_simulation_names_the_faulty_cube_and_reports_saturation(cubes, tmp_path, cbox):
    cube = read_cube(cubes / "1.nc")
    cube["radiance"].values[3, 4, 2] = np.nan
    cube.to_netcdf(tmp_path / "gap.nc", engine="h5netcdf")
    code, _, said = cbox("simulate", cubes / "1.nc", tmp_path / "gap.nc", "--out", tmp_path / "{name}.tif")
    assert code == 2 and f"{tmp_path / 'gap.nc'}: radiance[3, 4, 2]" in said
    for seconds, is_saturated in (("auto", False), ("1e6", True)):
        code, out, _ = cbox("simulate", cubes / "1.nc", "--out", tmp_path / "a.tif", "--exposure", seconds)
        assert code == 0 and ("of the pixels are saturated" in out) == is_saturated


def test_cubes_frames_and_verdicts_are_verified(cubes, tmp_path, cbox):
    """Each has a manifest next to it, or, being a folder, in it; a result or an input that changed is named."""
    plain, envi, frame, folder = (tmp_path / name for name in ("1.nc", "cube.hdr", "frame.tif", "capture"))
    plain.write_bytes((cubes / "1.nc").read_bytes())
    assert cbox("render", "cornell-box", "--size", 8, "--wavelengths", "500,600", "--samples", 4, "--out", envi)[0] == 0
    assert cbox("simulate", plain, "--out", frame, "--seed", 3)[0] == 0
    assert cbox("simulate", plain, "--out", folder)[0] == 0
    verdict, table = tmp_path / "verdict.json", tmp_path / "verdict.xml"
    code = cbox("regress", plain, cubes / "2.nc", "--json", verdict, "--junit", table)[0]
    assert code in (0, 1)
    for path in (cubes / "2.nc", envi, frame, folder, verdict, table):
        code, said, _ = cbox("verify", path)
        assert code == 0 and "are unchanged" in said
    assert json.loads((tmp_path / "frame.tif.manifest.json").read_text())["seed"] == 3
    envi.with_suffix(".img").write_bytes(b"")
    plain.write_bytes(b"")
    for path, phrase in (
        (envi, "cube.img: this result has changed"),
        (frame, "1.nc: this input has changed since"),
        (folder, "1.nc: this input has changed since"),
        (table, "1.nc: this input has changed since"),
    ):
        code, said, _ = cbox("verify", path)
        assert code == 1 and phrase in said
    assert_one_line_of_help(cbox("verify", plain), ["1.nc.manifest.json"])


def test_cubes_of_other_cameras_are_refused(cubes, tmp_path, cbox):
    """32 pixels see 39 degrees: half a degree is 0.4 px, which is noted; two degrees are 1.6 px, which is refused."""
    for degrees in (0.5, 2.0):
        cube = read_cube(cubes / "1.nc")
        camera = json.loads(cube.attrs["camera"])
        camera["parameters"][4] += degrees
        write_cube(tmp_path / f"{degrees}.nc", cube.assign_attrs(camera=json.dumps(camera)))
    code, out, _ = cbox("compare", tmp_path / "0.5.nc", cubes / "1.nc")
    assert code == 0 and "the cameras see the same points up to 0.4" in out
    assert_one_line_of_help(
        cbox("compare", tmp_path / "2.0.nc", cubes / "1.nc"),
        ["1.nc", "a camera", "px elsewhere", "within 1 px"],
    )


def test_a_known_difference_is_measured(cubes, tmp_path, cbox):
    cube = read_cube(cubes / "1.nc")
    cube["radiance"].values[..., 3] *= 1.03
    cube["radiance"].values[20, 10, 1] *= 1.5
    write_cube(tmp_path / "other.exr", cube)
    write_cube(tmp_path / "first.exr", read_cube(cubes / "1.nc"))
    code, *_ = cbox("compare", tmp_path / "other.exr", tmp_path / "first.exr", "--out", tmp_path / "maps")
    record = json.loads((tmp_path / "maps" / "comparison.json").read_text())
    planes = {row["name"]: row for row in record["planes"]}
    assert code == 0
    assert planes["550 nm"]["relative_mean"] == pytest.approx(0.03, rel=1e-5)
    assert planes["550 nm"]["relative_rms"] == pytest.approx(0.03, rel=1e-5)
    assert planes["600 nm"]["relative_rms"] == 0 and planes["600 nm"]["chi2_per_pixel"] is None
    worst = record["worst_pixels"][0]
    assert (worst["plane"], worst["x"], worst["y"]) == ("450 nm", 10, 20)
    assert worst["size"] == pytest.approx(50, rel=1e-5)
    relative = read_map(tmp_path / "maps" / "relative_difference.exr")[0]
    assert float(relative.sel(channel="450 nm")[20, 10]) == pytest.approx(0.5, rel=1e-5)
    assert "3 results and 2 inputs are unchanged" in cbox("verify", tmp_path / "maps")[1]


def test_what_cannot_be_compared_is_said(cubes, cbox):
    assert_one_line_of_help(cbox("compare", DEMO_CAPTURE, cubes / "1.nc"), ["1.nc", "W m^-2", "DN"])


def test_a_capture_compared_with_itself_is_alike(cbox):
    code, out, _ = cbox("compare", DEMO_CAPTURE, DEMO_CAPTURE)
    assert code == 0
    assert all(re.search(rf"{band} .* \+0\.000 +0\.000 ", out) for band in ("f400", "f550", "f700"))


def test_a_cube_in_every_format_and_a_raw_frame_of_it(cubes, tmp_path, cbox):
    radiance = read_cube(cubes / "1.nc")["radiance"].values
    for ending in (".exr", ".hdr"):
        path = tmp_path / f"again{ending}"
        code, *_ = cbox(
            "render",
            "cornell-box",
            "--size",
            32,
            "--wavelengths",
            "400:700:50",
            "--samples",
            64,
            "--seed",
            1,
            "--out",
            path,
        )
        assert code == 0
        assert np.array_equal(read_cube(path)["radiance"].values, radiance)
    code, out, _ = cbox("simulate", cubes / "1.nc", "--out", tmp_path / "raw.tif", "--preview", tmp_path / "raw.png")
    assert code == 0 and "Kodak DCS-200" in out
    counts, notes = read_raw(tmp_path / "raw.tif")
    assert counts.shape == (32, 32) and 0 < counts.min() < counts.max() <= 255
    assert notes["camera"] == "Kodak DCS-200" and notes["exposure_s"] > 0
    assert Image.open(tmp_path / "raw.png").size == (32, 32)


def test_luminances_are_printed_with_the_cube(tmp_path, cbox):
    """Against the cube's own radiance summed by colour-science, on pixels away from edges; keys as in the manual."""
    out, luminances = tmp_path / "a.nc", tmp_path / "a.json"
    code, said, _ = cbox(
        "render",
        "cornell-box",
        "--size",
        24,
        "--wavelengths",
        "400:700:20",
        "--samples",
        8,
        "--seed",
        1,
        "--out",
        out,
        "--json",
        luminances,
    )
    record = json.loads(luminances.read_text())
    light = record["photometry"]
    assert code == 0 and "16 wavelengths from 400 to 700 nm" in said and "whole picture" in said
    rows = [*light["surfaces"].values(), light["lamp"], light["picture"]]
    keys = {*record, *light, *(key for row in rows for key in row)}
    assert keys - {"cube", "width_px", "height_px", "wavelength_nm", "notes", "photometry"} == described(
        "docs/reference/files.md", "Luminances of a rendered box"
    )
    cube = read_cube(out)
    names = cube["surface"].attrs["names"].split(", ")
    assert list(light["surfaces"]) == names

    def xyz(radiance):
        fine = np.arange(360, 781)  # colour-science continues shorter tables by constants
        between = np.interp(fine, cube["wavelength"].values, radiance, 0, 0)
        return sd_to_XYZ(SpectralDistribution(between, fine), k=683.0, method="Integration")

    radiance = cube["radiance"].values
    for row, mean in [
        (light["picture"], radiance.mean(axis=(0, 1))),
        *(
            (
                light["surfaces"][name],
                radiance[binary_erosion(cube["surface"].values == names.index(name))].mean(axis=0),
            )
            for name in ("back", "left")
        ),
    ]:
        expected = xyz(mean)
        mask = row is light["picture"]
        assert row["luminance_cd_m2"] == pytest.approx(expected[1], rel=2e-4 if mask else 0.1)
        assert row["x"] == pytest.approx(expected[0] / expected.sum(), abs=1e-4 if mask else 0.005)
    ceiling = names.index("ceiling")
    naive = xyz(radiance[cube["surface"].values == ceiling].mean(axis=0))[1]
    assert naive > 1.2 * light["surfaces"]["ceiling"]["luminance_cd_m2"]
    assert 0 < light["surfaces"]["back"]["luminance_sigma_cd_m2"] < 0.02 * light["surfaces"]["back"]["luminance_cd_m2"]
    assert light["surfaces"]["floor"]["illuminance_lx"] > 0


def test_too_few_wavelengths_have_no_luminances(tmp_path, cbox):
    code, said, _ = cbox(
        "render",
        "cornell-box",
        "--size",
        8,
        "--wavelengths",
        "400:700:50",
        "--samples",
        4,
        "--out",
        tmp_path / "a.nc",
        "--json",
        tmp_path / "a.json",
    )
    assert code == 0 and "no luminances: 7 wavelengths from 400 to 700 nm" in said and "whole picture" not in said
    assert json.loads((tmp_path / "a.json").read_text())["photometry"] is None
