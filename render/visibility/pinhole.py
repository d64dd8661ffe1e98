"""A distortion-free film for a camera with distortion, and its resampling to the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

__all__ = ["Film", "film_for", "resampling"]


@dataclass(frozen=True, eq=False)
class Film:
    """Square pixels in the plane z = 1 of the camera's axes (x right, y down)."""

    #: (2,) upper left corner, slopes x and y.
    low: NDArray[np.float64]
    #: Pixels per unit of slope.
    scale: float
    #: (2,) width and height, pixels.
    size: NDArray[np.int64]

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return int(self.size[0] * self.size[1])

    def centres(self) -> NDArray[np.float64]:
        """Centres of the pixels, row by row.

        Returns
        -------
        NDArray
            (pixels, 2) slopes x and y.
        """
        row, column = np.indices((self.size[1], self.size[0])).reshape(2, -1)
        return self.low + (np.stack([column, row], axis=1) + 0.5) / self.scale


def film_for(camera: Camera, oversampling: int) -> Film:
    """Smallest film that covers the camera's image.

    Without distortion its pixels coincide with parts of the camera's pixels.

    Parameters
    ----------
    camera
        Lens and resolution.
    oversampling
        Film pixels per camera pixel and axis, in the middle of the image.

    Returns
    -------
    Film
        The film.
    """
    size = np.array([camera.width_px, camera.height_px])
    scale = camera.focal_length_px * oversampling
    if camera.is_pinhole:
        return Film((-0.5 - camera.principal_point_px) / camera.focal_length_px, scale, size * oversampling)
    u, v = np.meshgrid(np.arange(size[0] + 1) - 0.5, np.arange(size[1] + 1) - 0.5)
    local = camera.directions(u, v).reshape(-1, 3) @ camera.rotation.T
    normalised = local[:, :2] / local[:, 2:]
    low, high = np.nanmin(normalised, axis=0), np.nanmax(normalised, axis=0)
    return Film(low, scale, np.ceil((high - low) * scale).astype(np.int64))


def resampling(film: Film, camera: Camera) -> csr_array:
    """Weights of the mean over each camera pixel of a film, by shared area.

    Film pixels are approximated by upright rectangles in the camera's image: the derivative of the distortion gives
    their sizes. Beyond the turning point of its radial function the camera model has no image. A film pixel is at most
    as large as a camera pixel, so it overlaps at most two columns and two rows.

    Parameters
    ----------
    film
        Film of `film_for`.
    camera
        The same camera.

    Returns
    -------
    csr_array
        (camera pixels, film pixels) weights; rows sum to 1, or to 0 where no ray exists.
    """
    xy = film.centres()
    centre_px = camera.at_slopes(xy)
    has_image, extent = _image_of_pixels(film, camera, xy)
    first = np.floor(centre_px - extent / 2 + 0.5).astype(np.int64)
    inner = np.clip((first + 0.5 - (centre_px - extent / 2)) / extent, 0, 1)  # share in the first of two pixels
    rows, columns, weights = [], [], []
    area = extent.prod(axis=1)
    for right in (0, 1):
        for down in (0, 1):
            column, row = first[:, 0] + right, first[:, 1] + down
            share = area * (inner[:, 0] if right == 0 else 1 - inner[:, 0])
            share = share * (inner[:, 1] if down == 0 else 1 - inner[:, 1])
            inside = (column >= 0) & (column < camera.width_px) & (row >= 0) & (row < camera.height_px)
            used = np.flatnonzero(inside & has_image & (share > 0))
            rows.append(row[used] * camera.width_px + column[used])
            columns.append(used)
            weights.append(share[used])
    shape = (camera.width_px * camera.height_px, film.pixels)
    matrix = csr_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    total = matrix.sum(axis=1)
    return diags_array(np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)) @ matrix


def _image_of_pixels(
    film: Film, camera: Camera, xy: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Film pixels with an image (n,), and its width and height (n, 2), camera pixels."""
    if camera.lens.one_term:
        square = xy**2
        radial = 1 + camera.k1 * square.sum(axis=1)
        has_image = 1 + 3 * camera.k1 * square.sum(axis=1) > 0
        return has_image, (radial[:, None] + 2 * camera.k1 * square) * camera.focal_length_px / film.scale
    sides = np.einsum("nii->ni", camera.lens.slope_derivatives(xy, camera.k1)) * camera.scales_px / film.scale
    return camera.lens.reaches(xy, camera.k1) & (sides > 0).all(axis=1), np.maximum(sides, np.finfo(float).tiny)
