"""The folder of the manual on the path, for benchmarks that read the tables of its generated pages: import this."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "docs"))
