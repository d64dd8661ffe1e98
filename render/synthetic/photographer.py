"""Plan and counts of the frames of a simulated capture.

The simulation follows the sensor equation of the capture format (``calibration.radiometry``): signal, cosine-fourth
fall-off, vignetting, pixel sensitivity, bias, dark current, hot pixels, shot and read noise, rounding and clipping.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.spectra import Spectrum, read_spectra
from cboxlab.utils.errors import InputError
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray

from ..sensor import PACKAGED, Detector, noisy_counts, quantise
from .mosaic_sensor import MosaicSensor, SimulatedBand, bands_of, mosaic_sensor

__all__ = [
    "CaptureSettings",
    "Frame",
    "FrameHooks",
    "PixelMaps",
    "Shot",
    "band_filters",
    "behind_mosaic",
    "chosen_exposure",
    "frames_of",
    "photograph",
    "pixel_maps",
    "plan_shots",
]

Kind = Literal["band", "dark", "flat", "reference"]

#: Exposure times that can be set, within a decade, s.
EXPOSURE_STEPS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)


#: Transmittance of the grey filter in front of a colour sensor: the narrow filters pass about as much of all light.
_GREY = 0.02


@lru_cache
def band_filters() -> dict[str, Spectrum]:
    """Transmittances of the seven filters, 380 to 720 nm.

    Returns
    -------
    dict
        Transmittance by band.
    """
    return read_spectra(PACKAGED / "pxl1300l-filters.csv", "zero")


@dataclass(frozen=True)
class CaptureSettings(FrozenMappings):
    """Settings of the laboratory; by default a cooled 12-bit camera and a 35 mm lens at f/8."""

    #: Name of the capture in its manifest; that of the scene where empty.
    name: str = ""
    #: Scene in the manifest; the scene's name where empty.
    scene: str = ""
    #: Model of the camera.
    model: str = "PXL 1300L class"
    #: Width of the sensor, mm; the pixel pitch is this over the width in px.
    film_width_mm: float = 25.0
    #: Bits of a count.
    bit_depth: int = 12
    #: Gain, e-/DN.
    gain_e_per_dn: float = 12.0
    #: Read noise, e-.
    read_noise_e: float = 10.0
    #: Focal length, mm.
    focal_length_mm: float = 35.0
    #: f-number.
    f_number: float = 8.0
    #: Distance from lens to sensor, mm.
    image_distance_mm: float = 36.6
    #: Time from the end of a frame to the next one, s.
    readout_s: float = 1.2
    #: Shortest time between the end of one band and the start of the next, s.
    filter_change_s: float = 6.0
    #: Frames of each exposure.
    repeats: int = 2
    #: Frames of each exposure of the sphere as reference.
    reference_repeats: int = 1
    #: Largest fraction of full scale for the 99.5th percentile outside the lamp.
    level: float = 0.7
    #: Bias, DN.
    bias_dn: float = 100.0
    #: Standard deviation of the bias over pixels, DN.
    bias_pattern_dn: float = 0.5
    #: Dark current, e-/s.
    dark_current_e_s: float = 6.0
    #: Standard deviation over pixels of the logarithm of the dark current.
    dark_current_spread: float = 0.1
    #: Share of hot pixels, with 10 to 100 times the dark current.
    hot_share: float = 5e-4
    #: Standard deviation over pixels of the relative sensitivity.
    prnu: float = 0.01
    #: Loss of light in the corner in addition to the cosine-fourth law.
    vignetting: float = 0.08
    #: Radiance of the integrating sphere, for flats and references, over that of a wall of the box.
    sphere_brightness: float = 1.0
    #: Standard deviation of the scale of the spectroradiometer's reading in lamp.csv.
    lamp_relative_uncertainty: float = 0.02
    #: Number of surveyed points.
    point_count: int = 50
    #: Standard deviation of their image positions, px.
    point_sigma_px: float = 0.15
    #: Transmittances by filter, all at the same wavelengths.
    filters: Mapping[str, Spectrum] = field(default_factory=band_filters)
    #: Mosaic of the sensor; None for a monochrome one.
    mosaic: MosaicSensor | None = None

    @property
    def bands(self) -> tuple[SimulatedBand, ...]:
        """Bands of the capture: one a filter, or one a filter and channel of the mosaic."""
        return bands_of(tuple(self.filters), self.mosaic)

    @property
    def band_ids(self) -> tuple[str, ...]:
        """Identifiers of the bands."""
        return tuple(band.id for band in self.bands)

    @property
    def full_scale_dn(self) -> int:
        """The largest count."""
        return 2**self.bit_depth - 1


def behind_mosaic(settings: CaptureSettings, pattern: str) -> CaptureSettings:
    """Settings of a colour sensor behind a grey filter: each frame has all channels.

    The grey filter lets exposures be as long as those of narrow filters.

    Parameters
    ----------
    settings
        Settings of the laboratory.
    pattern
        Letters of one repeat of the mosaic, see ``mosaic_sensor``.

    Returns
    -------
    CaptureSettings
        With the mosaic, and one filter "grey" of equal transmittance at all wavelengths.

    Raises
    ------
    InputError
        If it is no pattern.
    """
    wide = next(iter(band_filters().values())).wavelength_nm
    return replace(
        settings,
        filters={"grey": Spectrum(wide, np.full(wide.size, _GREY), "zero")},
        mosaic=mosaic_sensor(pattern),
    )


@dataclass(frozen=True)
class Shot:
    """A table of capture.toml: an exposure and its repeats."""

    #: Kind of table.
    kind: Kind
    #: Filter; None for darks.
    filter: str | None
    #: Exposure, s.
    exposure_s: float
    #: Number of frames.
    repeats: int
    #: Start of the first repeat since the first frame, s; None if not recorded.
    start_s: float | None = None

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths of the frames inside the capture's folder."""
        stem = {
            "band": f"{self.filter}",
            "dark": f"dark-{self.exposure_s:g}s",
            "flat": f"flat-{self.filter}",
            "reference": f"sphere-{self.filter}",
        }[self.kind]
        return tuple(f"frames/{stem}-{repeat}.tif" for repeat in range(self.repeats))


