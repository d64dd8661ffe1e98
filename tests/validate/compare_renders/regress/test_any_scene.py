"""Pictures of any scene: R, G, B as stored in layers of any names, with surfaces and errors where files have them."""

import json
import re
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from cboxlab.rendering.files import Declared
from cboxlab.rendering.files.colour_pictures import as_xyz_picture
from cboxlab.utils.errors import InputError
from cboxlab.validation.compare_renders.regress import (
    UNKNOWN,
    Side,
    read_side,
    regress_inputs,
    regress_pictures,
    regress_sides,
    side_of,
)
from cboxlab.validation.compare_renders.regress.naming import _by_verdict, _changed
from cboxlab.validation.compare_renders.scene_pictures.guides import cryptomatte
from cboxlab.validation.compare_renders.stored_references import measured_reference, require_same_light
from helpers.files.rgbe import write_rgbe
from scipy.ndimage import gaussian_filter, minimum_filter

SIZE = 64
ROWS, COLUMNS = np.indices((SIZE, SIZE))
#: Three objects: a wall, a floor and a ball.
OBJECT = np.where(np.hypot(ROWS - 36, COLUMNS - 28) < 12, 2, (ROWS > 40).astype(int))


def light():
    """(y, x, 3) a smooth light on three paints."""
    paint = np.array([[0.7, 0.6, 0.5], [0.3, 0.35, 0.4], [0.15, 0.4, 0.2]])[OBJECT]
    return paint * (0.4 + 0.5 * COLUMNS / SIZE + 0.4 * (ROWS / SIZE) ** 2)[..., None]


def noisy(seed, picture=None, noise=0.04, filtered=0.0):
    """A rendering with independent noise, or noise through a pixel filter."""
    rng = np.random.default_rng(seed)
    values = (light() if picture is None else picture) * (
        1 + noise * (rng.standard_normal((SIZE, SIZE, 1)) + 0.15 * rng.standard_normal((SIZE, SIZE, 3)))
    )
    return gaussian_filter(values, (filtered, filtered, 0)) if filtered else values


def written(path, planes, header=None):
    """File of planes (y, x) by name."""
    kind = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    floats = {name: np.ascontiguousarray(plane, np.float32) for name, plane in planes.items()}
    OpenEXR.File(kind | (header or {}), floats).write(str(path))
    return str(path)


def colours(picture, layer=""):
    dot = f"{layer}." if layer else ""
    return {f"{dot}{name}": picture[..., i] for i, name in enumerate("RGB")}


def pair(folder, candidate, layer="", **other):
    """Outcome of two files."""
    files = [written(folder / f"{i}.exr", colours(p, layer) | other) for i, p in enumerate((noisy(1, **{}), candidate))]
    return regress_inputs(*files)


@pytest.mark.parametrize("filtered", [0.0, 0.5])
def test_other_seeds_are_the_same_and_the_planes_are_called_as_stored(tmp_path, filtered):
    for seed in range(5):
        files = [written(tmp_path / f"{i}.exr", colours(noisy(2 * seed + i, filtered=filtered))) for i in range(2)]
        outcome = regress_inputs(*files)
        assert outcome.same, outcome.deciding
    assert [row.name for row in outcome.of_kind("band")] == ["R", "G", "B"]
    assert any("as stored, without unit" in note for note in outcome.notes)
    assert any("noise assumed" in note for note in outcome.notes)


@pytest.mark.parametrize(
    ("change", "name", "spoilt"),
    [
        ("scale", "lamp-scale", lambda p: 1.03 * p),
        ("gains", "channel-gains", lambda p: p * [1.08, 1.0, 0.93]),
        ("gamma", "power", lambda p: p**1.2),
        ("sRGB", "screen-values", lambda p: 1.055 * np.maximum(p, 0.0031308) ** (1 / 2.4) - 0.055),
        ("exchanged", "bands-exchanged", lambda p: p[..., ::-1]),
        ("clamp", "clipped", lambda p: np.minimum(p, 0.45)),
        ("rolled", "shift", lambda p: np.roll(p, 20, axis=1)),
        ("mirrored", "mirrored", lambda p: p[:, ::-1]),
    ],
)
def test_causes_that_need_no_scene_are_named(tmp_path, change, name, spoilt):
    outcome = pair(tmp_path, spoilt(noisy(2)))
    assert not outcome.same
    assert (outcome.changes[0].change, outcome.changes[0].fits) == (name, True), outcome.changes


