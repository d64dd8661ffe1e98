"""Each change is named first, with its parameters; seeds are fixed, so outcomes do not vary."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cboxlab.rendering.device import variant
from cboxlab.rendering.effects import apply_checked, names_in
from cboxlab.rendering.files import COLOUR_SPACES, primaries_matrix
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators import render_image
from cboxlab.rendering.model import labelled_cube
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.compare_renders.regress import (
    SurfaceIndices,
    regress_pictures,
    regress_sides,
    side_of,
)
from cboxlab.validation.compare_renders.regress.evidence import build_evidence
from cboxlab.validation.compare_renders.regress.explanations import _meaning, from_pictures
from cboxlab.validation.compare_renders.regress.naming import _further_changes, named_changes
from cboxlab.validation.compare_renders.regress.variants import mismatch, with_lamp_size
from pictures import SIZE, WAVELENGTHS, noisy, remembered_variants, rendered, variants
from scipy.ndimage import convolve1d


def first_name(picture, noise=0.005):
    """First named change of a picture against an unchanged one, by pictures alone."""
    outcome, names = regress_sides(noisy(1, noise=noise), noisy(2, picture, noise=noise))
    assert not outcome.same
    return named_changes(names, None)[0]


def tent(clean):
    kernel = np.array([1, 6, 1]) / 8
    return convolve1d(convolve1d(clean, kernel, 0, mode="nearest"), kernel, 1, mode="nearest")


@pytest.mark.parametrize(
    ("change", "key", "value", "alter"),
    [
        ("lamp-scale", "factor", 1.02, lambda p: 1.02 * p),
        ("lamp-spectrum", None, None, lambda p: p * np.linspace(0.97, 1.03, WAVELENGTHS.size)),
        ("mirrored", "axis", "horizontal", lambda p: p[:, ::-1]),
        ("shift", "dx_px", 1.0, lambda p: np.concatenate([p[:, :1], p[:, :-1]], axis=1)),
        ("pixel-filter", "added_variance_px2", 0.25, tent),
        ("wavelengths", "order", "reversed", lambda p: p[..., ::-1]),
        (
            "bands-exchanged",
            "order",
            ["420", "500", "460", "540", "580", "620", "660", "700"],
            lambda p: p[..., [0, 2, 1, 3, 4, 5, 6, 7]],
        ),
        ("offset", "added_over_mean", 0.2, lambda p: p + 0.2 * p.mean()),
        ("clipped", None, None, lambda p: np.minimum(p, np.percentile(p, 90))),
        ("power", "exponent", 1 / 2.2, lambda p: (p / p.max()) ** (1 / 2.2)),
    ],
)
def test_a_change_identified_from_the_pictures_alone(change, key, value, alter):
    first = first_name(alter(rendered()[0]))
    assert first.change == change
    assert first.probability > 0.9
    if isinstance(value, float):
        assert first.parameters[key] == pytest.approx(value, abs=0.05)
    elif key is not None:
        assert first.parameters[key] == value


@pytest.mark.parametrize(("factor", "phrase"), [(1 / np.pi, "radiosity"), (1e-3, "prefix")])
def test_a_unit_taken_for_another_is_reported(factor, phrase):
    first = first_name(factor * rendered()[0])
    assert first.change == "lamp-scale"
    assert first.parameters["factor"] == pytest.approx(factor, rel=2e-3)
    assert phrase in first.parameters["meaning"]


def test_factors_between_units_have_a_meaning_and_others_none():
    phrases = {2.0: "both sides", np.pi: "radiosity", 4 * np.pi: "intensity", 683.0: "683 lm/W", 1e-3: "prefix"}
    for factor, phrase in phrases.items():
        for measured in (0.999 * factor, factor, 1.001 * factor):
            assert phrase in _meaning(measured)
    assert _meaning(1.7) is None


def test_wavelengths_with_wrong_labels_are_reported():
    candidate = replace(noisy(2), wavelength_nm=WAVELENGTHS + 20)
    outcome = regress_pictures(noisy(1), candidate)
    assert outcome.changes[0].change == "wavelengths"
    assert outcome.changes[0].parameters == {"labels_off_nm": pytest.approx(20)}


def test_bin_edges_taken_for_points_are_reported():
    """Rendered at wavelengths 20 nm lower than its labels say."""
    image = render_image(
        RenderJob(cornell_box(), cornell_camera(SIZE), WAVELENGTHS - 20, samples=64, batches=2, seed=7)
    )
    picture, _ = image.project(np.eye(WAVELENGTHS.size))
    _, names = regress_sides(noisy(1, noise=0.02), noisy(2, picture, noise=0.02))
    first = named_changes(names, variants())[0]
    assert first.change == "wavelengths"


@pytest.mark.parametrize("depth", [3, 7])
def test_light_after_too_many_reflections_is_missed(depth):
    """Depth rendered again: none of the explanation's own rays are in the picture."""
    picture, _ = rendered(depth)
    _, names = regress_sides(noisy(1, noise=0.02), noisy(2, picture, noise=0.02))
    first = named_changes(names, variants())[0]
    assert (first.change, first.parameters) == ("path-depth", {"max_bounces": depth})


