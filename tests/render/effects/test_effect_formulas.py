"""What effects do to each stage's value: conservation, monotonic behaviour, the formulas that define them."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.chain.counts import Counts
from cboxlab.rendering.chain.light import Light
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.effects import catalogue
from cboxlab.rendering.image.blur import kernel
from cboxlab.scenes import Spectrum, cornell_box, cornell_camera
from cboxlab.scenes.shapes import vector_area
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.validation.diagnose.hypotheses import hypotheses
from helpers.fakes.patch_light import NM as FAKE_NM
from helpers.fakes.patch_light import fake_patch_light
from helpers.fakes.stages import NM, apply, counts, curves, light
from scipy.special import ndtr


@pytest.mark.parametrize(("identifier", "value"), [("veiling-glare", 0.1), ("ghost", 0.1)])
def test_scattered_light_keeps_the_mean(identifier, value):
    before = light()
    after = apply(identifier, before, fraction=value)
    np.testing.assert_allclose(after.signal.mean(axis=(1, 2)), before.signal.mean(axis=(1, 2)), rtol=1e-12)
    assert np.ptp(after.signal[0]) < np.ptp(before.signal[0])


def test_ghost_of_a_point_lies_opposite():
    signal = np.zeros((1, 5, 8))
    signal[0, 1, 2] = 1.0
    after = apply("ghost", Light(signal, np.array([550.0]), cornell_camera(8)), fraction=0.25).signal[0]
    assert after[1, 2] == 0.75 and after[3, 5] == 0.25 and after.sum() == 1


@pytest.mark.parametrize("sigma", [0.3, 0.5, 1.0, 2.0])
def test_defocus_of_a_point_keeps_its_light_and_has_its_width(sigma):
    """Variance sigma^2; below a pixel the kernel serves edges, and is wider by up to 0.028 px^2."""
    signal = np.zeros((1, 61, 61))
    signal[0, 30, 30] = 1.0
    after = apply("defocus", Light(signal, np.array([550.0]), cornell_camera(61)), sigma_px=sigma).signal[0]
    offset = np.arange(61) - 30
    assert after.sum() == pytest.approx(1, abs=1e-12) and after.min() >= 0
    variance = float(after.sum(axis=0) @ offset**2)
    assert sigma**2 - 1e-3 < variance < sigma**2 + (0.028 if sigma < 1 else 2e-3)


@pytest.mark.parametrize("sigma", [0.2, 0.4, 0.7, 1.2])
def test_defocus_of_edges_agrees_with_blur_before_the_pixels(sigma):
    """Edges at 50 places: the analytic blurred edge averaged over pixels, its width found within 14%.

    A kernel of pixels cannot know where in its pixel an edge lies, so a part of the change remains.
    """

    def area(x):
        """Integral of the blurred edge's profile up to x."""
        z = x / sigma
        return sigma * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))

    pixel = np.arange(-15, 16)
    values = np.linspace(-0.49, 0.49, 50)[:, None]
    sharp = np.clip(pixel + 0.5 - values, 0, 1)
    truth = area(pixel + 0.5 - values) - area(pixel - 0.5 - values)
    inner = slice(10, 21)

    def error(width: float) -> float:
        blurred = np.array([np.convolve(row, kernel(width), "same") for row in sharp])
        return float(np.sum((blurred - truth)[:, inner] ** 2))

    change = float(np.sum((sharp - truth)[:, inner] ** 2))
    assert error(sigma) < {0.2: 0.4, 0.4: 0.15, 0.7: 0.02, 1.2: 0.002}[sigma] * change
    candidates = np.linspace(0.5, 1.5, 101)
    best = candidates[np.argmin([error(sigma * c) for c in candidates])]
    assert best == pytest.approx(1, abs=0.14 if sigma < 0.5 else 0.02)


