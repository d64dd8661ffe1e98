"""Data sets on disk: the same files by any way of working, nothing lost, and what a reader gets."""

import csv
import json
import shutil
import sys
import time

import h5py
import numpy as np
import pytest
import xarray as xr
from cboxlab.rendering.dataset import draw_box, load_recipe
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.files import read_cube
from cboxlab.utils.errors import InputError
from cboxlab.validation.app.commands.cli import main
from cboxlab.validation.dataset import Workers, create_dataset, open_dataset, preview_recipe, workers
from cboxlab.validation.dataset.checks import check_picture
from cboxlab.validation.dataset.formats import COPY_ENDINGS, open_picture, write_copy, write_picture
from cboxlab.validation.dataset.layout import Layout, begin
from cboxlab.validation.dataset.picture import render_pictures, rounded
from cboxlab.validation.dataset.tasks import tasks_of
from cboxlab.validation.dataset.workers import in_processes
from helpers.programs.command_line import assert_one_line_of_help
from helpers.programs.ending import ends_once
from helpers.scenes.recipes import write_recipe
from threadpoolctl import threadpool_limits

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

#: Two boxes that share rays.
PAIR = ("boxes = 2", "boxes = 2\nboxes_per_geometry = 2")

#: A second camera, an effect of light transport and a sensor.
MORE = (
    "[room]",
    """[[camera]]
name = "side"
width_px = 16
height_px = 16
left_mm = 60
[[effect]]
id = "veiling-glare"
[[sensor]]
name = "eye"
camera = "dcs200"
exposures = [0.5, 1.0]
[room]""",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sets")


@pytest.fixture(scope="module")
def recipe_file(folder):
    return write_recipe(folder, ("step_nm = 100.0", "step_nm = 30.0"), ("{ integer = [1, 2] }", "1"), PAIR, MORE)


@pytest.fixture(scope="module")
def run(folder, recipe_file):
    with threadpool_limits(2):  # workers of a scheduler compute in one thread
        return create_dataset(recipe_file, folder / "all")


def checksums(dataset):
    return {row["file"]: row["sha256"] for row in dataset.index}


def test_an_interrupted_run_continues_to_the_same_bits(folder, run, recipe_file):
    """One picture is missing, one was cut off, one has no record: only these are rendered again."""
    assert (run.rendered, run.reused, run.failed) == (4, 0, ())
    broken = shutil.copytree(folder / "all", folder / "broken")
    layout = Layout(broken)
    for name in ("main.nc", "main.json"):
        (layout.box(0) / name).unlink()
    cut = layout.box(1) / "side.nc"
    cut.write_bytes(cut.read_bytes()[:1000])
    (layout.box(1) / "main.json").unlink()
    again = create_dataset(recipe_file, broken)
    assert (again.rendered, again.reused) == (3, 1)
    assert checksums(again.dataset) == checksums(run.dataset)
    assert (broken / "index.csv").read_bytes() == (folder / "all" / "index.csv").read_bytes()
    assert not again.dataset.damaged() and not [*broken.rglob(".*unfinished*")]


def test_workers_of_a_scheduler_write_the_same_bits(folder, run, recipe_file):
    """Of numbers and attributes; Dask's profiler rarely changes the layout of an HDF5 file, not its content."""
    distributed = pytest.importorskip("distributed")
    local = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**local) as cluster:
        shared = create_dataset(recipe_file, folder / "shared", Workers(scheduler=cluster.scheduler_address))
    assert len(shared.dataset) == len(run.dataset)
    for index in range(len(run.dataset)):
        with shared.dataset[index] as picture, run.dataset[index] as expected:
            assert picture.identical(expected)


