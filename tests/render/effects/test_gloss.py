"""A coat over a paint: what it lets through and reflects, as handed to the patches and to the rays."""

import numpy as np
import pytest
from cboxlab.rendering.device import dr, mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.perturbation import brdf_change
from helpers.fakes.patch_light import fake_patch_light
from helpers.fakes.stages import apply

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: the coat's kernels")

SPECULAR, ROUGHNESS = 0.8, 0.3


def fresnel(cosine, index=1.5):
    """By Snell's law and the two polarisations."""
    inner = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = (cosine - index * inner) / (cosine + index * inner)
    along = (index * cosine - inner) / (index * cosine + inner)
    return (across**2 + along**2) / 2


@pytest.fixture
def applied(monkeypatch):
    """Light before and after, and what the rays were given in place of being traced."""
    before, arguments = fake_patch_light(), {}
    before = before.change(added=np.full(before.added.shape, 0.002))

    def traced(field, camera, radiance, reflectances, lamp_shares, reflection, **options):
        arguments.update(options, **vars(reflection), radiance=radiance, reflectances=reflectances)
        np.testing.assert_array_equal(lamp_shares, before.lamp_shares)
        return np.full((3, camera.height_px, camera.width_px), 0.01)

    monkeypatch.setattr(brdf_change, "changed_reflection", traced)
    after = apply("gloss", before, material="white", specular=SPECULAR, roughness=ROUGHNESS)
    return before, after, arguments


def test_what_the_rays_change_is_added(applied):
    before, after, arguments = applied
    np.testing.assert_allclose(after.added, 0.012)
    np.testing.assert_array_equal(arguments["reflectances"], before.scene.reflectances(before.wavelength_nm))
    assert arguments["material"] == list(before.scene.materials).index("white")
    radiance = after.change(added=before.added).patch_radiance()
    np.testing.assert_allclose(arguments["radiance"], radiance)


def test_patches_pass_through_the_coat_twice_and_see_its_own_reflection(applied):
    """Diffuse light: rho (1 - s F)^2 + A, F = 0.0918 and A the means over the hemisphere; other paints as they were."""
    before, after, arguments = applied
    cosine = (np.arange(400) + 0.5) / 400
    mean = float(np.mean(2 * cosine * arguments["coat"].albedo(cosine, 48)))
    through = 1 - SPECULAR * float(np.mean(2 * cosine * fresnel(cosine)))
    mask = before.transport.light.patches.material == arguments["material"]
    expected = before.patch_reflectance[mask] * through**2 + mean
    np.testing.assert_allclose(after.patch_reflectance[mask], expected, rtol=0.002)
    np.testing.assert_array_equal(after.patch_reflectance[~mask], before.patch_reflectance[~mask])


def test_the_lamps_light_passes_at_its_own_angle(applied):
    """Emitted next to: e (rho (1 - s F(c)) (1 - s F) + A(c)) less what the diffuse albedo makes of e."""
    before, after, arguments = applied
    patches, lamp = before.transport.light.patches, before.transport.light.lamps[0].centre
    mask = patches.material == arguments["material"]
    way = lamp - patches.centre[mask]
    cosine = np.sum(way * patches.normal[mask], axis=1) / np.linalg.norm(way, axis=1)
    spread = (np.arange(4000) + 0.5) / 4000
    through = 1 - SPECULAR * float(np.mean(2 * spread * fresnel(spread)))
    at_angle = before.patch_reflectance[mask] * ((1 - SPECULAR * fresnel(cosine)) * through)[:, None]
    at_angle = at_angle + arguments["coat"].albedo(cosine)[:, None]
    direct = before.transport.light.exchange.direct[mask]
    expected = direct * (at_angle - after.patch_reflectance[mask])
    np.testing.assert_allclose(after.patch_emission[mask], expected, rtol=0.02, atol=1e-4)


def test_base_and_means_are_those_of_the_coat(applied):
    """The base gets what passes on both ways; its mean over the ways out has the diffuse part for the second."""
    *_, arguments = applied
    random = np.random.default_rng(4)
    a, b = random.uniform(0.05, 1.0, (2, 200))
    incoming, outgoing = (
        mi.Vector3f(*(mi.Float(x.astype(np.float32)) for x in (np.sqrt(1 - z**2), 0 * z, z))) for z in (a, b)
    )
    expected = (1 - SPECULAR * fresnel(a)) * (1 - SPECULAR * fresnel(b))
    np.testing.assert_allclose(np.array(arguments["base"](incoming, outgoing)), expected, rtol=1e-5)
    base, lobe = arguments["albedo"](mi.Float(a.astype(np.float32)))
    np.testing.assert_allclose(np.array(base), (1 - SPECULAR * fresnel(a)) * (1 - SPECULAR * 0.0918), rtol=1e-4)
    np.testing.assert_allclose(np.array(lobe), arguments["coat"].albedo(a), rtol=0.02, atol=2e-3)
    assert dr.width(lobe) == 200


@pytest.mark.parametrize(("roughness", "times"), [(0.6, 1), (0.15, 2), (0.08, 4), (0.03, 8)])
def test_narrow_lobes_take_more_samples(monkeypatch, roughness, times):
    """1 + (0.15 / roughness)^2 times as many, at most eight times, to the next power of two; a quarter of them for the
    reflection before, but never fewer than for a broad lobe."""
    arguments, before = {}, fake_patch_light()
    monkeypatch.setattr(brdf_change, "changed_reflection", lambda *_, **options: arguments.update(options) or 0.0)
    apply("gloss", before, material="white", specular=0.5, roughness=roughness)
    assert arguments["samples"] == (times * before.samples, max(1, times // 4) * before.samples)


def test_rays_are_traced_again_only_for_another_coat_or_another_light(monkeypatch):
    """Light emitted by the picture's own points changes no ray's; patches that emit, and another coat, do.

    With one bounce patches are dark, whatever reflects.
    """
    traced, before = [], fake_patch_light()
    direct = before.change(max_bounces=1)
    monkeypatch.setattr(
        brdf_change, "changed_reflection", lambda *arguments, **_: traced.append(arguments) or np.zeros(1)
    )
    coat = {"material": "white", "specular": 0.5, "roughness": 0.3}
    brighter = before.change(fragment_emission=before.fragment_emission + 0.1)
    glowing = before.change(patch_emission=before.patch_emission + 0.1)
    shares = before.change(lamp_shares=2 * before.lamp_shares)
    for light, values, times in (
        (before, coat, 1),
        (brighter, coat, 1),
        (glowing, coat, 2),
        (shares, coat, 3),
        (before, coat | {"roughness": 0.4}, 4),
        (before, coat | {"specular": 0.6}, 5),
        (before, coat | {"material": "red"}, 6),
        (before.change(samples=2 * before.samples), coat, 7),
        (direct, coat, 8),
        (direct, coat | {"material": "red"}, 9),
    ):
        apply("gloss", light, **values)
        assert len(traced) == times
