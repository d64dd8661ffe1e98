"""Importing this makes the oracles of the tests importable: ``from oracles import mitsuba_effects``."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
