"""One kernel serves pictures of all sizes and numbers of samples: compilation takes longer than a small picture."""

import numpy as np
import pytest
from cboxlab.rendering.device import dr
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.rendering.perturbation import build_patch_transport
from cboxlab.rendering.radiosity import solve_light
from cboxlab.scenes import cornell_box, cornell_camera

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


BANDS = np.array([450.0, 550.0])


def kernels(computation, *arguments):
    """Hashes of the kernels that a computation needs."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        computation(*arguments)
        return {row["hash"] for row in dr.kernel_history() if row["type"] == dr.KernelType.JIT}


@pytest.mark.parametrize("renderer", [render_image, render_path_tracer, render_general_path_tracer])
def test_another_picture_needs_no_other_kernel(renderer):
    """Two widths, one of them a power of two, by which a literal would be divided with shifts."""
    first, other = (
        kernels(renderer, RenderJob(cornell_box(), cornell_camera(size), BANDS, samples, batches))
        for size, samples, batches in ((16, 8, 2), (21, 16, 3))
    )
    assert first and other <= first


def test_the_exchange_of_another_picture_needs_no_other_kernel():
    """Where sums were kept apart by thread, their number was part of the code."""
    light = solve_light(cornell_box(), BANDS, patch_edge_mm=150.0, patch_samples=64)
    first, other = (kernels(build_patch_transport, light, cornell_camera(size), 16) for size in (16, 21))
    assert first and other <= first
