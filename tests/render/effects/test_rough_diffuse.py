"""Oren and Nayar's reflection, written in angles, against what patches and rays are given."""

import numpy as np
import pytest
from cboxlab.rendering.device import mi
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.perturbation import brdf_change
from helpers.fakes.patch_light import fake_patch_light
from helpers.fakes.stages import apply

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: the reflection's kernels")

SIGMA = 0.5
A, B = 1 - 0.5 * SIGMA**2 / (SIGMA**2 + 0.33), 0.45 * SIGMA**2 / (SIGMA**2 + 0.09)


def reflection(incoming, outgoing, azimuth):
    """Relative to Lambert's, from the angles to the normal and the azimuth between them, radians."""
    alpha, beta = np.maximum(incoming, outgoing), np.minimum(incoming, outgoing)
    return A + B * np.maximum(0, np.cos(azimuth)) * np.sin(alpha) * np.tan(beta)


def albedo(incoming):
    """Mean over the ways out, by midpoints: cosine-weighted."""
    outgoing = (np.arange(600) + 0.5) / 600 * np.pi / 2
    azimuth = (np.arange(600) + 0.5) / 600 * 2 * np.pi
    weight = 2 * np.sin(outgoing) * np.cos(outgoing) * np.pi / 2 / 600
    return float(weight @ reflection(incoming, outgoing[:, None], azimuth).mean(axis=1))


@pytest.fixture
def applied(monkeypatch):
    before, arguments = fake_patch_light(), {}
    before = before.change(added=np.full(before.added.shape, 0.002))

    def traced(field, camera, radiance, reflectances, lamp_shares, reflection, **options):
        arguments.update(options, **vars(reflection), radiance=radiance, reflectances=reflectances)
        np.testing.assert_array_equal(lamp_shares, before.lamp_shares)
        return np.full((3, camera.height_px, camera.width_px), 0.01)

    monkeypatch.setattr(brdf_change, "changed_reflection", traced)
    return before, apply("rough-diffuse", before, material="white", sigma_rad=SIGMA), arguments


def test_what_the_rays_change_is_added(applied):
    before, after, arguments = applied
    np.testing.assert_allclose(after.added, 0.012)
    assert arguments["coat"] is None and arguments["samples"] == (before.samples, before.samples)
    np.testing.assert_allclose(arguments["radiance"], after.patch_radiance())


def test_the_rays_are_given_the_formula(applied):
    *_, arguments = applied
    random = np.random.default_rng(2)
    angles = np.arccos(random.uniform(0.05, 1.0, (2, 300)))
    azimuth = random.uniform(0, 2 * np.pi, 300)
    ways = [
        mi.Vector3f(
            *(
                mi.Float(x.astype(np.float32))
                for x in (
                    np.sin(angle) * np.cos(turn),
                    np.sin(angle) * np.sin(turn),
                    np.cos(angle),
                )
            )
        )
        for angle, turn in zip(angles, (0.3 + 0 * azimuth, 0.3 + azimuth), strict=True)
    ]
    values = np.array(arguments["base"](*ways))
    np.testing.assert_allclose(values, reflection(*angles, azimuth), rtol=2e-4)
    cosines = np.linspace(0.05, 1.0, 20)
    base, lobe = arguments["albedo"](mi.Float(cosines.astype(np.float32)))
    np.testing.assert_allclose(np.array(base), [albedo(a) for a in np.arccos(cosines)], rtol=2e-3)
    assert not np.array(lobe).any()


def test_patches_reflect_the_means_of_the_formula(applied):
    """Diffuse light by the mean over both hemispheres, the lamp's by that over the ways out at its angle."""
    before, after, arguments = applied
    patches, lamp = before.transport.light.patches, before.transport.light.lamps[0].centre
    mask = patches.material == arguments["material"]
    angle = (np.arange(200) + 0.5) / 200 * np.pi / 2
    mean = np.mean([albedo(a) * np.sin(2 * a) for a in angle]) * np.pi / 2
    np.testing.assert_allclose(after.patch_reflectance[mask], before.patch_reflectance[mask] * mean, rtol=2e-3)
    np.testing.assert_array_equal(after.patch_reflectance[~mask], before.patch_reflectance[~mask])
    way = lamp - patches.centre[mask]
    cosine = np.sum(way * patches.normal[mask], axis=1) / np.linalg.norm(way, axis=1)
    at_angle = np.array([albedo(a) for a in np.arccos(cosine)])[:, None]
    direct = before.transport.light.exchange.direct[mask]
    expected = direct * (before.patch_reflectance[mask] * at_angle - after.patch_reflectance[mask])
    np.testing.assert_allclose(after.patch_emission[mask], expected, rtol=0.03, atol=1e-4)


def test_rays_are_traced_again_for_another_roughness_even_where_patches_stay_dark(monkeypatch):
    traced, direct = [], fake_patch_light(max_bounces=1)
    monkeypatch.setattr(
        brdf_change, "changed_reflection", lambda *arguments, **_: traced.append(arguments) or np.zeros(1)
    )
    for sigma, material, times in ((0.3, "white", 1), (0.3, "white", 1), (0.4, "white", 2), (0.4, "red", 3)):
        apply("rough-diffuse", direct, material=material, sigma_rad=sigma)
        assert len(traced) == times
