"""Illuminances against closed forms: configuration factors of a square lamp, and the balance of a closed box."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.photometry import surface_illuminance, tristimulus_weights
from cboxlab.rendering.photometry.illuminance import _resting
from cboxlab.scenes import Spectrum, Surface
from cboxlab.scenes.shapes import box_mesh
from cboxlab.utils.errors import InputError
from helpers.scenes.boxes import EDGE, FLAT, box_with_lamp

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

GRID = np.arange(400.0, 701.0, 30.0)
HALF = 200.0

#: Luminance, cd m^-2, of the lamp of ``box_with_lamp``, 1 W m^-2 sr^-1 nm^-1 at all wavelengths.
LAMP = float(tristimulus_weights(GRID)[:, 1].sum())


def corner(a, b):
    """Configuration factor from a point to a parallel rectangle a x b at unit distance, one corner above the point."""
    p, q = np.sqrt(1 + a**2), np.sqrt(1 + b**2)
    return (a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / (2 * np.pi)


def lamp_over_floor(x, z):
    """Configuration factor from points of the floor, relative to its middle, to the lamp in the ceiling."""
    sides = [((HALF - s * x) / EDGE, (HALF - t * z) / EDGE) for s in (1, -1) for t in (1, -1)]
    return sum(np.sign(a) * np.sign(b) * corner(np.abs(a), np.abs(b)) for a, b in sides)


def test_direct_light_on_the_floor_is_the_lamps_configuration_factor():
    """Black walls. Mean over the floor by Gauss-Legendre; 2048 samples of each patch, floor of 0.01 %."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    x, z = np.meshgrid(nodes * EDGE / 2, nodes * EDGE / 2)
    mean = np.sum(np.outer(weights, weights) * lamp_over_floor(x, z)) / 4
    illuminance = surface_illuminance(box_with_lamp(0.0), GRID)
    assert illuminance["floor"] == pytest.approx(np.pi * LAMP * mean, rel=5e-4)
    assert illuminance["ceiling"] == 0 and np.isnan(illuminance["light"])
    walls = [illuminance[name] for name in ("left", "right", "back", "front")]
    flux = 4 * HALF**2 / EDGE**2  # what the lamp sends out, by reciprocity, falls on floor and walls
    assert walls == pytest.approx([np.pi * LAMP * (flux - mean) / 4] * 4, rel=2e-3)


def areas(scene):
    return {surface.name: float(surface.areas_mm2.sum()) for surface in scene.all_surfaces}


@pytest.mark.parametrize("rho", [0.3, 0.8])
def test_a_closed_box_of_one_reflectance_balances(rho):
    """All surfaces, the lamp too, reflect rho: the flux that arrives is the lamp's over 1 - rho."""
    scene = box_with_lamp(rho, reflectance=FLAT.scaled(rho))
    illuminance, size = surface_illuminance(scene, GRID), areas(scene)
    flux = np.pi * LAMP * size["light"]
    assert sum(size[n] * illuminance[n] for n in size) == pytest.approx(flux / (1 - rho), rel=1e-3)
    for bounces, orders in ((1, 1.0), (2, 1 + rho), (3, 1 + rho + rho**2)):
        cut = surface_illuminance(scene, GRID, max_bounces=bounces)
        assert sum(size[n] * cut[n] for n in size) == pytest.approx(flux * orders, rel=1e-3)


def test_what_stands_on_a_floor_takes_its_place():
    """A block covers part of the floor, also parts of patches: the balance holds for the surfaces that are open."""
    edge = 333.0
    block = Surface("block", "grey", *box_mesh((400.0, edge / 2, 450.0), (edge, edge, edge), 20.0))
    empty = box_with_lamp(0.5, reflectance=FLAT.scaled(0.5))
    scene = replace(empty, surfaces=(*empty.surfaces, block))
    illuminance, size = surface_illuminance(scene, GRID), areas(scene)
    size["floor"] -= edge**2
    size["block"] = 5 * edge**2  # its underside is in the dark
    flux = np.pi * LAMP * size["light"]
    assert sum(size[n] * illuminance[n] for n in size) == pytest.approx(flux / 0.5, rel=1e-3)


def test_an_underside_rests_where_a_floor_is_right_below_it():
    """Over both triangles of a floor of 10 x 8 mm, not next to it, above it or turned away from it."""
    a, b, c, d = np.array([[0.0, 0, 0], [0, 0, 8], [10, 0, 8], [10, 0, 0]])
    tracer = SimpleNamespace(vertices=np.array([[a, b, c], [a, c, d]]), normals=np.array([[0.0, 1, 0]] * 2))
    centre = np.array([[1.0, 0, 7], [9, 0, 1], [11, 0, 4], [5, 0, 9], [-1, 0, 1], [5, 2, 4], [5, 0, 4]])
    down = np.array([[0.0, -1, 0]] * 6 + [[0.0, 1, 0]])
    exchange = SimpleNamespace(escape=np.ones(7), direct=np.zeros((7, 1)))
    patched = SimpleNamespace(patches=SimpleNamespace(centre=centre, normal=down), exchange=exchange, tracer=tracer)
    assert _resting(patched).tolist() == [True, True, False, False, False, False, False]


def test_each_lamp_has_its_own_spectrum():
    """A second lamp in the place of the first, at another spectrum: light adds up."""
    warm = Spectrum(np.array([400.0, 700.0]), np.array([0.5, 3.0]))
    both = surface_illuminance(box_with_lamp(0.5), GRID)
    weights = tristimulus_weights(GRID)[:, 1]
    scene = box_with_lamp(0.5)
    scene = replace(scene, lamp=replace(scene.lamp, radiance=warm))
    illuminance = surface_illuminance(scene, GRID)
    ratio = weights @ warm.at(GRID) / weights.sum()  # grey walls keep the spectrum
    assert [illuminance[n] for n in both if n != "light"] == pytest.approx(
        [ratio * both[n] for n in both if n != "light"], rel=1e-5
    )


def test_a_scene_that_is_not_diffuse_is_refused():
    scene = box_with_lamp(0.5)
    rough = replace(scene.materials["grey"], bsdf={"type": "roughconductor"})
    with pytest.raises(InputError, match="Lambertian"):
        surface_illuminance(replace(scene, materials={"grey": rough}), GRID)
