"""Study of the sensor beyond the correction: photon transfer, dark level, response, curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..capture import Capture
from ..correction import CorrectedBands, DarkLibrary, NoiseModel
from .dark_fit import DarkFit, measure_dark_fit
from .nonlinearity import CalibrationCurve, fit_curve
from .photon_transfer import PhotonTransfer, measure_photon_transfer
from .response_points import ResponsePoint, ResponseSeries, light_series, measure_responses, response_points

__all__ = ["NO_STUDY", "SensorStudy", "study_sensor"]

#: Largest over smallest light of a series below which it is left out of the curve: it would not show the shape.
_MIN_LIGHT_RATIO = 3.0
#: Points of all series below which no curve is fitted.
_MIN_POINTS = 8


@dataclass(frozen=True, eq=False)
class SensorStudy:
    """Results of the study; None or empty where the capture lacks the frames."""

    #: Sensor parameters by photon transfer.
    transfer: PhotonTransfer | None
    #: Dark level over exposure time.
    dark_fit: DarkFit | None
    #: All exposures of steady lights.
    points: tuple[ResponsePoint, ...]
    #: Series in which one setting was changed.
    responses: tuple[ResponseSeries, ...]
    #: Curve from counts to linear light.
    curve: CalibrationCurve | None

    @property
    def verdicts(self) -> tuple[str, ...]:
        """One sentence for the dark level and for every response series."""
        dark = [] if self.dark_fit is None else [f"dark level: {self.dark_fit.verdict}"]
        return (*dark, *(f"{s.band} {s.source}: {s.fit.verdict}" for s in self.responses))


#: Study of a capture without counts.
NO_STUDY = SensorStudy(None, None, (), (), None)


def study_sensor(
    capture: Capture,
    bands: CorrectedBands,
    dark: DarkLibrary,
    noise: NoiseModel,
    channels: dict[str, str] | None,
) -> SensorStudy:
    """All parts of the study for which the capture has frames.

    Parameters
    ----------
    capture
        The capture.
    bands
        The capture's corrected bands.
    dark
        The capture's dark levels.
    noise
        Noise model of one count.
    channels
        With a mosaic, the channel of each band; None without one.

    Returns
    -------
    SensorStudy
        None or empty for parts without frames.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    points = response_points(capture, bands, dark, noise, channels)
    series = [s for s in light_series(points) if s.light.max() > _MIN_LIGHT_RATIO * s.light.min()]
    curve = None
    if sum(s.light.size for s in series) >= _MIN_POINTS:
        level = float(np.median(dark.level[0])) if dark.exposure_s.size else 0.0
        curve = fit_curve(series, level)
    return SensorStudy(
        measure_photon_transfer(capture, dark, channels),
        measure_dark_fit(dark, noise),
        points,
        measure_responses(points, float(capture.full_scale_dn)),
        curve,
    )
