"""Colour errors of filter weights, and the best filters for each number of filters."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID
from numpy.typing import NDArray

from ..instrument import BandResponse, colour_matching_functions
from .colorimetry import FilterWeights, train_filter_weights
from .radiance_ensemble import Radiances

__all__ = ["ColourError", "FilterChoice", "choose_filters", "colour_error", "lab_differences"]

#: With more subsets of one size than this, a local search by exchange replaces the exhaustive search.
_MOST_SUBSETS = 500


@dataclass(frozen=True, eq=False)
class ColourError:
    """Errors of noiseless X, Y, Z over n spectra."""

    #: (n, 3) relative errors of X, Y, Z.
    relative: NDArray[np.float64]
    #: (n,) Delta E*ab (1976) with the white of each spectrum.
    delta_e_ab: NDArray[np.float64]
    #: (n,) CIEDE2000 with the white of each spectrum.
    delta_e_2000: NDArray[np.float64]
    #: Name of the spectrum with the largest CIEDE2000.
    worst: str

    @property
    def rms(self) -> NDArray[np.float64]:
        """(3,) root mean square relative error of X, Y, Z."""
        return np.sqrt(np.mean(self.relative**2, axis=0))

    @property
    def largest(self) -> NDArray[np.float64]:
        """(3,) largest absolute relative error of X, Y, Z."""
        return np.abs(self.relative).max(axis=0)


def lab_differences(
    xyz: NDArray[np.float64], exact: NDArray[np.float64], white: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """CIELAB differences of two sets of XYZ, each against its white at L* = 100.

    Parameters
    ----------
    xyz
        (n, 3) X, Y, Z.
    exact
        (n, 3) X, Y, Z with which they are compared.
    white
        (n, 3) X, Y, Z of the white of each.

    Returns
    -------
    NDArray
        (n,) Delta E*ab (1976).
    NDArray
        (n,) CIEDE2000.
    """
    from colour import XYZ_to_Lab  # slow to import, and only needed here
    from colour.difference import delta_E_CIE1976, delta_E_CIE2000

    chromaticity = white[:, :2] / white.sum(axis=1, keepdims=True)
    first, second = (XYZ_to_Lab(item / white[:, 1:2], chromaticity) for item in (xyz, exact))
    return np.asarray(delta_E_CIE1976(first, second)), np.asarray(delta_E_CIE2000(first, second))


def colour_error(weights: FilterWeights, responses: Sequence[BandResponse], radiances: Radiances) -> ColourError:
    """Errors of filter weights over plausible radiances.

    Parameters
    ----------
    weights
        Filter weights.
    responses
        Response of every band.
    radiances
        Radiances and their whites.

    Returns
    -------
    ColourError
        Relative errors of X, Y, Z and colour differences of each radiance.

    Raises
    ------
    ValueError
        If X, Y or Z of a radiance is not above 0.
    """
    step = INTEGRAL_GRID.weights
    target = colour_matching_functions()
    curves = np.stack([response.response for response in responses])
    exact = radiances.values @ (step * target).T
    if np.any(exact <= 0):
        raise ValueError("X, Y and Z of every radiance must be above 0: the relative error is undefined")
    xyz = radiances.values @ (step * curves).T @ weights.weights.T
    first, second = lab_differences(xyz, exact, radiances.white @ (step * target).T)
    return ColourError(xyz / exact - 1, first, second, radiances.names[int(np.argmax(second))])


@dataclass(frozen=True, eq=False)
class FilterChoice:
    """Best set of one number of filters."""

    #: Identifiers of the filters.
    bands: tuple[str, ...]
    #: Root mean square relative error of X, Y, Z in training.
    training_rms: float
    #: Errors over the evaluation spectra.
    error: ColourError


def choose_filters(
    candidates: Sequence[BandResponse],
    training: NDArray[np.float64],
    evaluation: Radiances,
    counts: Sequence[int],
    relative_noise: float = 0.003,
) -> tuple[FilterChoice, ...]:
    """Candidates with the smallest colour error for each number of filters.

    Minimises the sum over X, Y, Z of the mean square relative error, noise included. All subsets are tried if there are
    few. Otherwise the best set of the previous size is extended by the best addition, then filters are exchanged one by
    one until no exchange helps (a local optimum).

    Parameters
    ----------
    candidates
        Responses of the filters to choose from.
    training
        (n, wavelength) radiances for the choice.
    evaluation
        Other radiances, for the error.
    counts
        Numbers of filters.
    relative_noise
        Standard deviation over signal of every band.

    Returns
    -------
    tuple[FilterChoice, ...]
        Best set of each size in `counts`, the smallest first.
    """
    step, goal = INTEGRAL_GRID.weights, colour_matching_functions()
    signal = training @ (step * np.stack([c.response for c in candidates])).T
    exact = training @ (step * goal).T
    moments, cross = [], []
    for axis in range(3):
        relative = signal / exact[:, axis : axis + 1]
        scale = np.sqrt(np.mean(relative**2, axis=0))
        relative = relative / np.where(scale > 0, scale, 1.0)
        moments.append(relative.T @ relative / len(signal) + max(relative_noise, 1e-6) ** 2 * np.eye(len(candidates)))
        cross.append(relative.mean(axis=0))

    def loss(subset: tuple[int, ...]) -> float:
        index = np.array(subset)
        return sum(
            float(1 - c[index] @ np.linalg.solve(o[np.ix_(index, index)], c[index]))
            for o, c in zip(moments, cross, strict=True)
        )

    choices: list[FilterChoice] = []
    best: tuple[int, ...] = ()
    everything = range(len(candidates))
    for count in range(1, max(counts) + 1):
        if comb(len(candidates), count) <= _MOST_SUBSETS:
            best = min(itertools.combinations(everything, count), key=loss)
        else:
            best = min(((*best, new) for new in everything if new not in best), key=loss)
            while True:
                swaps = [
                    (*best[:position], new, *best[position + 1 :])
                    for position in range(count)
                    for new in everything
                    if new not in best
                ]
                better = min(swaps, key=loss, default=best)
                if loss(better) >= loss(best) * (1 - 1e-9):
                    break
                best = better
        if count in counts:
            selected = [candidates[i] for i in sorted(best)]
            weights = train_filter_weights(selected, training, relative_noise)
            error = colour_error(weights, selected, evaluation)
            rms = float(np.sqrt(max(loss(best), 0.0) / 3))
            choices.append(FilterChoice(tuple(c.band for c in selected), rms, error))
    return tuple(choices)
