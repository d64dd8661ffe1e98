"""Raw frames of a sensor with a mosaic: every pixel shows the light of its channel.

A band is predicted at all pixels as if each had the band's channel. A raw frame has that light in the band's pixels
only; in the others it has that of the other bands of the same frame. Effects on counts that mix pixels, such as
crosstalk, therefore carry light from channel to channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Interleaving", "UnseenChannel"]


@dataclass(frozen=True, eq=False)
class UnseenChannel:
    """Pixels of a frame whose channel is in no band.

    They show the light of a band, times a factor.
    """

    #: Index of a band that sees the same frame.
    band: int
    #: (y, x) True for the pixels of the channel.
    pixels: NDArray[np.bool_]
    #: Signal of the channel over that of the band for the same light.
    factor: float


@dataclass(frozen=True, eq=False)
class Interleaving:
    """Channels of the pixels in each band's frames."""

    #: (band, y, x) True for the pixels of each band's channel.
    pixels: NDArray[np.bool_]
    #: Indices of the bands that see the same frames; each band is in one group.
    groups: tuple[tuple[int, ...], ...]
    #: Channels that no band of a group sees.
    unseen: tuple[UnseenChannel, ...] = ()

    def light(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Light on the pixels of the raw frames.

        Parameters
        ----------
        signal
            (band, y or 1, x or 1) signal of each band as if all pixels had its channel.

        Returns
        -------
        NDArray
            (band, y, x) the raw frame of each band, the same one for bands of one group.
        """
        return self._interleaved(signal, [unseen.factor for unseen in self.unseen])

    def response(self, response: NDArray[np.float64]) -> NDArray[np.float64]:
        """Response of the pixels of the raw frames, relative to the mean of their channel.

        Parameters
        ----------
        response
            (band, y, x) response, 1 on average over the band's pixels.

        Returns
        -------
        NDArray
            (band, y, x) the same for bands of one group.
        """
        means = [float(response[unseen.band][unseen.pixels].mean()) for unseen in self.unseen]
        return self._interleaved(response, [1.0 / mean if mean > 0 else 0.0 for mean in means])

    def _interleaved(self, values: NDArray[np.float64], factors: list[float]) -> NDArray[np.float64]:
        """(band, y, x) frames of the bands' values, each in its pixels."""
        values = np.broadcast_to(values, self.pixels.shape)
        frames = values.copy()
        for group in self.groups:
            frame = frames[group[0]]
            for band in group[1:]:
                np.copyto(frame, values[band], where=self.pixels[band])
            for unseen, factor in zip(self.unseen, factors, strict=True):
                if unseen.band in group:
                    np.copyto(frame, factor * values[unseen.band], where=unseen.pixels)
            frames[list(group)] = frame
        return frames
