"""CIELab, colour differences and what noise makes of them, previews: published values and formulas by hand."""

import numpy as np
import pytest
from cboxlab.validation.compare.colour_difference import (
    COLOUR_DIFFERENCES,
    White,
    expected_from_noise,
    lab,
    srgb_preview,
    white_of,
)

WHITE = White(0.45, 0.41, 37.0)
#: XYZ of the white.
XYZ = WHITE.luminance * np.array([WHITE.x / WHITE.y, 1.0, (1 - WHITE.x - WHITE.y) / WHITE.y])


def test_white_of_lab():
    """L*, a*, b* of the white are 100, 0, 0; half its luminance is L* = 116 0.5^(1/3) - 16 (CIE 15)."""
    np.testing.assert_allclose(lab(XYZ, WHITE), [100, 0, 0], atol=1e-9)
    np.testing.assert_allclose(lab(0.5 * XYZ, WHITE), [116 * 0.5 ** (1 / 3) - 16, 0, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [  # Sharma, Wu and Dalal 2005, table 1, pairs 1, 4, 17, 20, 34
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0000),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((50.0, 2.5, 0.0), (50.0, 3.2592, 0.3350), 1.0000),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_published_colour_differences(first, second, expected):
    assert COLOUR_DIFFERENCES["delta_e_2000"].between(first, second) == pytest.approx(expected, abs=5e-5)
    assert COLOUR_DIFFERENCES["delta_e_ab"].between(first, second) == pytest.approx(
        np.linalg.norm(np.subtract(first, second))
    )


def test_the_white_is_the_lamps_colour_at_the_brightest_surfaces():
    white = white_of([3.0, 5.0, 2.0], np.linspace(0, 200, 1001))
    assert (white.x, white.y, white.luminance) == pytest.approx((0.3, 0.5, 199.0))


def test_noise_of_lightness_alone_has_the_mean_of_a_half_normal():
    """Two bands that both see the white's colour: L* = 116 (Y / Yn)^(1/3) - 16 scatters by 116 / 3 dY / Y^(2/3).

    The mean of its size is sqrt(2 / pi) of that, its 95th percentile 1.96; 65,536 draws give both to half a per cent.
    """
    level, sigma = np.full((2, 256), 60.0), np.full((2, 256), 0.12)
    xyz_per_dn = np.outer(XYZ, [0.004, 0.002])
    expected = expected_from_noise(level, sigma, xyz_per_dn, WHITE, seed=1)["delta_e_ab"]
    relative = 0.006 * 60.0
    scatter = 116 / 3 * np.hypot(0.004, 0.002) * 0.12 * relative ** (-2 / 3)
    assert expected.mean == pytest.approx(np.sqrt(2 / np.pi) * scatter, rel=0.01)
    assert expected.p95 == pytest.approx(1.96 * scatter, rel=0.02)


def test_a_pixel_that_is_not_known_does_not_change_the_expected_mean():
    """The noise of known pixels is the same; statistics over 4096 pixels of 16 pictures agree within their errors."""
    level, sigma = np.full((2, 4096), 60.0), np.full((2, 4096), 0.12)
    xyz_per_dn = np.outer(XYZ, [0.004, 0.002])
    complete = expected_from_noise(level, sigma, xyz_per_dn, WHITE, seed=1)["delta_e_ab"]
    level[:, ::7] = np.nan
    partial = expected_from_noise(level, sigma, xyz_per_dn, WHITE, seed=1)["delta_e_ab"]
    assert partial.mean == pytest.approx(complete.mean, rel=0.02)
    assert partial.p95 == pytest.approx(complete.p95, rel=0.02)
    nothing = expected_from_noise(np.full((2, 8), np.nan), sigma[:, :8], xyz_per_dn, WHITE, seed=1)["delta_e_ab"]
    assert np.isnan([nothing.mean, nothing.p95, nothing.maximum]).all()


def test_greys_under_the_lamp_are_greys_of_srgb():
    """Shares of the white, by the standard's curve to 8 bits; a pixel that is not known is mid grey."""
    shares = np.array([0.0, 0.002, 0.05, 0.18, 0.5, 1.0, 1.3])
    picture = np.append(shares[:, None] * XYZ, [[np.nan, 1.0, 1.0]], axis=0)[None]
    values = srgb_preview(picture, WHITE)[0].astype(int)
    clipped = np.minimum(shares, 1.0)
    curve = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    assert np.abs(values[:-1] - np.round(255 * curve)[:, None]).max() <= 1
    assert values[-1].tolist() == [128, 128, 128]
