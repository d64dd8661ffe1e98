"""Camera files: written and read back, aimed by a point, refused in one message."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.export import read_camera
from cboxlab.rendering.files.cube_camera import camera_attribute, camera_of_attribute
from cboxlab.scenes import cornell_camera
from cboxlab.scenes.lens import Lens
from cboxlab.utils.errors import InputError
from helpers.files.camera_files import write_camera


def test_a_camera_comes_back_from_its_file(tmp_path):
    camera = cornell_camera(64).with_parameters([250, 300, -700, 3, -5, 2, 90, 30, 33, -0.05])
    write_camera(tmp_path / "camera.json", camera)
    again = read_camera(tmp_path / "camera.json")
    assert np.allclose(again.parameters, camera.parameters, rtol=1e-12, atol=1e-12)
    assert (again.width_px, again.height_px) == (64, 64)


def test_a_lens_of_more_terms_comes_back_too(tmp_path):
    lens = Lens("fisheye", k2=0.02, k3=-0.01, k4=0.003, aspect=1.02)
    camera = replace(cornell_camera(64), k1=-0.05, lens=lens)
    write_camera(tmp_path / "camera.json", camera)
    assert read_camera(tmp_path / "camera.json").lens == lens
    assert camera_of_attribute(camera_attribute(camera)).lens == lens
    assert camera_of_attribute(camera_attribute(cornell_camera(64))).lens == Lens()


def written(tmp_path, **changes):
    entry = {
        "format": "camera/1",
        "width_px": 40,
        "height_px": 30,
        "position_mm": [10, 20, 30],
        "look_at_mm": [10, 20, 90],
        "focal_length_px": 50,
        **changes,
    }
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({k: v for k, v in entry.items() if v is not None}))
    return path


def test_the_point_looked_at_is_in_the_middle_and_up_is_up(tmp_path):
    camera = read_camera(written(tmp_path, look_at_mm=[100, 60, 200], up=[0, 1, 0]))
    middle, above = camera.project([[100, 60, 200], [100, 70, 200]])
    assert np.allclose(middle, [19.5, 14.5])
    assert above[1] < middle[1] and abs(above[0] - middle[0]) < 1e-9
    assert np.linalg.det(camera.rotation) == pytest.approx(1)


@pytest.mark.parametrize(
    ("changes", "phrases"),
    [
        ({"look_at_mm": None}, "neither rotation nor look_at_mm"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "rotation and look_at_mm"),
        ({"look_at_mm": None, "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "no rotation"),
        ({"look_at_mm": [10, 90, 30]}, "direction of up"),
        ({"focal_length_px": -1}, "focal_length_px"),
        ({"width": 3}, "width"),
        ({"lens": {"model": "fisheye", "p1": 0.1}}, "no p1 in a lens of the model 'fisheye'"),
        ({"lens": {"k4": 0.1}}, "no k4"),
        ({"lens": {"aspect": 0}}, "aspect"),
        ({"position_mm": [1, 2]}, "position_mm"),
    ],
)
def test_a_faulty_file_is_refused_in_one_message(tmp_path, changes, phrases):
    with pytest.raises(InputError, match=phrases):
        read_camera(written(tmp_path, **changes))