def test_the_index_and_the_pictures_say_the_same(run):
    dataset = run.dataset
    assert len(dataset) == 4 and {row["camera"] for row in dataset.index} == {"main", "side"}
    assert sum(len(dataset.part(name)) for name in ("train", "validation", "test")) == 4
    with (dataset.folder / "index.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == 4
    with dataset[0] as picture:
        assert picture.sizes == {**picture.sizes, "y": 16, "x": 16, "wavelength": 11, "order": 4}
        total = picture["reflections"].sum("order") + picture["effects_light"]
        np.testing.assert_allclose(total, picture["radiance"], atol=2e-6 * float(picture["radiance"].max()))
        assert picture["raw_eye"].shape == (2, 16, 16) and picture["raw_eye"].dtype == np.uint16
        assert picture["developed_eye"].shape == (2, 16, 16, 3)
        low, high = picture["raw_eye"].attrs["exposure_s"]
        assert high == pytest.approx(2 * low)
        relative = picture["standard_error"].values / np.maximum(picture["radiance"].values, 1e-30)
        assert np.median(relative[picture["surface"].values >= 0]) < 0.1
    arrays = dataset.where(camera="side").arrays("radiance", "albedo")
    assert len(arrays) == 2 and arrays[1]["albedo"].shape == (16, 16, 11)
    with pytest.raises(InputError, match="Did you mean 'albedo'"):
        dataset.arrays("albedoo")


def test_the_index_as_parquet_is_that_of_the_text(run):
    table = pytest.importorskip("arro3.io").read_parquet(run.dataset.folder / "index.parquet").read_all()
    columns = {name: table[name].to_pylist() for name in run.dataset.index[0]}
    assert [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)] == [
        dict(row) for row in run.dataset.index
    ]


def test_the_model_of_a_picture_is_that_of_its_box(folder, run, recipe_file):
    box = draw_box(load_recipe(recipe_file), 1, recipe_file.parent)
    number = next(i for i, row in enumerate(run.dataset.index) if row["box"] == 1)
    model = run.dataset.model(number)
    assert [effect.id for effect in model.effects] == ["veiling-glare"]
    for mine, other in zip(model.scene.all_surfaces, box.model.scene.all_surfaces, strict=True):
        np.testing.assert_allclose(mine.vertices_mm, other.vertices_mm)
    assert run.dataset.drawn_values(number) == json.loads(json.dumps(box.record))
    with run.dataset[number] as picture:
        assert picture.attrs["effects_left_out"] == "veiling-glare"


def test_card_and_croissant_name_every_part(run):
    card = (run.dataset.folder / "README.md").read_text()
    assert "4 of 2 boxes" in card and "veiling-glare (4)" in card
    record = json.loads((run.dataset.folder / "croissant.json").read_text())
    assert record["conformsTo"] == "http://mlcommons.org/croissant/1.0"
    columns = {field["source"]["extract"]["column"] for field in record["recordSet"][0]["field"]}
    assert columns <= set(run.dataset.index[0])
    assert record["creator"]["@type"] in ("sc:Organization", "sc:Person")  # readers refuse anything else
    assert "4 pictures pass all checks" in (run.dataset.folder / "quality.html").read_text()


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda c: c["radiance"].values.__setitem__((3, 3, 2), np.nan), "not finite"),
        (lambda c: c["radiance"].values.__setitem__((3, 3), -1.0), "below 0"),
        (lambda c: c["radiance"].values.__setitem__((3, 3), 1e6), "brighter than the brightest lamp"),
        (lambda c: c["reflections"].values.__imul__(1.01), "parts of the light"),
        (lambda c: c["position"].values.__iadd__(5.0), "from its pixel's centre"),
        (lambda c: c["normal"].values.__imul__(-1.0), "points away"),
        (lambda c: c["albedo"].values.__iadd__(1.0), "albedo outside"),
    ],
)
def test_a_spoilt_picture_fails_its_checks(run, recipe_file, spoil, word):
    box = draw_box(load_recipe(recipe_file), run.dataset.index[0]["box"], recipe_file.parent)
    with run.dataset[0] as picture:
        sound = picture.load()
    assert check_picture(sound, box, 0.1, 23).faults == ()
    spoilt = sound.copy(deep=True)
    spoil(spoilt)
    assert any(word in fault for fault in check_picture(spoilt, box, 0.1, 23).faults)


