"""The picture's own errors as a covariance: whitened by it, what they make of a residual is noise of unit variance."""

import numpy as np
import pytest
from cboxlab.validation.predict import picture_errors
from cboxlab.validation.predict.predictor import averaged_on_faces

SHAPE = (2, 48, 48)


@pytest.fixture
def parts():
    """Two faces in two bands, two pixels in three not used; an error of one band and one of the left face."""
    generator = np.random.default_rng(3)
    v, u = np.mgrid[0 : SHAPE[1], 0 : SHAPE[2]] / SHAPE[1]
    signal = 1000 * np.array([1.0, 0.6])[:, None, None] * (1 + 0.5 * u + 0.2 * v)
    values = (u < 0.4).astype(float)
    used = generator.random(SHAPE) > 0.67
    sigma = 0.1 * np.sqrt(signal[used])
    band = np.broadcast_to(np.array([1.0, 0.0])[:, None, None], SHAPE)[used]
    face = np.broadcast_to(values, SHAPE)[used]
    others = [0.0007 * band * signal[used] / sigma, 0.001 * face * signal[used] / sigma]
    return signal, np.stack([values, 1 - values], axis=-1), used, sigma, others


def covariance(signal, coverage, used, sigma, others):
    """Of a residual over sigma, from the words alone: noise, cells and regions of faces at 0.15 %, the others."""
    _, rows, columns = np.nonzero(used)
    face = coverage.argmax(axis=-1)[rows, columns]
    level = signal[used] / sigma
    total = np.eye(len(sigma)) + sum(np.outer(other, other) for other in others)
    for pixels in (3, 12):  # 48 pixels hold 16 cells and 4 regions
        values = np.array([rows // pixels, columns // pixels, face])
        together = (values[:, :, None] == values[:, None, :]).all(axis=0)
        if pixels == 12:
            large = together.sum(axis=0) >= 20 * len(used)
            together &= large
        total += 0.0015**2 * together * np.outer(level, level)
    return total


def test_whitening_is_an_inverse_root_of_the_covariance(parts):
    errors = picture_errors(*parts)
    count = len(parts[3])
    root = errors.whitened(np.eye(count)).T
    expected = covariance(*parts)
    assert np.linalg.eigvalsh(expected)[-1] > 30  # the errors are well above noise of 0.3 %
    np.testing.assert_allclose(root @ expected @ root.T, np.eye(count), atol=2e-4)


def test_nothing_is_taken_from_what_no_error_makes(parts):
    """A pattern whose mean is nothing in every cell and band stays as it is."""
    signal, _, used, sigma, _ = parts
    errors = picture_errors(*parts)
    pattern = np.random.default_rng(1).standard_normal(len(sigma))
    for number in np.unique(errors.cell):
        for band in range(SHAPE[0]):
            in_cell = (errors.cell == number) & (np.nonzero(used)[0] == band)
            along = signal[used][in_cell] / sigma[in_cell]
            pattern[in_cell] -= along * (along @ pattern[in_cell]) / (along @ along) if in_cell.any() else 0.0
    np.testing.assert_allclose(errors.whitened(pattern), pattern, atol=1e-5)


def test_likeliest_errors_of_cells_are_those_of_a_normal_prior(parts):
    """Dense: K / (1 + K) of the pixels, and the logarithm of the determinant of 1 + K."""
    errors = picture_errors(*parts)
    weight = errors.weight.astype(float)
    cells = np.where(errors.cell[:, None] == errors.cell, np.outer(weight, weight), 0)
    with_noise = np.eye(len(weight)) + cells
    pixels = np.random.default_rng(2).standard_normal(len(weight))
    np.testing.assert_allclose(errors.of_cells(pixels), cells @ np.linalg.solve(with_noise, pixels), atol=1e-5)
    assert errors.volume_of_cells == pytest.approx(np.linalg.slogdet(with_noise)[1], rel=1e-5)


def test_averaged_changes_stay_on_their_face():
    """A mean of neighbours keeps what is even, halves of a picture do not mix, and noise falls."""
    face = np.where(np.arange(40) < 20, 3, 5) * np.ones((30, 1), int)
    face[10, 10] = -1
    steps = np.where(face == 5, 1.2, 0.9)[None]
    np.testing.assert_allclose(averaged_on_faces(steps, face), steps, rtol=1e-12)
    noise = 1 + 0.01 * np.random.default_rng(0).standard_normal((2, 30, 40))
    evened = averaged_on_faces(noise, face)
    assert np.std(evened - 1) < 0.4 * 0.01
    np.testing.assert_array_equal(evened[:, 10, 10], noise[:, 10, 10])
