"""Every benchmark can be loaded: none imports what has moved. Hidden effects fit every box of the blind practice."""

import importlib
import sys

import pytest
from cboxlab.render.device.variant import compiled
from cboxlab.scenes.scene_file import load_scene
from helpers.places import ROOT

BENCHMARKS = ROOT / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py")))
def test_benchmark_loads(name):
    importlib.import_module(name)


def test_effects_outside_the_catalogue_act_in_every_box():
    """A paint of another colour, a cube on the floor: whatever stands in the room."""
    boxes, outside = (
        importlib.import_module("blind_places"),
        importlib.import_module("outside_effects").OUTSIDE,
    )
    of_scenes = [effect for effect in outside.values() if effect.stage == "scene"]
    assert len(of_scenes) == 2
    for box in boxes.BOXES:
        scene = load_scene(boxes.scene_of(box))
        for effect in of_scenes:
            for row in (0.0, 0.6, 1.0):
                changed = effect.apply(scene, amount=0.3, row=row, column=0.5)
                assert {s.material for s in changed.surfaces} <= set(changed.materials)
                assert [s.material for s in changed.surfaces] != [s.material for s in scene.surfaces]
