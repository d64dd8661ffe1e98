"""Lights by name: relative spectra of CIE illuminants and black bodies, for the lamps of scenes."""

import numpy as np
import pytest
from cboxlab.scenes.named_lights import named_light
from cboxlab.scenes.scene_file import PACKAGED, load_scene
from cboxlab.utils.errors import InputError


@pytest.mark.parametrize("name", ["A", "D50", "D65", "F1", "F11", "planck 2900", "planck 2856 K"])
def test_a_light_is_one_at_560_nm(name):
    light = named_light(name)
    assert light.at(560.0) == pytest.approx(1.0, abs=1e-12)
    assert light.at(100.0) == 0.0
    assert light.values.min() >= 0


def test_the_published_tables():
    """CIE 15: A and D65 at 460 and 700 nm, in per cent of their value at 560 nm."""
    assert named_light("A").at([460.0, 700.0]) == pytest.approx([0.378121, 1.98261], rel=1e-5)
    assert named_light("D65").at([460.0, 700.0]) == pytest.approx([1.17812, 0.716091], rel=1e-5)


def test_illuminant_a_is_nearly_a_black_body():
    """CIE 15 defines A by Planck's law at 2848 K with c2 = 1.435e-2 m K, 2855.5 K with today's c2."""
    wavelength = np.arange(400.0, 701.0, 10.0)
    assert named_light("planck 2855.5").at(wavelength) == pytest.approx(named_light("A").at(wavelength), rel=2e-4)


@pytest.mark.parametrize("name", ["a", "D651", "F13", "planck", "planck x", "planck -3", "lamp.csv:A", ""])
def test_other_names_are_none(name):
    assert named_light(name) is None


@pytest.mark.parametrize("name", ["planck 10", "planck 1000000"])
def test_a_temperature_out_of_range_is_refused(name):
    with pytest.raises(InputError, match="500 to 50000"):
        named_light(name)


def scene_with(tmp_path, radiance):
    text = (PACKAGED / "cornell-box.toml").read_text()
    lamp = text[text.index("[lamp]") if "[lamp]" in text else text.index("[[lamp]]") :]
    line = next(line for line in lamp.splitlines() if line.startswith("radiance"))
    for data in PACKAGED.glob("*.csv"):
        (tmp_path / data.name).write_bytes(data.read_bytes())
    path = tmp_path / "box.toml"
    path.write_text(text.replace(line, f"radiance = {radiance!r}"))
    return path


@pytest.mark.parametrize("name", ["D65", "planck 2900"])
def test_a_scene_takes_a_light_by_name(tmp_path, name):
    scene = load_scene(scene_with(tmp_path, name))
    assert np.array_equal(scene.lamp.radiance.values, named_light(name).values)
    assert all(path.is_file() for path in scene.origin.files)


@pytest.mark.parametrize("name", ["D64", "planck 3"])
def test_a_scene_refuses_another_name(tmp_path, name):
    with pytest.raises(InputError, match="radiance"):
        load_scene(scene_with(tmp_path, name))
