"""Simple boxes with analytic answers, and cameras inside them."""

import numpy as np
from cboxlab.scenes import Camera, Lamp, Material, Scene, Spectrum, Surface
from cboxlab.scenes.camera import REFERENCE_ROTATION
from cboxlab.scenes.shapes import quad_mesh, ring_mesh

EDGE = 1000.0
BANDS = np.array([450.0, 550.0, 650.0])
FLAT = Spectrum(np.array([300.0, 900.0]), np.ones(2))


def grey(value, name="grey"):
    return Material(name, FLAT.scaled(value))


def quad(name, corners, material="grey"):
    return Surface(name, material, *quad_mesh(corners))


def square(centre, half, normal_axis, sign):
    """Corners of an axis-parallel square whose lit side looks along sign times the axis."""
    a, b = np.eye(3)[(normal_axis + 1) % 3], np.eye(3)[(normal_axis + 2) % 3]
    corners = [centre + half * (i * a + j * b) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return np.array(corners if sign > 0 else corners[::-1], float)


def walls(ceiling=True, front=True):
    """A cube from 0 to EDGE, lit from inside: name to corners."""
    middle, half = np.full(3, EDGE / 2), EDGE / 2
    sides = {
        "left": (0, 1),
        "right": (0, 0),
        "ceiling": (1, 1),
        "floor": (1, 0),
        "back": (2, 1),
        "front": (2, 0),
    }
    present = {n: s for n, s in sides.items() if (ceiling or n != "ceiling") and (front or n != "front")}
    return {
        name: square(middle + (2 * high - 1) * half * np.eye(3)[axis], half, axis, 1 - 2 * high)
        for name, (axis, high) in present.items()
    }


def box_with_lamp(rho, lamp_half=200.0, front=True, **lamp):
    """A grey cube with a square lamp flush in the middle of its ceiling."""
    corners = walls(front=front)
    hole = square(np.array([EDGE / 2, EDGE, EDGE / 2]), lamp_half, 1, -1)
    surfaces = [quad(name, c) for name, c in corners.items() if name != "ceiling"]
    surfaces.append(Surface("ceiling", "grey", *ring_mesh(corners["ceiling"], hole)))
    return Scene("box", tuple(surfaces), {"grey": grey(rho)}, Lamp(quad("light", hole), FLAT, **lamp))


def lamp_and(surfaces, lamp_corners, **lamp):
    """A lamp and receivers in empty space."""
    return Scene("test", tuple(surfaces), {"grey": grey(0.5)}, Lamp(quad("light", lamp_corners), FLAT, **lamp))


def camera_inside(size, z=50.0, focal=0.5):
    """In the middle of the cube's front, looking at its back."""
    return Camera(
        size,
        size,
        focal * size,
        np.full(2, (size - 1) / 2),
        0.0,
        REFERENCE_ROTATION.copy(),
        np.array([EDGE / 2, EDGE / 2, z]),
    )
