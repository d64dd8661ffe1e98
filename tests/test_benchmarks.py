"""Every benchmark can be loaded: none imports what has moved."""

import importlib
import sys
from pathlib import Path

import pytest
from cboxlab.render.variant import compiled

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py")))
def test_benchmark_loads(name):
    importlib.import_module(name)