@dataclass(frozen=True)
class Frame:
    """Description of one frame, for hooks."""

    #: Kind of its table.
    kind: Kind
    #: Filter; None for darks.
    filter: str | None
    #: Stated exposure, s.
    exposure_s: float
    #: Index among the repeats.
    repeat: int
    #: Start since the first frame of the sequence, s; None if not recorded.
    start_s: float | None


@dataclass(frozen=True)
class FrameHooks:
    """Functions that simulate faults in the camera; the defaults change nothing."""

    #: Frame -> the actual exposure time, s.
    exposure_s: Callable[[Frame], float] = lambda frame: frame.exposure_s
    #: Frame, expected signal (y, x) in DN above dark, flat included, unclipped -> changed signal.
    light: Callable[[Frame, NDArray[np.float64]], NDArray[np.float64]] = lambda frame, signal: signal
    #: Frame, counts (y, x) with bias and noise before rounding and clipping -> changed counts.
    counts: Callable[[Frame, NDArray[np.float64]], NDArray[np.float64]] = lambda frame, counts: counts


@dataclass(frozen=True, eq=False)
class PixelMaps:
    """Properties of each pixel."""

    #: (y, x) relative response to uniform light, mean 1.
    flat: NDArray[np.float64]
    #: (y, x) bias, DN.
    bias_dn: NDArray[np.float64]
    #: (y, x) dark current, e-/s.
    dark_current_e_s: NDArray[np.float64]


def pixel_maps(camera: Camera, settings: CaptureSettings, generator: np.random.Generator) -> PixelMaps:
    """Random properties of the pixels, and the flat field of the lens.

    The optical part of the flat is cos^4 of the field angle times 1 - vignetting r^2, r = 1 in the corner.

    Parameters
    ----------
    camera
        Camera, for size and field angles.
    settings
        Settings of the laboratory.
    generator
        Random numbers.

    Returns
    -------
    PixelMaps
        Properties of each pixel.
    """
    shape = camera.height_px, camera.width_px
    v, u = np.indices(shape)
    square = (u - camera.principal_point_px[0]) ** 2 + (v - camera.principal_point_px[1]) ** 2
    corner = ((shape[1] - 1) ** 2 + (shape[0] - 1) ** 2) / 4
    optics = (1 + square / camera.focal_length_px**2) ** -2 * (1 - settings.vignetting * square / corner)
    flat = optics * (1 + settings.prnu * generator.standard_normal(shape))
    current = settings.dark_current_e_s * np.exp(settings.dark_current_spread * generator.standard_normal(shape))
    hot = generator.random(shape) < settings.hot_share
    current[hot] *= 10 ** generator.uniform(1, 2, int(hot.sum()))
    bias = settings.bias_dn + settings.bias_pattern_dn * generator.standard_normal(shape)
    return PixelMaps(flat / flat.mean(), bias, current)


