"""An export holds the same box: triangles, spectra, rays, film; and what comes back is what was written."""

import io
import json
import shutil
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
import trimesh
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.export import (
    ExportSettings,
    exported_scene,
    read_rendered,
    renderer_catalogue,
    write_export,
)
from cboxlab.rendering.export.neutral import npy_pixels, read_layout, read_surfaces, read_warp
from cboxlab.scenes import Surface, cornell_box, cornell_camera, read_spectra
from cboxlab.scenes.shapes import file_mesh, sphere_mesh
from cboxlab.utils.errors import InputError
from helpers.scenes.boxes import box_with_lamp, camera_inside
from PIL import Image

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

SIZE, BATCHES, SUBPIXELS = 10, 2, 3
SETTINGS = ExportSettings(np.array([450.0, 500.0, 550.0, 640.0]), samples=9, batches=BATCHES, subpixels=SUBPIXELS)


def _png(values):
    stream = io.BytesIO()
    Image.fromarray(values.astype(np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def _npz(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def crooked():
    """A camera that looks aside, off centre, with distortion."""
    return cornell_camera(SIZE).with_parameters([260, 290, -780, 1, -2, 3, 14, 4.2, 4.9, -0.08])


@pytest.fixture(scope="module", params=["plain", "crooked"])
def exported(request, tmp_path_factory):
    camera = cornell_camera(SIZE) if request.param == "plain" else crooked()
    folder = tmp_path_factory.mktemp("export") / "box"
    write_export(folder, exported_scene(cornell_box(), camera, SETTINGS))
    return folder, camera


def test_meshes_are_exactly_our_triangles(exported):
    folder, _ = exported
    scene, entry = cornell_box(), json.loads((folder / "scene.json").read_text())
    assert [s["name"] for s in entry["surfaces"]] == [s.name for s in scene.surfaces]
    for surface, reference in zip(scene.surfaces, entry["surfaces"], strict=True):
        vertices, faces = file_mesh(folder / reference["mesh"], 1.0)
        assert np.array_equal(vertices, surface.vertices_mm) and np.array_equal(faces, surface.faces)
        assert reference["material"] == surface.material


def test_a_ball_is_a_sphere_and_its_mesh_has_the_spheres_normals(tmp_path):
    box, sphere = box_with_lamp(0.5), ([300.0, 120.0, 400.0], 120.0)
    ball = Surface("ball", "grey", *sphere_mesh(*sphere), ball=True)
    scene = replace(box, surfaces=(*box.surfaces, ball))
    write_export(tmp_path / "box", exported_scene(scene, camera_inside(SIZE), SETTINGS))
    entries = json.loads((tmp_path / "box" / "scene.json").read_text())["surfaces"]
    assert [entry["name"] for entry in entries if "sphere" in entry] == ["ball"]
    entry = entries[-1]["sphere"]
    np.testing.assert_allclose([*entry["center_mm"], entry["radius_mm"]], [*sphere[0], sphere[1]], rtol=1e-9)
    mesh = trimesh.load(tmp_path / "box" / entries[-1]["mesh"], process=False)
    np.testing.assert_array_equal(mesh.vertices, ball.vertices_mm)
    np.testing.assert_array_equal(mesh.faces, ball.faces)
    outwards = (ball.vertices_mm - sphere[0]) / sphere[1]
    rows = (tmp_path / "box" / entries[-1]["mesh"]).read_text().split("end_header")[1].split()
    normals = np.array(rows[: 6 * len(outwards)], float).reshape(-1, 6)[:, 3:]
    np.testing.assert_allclose(normals, outwards, atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)


def test_spectra_are_our_tables_and_channels_their_values(exported):
    folder, _ = exported
    scene = cornell_box()
    red = read_spectra(folder / "spectra" / "material-red.csv")["reflectance"]
    assert np.array_equal(red.values, scene.materials["red"].reflectance.values)
    channels = read_spectra(folder / "spectra" / "channels.csv")
    at = SETTINGS.wavelength_nm
    assert np.allclose(channels["material-red"].at(at), scene.materials["red"].reflectance.at(at))
    assert np.allclose(channels["lamp"].at(at), scene.lamp.radiance.at(at))
    assert np.allclose(channels["lamp_reflectance"].at(at), 0.78)
    reflected = read_spectra(folder / "spectra" / "lamp_reflectance.csv")["reflectance"]
    assert np.array_equal(reflected.values, scene.lamp.reflectance.values)


def test_each_ray_passes_through_its_own_part_of_its_pixel(exported):
    folder, camera = exported
    n = SIZE * SUBPIXELS
    for batch in range(BATCHES):
        rays = np.fromfile(folder / f"rays-{batch}.f32", "<f4").reshape(n, n, 6).astype(float)
        assert np.allclose(rays[..., :3], camera.position_mm)
        image = camera.project(camera.position_mm + 1000 * rays[..., 3:].reshape(-1, 3)).reshape(n, n, 2)
        part = np.floor((image + 0.5) * SUBPIXELS + 1e-4 * np.array([1, 1]) * (image < 0))
        row, column = np.indices((n, n))
        assert np.mean(part[..., 0] == column) > 0.99 and np.mean(part[..., 1] == row) > 0.99


def test_the_film_and_its_warp_show_every_pixel_where_it_is(exported):
    """A film that holds its own directions comes back as the directions of the camera's pixels."""
    folder, camera = exported
    entry = json.loads((folder / "scene.json").read_text())
    film = entry["film"]
    row, column = np.indices((film["height_px"], film["width_px"]))
    x, y = (
        film["low"][0] + (column + 0.5) / film["scale_px"],
        film["low"][1] + (row + 0.5) / film["scale_px"],
    )
    planes = {"R": x, "G": y, "B": 0 * x}
    out = folder / "mitsuba" / "out"
    out.mkdir(exist_ok=True)
    for batch in range(BATCHES):
        for group in range(2):
            header = {"type": OpenEXR.scanlineimage}
            with OpenEXR.File(header, {k: v.astype(np.float32) for k, v in planes.items()}) as file:
                file.write(str(out / f"batch-{batch}-group-{group}.exr"))
    cube = read_rendered(folder, "mitsuba")
    u, v = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    local = camera.directions(u, v) @ camera.rotation.T
    xy = local[..., :2] / local[..., 2:]
    # the mean over a pixel differs from the value at its centre only by the distortion's curvature
    assert np.abs(cube["radiance"].values[..., :2] - xy).max() < 0.02 / camera.focal_length_px
    assert cube["standard_error"].values.max() == 0 and cube["standard_error"].attrs["batches"] == BATCHES


def test_subpixels_are_averaged_and_batches_give_the_error(exported):
    folder, _ = exported
    n, s = SIZE * SUBPIXELS, SUBPIXELS
    values = np.random.default_rng(0).random((BATCHES, n, n, 4)).astype("<f4")
    (folder / "radiance" / "out").mkdir()
    values.tofile(folder / "radiance" / "out" / "group-0.f32")
    cube = read_rendered(folder, "radiance")
    batches = values.reshape(BATCHES, SIZE, s, SIZE, s, 4).mean(axis=(2, 4))
    assert np.allclose(cube["radiance"].values, batches.mean(axis=0), rtol=1e-6)
    assert np.allclose(cube["standard_error"].values, np.abs(batches[0] - batches[1]) / 2, atol=1e-6)
    assert np.array_equal(cube["wavelength"].values, SETTINGS.wavelength_nm)
    assert set(np.unique(cube["surface"].values)) <= {-2, -1, *range(7)}


@pytest.mark.parametrize("renderer", list(renderer_catalogue()))
def test_what_is_missing_or_cut_short_is_reported(exported, renderer, tmp_path):
    _, camera = exported
    fresh = tmp_path / "box"
    write_export(fresh, exported_scene(cornell_box(), camera, SETTINGS))
    with pytest.raises(InputError, match="no such file"):
        read_rendered(fresh, renderer)
    (fresh / renderer / "out").mkdir()
    for name in ("group-0.f32", "batch-0.exr", "batch-0-group-0.exr", "batch-0.npy"):
        (fresh / renderer / "out" / name).write_bytes(b"not a picture")
    with pytest.raises(InputError):
        read_rendered(fresh, renderer)


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("surfaces.png", b"not a picture", "surfaces.png"),
        ("surfaces.png", _png(np.zeros((SIZE, SIZE + 1))), "a grey picture"),
        ("surfaces.png", _png(np.full((SIZE, SIZE), 99)), "the number 99 of a surface"),
        ("warp.npz", b"not an archive", "rows, columns and weights"),
        ("warp.npz", _npz(row=[0], column=[10**9], weight=[1.0]), "other numbers"),
        ("warp.npz", _npz(row=[0], column=[0], weight=[np.nan]), "other numbers"),
        ("warp.npz", _npz(row=[0], column=[0]), "weight"),
    ],
    ids=["no picture", "too wide", "no surface", "no archive", "too far", "not finite", "a part"],
)
def test_a_damaged_map_of_an_export_is_a_fault_of_that_file(exported, tmp_path, name, content, fault):
    shutil.copytree(exported[0], tmp_path / "box")
    (tmp_path / "box" / name).write_bytes(content)
    with pytest.raises(InputError, match=fault):
        read_surfaces(tmp_path / "box"), read_warp(tmp_path / "box")


@pytest.mark.parametrize(
    ("key", "value"), [("width_px", float("inf")), ("samples", [1]), ("film", []), ("format", 1), ("lamp", None)]
)
def test_an_export_with_other_numbers_is_refused(exported, tmp_path, key, value):
    content = json.loads((exported[0] / "scene.json").read_text()) | {key: value}
    (tmp_path / "scene.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"scene\.json"):
        read_layout(tmp_path)


def test_an_array_that_states_more_than_it_holds_is_refused(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.ones((2, 3)))
    assert np.array_equal(npy_pixels(path, (2, 3)), np.ones((2, 3)))
    path.write_bytes(path.read_bytes().replace(b"(2, 3)", b"(2000000000, 300000)").replace(b" " * 14 + b"\n", b"\n"))
    with pytest.raises(InputError, match="a NumPy array"):
        npy_pixels(path, (2000000000, 300000))
    path.write_bytes(_npz(a=np.ones((2, 3))))
    with pytest.raises(InputError, match="an archive of arrays"):
        npy_pixels(path, (2, 3))


def test_what_not_all_renderers_have_is_refused():
    camera = camera_inside(SIZE)
    scene = box_with_lamp(0.5, exponent=2.0)
    with pytest.raises(InputError, match="lamp"):
        exported_scene(scene, camera, SETTINGS)
    with pytest.raises(InputError, match="at least 2"):
        exported_scene(cornell_box(), camera, replace(SETTINGS, batches=1))


def test_an_unknown_renderer_and_a_folder_that_is_no_export_are_reported(tmp_path):
    with pytest.raises(InputError, match="Did you mean 'mitsuba'"):
        read_rendered(tmp_path, "mitsuba3")
    with pytest.raises(InputError, match=r"scene\.json"):
        read_rendered(tmp_path, "mitsuba")
