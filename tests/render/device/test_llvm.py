"""Which LLVM compiles: never one that aborts the process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from cboxlab.rendering.device.variant import compiled

needs_llvm = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")
OLD_LLVM = next((str(p) for p in sorted(Path("/usr/lib").glob("*/libLLVM-15.so*"))), None)


@needs_llvm
@pytest.mark.parametrize(("release", "first"), [("missing", ""), ("15", ""), ("15", "import drjit; ")])
def test_a_library_that_does_not_work_is_passed_over(release, first):
    """What DRJIT_LIBLLVM_PATH names is left for a newer library, or, too late for that, for the stock integrator."""
    library = "/missing/libLLVM.so" if release == "missing" else OLD_LLVM
    if library is None:
        pytest.skip("needs LLVM 15, which does not work, next to one that does")
    program = (
        first
        + """
import numpy as np
from cboxlab.rendering.device import variant
from cboxlab.rendering.integrators import RenderJob, render_image
from cboxlab.scenes import cornell_box, cornell_camera
image = render_image(RenderJob(cornell_box(), cornell_camera(8), np.linspace(400, 700, 4), samples=2, batches=2))
assert image.project(np.eye(4))[0].mean() > 0
print("compiled" if variant.compiled() else "stock")
"""
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "DRJIT_LIBLLVM_PATH": library},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ("stock" if first else "compiled")
