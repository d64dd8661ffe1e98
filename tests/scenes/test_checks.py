"""Textures beyond 0 and 1, triangles without area, and surfaces that a medium fills."""

import numpy as np
import pytest
from cboxlab.scenes.checks import ROUNDING, SMALLEST_AREA, inside_faults, surface_faults, texture_faults
from cboxlab.scenes.scene import Material, Surface, Texture
from cboxlab.scenes.spectra import Spectrum

GLASS = Material("glass", Spectrum(np.array([400.0]), np.array([1.0])), bsdf={"type": "null"})
BIG = [[0, 0, 0], [1e4, 0, 0], [0, 1e4, 0]]


@pytest.mark.parametrize(("height", "faults"), [(3.0, 0), (0.3, 1)])
def test_a_triangle_is_measured_by_its_own_edges(height, faults):
    """A thin triangle next to a large one; its area over the square of its edge decides, not over the other's."""
    base = 1.0
    thin = [[0, 0, 0], [base, 0, 0], [base / 2, height * SMALLEST_AREA * 2 * base, 0]]
    surface = Surface("s", "white", np.array(BIG + thin, float), np.array([[0, 1, 2], [3, 4, 5]]))
    assert len(surface_faults(surface, "s")) == faults


CORNERS = np.array([[x, y, z] for x in (0.0, 1) for y in (0, 1) for z in (0, 1)])
#: Twelve triangles of a cube, counter-clockwise from outside.
CUBE = np.array(
    [
        triangle
        for a, b, c, d in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
        for triangle in ((a, b, c), (a, c, d))
    ]
)
TURNED = np.concatenate([CUBE[:5], CUBE[5:6, ::-1], CUBE[6:]])


@pytest.mark.parametrize(
    ("faces", "fault"),
    [(CUBE, ""), (CUBE[:-1], "an open surface"), (CUBE[:, ::-1], "inside out"), (TURNED, "an open surface")],
)
def test_what_a_medium_fills_is_closed_and_not_inside_out(faces, fault):
    faults = inside_faults(Surface("s", "glass", CORNERS, faces), GLASS, "s")
    assert [fault in str(each) for each in faults] == [True] * bool(fault)


@pytest.mark.parametrize(
    ("weight", "faults"), [(0.0, 0), (1.0, 0), (-0.9, 0), (-1.1, 1), (1e9 + 0.9, 0), (1e9 + 1.1, 1)]
)
def test_a_texture_reflects_from_nothing_to_everything(weight, faults):
    """Beyond both only by rounding; weights in units of it, but 0 and 1."""
    weight = weight if weight in (0.0, 1.0) else weight * ROUNDING
    white = Spectrum(np.array([400.0]), np.array([1.0]))
    assert len(texture_faults(Texture(np.array([[[0.5], [weight]]]), (white,)), "t")) == faults
