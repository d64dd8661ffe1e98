"""The light on a chart, from its patches alone."""

import numpy as np
from cboxlab.calibration.colour.shading import PatchPixels, fit_shading


def patches_under(light, rng, noise=0.5):
    """Twelve patches of random reflectance on a 200 x 300 frame under a light (v, u)."""
    results = []
    for row in range(3):
        for column in range(4):
            v, u = (a.ravel() for a in np.mgrid[row * 60 + 10 : row * 60 + 50, column * 70 + 10 : column * 70 + 60])
            signal = 200 * rng.uniform(0.05, 1.0) * light(u, v)
            results.append(
                PatchPixels(u.astype(float), v.astype(float), signal + noise * rng.standard_normal(u.size), noise)
            )
    return results


def test_illumination_is_recovered_from_the_patches_alone():
    """A light of cubic logarithm: ratios between places within 4 of the stated sigmas, sigmas below 0.5%.

    40 charts: mean square pull within [0.25, 2]. The jackknife is known to err on the large side with few
    patches, never on the small one.
    """

    def light(u, v):
        x, y = (u - 140) / 140, (v - 90) / 140
        return np.exp(-0.4 * x + 0.2 * y - 0.1 * x * y + 0.15 * x**3)

    rng, pulls = np.random.default_rng(12), []
    for _ in range(40):
        patches = patches_under(light, rng)
        shading = fit_shading(patches)
        assert shading.order == 3
        for u, v in ((40.0, 30.0), (250.0, 30.0), (40.0, 150.0), (250.0, 150.0)):
            ratio = shading.at(u, v) / shading.at(140.0, 90.0) / (light(u, v) / light(140.0, 90.0))
            sigma = shading.relative_sigma(u, v, (140.0, 90.0))
            assert sigma < 0.005
            pulls.append((ratio - 1) / sigma)
    assert 0.25 < np.mean(np.square(pulls)) < 2.0


def _weighted_fit(patches, order, centre, scale):
    """Coefficients by least squares over single pixels, each over its relative noise, its patch's mean removed.

    Returns them, and the sum of squares of all pixels with the fit to the other patches.
    """
    rows, sides = [], []
    for patch in patches:
        x, y = (patch.u_px - centre[0]) / scale, (patch.v_px - centre[1]) / scale
        terms = np.stack([x**j * y ** (n - j) for n in range(1, order + 1) for j in range(n + 1)], axis=1)
        weight = patch.signal.mean() / patch.sigma
        log = np.log(patch.signal)
        rows.append(weight * (terms - terms.mean(axis=0)))
        sides.append(weight * (log - log.mean()))
    left_out = 0.0
    for k in range(len(patches)):
        others = [i for i in range(len(patches)) if i != k]
        fit = np.linalg.lstsq(np.concatenate([rows[i] for i in others]), np.concatenate([sides[i] for i in others]))[0]
        left_out += float(np.sum((sides[k] - rows[k] @ fit) ** 2))
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(sides))[0], left_out


def test_patches_of_unequal_noise_weigh_by_it():
    """The same fit by single pixels and NumPy's least squares; noise differs by 20 between patches."""
    rng = np.random.default_rng(3)
    noise = np.geomspace(0.1, 2.0, 12)
    patches = []
    for patch, sigma in zip(patches_under(lambda u, v: np.exp((u - v) / 400), rng, noise=0.0), noise, strict=True):
        signal = patch.signal + sigma * rng.standard_normal(patch.signal.size)
        patches.append(PatchPixels(patch.u_px, patch.v_px, signal, float(sigma)))
    for order in (2, 3):
        shading = fit_shading(patches, orders=(order,))
        fit, left_out = _weighted_fit(patches, order, shading.centre_px, shading.scale_px)
        np.testing.assert_allclose(shading.coefficients, fit, rtol=1e-6, atol=1e-10)
        pixels = sum(p.signal.size * (p.signal.mean() / p.sigma) ** 2 for p in patches)
        assert abs(shading.validation[order] * pixels / left_out - 1) < 1e-6


def test_too_few_bright_patches_give_no_shading():
    patches = patches_under(lambda u, v: 1.0 + 0 * u, np.random.default_rng(1), noise=300.0)
    assert fit_shading(patches) is None
