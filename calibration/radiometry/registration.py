"""Band-to-band registration, since each filter and focus setting shifts and magnifies the image slightly.

A similarity (shift, magnification, rotation) aligns the edge strength of a band with that of the reference band.
Edges are used because the signals themselves may be unrelated: a patch can be bright in one band and dark in the
next. The maximisation of the enhanced correlation coefficient (Evangelidis and Psarakis, IEEE PAMI 30, 2008, in
OpenCV) is accurate to a few hundredths of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

__all__ = ["Registration", "move", "register"]

_SMOOTHING_PX = 1.0
_ROUNDS, _CHANGE = 200, 1e-7


@dataclass(frozen=True, eq=False)
class Registration:
    """matrix : (2, 3), pixel (u, v) of the reference -> pixel of the band. correlation : of the edges, at most 1.

    shift_px : (2,) at the centre of the image. magnification : of the band relative to the reference. found : False
    if the band has too few edges; the matrix is then the identity.
    """

    matrix: NDArray[np.float64]
    correlation: float
    shift_px: NDArray[np.float64]
    magnification: float
    found: bool


def _edges(image: NDArray[np.float64]) -> NDArray[np.float32]:
    """(y, x) gradient of the smoothed logarithm, so that bright parts do not dominate."""
    floor = 0.05 * float(np.percentile(image, 99))
    logarithm = gaussian_filter(np.log(np.maximum(image, 0) + max(floor, 1e-12)), _SMOOTHING_PX)
    v, u = np.gradient(logarithm)
    return np.hypot(u, v).astype(np.float32)


def _registration(matrix: NDArray[np.float64], shape: tuple[int, int], correlation: float) -> Registration:
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    shift = matrix[:, :2] @ middle + matrix[:, 2] - middle
    size = float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))
    return Registration(matrix, correlation, shift, size, correlation > 0)


def _similarity(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The similarity closest to an affine matrix (2, 3), with the same translation."""
    a, b = (matrix[0, 0] + matrix[1, 1]) / 2, (matrix[1, 0] - matrix[0, 1]) / 2
    return np.array([[a, -b, matrix[0, 2]], [b, a, matrix[1, 2]]])


def register(reference: NDArray[np.float64], band: NDArray[np.float64]) -> Registration:
    """The similarity from pixels of the reference to pixels of the band, both (y, x) signals of one scene."""
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
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _ROUNDS, _CHANGE)
    try:
        everything = np.full(shape, 255, np.uint8)
        correlation, found = cv2.findTransformECC(
            first, second, matrix, cv2.MOTION_AFFINE, criteria, everything, 3
        )
    except cv2.error:
        return _registration(np.eye(2, 3), shape, 0.0)
    affine = np.vstack([np.asarray(found, float), [0, 0, 1]])
    about = np.linalg.inv(before) @ affine @ before
    similar = np.vstack([_similarity(about[:2]), [0, 0, 1]])
    return _registration((before @ similar @ np.linalg.inv(before))[:2], shape, float(correlation))


def move(
    image: NDArray[np.float64], registration: Registration, *, smooth: bool = True
) -> NDArray[np.float64]:
    """The band's image (y, x) resampled to the reference's pixels, NaN outside; cubic or (not smooth) linear."""
    how = (cv2.INTER_CUBIC if smooth else cv2.INTER_LINEAR) | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(
            image, registration.matrix, image.shape[::-1], flags=how, borderMode=cv2.BORDER_CONSTANT,
            borderValue=np.nan,
        ),
        np.float64,
    )  # fmt: skip
