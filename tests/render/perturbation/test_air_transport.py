"""The air's cells: smooth light between them, and the exchange from cell to cell, without tracing."""

import numpy as np
import pytest
from cboxlab.rendering.perturbation import AirTransport


def grid(low, high, shape):
    """Axes of centres, corners (v, 3) and sizes (v, 3) of equal cells."""
    edges = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, shape, strict=True)]
    axes = tuple((e[1:] + e[:-1]) / 2 for e in edges)
    cells = [(i, j, k) for i in range(shape[0]) for j in range(shape[1]) for k in range(shape[2])]
    corner = np.array([[edges[a][cell[a]] for a in range(3)] for cell in cells])
    size = np.array([[np.diff(edges[a])[cell[a]] for a in range(3)] for cell in cells])
    return axes, corner, size


@pytest.fixture
def air():
    """A box of 4 x 3 x 5 cells from z = 0 on, and 3 x 3 x 2 cells in front of it, which reach further sideways."""
    inside = grid((0.0, 0.0, 0.0), (400.0, 300.0, 600.0), (4, 3, 5))
    front = grid((-200.0, -100.0, -500.0), (700.0, 500.0, 0.0), (3, 3, 2))
    nothing = np.zeros(0)
    corner, size = (np.concatenate([inside[i], front[i]]) for i in (1, 2))
    return AirTransport(
        (inside[0], front[0]),
        0.0,
        corner,
        size,
        size.prod(axis=1),
        nothing,
        nothing,
        (),
        nothing,
        nothing,
        np.zeros(3),
    )


def test_what_grows_evenly_is_known_everywhere_exactly(air):
    """Two quantities linear in place, given at the centres of the cells: the same anywhere, before and behind z = 0."""
    slopes = np.array([[0.3, -1.0], [0.02, 0.5], [-0.1, 2.0]])
    values = air.centres @ slopes + np.array([5.0, -3.0])
    assert values[0] == pytest.approx(np.array([50.0, 50.0, 60.0]) @ slopes + np.array([5.0, -3.0]))
    points = np.random.default_rng(2).uniform((5, 5, -450), (390, 290, 590), (4, 50, 3))
    points[..., :2] = np.where(points[..., 2:] < 0, 1.7 * points[..., :2] - 150.0, points[..., :2])
    assert (points[..., 2] < 0).any() and (points[..., 2] > 0).any() and points[..., 0].max() > 400
    expected = points.reshape(-1, 3) @ slopes + np.array([5.0, -3.0])
    np.testing.assert_allclose(air.weights_at(points) @ values, expected, rtol=1e-5, atol=1e-4)


def test_outside_the_box_there_is_no_light(air):
    """Behind its front, a millimetre outside its walls; in front of it, and a millimetre inside, there is."""
    values = np.ones((len(air.corner), 1))
    for axis, ends in ((0, (0.0, 400.0)), (1, (0.0, 300.0))):
        for end, outwards in zip(ends, (-1.0, 1.0), strict=True):
            points = np.tile([200.0, 150.0, 300.0], (3, 1))
            points[:, axis] = end + outwards * np.array([-1.0, 1.0, 1.0])
            points[2, 2] = -100.0
            assert (air.weights_at(points) @ values)[:, 0] == pytest.approx([1.0, 0.0, 1.0])


@pytest.mark.parametrize("extinction", [0.0, 0.002])
def test_cells_light_each_other_by_the_inverse_square_and_what_the_air_lets_through(air, extinction):
    """Mean radiance over the sphere, V e^(-s d) / (4 pi d^2); in its own ball of radius R a source of 1/mm makes R."""
    exchange = air.between_cells(extinction)
    volume, centre = air.size.prod(axis=1), air.corner + 0.5 * air.size
    for row, column in ((0, 1), (1, 0), (7, 70), (70, 7), (59, 60)):
        d = np.sqrt(np.sum((centre[row] - centre[column]) ** 2))
        expected = volume[column] * np.exp(-extinction * d) / (4 * np.pi * d**2)
        assert exchange[row, column] == pytest.approx(expected, rel=1e-9)
    radius = np.diag(exchange)
    np.testing.assert_allclose(4 / 3 * np.pi * radius**3, volume)