@pytest.mark.parametrize("factor", [0.7, 0.0])
def test_a_border_is_certain_where_its_own_pixels_show_it(tmp_path, factor):
    """Pixels that it leaves alone do not make it less certain: the rest of the picture has no part in it."""
    inside = np.pad(np.ones((SIZE - 2, SIZE - 2)), 1, constant_values=factor)
    outcome = pair(tmp_path, noisy(2) * inside[..., None])
    assert not outcome.same
    assert (outcome.changes[0].change, outcome.changes[0].fits) == ("border", True), outcome.changes
    assert outcome.changes[0].probability > 0.9


def test_a_local_change_is_seen_and_has_no_name(tmp_path):
    shade = 1 - 0.3 * np.exp(-((ROWS - 20) ** 2 + (COLUMNS - 45) ** 2) / 60)
    outcome = pair(tmp_path, noisy(2) * shade[..., None])
    assert not outcome.same
    assert outcome.changes[0].change == "unknown" or not outcome.changes[0].fits


def matte(header_name="ViewLayer.CryptoObject"):
    """Planes and header of a cryptomatte of the three objects."""
    codes = np.array([0x3F800001, 0x40000002, 0x40400003], np.uint32)
    layer = f"{header_name}00"
    planes = {f"{layer}.R": codes.view(np.float32)[OBJECT], f"{layer}.G": np.ones((SIZE, SIZE))}
    planes |= {f"{layer}.{c}": np.zeros((SIZE, SIZE)) for c in "BA"}
    names = {name: f"{code:08x}" for name, code in zip(("wall", "floor", "ball"), codes, strict=True)}
    key = "cryptomatte/abc1234"
    return planes, {f"{key}/name": header_name, f"{key}/manifest": json.dumps(names)}


@pytest.mark.parametrize("filtered", [0.0, 0.5])
def test_colours_that_change_while_their_sum_does_not_are_seen(tmp_path, filtered):
    """Red and blue change places: the sum stays in each pixel, and means of bands move by 2 %."""
    paint = np.array([[0.6, 0.5, 0.4], [0.4, 0.5, 0.6], [0.5, 0.5, 0.5]])[OBJECT]
    picture = paint * (0.4 + 0.5 * COLUMNS / SIZE)[..., None]
    files = [
        written(tmp_path / f"{seed}.exr", colours(noisy(seed, planes, noise=0.05, filtered=filtered)))
        for seed, planes in enumerate((picture, picture, picture[..., ::-1]))
    ]
    assert regress_inputs(*files[:2]).same
    outcome = regress_inputs(files[0], files[2])
    assert {row.kind for row in outcome.deciding} >= {"colour"}
    assert (outcome.changes[0].change, outcome.changes[0].parameters["order"]) == ("bands-exchanged", "BGR")


def test_radiance_s_pictures_of_any_scene_are_compared_as_stored(tmp_path):
    """An exposure of the header is divided out; the steps stay in the errors."""
    files = [str(write_rgbe(tmp_path / f"{seed}.hdr", noisy(seed))) for seed in (1, 2)]
    files.append(str(write_rgbe(tmp_path / "3.hdr", 2 * noisy(3), "EXPOSURE=2\n")))
    for other in files[1:]:
        outcome = regress_inputs(files[0], other)
        assert outcome.same and [row.name for row in outcome.of_kind("band")] == ["R", "G", "B"]
    doubled = regress_inputs(files[0], str(write_rgbe(tmp_path / "4.hdr", 2 * noisy(4))))
    assert doubled.changes[0].change == "lamp-scale"


@pytest.mark.parametrize("is_step", [True, False])
def test_a_step_along_a_straight_border_is_no_gradient_and_a_gradient_no_step(tmp_path, is_step):
    factor = np.where(COLUMNS < 27, 0.97, 1.0) if is_step else 1 + 0.12 * (COLUMNS / SIZE - 0.5)
    first = pair(tmp_path, noisy(2, light() * factor[..., None])).changes[0]
    assert first.change == (UNKNOWN if is_step else "gradient") and first.fits
    assert not is_step or re.search(r"a factor 0\.9[67]\d* in columns 0 to 26$", first.parameters["description"])


def test_layers_of_cycles_give_picture_and_objects(tmp_path):
    planes, header = matte()
    noise = {f"ViewLayer.Noisy Image.{c}": np.ones((SIZE, SIZE)) for c in "RGB"}
    files = [
        written(tmp_path / f"{i}.exr", colours(p, "ViewLayer.Combined") | planes | noise, header)
        for i, p in enumerate((noisy(1), noisy(2) * np.where(OBJECT == 2, 1.06, 1.0)[..., None]))
    ]
    outcome = regress_inputs(*files)
    assert {row.name for row in outcome.of_kind("surface")} == {"wall", "floor", "ball"}
    assert [row.name for row in outcome.of_kind("surface") if row.different] == ["ball"]
    assert any("cryptomatte" in note for note in outcome.notes)


