"""Amplitudes of an effect in parts of its pattern: alike for a true effect, unlike for one that a part imitates."""

import numpy as np
import pytest
from cboxlab.validation.diagnose.base_flaws.parts import PLACES, amplitudes_by_part, places_of, thirds_by_level

COUNT, PATCHES = 6000, 60
PART = np.arange(COUNT) % 3
PATCH = np.arange(COUNT) // (COUNT // PATCHES)


def judged(draw, amplitude):
    """Parts of a pattern with an amplitude each, next to noise of unit variance."""
    columns = np.zeros((COUNT, 3))
    columns[np.arange(COUNT), PART] = draw.standard_normal(COUNT) * np.array([1.0, 0.5, 0.2])[PART]
    residual = columns @ np.array(amplitude, float) + draw.standard_normal(COUNT)
    return amplitudes_by_part(PLACES, columns, PART, PATCH, lambda c: c, residual)


def test_amplitudes_of_parts_are_those_that_were_put_in():
    """Of 40 draws the errors over the stated ones have a mean square of 1, within four of its standard deviations."""
    draw = np.random.default_rng(1)
    each = [judged(draw, (1.0, 0.8, 1.3)) for _ in range(40)]
    errors = np.array([(np.array(j.amplitude) - (1.0, 0.8, 1.3)) / j.sigma for j in each])
    assert errors.mean() == pytest.approx(0, abs=4 / np.sqrt(errors.size))
    assert 1 - 4 * np.sqrt(2 / errors.size) < np.mean(errors**2) < 1 + 4 * np.sqrt(2 / errors.size)
    assert each[0].parts == PLACES


def test_errors_that_patches_share_widen_the_stated_ones():
    """In each part of a patch the pattern has its own error of 0.3. Bounds as above, and a fifth for few patches."""
    draw, errors = np.random.default_rng(6), []
    columns = np.zeros((COUNT, 3))
    for _ in range(40):
        columns[np.arange(COUNT), PART] = draw.standard_normal(COUNT) * 5
        sizes = 1 + 0.3 * draw.standard_normal((PATCHES, 3))
        residual = columns.sum(axis=1) * sizes[PATCH, PART] + draw.standard_normal(COUNT)
        parts = amplitudes_by_part(PLACES, columns, PART, PATCH, lambda c: c, residual)
        errors.append((np.array(parts.amplitude) - 1) / parts.sigma)
    assert 0.8 - 4 * np.sqrt(2 / 120) < np.mean(np.square(errors)) < 1.2 + 4 * np.sqrt(2 / 120)


def test_flaws_that_are_fitted_widen_no_error():
    draw = np.random.default_rng(7)
    columns = np.zeros((COUNT, 3))
    columns[np.arange(COUNT), PART] = draw.standard_normal(COUNT)
    residual = columns.sum(axis=1) + draw.standard_normal(COUNT)
    flaws = 10 * columns.sum(axis=1) * draw.standard_normal((PATCHES, 3))[PATCH, PART]
    flaws -= columns @ np.linalg.lstsq(columns, flaws)[0]
    arguments = PLACES, columns, PART, PATCH, lambda c: c
    plain = amplitudes_by_part(*arguments, residual)
    fitted = amplitudes_by_part(*arguments, residual + flaws, flaws)
    assert fitted.sigma == pytest.approx(plain.sigma)
    assert amplitudes_by_part(*arguments, residual + flaws).sigma[0] > 3 * plain.sigma[0]


def test_the_evidence_of_two_parts_has_its_closed_form():
    """Amplitudes 1 and 1.4 of variance s^2: each scatters by v = s^2 + 0.01, or by v = s^2 + 1."""
    columns = np.eye(3)[PART % 2] * 0.1
    residual = columns @ (1.0, 1.4, 0.0)
    parts = amplitudes_by_part(PLACES, columns, PART % 2, PATCH, lambda c: c, residual)
    near, far = (variance + 1 / columns[:, :2].sum(axis=0) / 0.1 for variance in (0.01, 1.0))
    expected = 0.4**2 / near.sum() + np.log(near.prod() * (1 / near).sum())
    expected -= 0.4**2 / far.sum() + np.log(far.prod() * (1 / far).sum())
    assert parts.lead == pytest.approx(expected, rel=1e-6)


def test_one_amplitude_everywhere_is_likelier_one_than_three_and_a_part_without_it_is_not():
    """At odds of 100 to 1, chi2 of 9.2, none of 50 draws of one amplitude is taken for three."""
    draw = np.random.default_rng(2)
    assert max(judged(draw, (1, 1, 1)).lead for _ in range(50)) < 9.2
    for without in ((1, 0, 1), (0, 0, 1), (1, 1, -1)):
        assert judged(draw, without).lead > 9.2
    assert judged(draw, (1, 0, 1)).unlike.endswith("inside faces")
    assert "at outlines" in judged(draw, (1, -1, 1)).unlike
    assert not judged(draw, (1, 1, 1)).unlike


def test_an_error_of_the_shape_is_forgiven():
    """Amplitudes that differ by a tenth, as errors of shapes make them, are no sign even without noise."""
    patterns = np.eye(3)[PART] * 30
    shares = [
        amplitudes_by_part(PLACES, patterns, PART, PATCH, lambda c: c, patterns @ a) for a in ([1, 1.1, 1], [1, 0, 1])
    ]
    assert shares[0].lead < -5
    assert not shares[0].unlike
    assert shares[1].lead > 50


def test_a_pattern_in_one_part_is_not_compared():
    columns = np.zeros((COUNT, 3))
    columns[:, 1], columns[:, 0] = 1.0, 0.01  # the second shows a ten-thousandth of the pattern
    residual = np.ones(COUNT)
    assert amplitudes_by_part(PLACES, columns, PART, PATCH, lambda c: c, residual).lead == -np.inf


def test_parts_are_outlines_and_contacts_by_the_nearer_border():
    """Three upright strips: the first two touch, the third is behind the second."""
    face = np.repeat([0, 1, 2], 8)[None, :].repeat(4, axis=0)
    part = places_of(face, [(0, 1), (1, 2)], [(0, 1)])[0]
    assert part.tolist() == [0] * 6 + [2, 2, 2, 2] + [0] * 5 + [1, 1] + [0] * 7


def test_thirds_by_level_share_the_square_of_the_pattern_in_every_band():
    draw = np.random.default_rng(4)
    signal, shape, band = draw.uniform(1, 2, 3000), draw.standard_normal(3000), np.repeat([0, 1], 1500)
    third = thirds_by_level(signal * np.where(band, 100, 1), band, shape)
    for each in (band == 0, band == 1):
        squares = np.bincount(third[each], shape[each] ** 2)
        assert squares == pytest.approx(np.full(3, squares.mean()), rel=0.02)
        assert signal[each & (third == 0)].max() <= signal[each & (third == 1)].min()
        assert signal[each & (third == 1)].max() <= signal[each & (third == 2)].min()
