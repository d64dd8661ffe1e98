"""A picture from patches, written out by hand: few patches with numbers at random, all sums as dense matrices."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cboxlab.rendering.perturbation import with_albedo
from helpers.fakes.patch_light import NM, fake_patch_light


def exchange_of(light):
    """As doubles: direct light, form factors, escape of the patches; direct, G, escape of the fragments."""
    e, t = light.transport.light.exchange, light.transport
    parts = (e.direct[:, 0], e.form_factors, e.escape, t.direct[:, 0], t.gather.toarray(), t.escape)
    return [np.asarray(part, float) for part in parts]


def everything_added(max_bounces=None):
    """Light with every source: surround, emission of patches and fragments, further radiance."""
    random, light = np.random.default_rng(2), fake_patch_light(max_bounces)
    return light.change(
        surround=np.array([0.02, 0.05, 0.03]),
        added=random.uniform(-0.01, 0.01, light.added.shape),
        patch_emission=random.uniform(0.0, 0.1, light.patch_emission.shape),
        fragment_emission=random.uniform(0.0, 0.1, light.fragment_emission.shape),
    )


def picture_of(light, radiance):
    """(w, y, x) from the patches' radiance (p, w): each pixel a sum over its fragments."""
    *_, direct, gather, escape = exchange_of(light)
    t = light.transport
    expected = np.empty_like(light.added)
    for band in range(len(NM)):
        arriving = direct + gather @ radiance[:, band] + escape * light.surround[band]
        leaving = light.fragment_reflectance[:, band] * arriving + light.fragment_emission[:, band]
        picture = np.zeros(t.covered.size)
        for fragment, pixel in enumerate(t.pixel):
            picture[pixel] += t.coverage[fragment] * leaving[fragment]
        beyond = light.surround[band] * (1 - t.covered)
        expected[band] = picture.reshape(t.covered.shape) + t.lamp_radiance[0] + beyond + light.added[band]
    return expected


def test_all_reflections_are_the_solution_of_the_radiosity_equation():
    """b = rho (e + F (b + own) + escape surround) + own light, by elimination in place of iteration."""
    light = everything_added()
    direct, factors, escape, *_ = exchange_of(light)
    radiance = np.empty_like(light.patch_emission)
    for band in range(len(NM)):
        rho, emission = np.diag(light.patch_reflectance[:, band]), light.patch_emission[:, band]
        source = direct + escape * light.surround[band] + factors @ emission
        radiance[:, band] = np.linalg.solve(np.eye(3) - rho @ factors, rho @ source) + emission
    np.testing.assert_allclose(light.patch_radiance(), radiance, rtol=3e-6)
    np.testing.assert_allclose(light.picture(), picture_of(light, radiance), rtol=3e-6, atol=1e-9)


@pytest.mark.parametrize("max_bounces", [1, 2, 3])
def test_reflections_end_at_the_stated_number(max_bounces):
    """The pixel's own reflection is the last: the patches reflect once less."""
    light = everything_added(max_bounces)
    direct, factors, escape, *_ = exchange_of(light)
    first = direct[:, None] + np.outer(escape, light.surround) + factors @ light.patch_emission
    radiance, arriving = light.patch_emission.copy(), first
    for _ in range(max_bounces - 1):
        bounce = light.patch_reflectance * arriving
        radiance, arriving = radiance + bounce, factors @ bounce
    np.testing.assert_allclose(light.picture(), picture_of(light, radiance), rtol=3e-6, atol=1e-9)


