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


def test_too_few_bright_patches_give_no_shading():
    patches = patches_under(lambda u, v: 1.0 + 0 * u, np.random.default_rng(1), noise=300.0)
    assert fit_shading(patches) is None
