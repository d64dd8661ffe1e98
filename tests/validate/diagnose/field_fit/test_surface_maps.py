"""What maps on surfaces change, against the radiosity solved again with the reflectance or the light changed."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.validation.diagnose.field_fit import field, lamp_dn
from cboxlab.validation.diagnose.field_fit.surface_maps import _cosines, _lamp_lobes, smooth_surface_maps
from helpers.captures.small_excess import SIGNAL, small_excess

STEP = 1e-3
PATCH_LIGHT, LIGHT = np.array([0.3, 0.1, 0.5, 0.4]), 0.6


def picture(transport, band, fragment_factor=1.0, patch_factor=1.0, fragment_light=0.0, patch_light=0.0):
    """(pixel,) radiance with reflectances times the factors and light added, and what arrives at patches and pixels."""
    t = transport
    patch_rho = t.reflectance[t.patch_material, band] * patch_factor
    first = PATCH_LIGHT + patch_light
    system = np.eye(len(patch_rho)) - patch_rho[:, None] * t.form_factors
    radiance = np.linalg.solve(system, patch_rho * first)
    arriving = LIGHT + fragment_light + t.gather @ radiance
    rho = t.reflectance[t.material, band] * fragment_factor
    return t.coverage * rho * arriving, first + t.form_factors @ radiance, arriving


@pytest.fixture(scope="module")
def excess():
    plain = small_excess(np.zeros(SIGNAL.shape))
    each = [picture(plain.transport, band)[1:] for band in range(len(plain.bands))]
    patches, pixels = (np.array(column).T for column in zip(*each, strict=True))
    return replace(plain, transport=replace(plain.transport, arriving=pixels, patch_arriving=patches))


def test_maps_change_the_picture_as_a_new_solution_does(excess):
    maps, t, band = smooth_surface_maps(excess), excess.transport, 2
    some = [0, 1, len(maps.waves) - 2]
    dn = lamp_dn(excess, band)
    visible = maps.visible(some)
    results = {"reflectance": maps.reflectance(band, some), "light": maps.light(band, some)}
    for row, k in enumerate(some):
        on_fragments = np.where(t.surface == maps.surface[k], maps.waves[k].at(t.position), 0.0)
        on_patches = np.where(t.patch_surface == maps.surface[k], maps.waves[k].at(t.patch_position), 0.0)
        np.testing.assert_allclose(visible[row], on_fragments, rtol=1e-6)
        both = {
            "reflectance": [
                picture(t, band, 1 + sign * STEP * on_fragments, 1 + sign * STEP * on_patches)[0] for sign in (1, -1)
            ],
            "light": [
                picture(t, band, fragment_light=sign * STEP * on_fragments, patch_light=sign * STEP * on_patches)[0]
                for sign in (1, -1)
            ],
        }
        for what, (more, less) in both.items():
            exact = dn * (more - less) / (2 * STEP)
            np.testing.assert_allclose(results[what][row], exact, rtol=1e-4, atol=1e-4 * np.abs(exact).max())


def test_normal_equations_are_the_same_from_blocks_of_pixels(excess, monkeypatch):
    columns = smooth_surface_maps(excess).reflectance(1, range(5))
    equations = field.normal_equations(excess, columns, 1)
    monkeypatch.setattr(field, "_BLOCK_PIXELS", 501)
    for part, other in zip(equations, field.normal_equations(excess, columns, 1), strict=True):
        np.testing.assert_allclose(other, part, rtol=1e-9, atol=1e-9 * np.abs(part).max())


def test_a_matte_lobe_changes_direct_light_by_its_incidence_and_all_light_by_the_view(excess):
    """Paint 1 reflects as known at 0, 15 .. 90 degrees, with straight lines between; what it lights follows."""
    t, band = excess.transport, 2
    t = replace(
        t,
        direct=np.full(t.arriving.shape, LIGHT),
        patch_direct=np.repeat(PATCH_LIGHT[:, None], len(excess.bands), 1),
    )
    degrees, knots = np.linspace(0, 90, 7), np.eye(7)
    excess = replace(excess, transport=t)
    dn, on_surface = lamp_dn(excess, band), t.material == 1
    lobe = smooth_surface_maps(excess).lobe(band, 1)
    rho, patch_rho = t.reflectance[t.material, band], t.reflectance[t.patch_material, band]
    system = np.eye(len(patch_rho)) - patch_rho[:, None] * t.form_factors
    assert len(lobe) == 15
    for at_angle, by_view, by_incidence in zip(knots, lobe[:7], lobe[8:], strict=True):
        view, incidence, of_patches = (
            np.interp(np.degrees(np.arccos(cosine)), degrees, at_angle)
            for cosine in (t.view, t.incidence, t.patch_incidence)
        )
        exact = on_surface * (view - view[on_surface].mean()) * t.arriving[:, band]
        np.testing.assert_allclose(by_view, dn * rho * exact, atol=1e-4 * dn)
        brighter = np.linalg.solve(system, patch_rho * PATCH_LIGHT * of_patches * (t.patch_material == 1))
        exact = on_surface * incidence * LIGHT + t.gather @ brighter
        np.testing.assert_allclose(by_incidence, dn * rho * exact, atol=1e-4 * dn)
    both = t.view * t.incidence
    np.testing.assert_allclose(
        lobe[7], dn * rho * on_surface * (both - both[on_surface].mean()) * LIGHT, atol=1e-4 * dn
    )


def test_the_prior_of_a_map_falls_to_one_half_at_the_second_order():
    maps = _cosines("floor", np.array([[0.0, 0, 0], [400, 0, 300]]))
    order = {tuple(m.waves[0]): float(m.values[0]) for m in maps}
    assert order[0, 0, 0] == 1
    assert order[2, 0, 0] == order[0, 0, 2] == pytest.approx(1 / 2)
    assert order[1, 0, 1] == pytest.approx(1 / 1.5)
    assert order[4, 0, 0] == pytest.approx(1 / 5)


def test_lobes_of_a_lamp_are_powers_of_the_cosine_and_their_first_order():
    """cos^n is 1 + n log(cos) for small n; towards the horizon the logarithm ends."""
    even, narrow, narrower, first = _lamp_lobes(np.cos(np.radians([0.0, 60.0, 90.0])))
    assert np.stack([even, narrow, narrower]) == pytest.approx(np.array([[1, 1, 1], [1, 0.5, 0], [1, 0.25, 0]]))
    assert first[:2] == pytest.approx((np.array([1, 0.5]) ** 1e-6 - 1) / 1e-6, abs=1e-5)
    assert -10 < first[2] < first[1]


def test_brighter_lamps_light_what_the_walls_reflect_too(excess):
    """By the radiosity solved again: light of the lamps in four forms, at patches and at pixels."""
    t, band = excess.transport, 1
    direct = np.full(t.arriving.shape, LIGHT)
    t = replace(t, direct=direct, patch_direct=np.repeat(PATCH_LIGHT[:, None], len(excess.bands), 1))
    excess = replace(excess, transport=t)
    lobes = smooth_surface_maps(excess).lamp_lobe(band)
    rho, patch_rho = t.reflectance[t.material, band], t.reflectance[t.patch_material, band]
    system = np.eye(len(patch_rho)) - patch_rho[:, None] * t.form_factors
    pairs = zip(lobes, _lamp_lobes(t.emission), _lamp_lobes(t.patch_emission), strict=True)
    for lobe, of_pixels, of_patches in pairs:
        exact = of_pixels * LIGHT + t.gather @ np.linalg.solve(system, patch_rho * PATCH_LIGHT * of_patches)
        np.testing.assert_allclose(lobe, lamp_dn(excess, band) * rho * exact, rtol=1e-4)


def test_maps_of_a_surface_lie_side_by_side(excess):
    maps = smooth_surface_maps(excess)
    by_surface = maps.by_surface()
    assert sorted(by_surface) == sorted(set(maps.surface))
    for surface, some in by_surface.items():
        np.testing.assert_array_equal(some, np.flatnonzero(maps.surface == surface))


@pytest.mark.parametrize(("height", "highest"), [(0.0, 4), (250.0, 3)])
def test_a_body_has_waves_of_one_order_less_than_a_wall(height, highest):
    waves = np.array([m.waves[0] for m in _cosines("body", np.array([[0.0, 0, 0], [400, height, 300]]))])
    assert waves.sum(axis=1).max() == highest