def test_glossy_white_paint_is_named_gloss():
    """White as rough plastic of Mitsuba, path traced: its diffuse part changes, too, which paint and caches imitate.

    By default rough plastic has Beckmann's distribution, whose lobe at alpha 0.15 has no tails: ours (GGX) fits it
    with 0.05 as well as with 0.15.
    """
    box = cornell_box()
    bsdf = {"type": "roughplastic", "alpha": 0.15, "int_ior": 1.5, "diffuse_reflectance": "reflectance"}
    glossy = {**box.materials, "white": replace(box.materials["white"], bsdf=bsdf)}
    sides = []
    for seed, scene in enumerate((box, replace(box, materials=glossy))):
        image = render_image(RenderJob(scene, cornell_camera(SIZE), WAVELENGTHS, 48, 4, seed=seed), integrator="path")
        sides.append(side_of([labelled_cube(image)], [f"seed {seed}"]))
    _, names = regress_sides(*sides)
    first = named_changes(names, variants())[0]
    assert (first.change, first.parameters["material"]) == ("gloss", "white")
    assert first.parameters["roughness"] in (0.05, 0.15)
    assert first.parameters["specular"] == pytest.approx(0.9, abs=0.2)


@pytest.fixture(scope="module")
def small_and_noisy():
    """Two sides of 32 x 32 pixels, and variants for them."""
    camera = cornell_camera(32)
    sides = [
        side_of([labelled_cube(render_image(RenderJob(cornell_box(), camera, WAVELENGTHS, 16, 8, seed=seed)))], ["it"])
        for seed in (5, 6)
    ]
    return *sides, remembered_variants(camera, sides[0])


@pytest.mark.parametrize("with_errors", [True, False])
def test_a_dim_lamp_in_a_small_noisy_picture_is_no_surprise(with_errors, small_and_noisy):
    """Too few pixels for the correlation between wavelengths, and edges whose errors may not be stated: the change is
    hardly larger than noise, and what noise leaves is no evidence of anything else."""
    first, second, light = small_and_noisy
    if not with_errors:
        first, second = (replace(side, variance=None, degrees=0.0) for side in (first, second))
    _, names = regress_sides(first, replace(second, radiance=0.985 * second.radiance))
    assert names.noise.correlation is None
    probability = {change.change: change.probability for change in named_changes(names, light)}
    assert probability["lamp-scale"] > 0.25
    assert probability.get("unknown", 0.0) + probability.get("ambient-cache", 0.0) < 0.1


def test_a_darker_border_is_named():
    """Without a scene the name is as certain as the border's own pixels make it."""
    picture = rendered()[0].copy()
    picture[:, 0] *= 0.7
    outcome, names = regress_sides(noisy(1, noise=0.02), noisy(2, picture, noise=0.02))
    assert not outcome.same
    first = named_changes(names, None)[0]
    assert (first.change, first.fits) == ("border", True)
    assert first.probability > 0.6
    assert first.parameters["left_factor"] == pytest.approx(0.7, abs=0.05)


