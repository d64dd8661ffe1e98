"""The published box (areas, orientation, the hole, the diagonal) and the shapes of scene files."""

import csv
import json

import numpy as np
import pytest
import trimesh
from cboxlab.scenes import Surface, cornell_box, cornell_camera
from cboxlab.scenes.shapes import box_mesh, file_mesh, joined, plate_mesh, quad_mesh, ring_mesh, vector_area
from cboxlab.utils.errors import InputError
from hypothesis import assume, given
from hypothesis import strategies as st

MIDDLE_OF_THE_ROOM = np.array([278.0, 450.0, 20.0])  # before the blocks and above them


@pytest.fixture(scope="module")
def box():
    return cornell_box()


def corners(surface):
    return surface.vertices_mm[surface.faces]


def normals(surface):
    a, b, c = np.moveaxis(corners(surface), 1, 0)
    return np.cross(b - a, c - a)


def published_quads(shared):
    quads = {}
    with open(shared / "cornell-box" / "geometry.csv", newline="") as stream:
        for row in csv.DictReader(stream):
            quads.setdefault((row["surface"], row["material"], row["quad"]), []).append(
                [float(row[axis]) for axis in ("x_mm", "y_mm", "z_mm")]
            )
    return quads


def test_names_of_surfaces_and_paints(box):
    paints = {surface.name: surface.material for surface in box.surfaces}
    assert paints == {
        "floor": "white",
        "ceiling": "white",
        "back": "white",
        "left": "red",
        "right": "green",
        "short-block": "white",
        "tall-block": "white",
    }
    assert set(box.materials) == {"white", "red", "green"}
    assert box.lamp.surface.name == "light"
    with pytest.raises(InputError, match="'roof'; expected one of floor, ceiling"):
        box.surface("roof")


def test_areas_by_hand(box):
    """Trapezoids: mean of the parallel sides times the distance between them; the lamp 130 by 105 mm."""

    def area(name):
        return box.surface(name).areas_mm2.sum()

    assert area("floor") == pytest.approx((552.8 + 549.6) / 2 * 559.2)
    assert area("back") == pytest.approx((549.6 + 556.0) / 2 * 548.8)
    assert area("right") == pytest.approx(559.2 * 548.8)
    assert area("ceiling") == pytest.approx(556.0 * 559.2 - 130 * 105)
    assert box.lamp.surface.areas_mm2.sum() == pytest.approx(130 * 105)


def test_every_published_quad_is_there_in_order(box, shared):
    quads = published_quads(shared)
    assert len(quads) == 16
    for (name, material, _), quad in quads.items():
        surface = box.lamp.surface if name == "light" else box.surface(name)
        assert surface.material == material
        if name == "ceiling":
            assert np.array_equal(surface.vertices_mm[:4], quad)
        else:
            triangles = corners(surface)
            for expected in (np.array(quad)[[0, 1, 2]], np.array(quad)[[0, 2, 3]]):
                assert np.any(np.all(triangles == expected, axis=(1, 2)))
    for surface in box.surfaces:
        count = sum(name == surface.name for name, _, _ in quads)
        assert len(surface.faces) == (8 if surface.name == "ceiling" else 2 * count)


