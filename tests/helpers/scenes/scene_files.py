"""The text of a small scene file, and what reading it gives."""

import pytest
from cboxlab.scenes import load_scene
from cboxlab.utils.errors import InputError

HEADER = 'format = "scene/1"\nname = "test"\n'
LAMP = """
[lamp]
quads_mm = [[[-1, 10, 1], [-1, 10, -1], [1, 10, -1], [1, 10, 1]]]
radiance = { wavelength_nm = [400, 700], values = [1.0, 2.0] }
"""
WHITE = "\n[material.white]\nreflectance = 0.75\n"
CEILING = """
[[surface]]
name = "ceiling"
material = "white"
quads_mm = [[[-5, 10, 5], [-5, 10, -5], [5, 10, -5], [5, 10, 5]]]
hole = "light"
"""
BLOCK = """
[[surface]]
name = "block"
material = "white"
box = { center_mm = [0, 1, 0], size_mm = [2, 2, 2], yaw_deg = 15 }
"""
GOOD = HEADER + LAMP + WHITE + CEILING + BLOCK


def load(folder, text):
    path = folder / "room.toml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path)


def fault(folder, text):
    with pytest.raises(InputError) as error:
        load(folder, text)
    assert "\n" not in str(error.value)
    return str(error.value)
