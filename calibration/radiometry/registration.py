"""Registration of bands.

Each filter and focus setting shifts and magnifies the image slightly. A similarity (shift, magnification, rotation)
aligns a band with the reference band. The signals themselves may be
unrelated: a patch can be bright in one band and dark in the next. First the strength of the edges is aligned by the
maximum of the enhanced correlation coefficient (Evangelidis and Psarakis, IEEE PAMI 30, 2008, in OpenCV). Adjacent
edges of different strength bias this by tenths of a pixel.

The similarity is therefore fitted a second time. Within a few pixels, where two materials meet, one band is a linear
function of the other for any spectra. The residual of that function is least where both bands coincide (Wein et al.,
Medical Image Analysis 12, 2008: linear combination).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import cv2
import numpy as np
from cboxlab.utils.distributions import robust_sigma
from numpy.typing import NDArray
from scipy.ndimage import affine_transform, correlate1d, gaussian_filter, spline_filter
from scipy.optimize import least_squares

__all__ = ["Registration", "move", "register"]

_log = logging.getLogger(__name__)

#: Standard deviation, px, of the Gaussian that smooths the logarithm before its gradient.
_SMOOTHING_PX = 1.0
#: Iterations of the enhanced correlation coefficient at most.
_CORRELATION_ITERATIONS = 200
#: Increase of the correlation at which its iteration ends.
_CORRELATION_INCREASE = 1e-7
#: Radius of a neighbourhood within which one band is a linear function of the other, px (standard deviation).
_NEAR_PX = 1.5
#: Pixels that are left out along the border, which the moved band may not cover.
_BORDER_PX = 6
#: Shift u, v (px), magnification - 1 and rotation (rad) that move a picture by a pixel or so: the fit's unknowns.
_UNITS = np.array([1.0, 1.0, 0.01, 0.01])
#: Weights of five neighbours for the slope of a smooth picture per pixel, correct for polynomials of fourth degree.
_SLOPE = np.array([1, -8, 0, 8, -1]) / 12
#: Evaluations of the fit at most.
_EVALUATIONS = 20
#: Relative decrease of the loss at which the fit ends: 1e-8 moves bands of the bundled capture by less than 1e-4 px.
_DECREASE = 1e-6
#: Largest change, in the units above, of the similarity that aligned the edges.
_LARGEST_CHANGE = 2.0


@dataclass(frozen=True, eq=False)
class Registration:
    """Similarity from pixels of the reference band to pixels of a band."""

    #: (2, 3) affine matrix: pixel (u, v) of the reference to pixel of the band.
    matrix: NDArray[np.float64]
    #: Correlation coefficient of the edges, at most 1; 0 without convergence.
    correlation: float
    #: (2,) shift (u, v) at the centre of the image, px.
    shift_px: NDArray[np.float64]
    #: Size of the band's image relative to the reference.
    magnification: float
    #: False if the band has too few edges for the iteration to converge; the matrix is then the identity.
    converged: bool


def _logarithm(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """(y, x) smoothed logarithm of the image.

    Bright parts do not dominate it; a floor hides noise in the dark.
    """
    floor = 0.05 * float(np.percentile(image, 99))
    return np.asarray(gaussian_filter(np.log(np.maximum(image, 0) + max(floor, 1e-12)), _SMOOTHING_PX))


def _edges(image: NDArray[np.float64]) -> NDArray[np.float32]:
    """(y, x) gradient of the smoothed logarithm."""
    v, u = np.gradient(_logarithm(image))
    return np.hypot(u, v).astype(np.float32)


def _registration(matrix: NDArray[np.float64], shape: tuple[int, int], correlation: float) -> Registration:
    """Registration with the shift at the image's centre and the size of a matrix (2, 3)."""
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    shift = matrix[:, :2] @ middle + matrix[:, 2] - middle
    size = float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))
    return Registration(matrix, correlation, shift, size, correlation > 0)


