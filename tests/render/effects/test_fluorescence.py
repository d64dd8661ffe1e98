"""Fluorescence with all its reflections, before and after, against photons followed one by one through a closed box."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.perturbation.patch_light import patch_light
from cboxlab.rendering.perturbation.patch_transport import build_patch_transport
from cboxlab.rendering.radiosity.final_gather import solve_light
from cboxlab.scenes import Material, Spectrum
from helpers.scenes.boxes import EDGE, box_with_lamp, camera_inside
from scipy.stats import t as student

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: tests of the compiled integrators")

GRID = np.arange(400.0, 701.0)
SEEN_NM, PEAK_NM, YIELD = np.array([520.0]), 510.0, 0.3
LAMP_HALF, PHOTONS, BATCHES = 200.0, 60_000, 8
#: Reflectance below 460 nm and above, of the dyed floor and of the rest.
DYE, REST = (0.2, 0.7), (0.6, 0.5)
WALLS = {"left": (0, 0.0), "right": (0, EDGE), "floor": (1, 0.0), "ceiling": (1, EDGE), "back": (2, EDGE)}
#: One false alarm in a million comparisons; beyond the photons' error patches may be wrong by this part.
T_LIMIT, PATCHES = float(student.isf(0.5e-6, BATCHES - 1)), 0.01


def paint(name, reflectance):
    short, long = reflectance
    return Material(name, Spectrum(np.array([300.0, 460.0, 461.0, 900.0]), np.array([short, short, long, long])))


def cosine(random, axis, inward):
    """Directions (n, 3) by Lambert's law about inward times an axis."""
    u, v = random.uniform(size=(2, len(axis)))
    around = [np.sqrt(u) * np.cos(2 * np.pi * v), np.sqrt(u) * np.sin(2 * np.pi * v)]
    result, rows = np.empty((len(axis), 3)), np.arange(len(axis))
    result[rows, axis] = inward * np.sqrt(1 - u)
    result[rows, (axis + 1) % 3], result[rows, (axis + 2) % 3] = around
    return result


def hit(position, direction):
    """Where rays inside the cube end: points (n, 3), axis and side (n,) of the wall; on = not on the lamp."""
    with np.errstate(divide="ignore"):
        ways = (np.where(direction > 0, EDGE, 0.0) - position) / direction
    axis = np.argmin(np.where(direction == 0, np.inf, ways), axis=1)
    rows = np.arange(len(axis))
    point = position + ways[rows, axis][:, None] * direction
    side = (direction[rows, axis] > 0).astype(int)
    point[rows, axis] = side * EDGE
    away = np.abs(point - EDGE / 2)
    lamp = (axis == 1) & (side == 1) & (away[:, 0] < LAMP_HALF) & (away[:, 2] < LAMP_HALF)
    return point, axis, side, ~lamp


def followed(random, position, direction, band, arrived):
    """Follow photons until they are absorbed; ``arrived`` receives each arrival and what is reflected there."""
    while len(position):
        point, axis, side, on = hit(position, direction)
        point, axis, side = point[on], axis[on], side[on]
        floor = (axis == 1) & (side == 0)
        goes_on = random.uniform(size=len(axis)) < np.where(floor, DYE[band], REST[band])
        arrived(point, axis, side, goes_on)
        position, axis, side = point[goes_on], axis[goes_on], side[goes_on]
        direction = cosine(random, axis, 1.0 - 2.0 * side)


def photons(seed):
    """Fluorescent light that leaves each wall, over the lamp's flux times the absorbed part's yield."""
    random = np.random.default_rng(seed)
    x, z = EDGE / 2 + LAMP_HALF * random.uniform(-1, 1, (2, PHOTONS))
    down = np.full(PHOTONS, 1)
    hits = []
    followed(
        random,
        np.column_stack([x, np.full(PHOTONS, EDGE), z]),
        cosine(random, down, -1.0),
        0,
        lambda point, axis, side, goes_on: hits.append(point[(axis == 1) & (side == 0)]),
    )
    glowing = np.concatenate(hits)
    leaving = {name: 0.0 for name in WALLS}
    leaving["floor"] += len(glowing)

    def arrived(point, axis, side, goes_on):
        for name, (photon_share, corner) in WALLS.items():
            leaving[name] += np.sum(goes_on & (axis == photon_share) & (side == (corner > 0)))

    up = np.full(len(glowing), 1)
    followed(random, glowing, cosine(random, up, 1.0), 1, arrived)
    return np.array([leaving[name] for name in WALLS]) / PHOTONS


@pytest.fixture(scope="module")
def box():
    """Scene, its light, and a function of the lamp's spectrum (301,): radiance (patch,) that the dyed floor adds."""
    scene = box_with_lamp(0.5, LAMP_HALF)
    surfaces = tuple(replace(s, material="red" if s.name == "floor" else "white") for s in scene.surfaces)
    scene = replace(scene, surfaces=surfaces, materials={"red": paint("red", DYE), "white": paint("white", REST)})
    field = solve_light(scene, SEEN_NM, patch_edge_mm=90.0, patch_samples=1024)
    transport = build_patch_transport(field, camera_inside(8), 16)
    effect = apply_checked("fluorescence", {"material": "red", "yield": YIELD, "peak_nm": PEAK_NM}, "test")

    def added(lamp):
        at_seen = (GRID == SEEN_NM[:, None]).astype(float)
        before = patch_light(transport, scene, SEEN_NM, GRID, at_seen, lamp)
        return (effect.apply(before).patch_radiance() - before.patch_radiance())[:, 0]

    return scene, field, added


def test_a_line_excites_by_its_own_wavelength(box):
    """Of absorbed quanta, in steps of 5 nm: a lamp with a line of 420 nm over one that is even from 400 to 455 nm."""
    _, _, added = box
    line = added(np.where(GRID < 460, 1.0 * (GRID == 420), 1.0))
    absorbed = np.arange(400.0, 456.0, 5.0)
    np.testing.assert_allclose(line, added(np.ones(GRID.size)) * 420 / (absorbed.sum() - (400 + 455) / 2), rtol=1e-4)


def test_fluorescence_reaches_every_wall_as_photons_do(box):
    scene, field, added = box
    change = added(np.ones(GRID.size))
    surface = field.patches.surface
    names = [s.name for s in scene.surfaces]
    results = [
        np.average(change[mask], weights=field.patches.area[mask])
        for mask in (surface == names.index(name) for name in WALLS)
    ]

    batches = np.array([photons(seed) for seed in range(BATCHES)])
    areas = np.array([EDGE**2 - (4 * LAMP_HALF**2 if name == "ceiling" else 0) for name in WALLS])
    bell = np.exp(-0.5 * ((SEEN_NM[0] - PEAK_NM) / 24.0) ** 2) / (24.0 * np.sqrt(2 * np.pi))
    quanta = (1 - DYE[0]) * (455.0**2 - 400.0**2) / 2  # absorbed of a flat spectrum of 1, by nm times nm
    scale = YIELD * quanta * bell / SEEN_NM[0] * 4 * LAMP_HALF**2 / areas
    expected, error = batches.mean(axis=0) * scale, batches.std(axis=0, ddof=1) / np.sqrt(BATCHES) * scale
    assert np.all(error < 0.02 * expected)
    assert np.all(np.abs(results - expected) < PATCHES * expected + T_LIMIT * error), (results / expected, error)
