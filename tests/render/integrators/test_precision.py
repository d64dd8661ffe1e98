"""Passes: down to a stated error, interrupted and taken up, on several workers; cubes by strips; bands' covariance."""

import os
from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.files.cube_files import read_cube, write_cube
from cboxlab.rendering.files.cube_strips import strip_cameras, write_strips
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.image.image import RenderedImage
from cboxlab.rendering.integrators import passes, precision
from cboxlab.rendering.integrators.choice import render_image
from cboxlab.rendering.integrators.passes import combined, render_pass
from cboxlab.rendering.integrators.precision import (
    BATCHES,
    fireflies,
    relative_error,
    render_passes,
    render_to_precision,
)
from cboxlab.rendering.radiosity import patched_scene
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import Cancelled, ProgressReporter
from helpers.captures.large_patches import PATCHES
from helpers.scenes.boxes import BANDS

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators"),
    pytest.mark.usefixtures("large_patches"),
]

WHERE = cornell_box(), cornell_camera(12), BANDS


@pytest.mark.parametrize("percentile", [50.0, 90.0])
def test_the_error_asked_for_is_met(percentile, monkeypatch):
    """Its passes have samples of each pixel's own above the median."""
    jobs = []

    def watched(job, report=None):
        jobs.append(job)
        return render_pass(job, report)

    monkeypatch.setattr(precision, "render_pass", watched)
    image = render_to_precision(RenderJob(*WHERE), 0.008, percentile=percentile)
    assert relative_error(image, percentile) <= 0.008
    assert len(image.coefficients) >= BATCHES
    assert {isinstance(job.samples, int) for job in jobs[BATCHES:]} == {percentile == 50.0}


@pytest.mark.parametrize("bsdf", [None, {"type": "roughplastic", "diffuse_reflectance": "reflectance"}])
def test_each_pixel_takes_its_own_samples(bsdf):
    """A pixel is that of an even picture with as many samples, to the bit; of diffuse paint and of a coat."""
    scene = cornell_box()
    white = replace(scene.materials["white"], bsdf=bsdf)
    scene = replace(scene, materials={**scene.materials, "white": white})
    job = RenderJob(scene, *WHERE[1:], samples=32, batches=1, seed=4)
    halvings = np.random.default_rng(0).integers(3, size=(12, 12)).astype(np.uint8)
    mixed = render_pass(replace(job, samples=32 >> halvings.astype(int))).coefficients
    for times in range(3):
        even = render_pass(replace(job, samples=32 >> times)).coefficients
        assert np.array_equal(mixed[:, halvings == times], even[:, halvings == times])


def test_samples_go_where_a_percentile_above_the_median_asks_for_them():
    """Half as many or fewer in all, the error asked for met, the pixels above it no noisier, the median as it is."""
    where = cornell_box(), cornell_camera(32), BANDS
    rough = render_passes(RenderJob(*where, samples=64, batches=BATCHES))
    assert precision._halvings(rough, 50.0, 64) is None
    most = precision._halvings(rough, 95.0, 2**20)
    assert 0.5 <= np.mean(most == most.max()) < 0.7  # those of the median pixel and easier ones
    halvings = precision._halvings(rough, 95.0, 16)
    assert halvings.max() <= 4 and np.mean(0.5**halvings) < 0.5
    job = RenderJob(*where, samples=1024, batches=BATCHES, seed=1)
    even = render_passes(job)
    spread = render_passes(replace(job, samples=1024 >> halvings.astype(int)))
    assert relative_error(spread, 95.0) < 1.5 * relative_error(even, 95.0)
    hard = halvings == 0
    assert 0.05 <= hard.mean() < 0.6
    assert np.array_equal(spread.coefficients[:, hard], even.coefficients[:, hard])
    width = [np.subtract(*np.log([relative_error(image, p) for p in (95.0, 25.0)])) for image in (spread, even)]
    assert width[0] < 0.7 * width[1]