def test_a_coated_box_splits_into_albedo_irradiance_and_specular_light(tmp_path, monkeypatch):
    """To rounding, in pixels of one surface; a coat's light that is wrong by a little fails the checks."""
    for name, value in (("_PATCHES_PER_DIAGONAL", 6), ("_PATCH_SAMPLES", 128), ("_SAMPLES", 64)):
        monkeypatch.setattr(sys.modules["cboxlab.validation.predict.transported"], name, value)
    gloss = '[[effect]]\nid = "gloss"\nmaterial = "light"\nspecular = 0.6\nroughness = [0.2, 0.3]\n[room]'
    path = write_recipe(tmp_path, ("[room]", gloss))
    recipe = load_recipe(path)
    box = draw_box(recipe, 0, tmp_path)
    (picture,) = render_pictures([box], "main", recipe, tmp_path)
    single = picture["coverage"].values.max(axis=-1) > 1 - 1e-6
    split = picture["reflections"][0] + picture["albedo"] * picture["irradiance"] / np.pi + picture["specular"]
    difference = np.abs(split - picture["radiance"]).values[single]
    assert single.sum() > 60 and difference.max() < 2e-6 * float(picture["radiance"].max())
    assert float(picture["specular"].max()) > 0.01 * float(picture["radiance"].median())
    assert check_picture(picture, box, 0.1, 23).faults == ()
    picture["specular"] += 0.01 * picture["radiance"].max()
    assert any("specular light are not" in fault for fault in check_picture(picture, box, 0.1, 23).faults)


def test_a_dark_coat_gets_the_rays_that_its_noise_needs(tmp_path, monkeypatch):
    """A coat that takes light leaves the error of the base: the picture still has the noise that was asked for."""
    from cboxlab.validation.dataset import picture as module

    sample_counts = []
    plain = module.render_to_precision
    path = write_recipe(tmp_path, ("[room]", '[[effect]]\nid = "gloss"\nmaterial = "light"\nspecular = 1.0\n[room]'))
    recipe = load_recipe(path)
    box = draw_box(recipe, 0, tmp_path)
    errors = iter([0.11])

    def once(image, percentiles):
        return [next(errors, 0.05)] * len(percentiles)

    def counted(job, noise, **others):
        sample_counts.append(noise)
        return plain(job, noise, **others)

    monkeypatch.setattr(module, "render_to_precision", counted)
    monkeypatch.setattr(module, "relative_errors", once)
    for name, value in (("_PATCHES_PER_DIAGONAL", 6), ("_PATCH_SAMPLES", 128), ("_SAMPLES", 64)):
        monkeypatch.setattr(sys.modules["cboxlab.validation.predict.transported"], name, value)
    list(render_pictures([box], "main", recipe, tmp_path))
    assert sample_counts == pytest.approx([0.1, 0.1**2 / 0.11 * 0.9])


def test_formats_hold_the_same_picture(run, tmp_path):
    """Zarr is equal to the bit, and its file, too; copies hold the radiance, HDF5 in the order of the benchmarks."""
    pytest.importorskip("zarr")
    with run.dataset[0] as picture:
        cube = picture.load()
    files = [tmp_path / name for name in ("a.zarr.zip", "b.zarr.zip")]
    for file in files:
        write_picture(file, cube)
    with open_picture(files[0]) as again:
        xr.testing.assert_identical(again.load().drop_encoding(), cube.drop_encoding())
    assert files[0].read_bytes() == files[1].read_bytes()
    for ending in COPY_ENDINGS.values():
        write_copy(tmp_path / f"copy{ending}", cube)
    for ending in (".exr", ".hdr"):
        np.testing.assert_array_equal(read_cube(tmp_path / f"copy{ending}")["radiance"], cube["radiance"])
    with h5py.File(tmp_path / "copy.mat") as file:
        bands, most = file["bands"][()].squeeze(), file["norm_factor"][()].item()
        radiance = np.array(file["cube"]).T * most  # as readers of the benchmarks turn it
    np.testing.assert_array_equal(bands, cube["wavelength"])
    np.testing.assert_allclose(radiance, cube["radiance"], rtol=1e-6)


def test_a_set_in_zarr_with_copies(tmp_path):
    pytest.importorskip("zarr")
    formats = ("noise = 0.1", 'noise = 0.1\ntruths = ["albedo"]\nformat = "zarr"\ncopies = ["hdf5", "exr"]')
    data_set = create_dataset(write_recipe(tmp_path, formats, ("boxes = 2", "boxes = 1")), tmp_path / "set")
    assert [row["file"] for row in data_set.dataset.index] == ["boxes/000000/main.zarr.zip"]
    assert {"main.mat", "main.exr", "main.json"} <= {path.name for path in (tmp_path / "set/boxes/000000").iterdir()}
    assert set(data_set.dataset.arrays("radiance", "albedo")[0]) == {"radiance", "albedo"}
    assert not data_set.dataset.damaged()