def test_chromatic_focus_leaves_550_nm_sharp_and_is_defocus_elsewhere():
    before = light()
    after = apply("chromatic-focus", before, sigma_px_per_100nm=0.8).signal
    np.testing.assert_array_equal(after[1], before.signal[1])
    same = apply("defocus", before, sigma_px=0.8 * 1.38).signal[0]
    np.testing.assert_allclose(after[0], same, rtol=1e-9)


def test_lateral_colour_moves_edges_by_their_radius():
    """A smooth bump 20 px from the principal point moves by 20 (lambda - 550) ppm 1e-6, here 0.014 x 20."""
    u, v = np.meshgrid(np.arange(64.0), np.arange(64.0))
    image = np.exp(-((u - 51.5) ** 2 + (v - 31.5) ** 2) / 8)
    before = Light(np.stack([image] * 3), np.array([410.0, 550.0, 690.0]), cornell_camera(64))
    after = apply("lateral-colour", before, ppm_per_nm=100)
    moved = [float((s * u).sum() / s.sum()) for s in after.signal]
    assert moved[2] - moved[1] == pytest.approx(20 * 0.014, rel=0.02)
    assert moved[0] - moved[1] == pytest.approx(-20 * 0.014, rel=0.02)
    np.testing.assert_allclose(after.signal[1], image, atol=1e-15)


def test_lateral_colour_of_a_known_scene_is_a_focal_length_for_each_band():
    """What another focal length makes of the picture is taken in proportion to each band's magnification."""
    camera, pattern = cornell_camera(16), np.random.default_rng(3).standard_normal((3, 16, 16))
    nm = np.array([410.0, 550.0, 690.0])
    before = Light(
        np.ones((3, 16, 16)),
        nm,
        camera,
        lambda moved_camera: (moved_camera.focal_length_px / camera.focal_length_px - 1) * pattern,
    )
    after = apply("lateral-colour", before, ppm_per_nm=50).signal - 1
    expected = 50e-6 * (nm - 550)[:, None, None] * pattern
    np.testing.assert_allclose(after, expected, atol=1e-12)
    twice = apply("lateral-colour", before.scaled(2.0), ppm_per_nm=50).signal - 2
    np.testing.assert_allclose(twice, 2 * expected, atol=1e-12)


def test_resampled_light_does_not_ring_below_nothing():
    """An edge against black, magnified by pixels alone: nothing turns negative."""
    image = np.zeros((1, 32, 32))
    image[0, 8:24, 8:24] = 1.0
    for nm in (410.0, 690.0):
        after = apply("lateral-colour", Light(image, np.array([nm]), cornell_camera(32)), ppm_per_nm=150)
        assert after.signal.min() >= 0 and after.signal.max() > 1e-3


def test_vignetting_loses_its_amount_in_the_corner_and_nothing_in_the_centre():
    uniform = Light(np.ones((1, 41, 51)), np.array([550.0]), cornell_camera(41))
    after = apply("vignetting", uniform, edge_loss=0.3).signal[0]
    assert after[0, 0] == pytest.approx(0.7) and after[20, 25] == 1
    assert after[20, 0] == pytest.approx(1 - 0.3 * 25**2 / (25**2 + 20**2))


def test_a_fall_off_that_camera_and_flats_correct_leaves_its_inverse():
    """Truth, over the fall-off by the flats: any loss within the bounds has its inverse within them."""
    (loss,) = catalogue()["vignetting"].numbers
    uniform = Light(np.ones((1, 41, 51)), np.array([550.0]), cornell_camera(41))
    lost, twice_corrected = (
        apply("vignetting", uniform, edge_loss=edge).signal[0, 0, 0] for edge in (loss.high, loss.low)
    )
    assert lost * twice_corrected == pytest.approx(1) and loss.low < -0.66


def test_filter_leak_lifts_the_stop_band_and_keeps_the_peak():
    after = apply("filter-leak", curves(), fraction=0.02).transmittance[0, 1]
    assert after[NM == 550][0] == pytest.approx(1) and after[NM == 700][0] == pytest.approx(0.02)


