"""A rendered image and its average over batches."""

from dataclasses import replace

import numpy as np
from cboxlab.rendering.image import LAMP, NOTHING, RenderedImage


def random_image(batches):
    generator = np.random.default_rng(5)
    return RenderedImage(
        coefficients=generator.random((batches, 6, 9, 4)).astype(np.float32),
        spectra=generator.random((4, 31)),
        wavelength_nm=np.linspace(400, 700, 31),
        coverage=np.ones((6, 9, 2), np.float32),
        facet_surface=np.array([0]),
        surface_names=("wall",),
    )


def test_the_average_over_batches_has_the_same_mean_and_no_variance():
    image, weights = random_image(7), np.random.default_rng(6).random((31, 3))
    exact = np.einsum("byxn,nw,wq->yxq", image.coefficients.astype(float), image.spectra, weights) / 7
    np.testing.assert_allclose(image.mean(weights), exact, rtol=1e-12)
    averaged = image.averaged()
    assert averaged.coefficients.nbytes == image.coefficients.nbytes / 7
    mean, variance = averaged.project(weights)
    assert np.isnan(variance).all()
    for mean_of_image in (averaged.mean(weights), mean):
        np.testing.assert_allclose(mean_of_image, exact, rtol=1e-6)


def test_a_pixel_shows_the_surface_of_its_largest_share():
    """Two faces of a wall count together; lamps and pixels that show nothing have their own marks."""
    shares = [[0.2, 0.4, 0.3, 0.1], [0.3, 0.3, 0.4, 0.0], [0.1, 0.1, 0.2, 0.6], [0.0, 0.3, 0.1, 0.0]]
    coverage = np.array([shares], np.float32)
    facets, names = np.array([0, 1, 1, 2]), ("floor", "wall")
    image = replace(random_image(2), coverage=coverage, facet_surface=facets, surface_names=names)
    assert image.surface.tolist() == [[1, 1, LAMP, NOTHING]]