def test_fewer_bits_round_to_the_stated_error():
    values = xr.DataArray(np.random.default_rng(1).lognormal(0, 5, 10000).astype(np.float32))
    for bits in (8, 12, 23):
        short = rounded(values, bits)
        assert np.abs(short / values - 1).max() <= 2.0 ** -(bits + 1)
        assert not (short.values.view(np.uint32) & ((1 << (23 - bits)) - 1)).any()
    assert np.isnan(rounded(xr.DataArray(np.array([np.nan], np.float32)), 8)).all()


def test_the_task_of_a_worker_that_ends_is_run_again(tmp_path, monkeypatch):
    """Their processes know neither this module nor cboxlab, and so begin at once."""
    tasks = [tmp_path / "mark"]
    assert list(in_processes(tasks, 1, lambda: None, ends_once, abs)) == [[{"box": "mark"}]]
    tasks[0].unlink()
    monkeypatch.setattr(workers, "_MOST_ENDS", 1)
    with pytest.raises(InputError, match="worker processes that ended"):
        list(in_processes(tasks, 1, lambda: None, ends_once, abs))


@pytest.mark.parametrize("again", [True, False])
def test_a_scheduler_that_ends_loses_nothing(monkeypatch, again):
    """One that starts again gets the tasks that remain; without one the run ends in one line."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(workers, "_RESTART_S", 20.0 if again else 1.0)
    monkeypatch.setattr(workers, "_MOST_HELD", 2)  # the third one is submitted when one is done
    local = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    local |= {"protocol": "tcp", "host": "127.0.0.1"}
    clusters = [distributed.LocalCluster(**local)]
    address, results = clusters[0].scheduler_address, []
    port = int(address.rsplit(":", 1)[1])
    try:
        for result in workers.on_scheduler([0.1, 0.2, 0.3], address, lambda: None, slept):
            results.append(result)
            if len(clusters) == 1:
                clusters[0].close()
                clusters.append(distributed.LocalCluster(**local, scheduler_port=port) if again else None)
    except InputError as error:
        assert not again and "no answer" in str(error) and "Repeat the command" in str(error)
    finally:
        for cluster in filter(None, clusters):
            cluster.close()
    assert sorted(results) == [0.1, 0.2, 0.3] if again else len(results) < 3


def slept(seconds):
    time.sleep(seconds)
    return seconds


def test_a_worker_with_other_versions_is_named():
    with pytest.raises(InputError, match=r"a worker on .* with cboxlab .* \(not 0.0\)"):
        workers.run_with_versions({"cboxlab": "0.0"}, slept, 0.0)


def test_tasks_hold_boxes_of_one_geometry(tmp_path):
    path = write_recipe(tmp_path, ("boxes = 2", "boxes = 25\nboxes_per_geometry = 10"))
    tasks = tasks_of(load_recipe(path), path, Layout(tmp_path / "set"))
    numbers = [n for task in tasks for n in task.boxes]
    assert numbers == list(range(28)) and len(tasks[-1].boxes) == 8  # whole blocks, also at the end of the set
    assert all(len({n // 10 for n in task.boxes}) == 1 for task in tasks)


def outcome(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        main(list(map(str, arguments)))
    out, err = capsys.readouterr()
    return ended.value.code, out, err


@pytest.mark.parametrize("case", ["key", "nowhere", "other", "file", "begun", "version", "sensor", "dark", "scheduler"])
def test_a_mistake_ends_in_one_line_and_writes_nothing(capsys, tmp_path, monkeypatch, case):
    target, options = tmp_path / "set", []
    path = write_recipe(tmp_path)
    phrases = {
        "key": ["seeds", "Did you mean 'seed'"],
        "nowhere": ["nowhere.toml", "no such file"],
        "other": ["other files"],
        "file": ["is no folder"],
        "begun": ["another recipe"],
        "version": ["mitsuba 0.1"],
        "sensor": ["sensor[0]", "of the sensitivity"],
        "dark": ["picture", "0.4 to 0.7 nm", "no light"],
        "scheduler": ["--scheduler", "no answer"],
    }[case]
    if case == "key":
        path = write_recipe(tmp_path, ("seed = 11", "seeds = 11"))
    elif case == "nowhere":
        path = tmp_path / "nowhere.toml"
    elif case == "sensor":
        sensor = '[[sensor]]\nname = "a"\ncamera = "dcs200"\n[room]'
        path = write_recipe(tmp_path, ("[picture]", "[picture]\nlast_nm = 600"), ("[room]", sensor))
    elif case == "dark":
        path = write_recipe(tmp_path, ("step_nm = 100.0", "first_nm = 0.4\nlast_nm = 0.7\nstep_nm = 0.1"))
    elif case == "other":
        target.mkdir()
        (target / "notes.txt").write_text("mine")
    elif case == "file":
        target.write_text("mine")
    elif case in ("begun", "version"):
        begin(load_recipe(path), path, target)
        if case == "begun":
            path = write_recipe(tmp_path, ("seed = 11", "seed = 12"))
        else:
            state = json.loads((target / "dataset.json").read_text())
            state["versions"]["mitsuba"] = "0.1"
            (target / "dataset.json").write_text(json.dumps(state))
    elif case == "scheduler":
        pytest.importorskip("distributed")
        monkeypatch.setattr(workers, "TIMEOUT_S", 1.0)
        options = ["--scheduler", "tcp://127.0.0.1:9"]
    assert_one_line_of_help(outcome(capsys, "dataset", path, "--out", target, *options), phrases)
    assert not [*target.rglob("*.nc")]


def test_a_preview_costs_what_the_run_costs(folder, run, recipe_file, monkeypatch):
    """Of boxes that share rays, through two cameras: one file, the right number, a time and a size near the run's."""
    monkeypatch.setattr(sys.modules["cboxlab.validation.dataset.preview"], "_THUMBNAILS", 1)
    preview = preview_recipe(recipe_file, folder / "preview.html")
    assert preview.pictures == 4 and preview.page.read_text().count("data:image/png") >= 1
    sizes = [row["bytes"] for row in run.dataset.index]
    assert 0.5 * min(sizes) < preview.bytes_each < 2 * max(sizes)
    # both are clocks: a machine that is busy during one of them makes it several times as long
    assert 0 < 4 * preview.seconds_each < 10 * run.picture_seconds
    assert {path.name for path in folder.iterdir()} >= {"preview.html", "recipe.toml"}
    assert not [*folder.glob("*picture*")]