def test_tables_are_the_published_ones(box, shared):
    with open(shared / "cornell-box" / "reflectance.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for name, material in box.materials.items():
        wavelength = [float(row["wavelength_nm"]) for row in rows]
        assert np.array_equal(material.reflectance.wavelength_nm, wavelength)
        assert np.array_equal(material.reflectance.values, [float(row[name]) for row in rows])
    assert box.lamp.radiance.at([400, 500, 600, 700]) == pytest.approx([0, 8, 15.6, 18.4])
    assert box.lamp.reflectance.at([390, 550, 710]) == pytest.approx([0.78] * 3)
    camera = json.loads((shared / "cornell-box" / "camera.json").read_text())
    assert cornell_camera(256).position_mm == pytest.approx(camera["position_mm"])
    assert cornell_camera(256).directions(127.5, 127.5) == pytest.approx(camera["direction"])


def test_values_between_and_beyond_the_published_samples(box):
    """White: 0.343 at 400, 0.445 at 404 nm. Beyond 400 to 700 nm the paint is held and the lamp dark."""
    white, red = box.materials["white"].reflectance, box.materials["red"].reflectance
    assert white.at([400, 401, 402, 404]) == pytest.approx([0.343, 0.3685, 0.394, 0.445])
    assert white.at([390, 710]) == pytest.approx([0.343, 0.737])
    assert red.at(700) == pytest.approx(0.642)
    assert box.lamp.radiance.at([399, 450, 550, 701]) == pytest.approx([0, 4.0, 11.8, 0])


def test_a_point_in_the_room_sees_the_front_of_every_wall_and_the_lamp(box):
    """Outside a block a point sees some of its faces; a point inside sees the back of all."""
    for surface in [box.lamp.surface, *box.surfaces]:
        towards = (MIDDLE_OF_THE_ROOM - corners(surface)) * normals(surface)[:, None]
        if surface.name.endswith("block"):
            inside = surface.vertices_mm.mean(axis=0)
            assert np.all(((corners(surface) - inside) * normals(surface)[:, None]).sum(axis=2) > 0)
        else:
            assert np.all(towards.sum(axis=2) > 0), surface.name


def test_left_wall_is_split_from_its_first_to_its_third_corner(box):
    """Corner 4 lies 3.2 mm off the plane of 1, 2, 3, so the diagonal is part of the wall's shape."""
    left_wall = box.surface("left")
    first, third = [552.8, 0.0, 0.0], [556.0, 548.8, 559.2]
    for triangle in corners(left_wall):
        assert first in triangle.tolist() and third in triangle.tolist()
    plane = normals(left_wall)[0] / np.linalg.norm(normals(left_wall)[0])
    assert abs((np.array([556.0, 548.8, 0.0]) - first) @ plane) == pytest.approx(3.2, abs=0.01)


def test_ceiling_is_open_where_the_lamp_is_and_closed_elsewhere(box):
    points = np.random.default_rng(2).uniform([0.5, 0, 0.5], [555.5, 0, 558.7], (4000, 3))
    x, z = points[:, 0], points[:, 2]
    in_lamp = (x > 213) & (x < 343) & (z > 227) & (z < 332)
    corner, edge_1, edge_2 = (corners(box.surface("ceiling"))[:, k, ::2] for k in range(3))
    hits = sum(inside_triangle(points[:, ::2], *triangle) for triangle in zip(corner, edge_1, edge_2, strict=True))
    assert in_lamp.sum() > 100
    assert np.array_equal(hits, np.where(in_lamp, 0, 1))


def inside_triangle(points, a, b, c):
    """1 for each point (n, 2) strictly inside the triangle, 0 for the others."""

    def side(p, q):
        return (q[0] - p[0]) * (points[:, 1] - p[1]) - (q[1] - p[1]) * (points[:, 0] - p[0])

    sides = np.stack([side(a, b), side(b, c), side(c, a)])
    return (np.all(sides > 0, axis=0) | np.all(sides < 0, axis=0)).astype(int)


def convex_polygon(angles, radius, squeeze):
    angles = np.sort(angles)
    return radius * np.column_stack([np.cos(angles), squeeze * np.sin(angles), np.zeros(len(angles))])


spread_angles = st.lists(st.floats(0, 2 * np.pi), min_size=3, max_size=6).filter(
    lambda values: np.diff(np.sort([*values, min(values) + 2 * np.pi])).min() > 0.05
)


@given(spread_angles, spread_angles, st.floats(0.3, 1.0), st.floats(0, 360), st.booleans(), st.integers(0, 2**31))
def test_a_ring_tiles_what_is_around_its_hole(outer_angles, hole_angles, squeeze, turn, reverse, seed):
    """Triangles face one way, have the area of the ring, and no random point lies in two of them."""
    outer = convex_polygon(outer_angles, 10.0, squeeze)
    hole = outer.mean(axis=0) + convex_polygon(hole_angles, 0.3, 1.0)
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)
    matrix = trimesh.transformations.rotation_matrix(np.radians(turn), axis)[:3, :3]
    hole = hole[::-1] if reverse else hole
    try:
        vertices, faces = ring_mesh(outer @ matrix.T, hole @ matrix.T)
    except ValueError:
        assume(False)
    assert len(faces) == len(outer) + len(hole)
    assert np.allclose(np.sort(vertices, axis=0), np.sort(np.concatenate([outer, hole]) @ matrix.T, axis=0))
    flat = vertices @ matrix
    areas = np.array([vector_area(flat[face])[2] for face in faces])
    assert np.all(areas > 0)
    assert areas.sum() == pytest.approx(vector_area(outer)[2] - abs(vector_area(hole)[2]))
    points = np.random.default_rng(seed).uniform(-10, 10, (300, 2))
    hits = sum(inside_triangle(points, *flat[face, :2]) for face in faces)
    assert np.all(hits <= 1)


SQUARE = [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]]


@pytest.mark.parametrize(
    ("hole", "phrase"),
    [
        ([[1, 1, 0.1], [2, 1, 0.1], [2, 2, 0.1], [1, 2, 0.1]], "one plane"),
        ([[3, 3, 0], [5, 3, 0], [5, 5, 0], [3, 5, 0]], "not inside"),
        ([[0, 1, 0], [2, 1, 0], [2, 2, 0], [0, 2, 0]], "not inside"),
        ([[1, 1, 0], [3, 3, 0], [3, 1, 0], [1, 3, 0]], "not convex"),
        ([[1, 1, 0], [1, 1, 0], [2, 2, 0], [1, 2, 0]], "not convex"),
    ],
)
def test_a_hole_that_is_none_is_refused(hole, phrase):
    with pytest.raises(ValueError, match=phrase):
        ring_mesh(SQUARE, hole)