def chosen_exposure(rate_dn_s: float, settings: CaptureSettings) -> float:
    """Longest time of EXPOSURE_STEPS for which bias plus signal stays within the level.

    Parameters
    ----------
    rate_dn_s
        Signal of bright pixels, DN/s.
    settings
        Bias, level and bit depth.

    Returns
    -------
    float
        Exposure, s.

    Raises
    ------
    InputError
        If the rate is not above 0, or the time is not between 0.1 ms and one hour.
    """
    span_dn = settings.level * settings.full_scale_dn - settings.bias_dn
    longest = span_dn / rate_dn_s if rate_dn_s > 0 else np.inf
    if not 1e-4 < longest < 3600:
        raise InputError(
            "capture: exposure",
            f"{rate_dn_s:g} DN/s in the brightest surfaces of a band",
            "a signal for which the exposure is between 0.1 ms and one hour",
            "Is the lamp's radiance absolute, in W m^-2 sr^-1 nm^-1?",
        )
    decade = int(np.floor(np.log10(longest)))
    marks = [float(f"{mark}e{power}") for power in (decade - 1, decade) for mark in EXPOSURE_STEPS]
    return max(mark for mark in marks if mark <= longest)


def plan_shots(
    scene_dn_s: Mapping[str, float],
    field_dn_s: Mapping[str, float],
    settings: CaptureSettings,
    generator: np.random.Generator,
) -> tuple[Shot, ...]:
    """All exposures of a capture.

    Bands in random order, then flats, references, and darks for every exposure used.

    Parameters
    ----------
    scene_dn_s
        By band, 99.5th percentile of the scene's signal outside the lamp, DN/s.
    field_dn_s
        By band, signal of the uniform source of flats and references, DN/s.
    settings
        Settings of the laboratory.
    generator
        Random numbers.

    Returns
    -------
    tuple of Shot
        In the order of the manifest.
    """
    bands, shots, start = list(scene_dn_s), [], 0.0
    for index in generator.permutation(len(bands)):
        exposure = chosen_exposure(scene_dn_s[bands[index]], settings)
        shots.append(Shot("band", bands[index], exposure, settings.repeats, round(start, 1)))
        start += settings.repeats * (exposure + settings.readout_s)
        start += settings.filter_change_s * generator.uniform(1, 3)
    for band in bands:
        shots.append(Shot("flat", band, chosen_exposure(field_dn_s[band], settings), settings.repeats))
    for band in bands:
        exposure = chosen_exposure(field_dn_s[band], settings)
        shots.append(Shot("reference", band, exposure, settings.reference_repeats))
    for exposure in sorted({shot.exposure_s for shot in shots}):
        shots.append(Shot("dark", None, exposure, settings.repeats))
    return tuple(shots)


def frames_of(shot: Shot, readout_s: float) -> tuple[Frame, ...]:
    """Frames of a shot; each starts after the exposure and readout of the previous one.

    Parameters
    ----------
    shot
        The shot.
    readout_s
        Time between frames, s.

    Returns
    -------
    tuple of Frame
        One description a repeat.
    """
    return tuple(
        Frame(
            shot.kind,
            shot.filter,
            shot.exposure_s,
            repeat,
            None if shot.start_s is None else shot.start_s + repeat * (shot.exposure_s + readout_s),
        )
        for repeat in range(shot.repeats)
    )


def photograph(
    shots: Sequence[Shot],
    signals: Callable[[Shot], NDArray[np.float64]],
    maps: PixelMaps,
    settings: CaptureSettings,
    generator: np.random.Generator,
    hooks: FrameHooks | None = None,
) -> dict[str, NDArray[np.uint16]]:
    """Counts of every frame of the shots.

    Parameters
    ----------
    shots
        The shots.
    signals
        Shot -> expected signal (y, x) in DN per second for a flat of 1; not called for darks.
    maps
        Properties of each pixel.
    settings
        Settings of the laboratory.
    generator
        Random numbers.
    hooks
        Changes inside the camera; None for none.

    Returns
    -------
    dict
        Counts (y, x), uint16, by path of the frame.
    """
    hooks = hooks or FrameHooks()
    none = np.zeros(0)
    detector = Detector(settings.gain_e_per_dn, settings.bit_depth, none, none, none)
    read_noise_dn = settings.read_noise_e / settings.gain_e_per_dn
    photographs = {}
    for shot in shots:
        rate = np.zeros(maps.flat.shape) if shot.kind == "dark" else signals(shot) * maps.flat
        for frame, path in zip(frames_of(shot, settings.readout_s), shot.paths, strict=True):
            exposure = hooks.exposure_s(frame)
            light = rate if shot.kind == "dark" else hooks.light(frame, rate * exposure)
            electrons = np.maximum(light, 0) * settings.gain_e_per_dn + maps.dark_current_e_s * exposure
            counts = noisy_counts(electrons, maps.bias_dn, read_noise_dn, detector, generator)
            photographs[path] = quantise(hooks.counts(frame, counts), settings.bit_depth)
    return photographs