@pytest.mark.parametrize("manifest", [b"\xe9", b"{", b"[1]", b'{"wall": 3}', b'{"wall": "x"}', b"[" * 5000])
def test_objects_of_a_cryptomatte_without_readable_names_are_numbered(manifest):
    planes, _ = matte()
    header = {"cryptomatte/a/name": "ViewLayer.CryptoObject", "cryptomatte/a/manifest": _Text(manifest)}
    assert set(cryptomatte(header, planes).names) == {f"object {c}" for c in (0x3F800001, 0x40000002, 0x40400003)}


class _Text:
    """A text of a header, which the library decodes when it is asked for."""

    def __init__(self, content):
        self.content = content

    def __str__(self):
        return self.content.decode()


def test_an_index_that_a_filter_averages_gives_objects_away_from_edges(tmp_path):
    index = gaussian_filter(3.0 * OBJECT, 0.5)
    side = read_side([tmp_path / written(tmp_path / "a.exr", colours(noisy(1)) | {"idx.I": index})])
    assert set(side.surfaces.names) == {"object 0", "object 3", "object 6"}
    inside = side.surfaces.index >= 0
    assert (np.array([0, 3, 6])[OBJECT] == index.round())[inside].all()
    assert not inside[np.abs(index - 3 * OBJECT) > 0.01].any()


def test_a_changed_albedo_is_noted(tmp_path):
    paint = np.stack(3 * [np.array([0.7, 0.3, 0.2])[OBJECT]], axis=-1)
    files = [
        written(tmp_path / f"{i}.exr", colours(noisy(i)) | colours(a, "alb"))
        for i, a in enumerate((paint, paint * np.where(OBJECT == 1, 1.1, 1.0)[..., None]))
    ]
    outcome = regress_inputs(*files)
    assert any("the albedo layer differs in" in note for note in outcome.notes)
    assert len(outcome.of_kind("surface")) == 3
    assert not any(
        "differs" in note
        for note in regress_inputs(
            files[0], written(tmp_path / "2.exr", colours(noisy(7)) | colours(paint, "alb"))
        ).notes
    )