def test_filter_shift_moves_the_pass_band_by_the_cosine_in_the_filter():
    """Peak at 550 sqrt(1 - sin^2 / n^2) nm: sin^2 = 0.2, n = 1.5: 524.99 nm; on the axis none."""
    after = apply("filter-shift", curves(), effective_index=1.5).transmittance[:, 1]
    peak = [float(NM @ t / t.sum()) for t in after]
    assert peak[0] == pytest.approx(550, abs=0.01)
    assert peak[3] == pytest.approx(550 * np.sqrt(1 - 0.2 / 2.25), abs=0.1)
    assert np.all(np.diff(peak) < 0)


def test_lamp_spectrum_keeps_the_mean_and_tilts_as_wien():
    """Ratios of two black bodies in Wien's approximation, 1/T apart by 20e-6: exactly this tilt."""
    box = cornell_box()
    grid = np.arange(400.0, 701.0)
    before, after = (s.lamp.radiance.at(grid) for s in (box, apply("lamp-spectrum", box, mired_shift=20)))
    assert np.trapezoid(after, grid) == pytest.approx(np.trapezoid(before, grid), rel=1e-12)

    def wien(kelvin):
        return np.exp(-0.014387769 / (grid * 1e-9 * kelvin))

    ratio = wien(1 / (1 / 3000 + 20e-6)) / wien(3000)
    in_light = before > 0
    tilt = (after[in_light] / before[in_light]) / ratio[in_light]
    np.testing.assert_allclose(tilt, tilt[0], rtol=1e-9)
    assert after[-1] / before[-1] > after[in_light][1] / before[in_light][1]


def test_a_lamp_moves_with_its_hole():
    """The ceiling stays a ring of the same area around the lamp; a lamp outside the ceiling is refused."""
    box = cornell_box()
    moved = apply("lamp-offset", box, dx_mm=40, dz_mm=-25)
    shift = moved.lamp.surface.vertices_mm - box.lamp.surface.vertices_mm
    np.testing.assert_allclose(shift, [[40, 0, -25]] * 4)
    before, after = box.surface("ceiling"), moved.surface("ceiling")
    assert after.areas_mm2.sum() == pytest.approx(before.areas_mm2.sum())
    normals = [vector_area(after.vertices_mm[face]) for face in after.faces]
    assert all(normal[1] < 0 for normal in normals)
    corners = {tuple(v) for v in after.vertices_mm}
    assert {tuple(v) for v in moved.lamp.surface.vertices_mm} <= corners
    others = [s for s in box.surfaces if s.name != "ceiling"]
    assert len(others) == 6 and all(moved.surface(s.name) is s for s in others)
    effect = catalogue()["lamp-offset"]
    with pytest.raises(InputError, match="inside"):
        effect.apply(box, dx_mm=300.0, dz_mm=0.0)


def test_lamp_shape_and_direction_reach_the_lamp():
    box = cornell_box()
    assert apply("lamp-nonuniform", box, edge_ratio=0.4).lamp.edge_ratio == 0.4
    once = apply("lamp-directional", box, exponent=1.5)
    assert apply("lamp-directional", once, exponent=0.5).lamp.exponent == 2


def test_lamp_reflectance_replaces_the_mean_and_keeps_the_shape():
    box = cornell_box()
    sloped = replace(box, lamp=replace(box.lamp, reflectance=Spectrum(NM, 0.2 + 0.001 * (NM - 400))))
    for scene in (box, sloped):
        table, after = (
            s.lamp.reflectance.at(WAVELENGTH_NM) for s in (scene, apply("lamp-reflectance", scene, reflectance=0.5))
        )
        np.testing.assert_allclose(after, table * 0.5 / table.mean(), rtol=1e-2)
        assert after.mean() == pytest.approx(0.5, abs=1e-3)
    assert not apply("lamp-reflectance", box, reflectance=0.0).lamp.reflects
    black = apply("lamp-reflectance", box, reflectance=0.0)
    assert apply("lamp-reflectance", black, reflectance=0.4).lamp.reflectance.at([400, 700]) == pytest.approx(0.4)