def test_a_coat_is_sized():
    """Our own coat, as a ratio on a picture of the integrator's rays."""
    coat = {"material": "white", "specular": 0.8, "roughness": 0.15}
    glossy = apply_checked("gloss", coat, "gloss", names_in(cornell_box())).apply(variants().light)
    ratio = variants().ratio(glossy.picture())
    _, names = regress_sides(noisy(1, noise=0.02), noisy(2, ratio * rendered()[0], noise=0.02))
    first = named_changes(names, variants())[0]
    assert (first.change, first.parameters["material"]) == ("gloss", "white")
    assert first.parameters["roughness"] == 0.15
    assert first.parameters["specular"] == pytest.approx(0.8, abs=0.1)


def test_half_a_pixel_is_named_shift():
    """Rendered again through a moved camera: no pixel is interpolated."""
    camera = cornell_camera(SIZE)
    half = replace(camera, principal_point_px=camera.principal_point_px + np.array([0.5, 0.0]))
    image = render_image(RenderJob(cornell_box(), half, WAVELENGTHS, samples=64, batches=2, seed=6))
    first = first_name(image.project(np.eye(WAVELENGTHS.size))[0], noise=0.02)
    assert first.change == "shift"
    assert first.parameters == {"dx_px": pytest.approx(0.5, abs=0.1), "dy_px": pytest.approx(0.0, abs=0.1)}


def through(camera, seed):
    """One side, rendered through a camera of 96 x 96 pixels."""
    return side_of(
        [labelled_cube(render_image(RenderJob(cornell_box(), camera, WAVELENGTHS, 64, 4, seed=seed)))], [f"seed {seed}"]
    )


@cache
def unaltered():
    """The published camera's side, for all alterations."""
    return through(cornell_camera(96), 1)


@pytest.mark.parametrize(
    ("altered", "pattern", "change", "expected"),
    [
        (
            {"focal_length_px": 1.03 * 134.4},
            ("magnification", True),
            "view",
            {"magnification": 1.03, "turned_deg": 0.0},
        ),
        (
            {"rotation": np.radians(0.5)},
            ("turn", True),
            "view",
            {"magnification": 1.0, "turned_deg": 0.5},
        ),
        (
            {"k1": -0.05},
            ("magnification", False),
            "distortion",
            {"outwards_px_at_half_width": -0.05 * (47.5 / 134.4) ** 2 * 47.5},
        ),
    ],
    ids=["magnification", "turn", "distortion"],
)
def test_another_camera_is_named(altered, pattern, change, expected):
    """Rendered again through it: no pixel is interpolated. pattern : the clearest one, and whether it is positive."""
    camera = cornell_camera(96)
    assert camera.focal_length_px == pytest.approx(134.4)
    if "rotation" in altered:
        cosine, sine = np.cos(altered["rotation"]), np.sin(altered["rotation"])
        turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])  # of what it sees: x to y is clockwise
        altered = {"rotation": turn @ camera.rotation}
    outcome, names = regress_sides(unaltered(), through(replace(camera, **altered), 2))
    clearest = max(outcome.of_kind("pattern"), key=lambda row: abs(row.statistic))
    assert clearest.different
    assert (clearest.name, clearest.difference > 0) == pattern
    first = named_changes(names, None)[0]
    assert first.change == change and first.probability > 0.9
    tolerance = {"magnification": 2e-3, "turned_deg": 0.05, "outwards_px_at_half_width": 0.03}
    for key, value in expected.items():
        assert first.parameters[key] == pytest.approx(value, abs=tolerance[key])


def test_red_and_blue_exchanged_are_named():
    """In pictures of X, Y, Z whose red and blue (ITU-R BT.709) were exchanged before."""
    matrix = primaries_matrix(COLOUR_SPACES["rec709"])
    rgb = rendered()[0] @ np.linspace(0.2, 1.0, 3 * WAVELENGTHS.size).reshape(-1, 3)
    rgb *= [1.0, 0.7, 0.4]
    sides = []
    for seed, order in enumerate(([0, 1, 2], [2, 1, 0])):
        side = noisy(seed, rgb[..., order] @ matrix.T, noise=0.02)
        sides.append(replace(side, wavelength_nm=np.full(3, np.nan), in_colour=True))
    outcome = regress_pictures(*sides)
    assert outcome.changes[0].change == "bands-exchanged"
    assert outcome.changes[0].parameters["order"] == "BGR"


