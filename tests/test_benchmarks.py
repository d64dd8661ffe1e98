"""Every benchmark can be loaded: none imports what has moved."""

import importlib
import sys

import pytest
from cboxlab.render.device.variant import compiled
from helpers.places import ROOT

BENCHMARKS = ROOT / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py")))
def test_benchmark_loads(name):
    importlib.import_module(name)