def test_an_interrupted_picture_goes_on_where_it_stopped(tmp_path, monkeypatch):
    """Stopped after three passes: the rest alone is rendered, and the picture is that of one go, to the bit."""
    passes = tmp_path / "cube.nc.passes"
    image = render_to_precision(RenderJob(*WHERE), 0.004)
    rendered = []

    def watched(job, report=None):
        if job.samples > precision.PILOT_SAMPLES:
            if len(rendered) == 3:
                raise KeyboardInterrupt
            rendered.append(job.first_batch)
        return render_pass(job, report)

    monkeypatch.setattr(precision, "render_pass", watched)
    with pytest.raises(KeyboardInterrupt):
        render_to_precision(RenderJob(*WHERE), 0.004, checkpoint=passes)
    assert rendered == [0, 1, 2]
    monkeypatch.setattr(precision, "render_pass", render_pass)
    messages = []
    reporter = ProgressReporter(lambda stage, done: messages.append((stage, done)))
    resumed = render_to_precision(RenderJob(*WHERE), 0.004, checkpoint=passes, progress=reporter)
    assert list(dict.fromkeys(stage for stage, _ in messages)) == ["rendering with few samples", "rendering"]
    parts = [done for stage, done in messages if stage == "rendering"]
    first = parts[: parts.index(1.0) + 1]  # if the passes do not suffice, more follow
    assert first == sorted(first) and parts[-1] == 1
    assert parts[0] == 3 / BATCHES
    assert np.array_equal(resumed.coefficients, image.coefficients)
    other = render_to_precision(RenderJob(*WHERE, seed=5), 0.004, checkpoint=passes)
    assert not np.array_equal(other.coefficients, image.coefficients)
    passes.write_bytes(b"broken")
    assert np.array_equal(
        render_to_precision(RenderJob(*WHERE), 0.004, checkpoint=passes).coefficients, image.coefficients
    )


def test_a_cancelled_picture_keeps_whole_passes_alone(tmp_path):
    """Cancelled in its third pass: two are kept, no unfinished file is left, and nothing more is rendered."""
    passes = tmp_path / "cube.nc.passes"

    def cancel_in_third_pass(stage, done):
        if stage == "rendering" and 2 / BATCHES < done:
            reporter.cancel()

    reporter = ProgressReporter(cancel_in_third_pass)
    with pytest.raises(Cancelled):
        render_to_precision(RenderJob(*WHERE), 0.004, checkpoint=passes, progress=reporter)
    assert [path.name for path in tmp_path.iterdir()] == [passes.name]
    stages = []
    resumed = ProgressReporter(lambda stage, done: stages.append(done) if stage == "rendering" else None)
    render_to_precision(RenderJob(*WHERE), 0.004, checkpoint=passes, progress=resumed)
    assert stages[0] == pytest.approx(3 / BATCHES)
    reporter = ProgressReporter()
    reporter.cancel()
    with pytest.raises(Cancelled):
        render_to_precision(RenderJob(*WHERE), 0.004, progress=reporter)


def test_passes_are_the_batches_of_one_picture():
    parts = [render_pass(RenderJob(*WHERE, 16, seed=3).batch(n)) for n in range(3)]
    image = render_image(RenderJob(*WHERE, samples=16, batches=3, seed=3))
    assert np.array_equal(combined(parts).coefficients, image.coefficients)


def test_another_machines_basis_makes_no_difference():
    """Spectra of other signs and order, coefficients to match: combined into the first's basis exactly."""
    first, second = (render_pass(RenderJob(*WHERE, 8).batch(n)) for n in range(2))
    order = np.random.default_rng(1).permutation(len(second.spectra))
    turned = replace(second, spectra=-second.spectra[order], coefficients=-second.coefficients[..., order])
    a, b = (combined([first, x]).project(np.eye(3))[0] for x in (second, turned))
    assert a == pytest.approx(b, rel=1e-4, abs=1e-9)