def test_an_object_that_layers_alone_show_is_a_difference(tmp_path):
    """A small object as bright as the wall behind it: the light is the same, depth and index are not."""
    depth = np.where(OBJECT == 1, 3.0, 2.0) + 0.001 * np.arange(OBJECT.shape[1])
    without, index = depth.copy(), OBJECT.copy()
    y, x = (int(axis[len(axis) // 2]) for axis in np.nonzero(minimum_filter(OBJECT == 0, 9)))
    depth[y - 2 : y + 3, x - 2 : x + 3] = 1.5
    index[y - 2 : y + 3, x - 2 : x + 3] = 7

    def layers(seed, depth, index):
        return written(tmp_path / f"{seed}.exr", colours(noisy(seed)) | {"dd.Y": depth, "idx.I": index.astype(float)})

    with_object = layers(1, depth, index)
    outcome = regress_inputs(with_object, layers(2, without, OBJECT))
    assert [row.name for row in outcome.of_kind("layer") if row.different] == ["depth", "objects"]
    assert outcome.changes[0].parameters["description"] == "the light is the same, the depth and objects layer differs"
    assert regress_inputs(with_object, layers(3, depth, index)).same
    # numbers in another order, and a depth in millimetres, are other definitions
    assert regress_inputs(with_object, layers(4, 1000 * depth, 9 - index)).same


def test_errors_of_a_g_buffer_are_used(tmp_path):
    """pbrt states the variance of samples and their number."""
    variance = colours((light() * 0.04) ** 2 * 256, "Variance")
    side = read_side([tmp_path / written(tmp_path / "a.exr", colours(noisy(1)) | variance, {"samplesPerPixel": 256})])
    assert side.degrees == 255
    assert np.sqrt(side.variance) == pytest.approx(0.04 * light(), rel=1e-5)


def test_files_may_hold_pixels_that_are_not_numbers(tmp_path):
    """Both in the picture and in its errors; all other errors are used."""
    picture, error = noisy(1), (light() * 0.04) ** 2 * 256
    picture[7, 5, 1], error[7, 5] = np.inf, np.nan
    planes, header = colours(picture) | colours(error, "Variance"), {"samplesPerPixel": 256}
    files = [written(tmp_path / "a.exr", colours(noisy(2))), written(tmp_path / "b.exr", planes, header)]
    side = read_side([Path(files[1])])
    assert side.degrees == 255 and np.isfinite(side.variance).all()
    assert np.argwhere(side.not_numbers.pixels).tolist() == [[7, 5]]
    outcome = regress_inputs(*files)
    assert [row.label for row in outcome.deciding] == [
        "1 pixel is not a number in the candidate (infinity in G), at row 7, column 5"
    ]
    several = read_side([Path(file) for file in files])
    assert several.batches.shape[0] == 2 and several.not_numbers.pixels.sum() == 1


def test_a_layer_is_asked_for_and_may_be_declared(tmp_path):
    path = tmp_path / "a.exr"
    written(path, colours(noisy(1), "left") | colours(2 * noisy(2), "right"))
    with pytest.raises(InputError, match="layer='left'"):
        read_side([path])
    side = read_side([path], Declared(layer="right"))
    assert side.radiance.mean() == pytest.approx(2 * light().mean(), rel=0.01)
    assert side.declared == ("layer",)
    with pytest.raises(InputError, match="declared layer"):
        read_side([path], Declared(layer="top"))


def test_parts_of_a_file_are_layers(tmp_path):
    parts = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage}, {c: p.astype(np.float32) for c, p in planes.items()}, name)
        for name, planes in (("beauty", colours(noisy(1))), ("albedo", colours(0 * light() + 0.5)))
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    side = read_side([tmp_path / "a.exr"])
    assert side.bands == ("R", "G", "B")
    assert side.guides["albedo"] == pytest.approx(0.5)


def test_a_picture_as_stored_needs_units_next_to_a_model_or_another_quantity(tmp_path):
    stored = written(tmp_path / "a.exr", colours(noisy(1)))
    box = as_xyz_picture(light())
    with pytest.raises(InputError, match="declare colour-space=NAME"):
        regress_pictures(read_side([Path(stored)]), side_of([box], ["in cd m^-2"]))
    with pytest.raises(InputError, match="declare colour-space=NAME"):
        regress_inputs(stored, stored, model="cornell-box")


def test_primaries_that_differ_are_refused(tmp_path):
    spaces = (
        (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290),
        (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    )
    files = [
        written(tmp_path / f"{i}.exr", colours(noisy(i)), {"chromaticities": tuple(map(float, s))})
        for i, s in enumerate(spaces)
    ]
    with pytest.raises(InputError, match="rec2020"):
        regress_inputs(*files)


def test_the_fixture_s_reference_holds_objects_of_any_scene(tmp_path):
    index = {"idx.I": OBJECT.astype(float)}

    def reference(start, factor=1.0):
        files = [written(tmp_path / f"{start + i}.exr", colours(noisy(start + i) * factor) | index) for i in range(6)]
        return measured_reference(read_side([Path(file) for file in files]), start, 64, {})

    stored = reference(10)
    assert {"surface: object 0", "surface: object 1", "surface: object 2"} <= set(stored.means)
    require_same_light(stored, reference(20))
    ball = np.where(OBJECT == 2, 1.05, 1.0)[..., None]
    with pytest.raises(AssertionError, match="surface: object 2"):
        require_same_light(stored, reference(30, ball))


@pytest.mark.parametrize(
    ("strength", "moved_px", "hidden", "refused"),
    [(0.1, 0.0, False, False), (0.03, 0.0, True, False), (0.1, 1.0, False, True)],
    ids=["gains alone", "as small as unseen changes of a part", "a shadow moved"],
)
def test_a_name_of_exact_shape_must_leave_pictures_that_the_verdict_calls_the_same(strength, moved_px, hidden, refused):
    """A sun that moves scales most of the light, and moves a shadow, too. A part may change by 5 % unseen."""
    gains = 1 + strength * np.array([1.0, 0.0, -0.7])

    def side(seed, middle, gains):
        shadow = 1 - 0.6 * np.clip(3.5 - np.hypot(ROWS - 20, COLUMNS - middle), 0, 1)[..., None]
        cubes = np.stack([noisy(seed + n, light() * shadow * gains) for n in range(3)])
        error = cubes.var(axis=0, ddof=1) / 3
        colour = {"in_colour": True, "colours": ("R", "G", "B"), "batches": cubes}
        return Side("cubes", np.full(3, np.nan), cubes.mean(axis=0), error, 2.0, None, **colour)

    _, comparison = regress_sides(side(10, 40, 1.0), side(50, 40 + moved_px, gains))
    misfit, is_hidden = _by_verdict(comparison, lambda picture: picture * gains, None)
    assert (is_hidden, misfit > 1) == (hidden, refused)


def test_noise_of_a_changed_single_picture_follows_the_slope_of_its_change():
    """A square has the slope 2 x."""
    values = np.array([[[2.0, 3.0, 5.0]]])
    side = Side("picture", np.full(3, np.nan), values, np.full(values.shape, 0.01), None, None)
    changed = _changed(side, np.square)
    np.testing.assert_allclose(changed.radiance, values**2)
    np.testing.assert_allclose(changed.variance, 0.01 * (2 * values) ** 2)
