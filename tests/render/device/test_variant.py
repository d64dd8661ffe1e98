"""No import chooses how a process computes; the first computation does, in whichever thread."""

import subprocess
import sys

import pytest
from cboxlab.rendering.device.variant import compiled

IMPORT_ALL = """
import importlib, os, pkgutil, sys
before = dict(os.environ)
imported = set()
for room in ("scenes", "calibration", "rendering", "validation"):
    package = importlib.import_module("cboxlab." + room)
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
        imported.add(room)
after = dict(os.environ)
after.pop("LD_LIBRARY_PATH", None), before.pop("LD_LIBRARY_PATH", None)  # OpenCV prepares it for child processes
assert after == before, set(after.items()) ^ set(before.items())
"""

RENDER = """
import numpy as np
from cboxlab.rendering.integrators import RenderJob, render_image
from cboxlab.scenes import cornell_box, cornell_camera

def picture():
    image = render_image(RenderJob(cornell_box(), cornell_camera(8), np.linspace(400, 700, 4), samples=2, batches=2))
    return bool(image.project(np.eye(4))[0].mean() > 0)
"""


def run(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_an_import_leaves_the_caller_the_variant_that_it_chose():
    program = "import mitsuba as mi; mi.set_variant('scalar_rgb')\n" + IMPORT_ALL + "print(mi.variant())"
    assert run(program) == "scalar_rgb"


@pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")
def test_imports_settle_nothing_and_a_thread_computes_as_the_first_one_does():
    """Mitsuba's variant belongs to a thread: another one takes the same, not none. The environment stays as it is.

    On the default device, and in a fork of the process, which shares its imports, on a stated one.
    """
    program = f"""
{IMPORT_ALL}
print(len(imported), 'drjit' in sys.modules or 'mitsuba' in sys.modules, flush=True)
fork = os.fork()
if fork: os.waitpid(fork, 0)
import threading
{RENDER}
from cboxlab.rendering.device import mi, variant
if not fork: variant.use("scalar")
variants = [mi.variant()]
threads = [threading.Thread(target=lambda: variants.append((picture(), mi.variant()))) for _ in range(2)]
for thread in threads:
    thread.start()
    thread.join()
print(variants, dict(os.environ) == {{**os.environ, **before}})
"""
    expected = [f"{[name, (True, name), (True, name)]} True" for name in ("scalar_spectral", "llvm_ad_mono")]
    assert run(program).splitlines() == ["4 False", *expected]