def test_another_albedo_for_diffuse_and_for_direct_light():
    """One paint: diffuse light meets half of its table, the lamp's light the table times the cosine towards the lamp.

    So b = rho/2 (F b + e) + (rho cosine - rho/2) e on that paint, all else as it was.
    """
    light = fake_patch_light()
    materials = list(light.scene.materials)
    after = with_albedo(light, materials.index("white"), lambda rho: 0.5 * rho, lambda rho, cosine: rho * cosine)
    patches, lamp = light.transport.light.patches, light.transport.light.lamps[0].centre
    direct, factors, *_ = exchange_of(light)
    rho = light.patch_reflectance.copy()
    first = rho * direct[:, None]
    for k in range(3):
        if materials[patches.material[k]] != "white":
            continue
        way = lamp - patches.centre[k]
        cosine = float(way @ patches.normal[k]) / float(np.sqrt(way @ way))
        first[k] = rho[k] * cosine * direct[k]
        rho[k] *= 0.5
    expected = np.stack(
        [np.linalg.solve(np.eye(3) - rho[:, [b]] * factors, first[:, b]) for b in range(len(NM))], axis=1
    )
    np.testing.assert_allclose(after.patch_radiance(), expected, rtol=3e-6)
    np.testing.assert_array_equal(after.fragment_reflectance, light.fragment_reflectance)


def test_each_lamps_light_meets_the_albedo_at_its_own_angle():
    """Two lamps of other colours: rho cosine of each on the paint, less the half that diffuse light meets."""
    light = fake_patch_light()
    field, random = light.transport.light, np.random.default_rng(6)
    second = SimpleNamespace(centre=np.array([100.0, 500.0, 80.0]))
    direct = random.uniform(0.1, 0.3, (3, 2)).astype(np.float32)
    exchange = replace(field.exchange, direct=direct)
    transport = replace(light.transport, light=replace(field, lamps=(*field.lamps, second), exchange=exchange))
    shares = np.array([[0.4, 0.9, 1.2], [1.6, 1.1, 0.8]])
    white = list(light.scene.materials).index("white")
    two = light.change(transport=transport, lamp_shares=shares)
    after = with_albedo(two, white, lambda rho: 0.5 * rho, lambda rho, cosine: rho * cosine)
    for k in np.flatnonzero(field.patches.material == white):
        expected = np.zeros(len(NM))
        for lamp, arriving, share in zip(transport.light.lamps, direct[k], shares, strict=True):
            way = lamp.centre - field.patches.centre[k]
            cosine = float(way @ field.patches.normal[k]) / float(np.sqrt(way @ way))
            expected += light.patch_reflectance[k] * (cosine - 0.5) * arriving * share
        np.testing.assert_allclose(after.patch_emission[k], expected, rtol=1e-6)


def test_where_light_is_reflected_once_patches_reflect_nothing():
    light = fake_patch_light(max_bounces=1)
    after = with_albedo(light, 0, lambda rho: 0.5 * rho, lambda rho, cosine: rho * cosine)
    assert not after.patch_emission.any()


def test_what_is_known_of_the_same_numbers_is_not_computed_again():
    """The solution of equal reflectances and sources is kept, of one changed number it is another; old ones go."""
    transport = fake_patch_light().transport
    computed = []

    def of(*numbers):
        def compute():
            computed.append(numbers)
            return np.sum(numbers)

        return transport.cached(("sum", np.array(numbers)), compute)

    assert [of(1.0, 2.0), of(1.0, 2.0), of(1.0, 2.5), of(1.0, 2.0)] == [3.0, 3.0, 3.5, 3.0]
    assert computed == [(1.0, 2.0), (1.0, 2.5)]
    for number in range(100):
        of(number)
        assert of(1.0, 2.0) == 3.0, "the one in use stays"
    assert of(1.0, 2.5) == 3.5
    assert computed.count((1.0, 2.0)) == 1
    assert computed.count((1.0, 2.5)) == 2
    assert len(transport._results) < 20


@pytest.mark.parametrize("changed", ["patch_reflectance", "patch_emission", "surround", "max_bounces"])
def test_a_solution_follows_whatever_changes_it(changed):
    """A light derived from another of the same geometry is as one with a fresh transport."""
    light = everything_added()
    light.patch_radiance()
    value = 3 if changed == "max_bounces" else 1.1 * getattr(light, changed)
    other = light.change(**{changed: value})
    fresh = replace(other, transport=replace(other.transport))
    assert fresh.transport._results == {}
    np.testing.assert_array_equal(other.patch_radiance(), fresh.patch_radiance())
    assert np.any(other.patch_radiance() != light.patch_radiance())