def _similarity(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The similarity closest to an affine matrix (2, 3), with the same translation."""
    a, b = (matrix[0, 0] + matrix[1, 1]) / 2, (matrix[1, 0] - matrix[0, 1]) / 2
    return np.array([[a, -b, matrix[0, 2]], [b, a, matrix[1, 2]]])


def _refined(
    reference: NDArray[np.float64], band: NDArray[np.float64], start: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Similarity (2, 3) about the image's centre by local linear functions.

    The result is ``start`` where the fit moves by more than _LARGEST_CHANGE.
    """
    first, second = (_logarithm(image) for image in (reference, band))
    spline, middle = spline_filter(second, mode="mirror"), (np.array(first.shape) - 1) / 2
    rows, columns = np.indices(first.shape) - middle[:, None, None]

    def near(image: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(gaussian_filter(image, _NEAR_PX))

    mean = near(first)
    spread = near(first**2) - mean**2
    spread += 1e-3 * float(spread.mean())

    def moved(unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        u, v, size, turn = unknowns * _UNITS
        # ndimage's order is (v, u)
        matrix = np.array([[1 + size, turn], [-turn, 1 + size]])
        offset = middle + np.array([v, u]) - matrix @ middle
        return np.asarray(affine_transform(spline, matrix, offset, prefilter=False, mode="mirror"))

    def rest_of(image: NDArray[np.float64]) -> NDArray[np.float64]:
        """Residual (n,) of the local linear functions, itself linear in the image."""
        image_mean = near(image)
        slope = (near(image * first) - image_mean * mean) / spread
        rest = image - image_mean - slope * (first - mean)
        return rest[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX].ravel()

    def remainder(unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        return rest_of(moved(unknowns))

    def derivatives(unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        image = moved(unknowns)
        down, right = (correlate1d(image, _SLOPE, axis) for axis in (0, 1))
        by_unknown = right, down, down * rows + right * columns, down * columns - right * rows
        return np.stack([rest_of(unit * change) for unit, change in zip(_UNITS, by_unknown, strict=True)], axis=1)

    begin = np.array([start[0, 2], start[1, 2], start[0, 0] - 1, start[1, 0]]) / _UNITS
    usual = robust_sigma(remainder(begin)) if min(first.shape) > 4 * _BORDER_PX else 0.0
    if not usual > 0:
        return start
    limits = {"max_nfev": _EVALUATIONS, "ftol": _DECREASE}
    fitted = least_squares(remainder, begin, derivatives, loss="soft_l1", f_scale=usual, **limits).x
    if np.max(np.abs(fitted - begin)) > _LARGEST_CHANGE:
        return start
    u, v, size, turn = fitted * _UNITS
    return np.array([[1 + size, -turn, u], [turn, 1 + size, v]])


def register(reference: NDArray[np.float64], band: NDArray[np.float64]) -> Registration:
    """Similarity from pixels of the reference to pixels of the band.

    Parameters
    ----------
    reference
        (y, x) signal of the reference band.
    band
        (y, x) signal of the band, of the same scene.

    Returns
    -------
    Registration
        The similarity; the identity, with `converged` False, if the band has too few edges.
    """
    shape = reference.shape
    first, second = _edges(reference), _edges(band)
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2], np.float32)
    window = cv2.createHanningWindow((shape[1], shape[0]), cv2.CV_32F)
    start, _ = cv2.phaseCorrelate(first, second, window)
    matrix = np.array([[1, 0, start[0]], [0, 1, start[1]]], np.float32)
    if max(abs(start[0]), abs(start[1])) > 0.1 * min(shape):
        matrix = np.eye(2, 3, dtype=np.float32)
    # The similarity is taken about the image's centre, where shift and magnification are uncorrelated.
    before = np.array([[1, 0, middle[0]], [0, 1, middle[1]], [0, 0, 1.0]])
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _CORRELATION_ITERATIONS, _CORRELATION_INCREASE)
    try:
        everything = np.full(shape, 255, np.uint8)
        correlation, warp = cv2.findTransformECC(first, second, matrix, cv2.MOTION_AFFINE, criteria, everything, 3)
    except cv2.error:
        _log.info("too few edges to register a band: taken as not moved")
        return _registration(np.eye(2, 3), shape, 0.0)
    affine = np.vstack([np.asarray(warp, float), [0, 0, 1]])
    about = np.linalg.inv(before) @ affine @ before
    similar = np.vstack([_refined(reference, band, _similarity(about[:2])), [0, 0, 1]])
    return _registration((before @ similar @ np.linalg.inv(before))[:2], shape, float(correlation))


def move(image: NDArray[np.float64], registration: Registration, *, smooth: bool = True) -> NDArray[np.float64]:
    """Image of a band resampled to the pixels of the reference band.

    Parameters
    ----------
    image
        (y, x) image of the band.
    registration
        Similarity from `register`.
    smooth
        True for cubic interpolation, False for linear.

    Returns
    -------
    NDArray
        (y, x) resampled image; NaN outside the band's image.
    """
    # ndimage's order is (v, u)
    turned, shift = registration.matrix[::-1, 1::-1], registration.matrix[::-1, 2]
    order = 3 if smooth else 1
    return np.asarray(affine_transform(image, turned, shift, order=order, mode="constant", cval=np.nan), np.float64)
