"""On a GPU the integrators make the pictures that they make on the CPU. Runs where there is one."""

import os
import subprocess
import sys

import numpy as np
import pytest
from cboxlab.rendering.device import dr, variant

RENDERED = """
import sys
import numpy as np
from cboxlab.rendering.device import variant
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.radiosity import render_final_gather
from cboxlab.scenes import cornell_box, cornell_camera

variant.ensure()
bands = np.array([450.0, 550.0, 650.0])
found = {"variant": sys.modules["mitsuba"].variant()}
for one in (render_final_gather, render_path_tracer, render_general_path_tracer):
    image = one(RenderJob(cornell_box(), cornell_camera(24), bands, samples=256, batches=8, seed=1))
    mean, variance = image.project(np.eye(3))
    found |= {f"{one.__name__} mean": mean, f"{one.__name__} variance": variance, "coverage": image.coverage}
np.savez(sys.argv[1], **found)
"""


def rendered(device, path):
    """What the script writes, in a separate process: a process keeps its variant."""
    where = {**os.environ, "CBOX_DEVICE": device}
    subprocess.run([sys.executable, "-c", RENDERED, str(path)], check=True, env=where)
    return dict(np.load(path))


def compare(ours, other):
    """Two sets of pictures with other random numbers, or the same ones rounded otherwise: within 4.9 standard errors in
    the mean of all pixels, and what a pixel sees the same but at edges."""
    assert (np.abs(ours["coverage"] - other["coverage"]).max(axis=-1) > 0.02).mean() < 0.01
    for key in [name.removesuffix(" mean") for name in ours if name.endswith(" mean")]:
        means = [picture[f"{key} mean"].mean(axis=(0, 1)) for picture in (ours, other)]
        # the bands share their random numbers, so each of them is compared by itself
        errors = [np.sqrt(picture[f"{key} variance"].mean(axis=(0, 1)) / 24**2) for picture in (ours, other)]
        assert np.all(np.abs(means[0] - means[1]) < 4.9 * np.hypot(*errors)), key
        assert np.all(errors[0] < 0.01 * means[0]), key


def test_pictures_on_a_gpu_are_those_of_the_cpu(tmp_path):
    variant.ensure()
    if not dr.has_backend(dr.JitBackend.CUDA):
        pytest.skip("needs an NVIDIA GPU with its driver")
    cpu, gpu = (rendered(device, tmp_path / f"{device}.npz") for device in ("cpu", "cuda"))
    assert str(gpu["variant"]).startswith("cuda") and not str(cpu["variant"]).startswith("cuda")
    compare(cpu, gpu)