def test_the_null_of_the_lamps_reflectance_is_the_scenes_own():
    """In another box it does nothing at another number, from which a fit starts."""
    effect, box = catalogue()["lamp-reflectance"], cornell_box()
    for level in (0.0, 0.3):
        scene = apply("lamp-reflectance", box, reflectance=level)
        (parameter,) = effect.within(scene).parameters
        assert (
            parameter.null == pytest.approx(level)
            and parameter.low <= parameter.null + parameter.coordinate_step <= parameter.high
        )
        np.testing.assert_allclose(
            effect.apply(scene, reflectance=parameter.null).reflectances(NM), scene.reflectances(NM), rtol=1e-12
        )
        lamp_hypotheses = [h for h in hypotheses(("b",), scene, RenderSettings()) if h.effect.id == effect.id]
        assert len(lamp_hypotheses) == 1 and lamp_hypotheses[0].at({}).values["reflectance"] == parameter.null
    assert effect.within(box).parameters[0].null == pytest.approx(effect.parameters[0].null)


def test_wall_reflectance_scales_one_paint_and_never_beyond_1():
    box = cornell_box()
    after = apply("wall-reflectance", box, material="red", scale=1.1)
    red, table = (scene.materials["red"].reflectance.at(NM) for scene in (after, box))
    np.testing.assert_allclose(red, 1.1 * table)
    assert after.materials["white"] is box.materials["white"]
    bright = apply("wall-reflectance", box, material="white", scale=1.5).materials["white"].reflectance
    assert bright.values.max() == 1


def test_a_block_turns_right_handed_about_its_own_footprint():
    """About +y +z turns towards +x. The footprint's centre goes where dx and dz say; heights stay."""
    box = cornell_box()
    before = box.surface("tall-block").vertices_mm
    moved = apply("block-pose", box, block="tall", dx_mm=5, dz_mm=-3, yaw_deg=30)
    after = moved.surface("tall-block").vertices_mm
    centre = np.unique(before[before[:, 1] == 0], axis=0).mean(axis=0)
    a, b = before - centre, after - centre - [5, 0, -3]
    turn = np.deg2rad(30)
    np.testing.assert_allclose(b[:, 0], a[:, 0] * np.cos(turn) + a[:, 2] * np.sin(turn), atol=1e-9)
    np.testing.assert_allclose(b[:, 2], a[:, 2] * np.cos(turn) - a[:, 0] * np.sin(turn), atol=1e-9)
    np.testing.assert_allclose(b[:, 1], a[:, 1], atol=1e-9)


def test_interreflection_changes_the_bounces():
    assert apply("interreflection", RenderSettings(max_bounces=1)).max_bounces is None
    assert apply("interreflection", RenderSettings(), max_bounces=2).max_bounces == 2


def test_camera_pose_turns_camera_axes_and_shifts_the_centre():
    """A turn about the camera's own forward axis by 90 degrees carries a point on the right to below."""
    camera = cornell_camera(64)
    turned = catalogue()["camera-pose"].apply(
        camera, rx_deg=0.0, ry_deg=0.0, rz_deg=90.0, tx_mm=0.0, ty_mm=0.0, tz_mm=0.0
    )
    point = [[100.0, 273.0, 0.0]]
    right, down = camera.project(point)[0] - camera.principal_point_px
    assert right > 10
    offset = turned.project(point)[0] - camera.principal_point_px
    np.testing.assert_allclose(offset, [-down, right], atol=1e-9)
    shifted = apply("camera-pose", camera, tx_mm=3, tz_mm=-2)
    np.testing.assert_allclose(shifted.position_mm - camera.position_mm, [3, 0, -2])
    assert apply("lens-distortion", camera, k1=0.02).k1 == pytest.approx(camera.k1 + 0.02)


