"""Patterns fixed on the sensor: lines, pixels, amplifiers, smooth patterns, waves, spots."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cboxlab.rendering.fitted_fields import Acts, ImageMaps
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.sparse import csr_matrix

from ..field_fit import (
    Columns,
    Family,
    FieldFit,
    FitInput,
    FittedExplanation,
    ResidualData,
    Wave,
    bells_on,
    each_band,
    equations_in_all_bands,
    fixed_spectrum,
    pixel_fit,
    scaled,
    strongest_waves,
)

__all__ = ["SensorPatterns"]

#: Pixels that a read-out takes in turn, in words, by rows and columns of their repeat, px.
_IN_TURN = {"every second row": (2, 1), "every second column": (1, 2)}

#: Highest order of the cosines of a smooth pattern: resolves a tenth of the image.
_SMOOTH_ORDER = 10

#: Largest correlation of pixels with a neighbour in a pattern of single pixels. Independent pixels have 0 or less, dark
#: corners and edges that a picture misses 0.3 or more along their line.
_MAX_NEIGHBOURS_CORRELATION = 0.15

#: Largest part of such a pattern in a square of the sensor. Pixels that scatter in one place, as a render's noise
#: does in deep shadow, are no pattern of the sensor.
_MAX_PART_IN_A_SQUARE = 0.4

#: Side of the square over that of the sensor.
_SQUARE = 0.25


def _largest_part(gain: NDArray[np.float64]) -> float:
    """Part of a gain (y, x) in the square that has most, a quarter of the sensor wide."""
    side = max(round(max(gain.shape) * _SQUARE), 1)
    most = uniform_filter(gain, side, mode="constant").max() * side**2
    return float(most / max(gain.sum(), 1e-300))


@dataclass(frozen=True, eq=False)
class SensorPatterns:
    """Patterns of one operator, such as counts added or counts multiplied."""

    #: Family of the patterns.
    family: Family
    #: Quantity on which they act.
    acts: Acts
    #: Residual and its regions of largest excess.
    fit_input: FitInput
    #: (band, y, x) change of the signal by a map that is 1 everywhere, DN.
    operator: NDArray[np.float64]
    #: (band,) strength of a pattern that goes with the exposure time.
    by_exposure: NDArray[np.float64]
    #: The form of such a pattern in words.
    exposure_form: str
    #: Variance of a pixel's number by noise that all bands share.
    common_variance: float = 0.0

    @property
    def data(self) -> ResidualData:
        """Residual to be explained."""
        return self.fit_input.data

    def over_the_sensor(self) -> Iterator[FittedExplanation]:
        """Rows, columns and smooth patterns over the whole sensor.

        Yields
        ------
        FittedExplanation
            Each of them in all bands, in one band, in each band, and by the exposure time.
        """
        yield from self._by_maps("rows", ImageMaps("rows"), sharp=True)
        yield from self._by_maps("columns", ImageMaps("columns"), sharp=True)
        yield from self._by_maps("a smooth pattern", ImageMaps("cosines", order=_SMOOTH_ORDER))

    def single_pixels(self) -> Iterator[FittedExplanation]:
        """Patterns of single pixels, alike in all bands or by the exposure time.

        Yields
        ------
        FittedExplanation
            None where neighbours are alike: then it is no pattern of single pixels. None behind a mosaic where one
            frame has all bands: nothing else then shows the same pixel.
        """
        if self.data.used.sum(axis=0).max() < min(len(self.data.bands), 2):
            return
        spectra = (
            ("alike in all bands", np.ones(len(self.data.bands)), self.common_variance),
            (self.exposure_form, self.by_exposure, 0.0),
        )
        for form, spectrum, variance in spectra:
            scale = np.abs(spectrum).max()
            operator = self.operator * (spectrum / scale if scale > 0 else spectrum)[:, None, None]
            fit, correlation = pixel_fit(self.data, operator, variance)
            gain = (fit.coefficients[0] ** 2).reshape(self.data.shape) * np.sum(
                (operator * self.data.weight) ** 2, axis=0
            )
            if correlation > _MAX_NEIGHBOURS_CORRELATION or _largest_part(gain) > _MAX_PART_IN_A_SQUARE:
                continue
            fit = replace(fit, coefficients=fit.coefficients * (spectrum / max(scale, 1e-300))[:, None])
            maps = ImageMaps("pixels")
            # a rendering's own noise is alike in all bands: such pixels count only where something remains
            sharp = form == self.exposure_form
            yield FittedExplanation(
                self.family, f"single pixels, {form}", fit, self._columns(maps), self.acts, maps, sharp=sharp
            )

    def of_amplifiers(self, unit: str) -> Iterator[FittedExplanation]:
        """Patterns of amplifiers that take pixels in turn, or a quarter of the sensor.

        In one band only differences between its own pixels count, such as those of the two greens.

        Parameters
        ----------
        unit
            Unit of the numbers after a value, such as " DN"; "%" for parts.

        Yields
        ------
        FittedExplanation
            Rows or columns in turn, and places of the mosaic's repeat, in all bands alike and in one band; quarters.
            Nothing without a mosaic.
        """
        data = self.data
        if data.cell is None:
            return
        patterns = {form: ImageMaps("repeat", repeat=repeat) for form, repeat in _IN_TURN.items()}
        patterns["quarters of the sensor"] = ImageMaps("quarters")
        of_repeat = ImageMaps("repeat", repeat=data.cell)
        present = of_repeat.matrix(data.shape) @ data.used.reshape(len(data.bands), -1).T.astype(float) > 0
        if present.sum(axis=0).max() > 1:  # a channel has several places
            patterns["places of the mosaic's repeat"] = of_repeat
        bands = len(data.bands)
        for form, maps in patterns.items():
            columns, within, share = self._columns(maps), self._within_bands(maps), self._shares(maps)
            fit = fixed_spectrum(equations_in_all_bands(data, columns), np.ones(bands))
            distance = self._apart(fit.coefficients, share if maps is of_repeat else None, unit)
            yield self._sharp(f"{form}, {distance}", fit, columns, maps, len(patterns))
            n = equations_in_all_bands(data, within)
            fit = max((fixed_spectrum(n, band) for band in np.eye(bands)), key=lambda trial: trial.evidence)
            mean = np.sum(share * fit.coefficients, axis=1, keepdims=True)
            band = np.arange(bands)[:, None] == int(np.argmax(fit.size))
            fit = replace(fit, coefficients=np.where(band & (share > 0), fit.coefficients - mean, 0.0))
            distance = self._apart(fit.coefficients, share, unit)
            yield self._sharp(f"{form} in one band, {distance}", fit, columns, maps, len(patterns) * bands)

    def black_levels(self) -> Iterator[FittedExplanation]:
        """The same number in all pixels of one channel.

        Yields
        ------
        FittedExplanation
            The channel that gains most, and each channel otherwise. Nothing without a mosaic.
        """
        if self.data.cell is None:
            return
        maps, bands = ImageMaps("cosines"), len(self.data.bands)
        columns = self._columns(maps)
        n = equations_in_all_bands(self.data, columns)
        fit = max((fixed_spectrum(n, band) for band in np.eye(bands)), key=lambda trial: trial.evidence)
        where = self.data.bands[int(np.argmax(fit.size))]
        form = f"a black level in one band, {float(fit.coefficients.sum()):+.3g} DN in {where}"
        yield self._sharp(form, fit, columns, maps, bands)
        each = each_band(n)
        form = f"a black level in each band, {np.abs(each.coefficients).max():.3g} DN at most"
        yield self._sharp(form, each, columns, maps, 1)

    def _shares(self, maps: ImageMaps) -> NDArray[np.float64]:
        """(band, k) shares of a band's used pixels in each map."""
        used = self.data.used.reshape(len(self.data.bands), -1).T.astype(float)
        count = np.asarray(maps.matrix(self.data.shape) @ used).T
        return count / np.maximum(count.sum(axis=1, keepdims=True), 1.0)

    def _within_bands(self, maps: ImageMaps) -> Columns:
        """Changes by maps less their mean over the pixels that a band sees."""
        matrix, share = csr_matrix(maps.matrix(self.data.shape)).toarray(), self._shares(maps)
        return lambda band: np.asarray((matrix - share[band][:, None]) * self.operator[band].ravel())

    def _apart(self, coefficients: NDArray[np.float64], share: NDArray[np.float64] | None, unit: str) -> str:
        """Distance of the largest and smallest number in the band where it is largest.

        coefficients : (band, k) the numbers. share : (band, k) share of each band's pixels in the maps; None where all
        bands have the same maps.
        """
        inside = np.ones(coefficients.shape, bool) if share is None else share > 0
        apart = [float(np.ptp(each[of])) if of.any() else 0.0 for each, of in zip(coefficients, inside, strict=True)]
        most = int(np.argmax(apart))
        distance = f"{apart[most]:.2%} apart" if unit == "%" else f"{apart[most]:.3g}{unit} apart"
        return distance if share is None else f"{distance} in {self.data.bands[most]}"

    def _sharp(
        self, form: str, fit: FieldFit, columns: Columns, maps: ImageMaps, num_choices: int
    ) -> FittedExplanation:
        """A form that errors of the rendering do not make."""
        return FittedExplanation(self.family, form, fit, columns, self.acts, maps, sharp=True, num_choices=num_choices)

    def waves(self, of_one_band: Callable[[Wave, int], FittedExplanation] | None = None) -> Iterator[FittedExplanation]:
        """Straight waves and rings.

        Parameters
        ----------
        of_one_band
            Fit of further bands to a wave that was found in one band, from the wave and the number of choices. None
            fits each band separately, as for a wave of all bands.

        Yields
        ------
        FittedExplanation
            Each wave in its band or in all bands, then with further bands.
        """
        bands = len(self.data.bands)
        for wave in strongest_waves(self.data, self.operator):
            columns = self._columns(wave.maps)
            n = equations_in_all_bands(self.data, columns)
            spectrum = np.ones(bands) if wave.band is None else np.eye(bands)[wave.band]
            shape = "rings" if wave.maps.curvature else "a wave"
            form = shape if wave.band is None else f"{shape} in one band"
            choices = wave.num_trials * (1 if wave.band is None else bands)
            fit = fixed_spectrum(n, spectrum)
            yield FittedExplanation(
                self.family, form, fit, columns, self.acts, wave.maps, sharp=True, num_choices=choices
            )
            if of_one_band is not None and wave.band is not None:
                yield of_one_band(wave, choices)
            else:
                yield FittedExplanation(
                    self.family,
                    f"{shape} in each band",
                    each_band(n),
                    columns,
                    self.acts,
                    wave.maps,
                    sharp=True,
                    num_choices=choices,
                )

    def spots(self) -> Iterator[FittedExplanation]:
        """Spots where the excess is largest.

        Yields
        ------
        FittedExplanation
            The spot of all bands in all bands and in one band, then the spot of one band in that band.
        """
        if self.fit_input.bells is not None:
            yield from self._by_maps("a spot", self.fit_input.bells, local=True)
        if self.fit_input.spot_of_one_band is not None:
            # in all bands it would have fewer cells than families that are fitted where all bands differ
            yield from self._by_maps(
                "a spot", bells_on(self.fit_input.spot_of_one_band, self.data.cell), local=True, together=False
            )

    def _columns(self, maps: ImageMaps) -> Columns:
        basis: NDArray[Any] | csr_matrix = maps.matrix(self.data.shape)
        return lambda band: scaled(basis, self.operator[band])

    def _by_maps(
        self, form: str, maps: ImageMaps, *, local: bool = False, sharp: bool = False, together: bool = True
    ) -> Iterator[FittedExplanation]:
        """Patterns by some maps; in all bands alike only if ``together``."""
        bands, columns = len(self.data.bands), self._columns(maps)
        n = equations_in_all_bands(self.data, columns)
        if together:
            alike = fixed_spectrum(n, np.ones(bands))
            yield FittedExplanation(self.family, form, alike, columns, self.acts, maps, local=local, sharp=sharp)
        each = each_band(n)
        strongest = int(np.argmax(each.size))
        yield FittedExplanation(
            self.family,
            f"{form} in one band",
            fixed_spectrum(n, np.eye(bands)[strongest]),
            columns,
            self.acts,
            maps,
            local=local,
            sharp=True,
            num_choices=bands,
        )
        if not local:
            yield FittedExplanation(self.family, f"{form} in each band", each, columns, self.acts, maps, sharp=sharp)
            timed = fixed_spectrum(n, self.by_exposure)
            yield FittedExplanation(
                self.family, f"{form} {self.exposure_form}", timed, columns, self.acts, maps, sharp=sharp
            )