def test_what_no_explanation_fits_is_unknown():
    """A stain in the middle of the back wall."""
    clean, _ = rendered()
    rows, columns = np.indices(clean.shape[:2])
    stain = np.exp(-((rows - 18) ** 2 + (columns - 24) ** 2) / 18.0) * np.sin(WAVELENGTHS[:, None, None] / 30)
    _, names = regress_sides(noisy(1, noise=0.02), noisy(2, clean * (1 + 0.4 * np.moveaxis(stain, 0, -1)), noise=0.02))
    assert named_changes(names, variants())[0].change == "unknown"


def test_a_right_explanation_leaves_noise():
    """Chi-square per number is at most 1: floors make it smaller."""
    _, names = regress_sides(noisy(1), noisy(2, 1.05 * rendered()[0]))
    evidence = build_evidence(names)
    best = min(from_pictures(evidence, noisy(1)), key=lambda e: e.chi2)
    assert best.change.startswith("lamp")
    assert 0.3 < best.chi2 / evidence.numbers < 1.2


def test_a_picture_without_the_inside_of_a_surface_is_still_explained():
    """6 x 6 pixels: none is smooth, and the explanation rests on edges and borders alone."""

    def corner(side):
        index = side.surfaces.index[:6, :6]
        small = SurfaceIndices(index, side.surfaces.names, np.zeros(index.shape, bool))
        return replace(side, radiance=side.radiance[:6, :6], variance=side.variance[:6, :6], surfaces=small)

    sides = corner(noisy(1, noise=0.02)), corner(noisy(2, 1.3 * rendered()[0], noise=0.02))
    _, names = regress_sides(*sides)
    assert (build_evidence(names).cell < 0).all()
    first = named_changes(names, None)[0]
    assert first.change == "lamp-scale" and first.parameters["factor"] == pytest.approx(1.3, abs=0.03)


def test_the_published_box_is_recognised_and_another_is_not():
    assert mismatch(variants(), noisy(1)) < 0.05
    clean, _ = rendered()
    assert mismatch(variants(), noisy(1, clean[:, ::-1])) > 0.05


def test_a_larger_lamp_fills_a_larger_hole():
    box = cornell_box()
    grown = with_lamp_size(box, 1.2)
    lamp, before = (scene.lamp.surface.areas_mm2.sum() for scene in (grown, box))
    assert lamp == pytest.approx(1.44 * before)
    lost = box.surface("ceiling").areas_mm2.sum() - grown.surface("ceiling").areas_mm2.sum()
    assert lost == pytest.approx(lamp - before)


def test_without_a_compiler_the_pictures_alone_are_judged(monkeypatch):
    sides = noisy(1), noisy(2, rendered(3)[0])
    monkeypatch.setattr(variant, "compiled", lambda: False)
    outcome = regress_pictures(*sides)
    assert not outcome.same
    assert any("LLVM" in note for note in outcome.notes)


def test_a_picture_that_is_brighter_slowly_and_on_a_surface_is_a_further_change():
    """To one side, downwards by the square, and on the second surface: nothing of it remains."""
    _, comparison = regress_sides(noisy(1), noisy(2))
    evidence = build_evidence(comparison)
    further = _further_changes(comparison, evidence, None)
    y, x = np.meshgrid(*[np.linspace(-1, 1, SIZE)] * 2, indexing="ij")
    _, mask, *_ = comparison.strata.surfaces.values()
    change = evidence.features(evidence.baseline * (0.02 * x - 0.01 * y**2 + 0.03 * mask)[..., None])
    remainder = change - further @ np.linalg.lstsq(further, change, rcond=None)[0]
    assert np.linalg.norm(remainder) < 1e-6 * np.linalg.norm(change)