def test_crosstalk_keeps_all_charge_and_gives_neighbours_a_quarter():
    before = counts()
    after = apply("crosstalk", before, fraction=0.08)
    for name in ("scene", "flat", "reference"):
        a, b = getattr(before, name), getattr(after, name)
        np.testing.assert_allclose(b.sum(axis=(1, 2)), a.sum(axis=(1, 2)), rtol=1e-12)
        mixed = 0.92 * a[1, 5, 6] + 0.02 * (a[1, 4, 6] + a[1, 6, 6] + a[1, 5, 5] + a[1, 5, 7])
        assert b[1, 5, 6] == pytest.approx(mixed)


def test_smear_adds_the_columns_mean_signal():
    before = counts()
    after = apply("smear", before, fraction=0.03)
    added = after.flat - before.flat
    np.testing.assert_allclose(added[1], np.tile(0.03 * (before.flat[1].mean(axis=0) - 102.0), (20, 1)))


def test_counts_effects_follow_their_formulas():
    c = counts()
    offset = apply("dark-offset", c, dn=3)
    for name in ("scene", "flat", "reference"):
        np.testing.assert_allclose(getattr(offset, name) - getattr(c, name), 3.0)
    assert offset.dark_flat is c.dark_flat
    bent = apply("nonlinearity", c, b=-0.02)
    np.testing.assert_allclose(bent.scene, c.scene * (1 - 0.02 * c.scene / 4095))
    np.testing.assert_allclose(bent.dark_reference, c.dark_reference * (1 - 0.02 * c.dark_reference / 4095))

    above = apply("nonlinearity", replace(c, scene=4095.0 + 100 * c.scene / c.scene.max()), b=-0.02).scene
    np.testing.assert_allclose(above, 4095 * 0.98 + 0.96 * 100 * c.scene / c.scene.max())  # the slope at full scale

    def ratio(after: Counts, of: str = "scene") -> np.ndarray:
        """Signal above dark over that without the effect, by band; the same in all pixels."""
        dark = getattr(c, f"dark_{of}")[:, None, None]
        ratios = (getattr(after, of) - dark) / (getattr(c, of) - dark)
        np.testing.assert_allclose(ratios, ratios[:, :1, :1] + 0 * ratios, rtol=1e-9)
        return ratios[:, 0, 0]

    longer = apply("shutter-offset", c, seconds=0.1)
    np.testing.assert_allclose(ratio(longer), [1.025, 1.05, 1.1])
    np.testing.assert_allclose(ratio(longer, "flat"), [1.05, 1.1, 1.2])
    np.testing.assert_allclose(ratio(longer, "reference"), [1.1, 1.2, 1.4])
    drift = apply("lamp-drift", c, per_minute=0.01)
    np.testing.assert_allclose(ratio(drift), [1.005, 1.02, 1.05])
    assert drift.flat is c.flat and drift.reference is c.reference
    gain = apply("band-gain", c, band="f550", scale=1.1)
    np.testing.assert_allclose(ratio(gain), [1, 1.1, 1])
    assert gain.flat is c.flat and gain.reference is c.reference


@pytest.mark.parametrize(
    ("surface", "axis", "low", "extent"),
    [("floor", "z", 0.0, 559.2), ("left", "y", 0.0, 548.8), ("left", "x", 549.6, 6.4)],
)
def test_reflectance_gradient_darkens_along_one_axis(surface, axis, low, extent):
    """Patches and fragments of the surface by 1 - 0.4 s, s = 0 at its low end and 1 at its high end; others stay."""
    before = fake_patch_light()
    after = apply("reflectance-gradient", before, surface=surface, axis=axis, amplitude=0.4)
    transport, column = before.transport, "xyz".index(axis)
    patches = transport.light.patches
    index = [s.name for s in before.scene.surfaces].index(surface)
    for reflectance_factor, position, old, new in (
        (patches.surface, patches.centre, before.patch_reflectance, after.patch_reflectance),
        (transport.surface, transport.position, before.fragment_reflectance, after.fragment_reflectance),
    ):
        s = (position[:, column] - low) / extent
        assert np.all((s > 0) & (s < 1) | (reflectance_factor != index)) and np.any(reflectance_factor == index)
        np.testing.assert_allclose(
            new, old * np.where(reflectance_factor == index, 1 - 0.4 * s, 1.0)[:, None], rtol=1e-12
        )


