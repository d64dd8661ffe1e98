"""One kernel serves pictures of all sizes and numbers of samples: compilation takes longer than a small picture."""

import numpy as np
import pytest
from cboxlab.rendering.device import dr
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.integrators.path_tracer import render_path_tracer
from cboxlab.scenes import cornell_box, cornell_camera

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


def kernels(renderer, size, samples, batches):
    """Hashes of the kernels that one picture needs."""
    dr.kernel_history_clear()
    renderer(RenderJob(cornell_box(), cornell_camera(size), np.array([450.0, 550.0]), samples, batches))
    return {row["hash"] for row in dr.kernel_history() if row["type"] == dr.KernelType.JIT}


@pytest.mark.parametrize("renderer", [render, render_path_tracer, render_general_path_tracer])
def test_another_picture_needs_no_other_kernel(renderer):
    """Two widths, one of them a power of two, by which a literal would be divided with shifts."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        first = kernels(renderer, 16, 8, 2)
        other = kernels(renderer, 21, 16, 3)
        dr.kernel_history_clear()
    assert first and other <= first
