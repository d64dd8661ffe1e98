"""The same seed gives the same bits with one thread or several, and in another process."""

import hashlib
import subprocess
import sys

import drjit as dr
import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob, film
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.perturbation.patch_transport import build_patch_transport
from cboxlab.rendering.radiosity.final_gather import gather, render_final_gather, solve_light
from cboxlab.scenes import cornell_box, cornell_camera

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")


def digest():
    """Of small pictures by both integrators, and of the exchange that predicts effects."""
    scene, camera, bands = cornell_box(), cornell_camera(16), np.array([450.0, 650.0])
    light = solve_light(scene, bands, patch_edge_mm=150.0, patch_samples=256, seed=3)
    transport = build_patch_transport(light, camera, 64, seed=3)
    arrays = (
        gather(light, camera, 16, 2, seed=3).coefficients,
        render_path_tracer(RenderJob(scene, camera, bands, samples=16, batches=2, seed=3)).coefficients,
        transport.direct,
        transport.gather.data,
        transport.gather.indices,
    )
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()


def test_one_thread_in_another_process_changes_no_bit():
    if dr.thread_count() == 1:
        pytest.skip("needs more than one core")
    code = "import drjit; drjit.set_thread_count(1); from test_determinism import digest; print(digest())"
    run = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=__file__.rpartition("/")[0],
    )
    assert run.stdout.split()[-1] == digest()


@pytest.mark.parametrize("render", [render_final_gather, render_path_tracer, render_general_path_tracer])
def test_how_many_batches_one_kernel_call_computes_changes_no_bit(monkeypatch, render):
    """Five batches of 256 pixels, a quarter of them with twice the samples: in calls of 2^16 lanes, and of 100."""
    samples = np.where(np.indices((16, 16)).sum(axis=0) % 4 == 0, 32, 16)
    results = []
    for lanes in (2**16, 100):
        monkeypatch.setattr(film, "_LANES_PER_CALL", lanes)
        bands = np.array([450.0, 650.0])
        image = render(RenderJob(cornell_box(), cornell_camera(16), bands, samples=samples, batches=5, seed=3))
        results.append(image.coefficients)
    np.testing.assert_array_equal(*results)
    assert np.unique(results[0].mean(axis=(1, 2, 3))).size == 5  # batches differ
