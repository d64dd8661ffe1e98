"""Black pixels among lit neighbours, and values cut off at a limit, on one side alone.

Noise of light is skewed towards the bright side. A mean of non-negative samples whose relative error is a seventh is
never dark by chance: all samples would have to be. Values that are cut off are equal to the limit and to each other,
and those of the other side lie beyond it there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cboxlab.utils.distributions import NORMAL_OVER_MEDIAN
from numpy.typing import NDArray
from scipy.ndimage import median_filter, minimum_filter
from scipy.special import bdtrc

from .difference import Finding, sigma_of
from .fine_light import block_sums

__all__ = ["cut_values", "dark_pixels"]

#: Part of the neighbours' median below which a pixel is dark; negative ones are of filters with negative lobes.
_DARK_PART = 0.02
#: Part of the neighbours' median that the other side has at least.
_LIT_PART = 0.5
#: Dark pixels over dim ones, from which noise does not make them.
_DARK_OVER_DIM = 2.0
#: Dark pixels of one side over those of the other, from which noise does not make them.
_MORE_ON_ONE_SIDE = 10.0
#: Largest relative scatter of neighbours at which a dark pixel is no noise.
_MAX_SCATTER = 0.15
#: Light of a dark pixel over the least of the other side around it, below which no dark part of the scene explains it.
_DARKER = 0.5
#: Pixels a side of the neighbourhood.
_WINDOW_PX = 7


def dark_pixels(
    baseline: NDArray[np.float64],
    candidate: NDArray[np.float64],
    smooth: NDArray[np.bool_],
    critical: float,
    *,
    with_errors: bool = True,
) -> Finding:
    """Count of pixels that are dark in one picture alone.

    Parameters
    ----------
    baseline, candidate
        (y, x) pictures with their outliers.
    smooth
        (y, x) pixels away from edges, lamp and border.
    critical
        Probability that a finding states as its own.
    with_errors
        Whether both sides state their noise. Otherwise a pixel may be one sample, of a dark part of the scene near it.
        Noise that makes dark pixels then makes them on both sides, and in penumbras and at edges rather than in quiet
        parts.

    Returns
    -------
    Finding
        The size is the part of smooth pixels.
    """
    sides = [_Side(picture, median_filter(picture, _WINDOW_PX, mode="nearest")) for picture in (baseline, candidate)]
    of_baseline, of_candidate = (
        first.between(0.0, _DARK_PART) & second.between(_LIT_PART, np.inf) for first, second in (sides, sides[::-1])
    )
    if not with_errors:
        around = [_DARKER * minimum_filter(picture, _WINDOW_PX, mode="nearest") for picture in (candidate, baseline)]
        of_baseline, of_candidate = of_baseline & (baseline < around[0]), of_candidate & (candidate < around[1])
    quiet = [smooth & side.quiet & (not side.mostly_dim(smooth)) for side in sides]
    counts = [int((dark & calm).sum()) for dark, calm in zip((of_baseline, of_candidate), quiet, strict=True)]
    count = sum(counts)
    if not with_errors and _by_noise(of_baseline, of_candidate, count, quiet[0] | quiet[1]):
        count, counts = 0, [0, 0]
    size = count / max(int(smooth.sum()), 1)
    probability = critical / 1e6 if count else 1.0
    side = "" if not count else " of the candidate" if counts[1] else " of the baseline"
    return Finding(f"black pixels{side}", count, size, size / 10 if count else 1.0, 12.0, probability)


def cut_values(baseline: NDArray[np.float64], candidate: NDArray[np.float64]) -> Finding | None:
    """Sign test of pixels with the limit of one side and a value beyond it on the other.

    In equal pictures either side has such pixels, and blocks of them have either sign: a lobe of a pixel filter or an
    empty pixel may be on both. Negative lobes that one side cuts off at 0 have one sign.

    Parameters
    ----------
    baseline, candidate
        (b, y, x) independent pictures with their outliers, as many of each side.

    Returns
    -------
    Finding or None
        The size is the part of the pixels that are cut. None where no side has a value twice.
    """
    baseline, candidate = (side.reshape(-1, side.shape[-1]) for side in (baseline, candidate))
    findings = []
    for sign, end in ((1.0, "below"), (-1.0, "above")):
        sides = sign * baseline, sign * candidate
        limits = [float(side.min()) for side in sides]
        beyond = [
            (sides[n] == limits[n]) & (sides[1 - n] < limits[n]) if (sides[n] == limits[n]).sum() > 1 else np.zeros(1)
            for n in (0, 1)
        ]
        counts = [int((block_sums(cut) > 0).sum()) if cut.ndim == baseline.ndim else 0 for cut in beyond]
        total, cut = sum(counts), int(np.argmax(counts))
        if total == 0:
            continue
        probability = min(1.0, 4 * float(bdtrc(max(counts) - 1, total, 0.5)))
        side, pixels = ("baseline", "candidate")[cut], int(beyond[cut].sum())
        size = pixels / baseline.size
        name = f"values of the {side} cut off {end} {sign * limits[cut]:.3g}"
        findings.append(Finding(name, pixels, size, sigma_of(size, probability, total), float(total), probability))
    return min(findings, key=lambda finding: finding.probability, default=None)


def _by_noise(
    of_baseline: NDArray[np.bool_], of_candidate: NDArray[np.bool_], count: int, quiet: NDArray[np.bool_]
) -> bool:
    """Whether noise may make dark pixels: on both sides alike, or rather outside of quiet parts.

    count : dark pixels in quiet parts.
    """
    fewer, more = sorted((int(of_baseline.sum()), int(of_candidate.sum())))
    outside = fewer + more - count
    return count * (quiet.size - quiet.sum()) <= outside * quiet.sum() or more < _MORE_ON_ONE_SIDE * fewer


@dataclass(frozen=True, eq=False)
class _Side:
    """One picture, and the medians of neighbours."""

    #: (y, x) picture.
    picture: NDArray[np.float64]
    #: (y, x) medians around each pixel.
    median: NDArray[np.float64]

    def between(self, low: float, high: float) -> NDArray[np.bool_]:
        """(y, x) pixels in a range of parts of the light around them."""
        with np.errstate(invalid="ignore"):  # infinity times 0
            return (self.median > 0) & (self.picture >= low * self.median) & (self.picture < high * self.median)

    @property
    def quiet(self) -> NDArray[np.bool_]:
        """(y, x) pixels whose neighbours scatter little."""
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.where(self.median > 0, np.abs(self.picture / self.median - 1), np.inf)
        scatter = NORMAL_OVER_MEDIAN * median_filter(np.where(np.isfinite(off), off, 1e9), _WINDOW_PX, mode="nearest")
        return np.asarray(scatter < _MAX_SCATTER)

    def mostly_dim(self, smooth: NDArray[np.bool_]) -> bool:
        """Whether noise makes the dark pixels, since it makes about as many dim ones.

        A denoiser leaves some pixels as noisy as they were.
        """
        inside = smooth & self.quiet
        dark, dim = (int((inside & self.between(*part)).sum()) for part in ((0, _DARK_PART), (_DARK_PART, _LIT_PART)))
        return dark <= _DARK_OVER_DIM * dim