@pytest.mark.parametrize("outer", [[[0, 0, 0]] * 4, [[0, 0, 0], [0, 0, 0], [4, 4, 0], [0, 4, 0]]])
def test_a_hole_in_nothing_is_refused(outer):
    with pytest.raises(ValueError, match="no area"):
        ring_mesh(outer, SQUARE)


def rectangle(x, y, width, height, turn=0.0):
    """Corners (4, 3) about a centre, turned in the plane z = 0."""
    c, s = np.cos(turn), np.sin(turn)
    flat = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([width, height]) / 2
    return np.column_stack([flat @ np.array([[c, s], [-s, c]]) + [x, y], np.zeros(4)])


@pytest.mark.parametrize(
    "holes",
    [
        [rectangle(1, 1, 1, 1), rectangle(3, 3, 1, 1)],
        [rectangle(1, 1, 1, 1), rectangle(3, 1.2, 1, 1), rectangle(2, 3, 3, 0.5)],
        [rectangle(1.2, 1.2, 1, 1, 0.6), rectangle(2.8, 2.6, 1.4, 1, 0.6)],
        [rectangle(1, 1, 1, 1), rectangle(1, 3, 1, 1), rectangle(3, 1, 1, 1), rectangle(3, 3, 1, 1)],
        # slits side by side, which only lines along their long edges part
        [rectangle(2 + d * np.cos(1.0), 2 + d * np.sin(1.0), 0.3, 2.2, 1.0) for d in (-0.2, 0.2)],
    ],
)
def test_a_plate_with_several_holes_is_tiled(holes):
    """No triangle overlaps a hole or another triangle, all face one way, and their area is what the holes leave."""
    vertices, faces = plate_mesh(SQUARE, holes)
    areas = np.array([vector_area(vertices[face])[2] for face in faces])
    assert np.all(areas > 0)
    assert areas.sum() == pytest.approx(16 - sum(vector_area(hole)[2] for hole in holes))
    points = np.random.default_rng(2).uniform(0, 4, (2000, 2))
    hits = sum(inside_triangle(points, *vertices[face, :2]) for face in faces)
    dark = sum(inside_triangle(points, *hole[[0, i, i + 1], :2]) for hole in holes for i in (1, 2))
    assert np.array_equal(hits, 1 - dark)


def test_holes_that_no_line_parts_are_refused():
    """Four around a middle, each next to the next one's end; two that overlap."""
    windmill = [
        rectangle(x, y, w, h)
        for x, y, w, h in ((1.4, 0.8, 2.2, 0.6), (3.2, 1.4, 0.6, 2.2), (2.6, 3.2, 2.2, 0.6), (0.8, 2.6, 0.6, 2.2))
    ]
    for holes in (windmill, [rectangle(2, 2, 1, 1), rectangle(2.5, 2, 1, 1)]):
        with pytest.raises(ValueError, match="no straight line"):
            plate_mesh(SQUARE, holes)


def test_a_block_is_closed_turned_about_its_centre_and_lit_from_outside():
    """Yaw about +y is right-handed: +90 degrees takes +z to +x. The signed volume is that of the box."""
    vertices, faces = box_mesh((10, 20, 30), (2, 4, 6), 90.0)
    assert np.ptp(vertices, axis=0) == pytest.approx([6, 4, 2])
    assert vertices.mean(axis=0) == pytest.approx([10, 20, 30])
    solid = trimesh.Trimesh(vertices, faces, process=False)
    assert solid.is_watertight and solid.volume == pytest.approx(48.0)
    narrow, _ = box_mesh((0, 0, 0), (0.002, 1, 2), 30.0)
    farthest = narrow[np.argmax(narrow[:, 2])]
    assert farthest[0] == pytest.approx(np.sin(np.radians(30)), abs=0.002)


@pytest.mark.parametrize("kind", ["obj", "ply", "stl"])
def test_a_mesh_file_keeps_its_shape_and_takes_its_unit(tmp_path, kind):
    path = tmp_path / f"ball.{kind}"
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    ball.export(path)
    vertices, faces = file_mesh(path, 1000.0)
    read = trimesh.Trimesh(vertices, faces)
    assert len(faces) == len(ball.faces)
    assert read.volume == pytest.approx(ball.volume * 1e9, rel=1e-5)


def test_a_joined_mesh_is_the_sum_of_its_parts():
    quad = quad_mesh(SQUARE)
    vertices, faces = joined([quad, box_mesh((9, 9, 9), (1, 1, 1), 0), quad])
    assert len(vertices) == 16 and len(faces) == 16
    assert Surface("all", "white", vertices, faces).areas_mm2.sum() == pytest.approx(16 + 6 + 16)