def test_a_worker_that_dies_costs_its_pass_only(tmp_path):
    """A worker process that its last pass kills once, and that starts again: the picture is the one rendered here."""
    distributed = pytest.importorskip("distributed", reason="needs dask[distributed], of the extra 'distributed'")
    jobs = [RenderJob(*WHERE, 8).batch(n) for n in range(3)]
    marker = tmp_path / "died"
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        futures = [client.submit(_dying_once, job, str(marker), pure=False) for job in jobs]
        images = client.gather(futures)
        shared = dict(
            (job.first_batch, image) for job, image in passes.distributed(jobs[:2], cluster.scheduler_address)
        )
    assert marker.exists()
    assert np.array_equal(shared[1].coefficients, images[1].coefficients)
    local = [render_pass(job) for job in jobs]
    for remote, other in zip(images, local, strict=True):
        assert combined([other, remote]).coefficients[1] == pytest.approx(other.coefficients[0], rel=1e-4, abs=1e-6)


def _dying_once(job, marker):
    patched_scene.PATCHES_PER_DIAGONAL = PATCHES  # in the worker, as here
    if job.first_batch == 2 and not os.path.exists(marker):
        open(marker, "w").close()
        os._exit(1)
    return render_pass(job)


def test_a_scheduler_that_is_not_there(monkeypatch):
    monkeypatch.setattr(passes, "TIMEOUT_S", 0.5)
    pytest.importorskip("distributed", reason="needs dask[distributed], of the extra 'distributed'")
    with pytest.raises(InputError, match=r"scheduler: found no answer from tcp://127.0.0.1:9"):
        render_to_precision(RenderJob(*WHERE), 0.004, scheduler="tcp://127.0.0.1:9")


def test_strips_make_up_the_cube(tmp_path):
    """Written strip by strip, read as a whole: the same values, units and names."""
    cube = render_image(RenderJob(*WHERE, samples=4, batches=2)).cube()
    write_cube(tmp_path / "whole.nc", cube)
    write_strips(tmp_path / "strips.nc", 12, (cube.isel(y=slice(top, top + 5)) for top in range(0, 12, 5)))
    assert read_cube(tmp_path / "strips.nc").identical(read_cube(tmp_path / "whole.nc"))
    with pytest.raises(InputError, match=r"found strips of 10 rows; expected 12 rows"):
        write_strips(tmp_path / "short.nc", 12, (cube.isel(y=slice(top, top + 5)) for top in (0, 5)))
    assert not (tmp_path / "short.nc").exists()


def test_strips_of_a_camera_see_what_it_sees():
    camera = cornell_camera(20)
    parts = strip_cameras(camera, rows=8)
    assert [p.height_px for p in parts] == [8, 8, 4]
    v, u = np.indices((20, 20))
    rays = [p.directions(*np.indices((p.height_px, 20))[::-1]) for p in parts]
    assert np.concatenate(rays) == pytest.approx(camera.directions(u, v), abs=1e-12)


def test_covariance_between_bands_is_kept():
    """Two wavelengths share their paths: the variance of their sum, over pixels, is that of summed batches and far
    from the sum of their variances."""
    image = render_image(RenderJob(*WHERE, samples=16, batches=8))
    each = image.project(np.eye(3))[1][..., 1:].sum(axis=-1)
    both = image.project(np.array([[0.0], [1.0], [1.0]]))[1][..., 0]
    summed = (image.coefficients @ image.spectra)[..., 1:].sum(axis=-1).var(axis=0, ddof=1) / 8
    assert both == pytest.approx(summed, rel=1e-3, abs=1e-12 * summed.max())
    assert np.median((both / each)[each > 0]) > 1.5


def test_fireflies_are_reported():
    """Gaussian noise in 8 batches has none (false alarms: 1 in 1000); one batch of one pixel too bright is found."""
    values = 1 + 0.01 * np.random.default_rng(5).standard_normal((8, 64, 64, 3)).astype(np.float32)
    image = RenderedImage(
        values,
        np.eye(3),
        np.array([450.0, 550.0, 650.0]),
        np.ones((64, 64, 1), np.float32),
        np.zeros(1, int),
        (),
    )
    assert not fireflies(image).any()
    values[3, 10, 20] += 5.0
    assert np.argwhere(fireflies(image)).tolist() == [[10, 20]]
    assert not fireflies(replace(image, coefficients=values[:2])).any()