def test_a_folder_without_a_data_set_is_refused(tmp_path):
    with pytest.raises(InputError, match="state of a data set"):
        open_dataset(tmp_path)


def test_a_large_picture_is_that_of_its_strips(tmp_path, monkeypatch):
    """Labels, points and albedo are the same to the bit; the light differs by its error alone."""
    gloss = '[[effect]]\nid = "veiling-glare"\n[room]'
    path = write_recipe(tmp_path, ("noise = 0.1", "noise = 0.05"), ("[room]", gloss))
    recipe = load_recipe(path)
    box = draw_box(recipe, 0, tmp_path)
    (plain,) = render_pictures([box], "main", recipe, tmp_path)
    monkeypatch.setattr(sys.modules["cboxlab.validation.dataset.picture"], "STRIP_PIXELS", 16 * 5)
    (joined,) = render_pictures([box], "main", recipe, tmp_path)
    assert joined.sizes == plain.sizes and list(joined.data_vars) == list(plain.data_vars)
    for name in ("surface", "material", "coverage", "depth", "position", "normal", "albedo"):
        np.testing.assert_array_equal(joined[name], plain[name])
    visible = plain["surface"].values >= 0
    scale = np.hypot(plain["standard_error"], joined["standard_error"]).values[visible]
    z = (joined["radiance"] - plain["radiance"]).values[visible] / scale
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3  # independent errors of the stated size
    assert check_picture(joined, box, 0.05, 23).faults == ()


def test_pictures_that_do_not_fit_into_memory_are_refused(tmp_path, monkeypatch):
    path = write_recipe(tmp_path, ("width_px = 16", "width_px = 4096"), ("height_px = 16", "height_px = 4096"))
    monkeypatch.setattr(sys.modules["cboxlab.validation.dataset.memory"], "_memory_bytes", lambda: 8e9)
    with pytest.raises(InputError, match=r"camera\[0\].*4096 x 4096 pixels, about 1\d\.\d GB.*at most the 8.0 GB"):
        create_dataset(path, tmp_path / "set")
    assert not (tmp_path / "set").exists()