def test_fluorescence_emits_the_quanta_it_absorbs():
    """White absorbs what arrives below 455 nm, by 5 nm, and emits its quanta in a bell about 520 nm of sigma 24 nm.

    The lamp is a slope, so that its place on the scale of wavelengths counts; light is reflected without end.
    """
    before = fake_patch_light()
    after = apply("fluorescence", before, **{"material": "white", "yield": 0.3, "peak_nm": 520.0})
    transport, scene = before.transport, before.scene
    exchange, patches = transport.light.exchange, transport.light.patches
    white = list(scene.materials).index("white")
    arriving_patch, arriving_fragment = np.zeros(3), np.zeros(5)
    wavelengths = np.arange(400.0, 456.0, 5.0)
    for nm in wavelengths:
        table = scene.reflectances(np.array([nm]))[:, 0]
        rho = table[patches.material]
        factors = exchange.form_factors.astype(float)
        b = np.linalg.solve(np.eye(3) - rho[:, None] * factors, rho * exchange.direct[:, 0])
        width = 2.5 if nm in wavelengths[[0, -1]] else 5.0
        quanta = (1 - table[white]) * (0.2 + 1.8 * (nm - 300) / 600) * nm * width
        arriving_patch += (exchange.direct[:, 0] + factors @ b) * quanta
        arriving_fragment += (transport.direct[:, 0] + transport.gather.toarray() @ b) * quanta
    lamp = 0.2 + 1.8 * (FAKE_NM - 300) / 600
    bell = np.exp(-((FAKE_NM - 520.0) ** 2) / (2 * 24.0**2)) / (24.0 * np.sqrt(2 * np.pi))
    spectrum = 0.3 * bell / FAKE_NM / lamp
    mask = patches.material == white
    np.testing.assert_allclose(after.patch_emission, np.outer(mask * arriving_patch, spectrum), rtol=1e-5)
    mask = transport.material == white
    np.testing.assert_allclose(after.fragment_emission, np.outer(mask * arriving_fragment, spectrum), rtol=1e-5)


def test_ambient_spectra_are_1_at_550_nm():
    """Planck's ratio to 550 nm, and the lines as defined, by independent formulas."""
    light, lamp = fake_patch_light(), 0.2 + 1.8 * (FAKE_NM - 300) / 600
    c2 = 0.014387769

    def planck(nm, kelvin):
        return nm**-5 / np.expm1(c2 / (nm * 1e-9 * kelvin))

    for spectrum, kelvin in (("daylight", 6500.0), ("tungsten", 2900.0)):
        values = {"radiance": 0.01, "spectrum": spectrum}
        surround = apply("ambient-light", light, **values).surround
        assert surround == pytest.approx(0.01 * planck(FAKE_NM, kelvin) / planck(550.0, kelvin) / lamp, rel=1e-6)
    values = {"radiance": 0.01, "spectrum": "fluorescent"}
    surround = apply("ambient-light", light, **values).surround
    lines = [(436, 1.0, 5), (488, 0.6, 7), (545, 2.2, 6), (611, 1.6, 7)]
    shape = [0.35 + sum(h * np.exp(-((nm - c) ** 2) / (2 * s * s)) for c, h, s in lines) for nm in (550.0, *FAKE_NM)]
    assert surround == pytest.approx(0.01 * np.array(shape[1:]) / shape[0] / lamp, rel=1e-9)
