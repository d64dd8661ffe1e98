"""All checks of a capture for errors, in order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ..capture import Capture
from ..correction import CorrectedBands, DarkLibrary, NoiseModel
from ..geometry import CameraFit
from ..radiometry import Radiometry
from .constants import check_constant, check_flats_and_references, check_focal_length
from .content import check_frame_content, check_names, check_spectra_content
from .counts import check_counts
from .darks import check_darks
from .fingerprint import check_fingerprint, check_flat_shapes
from .points import check_points
from .repeats import check_noise, check_repeats
from .schedule import check_exposures, check_schedule
from .stacks import read_stacks
from .suspicion import Suspicion
from .tables import check_numbers, check_scene, check_tables

__all__ = ["find_suspicions"]


def find_suspicions(
    capture: Capture,
    bands: CorrectedBands,
    dark: DarkLibrary,
    noise: NoiseModel,
    radiometry: Radiometry,
    fit: CameraFit | None,
    *,
    channels: Mapping[str, str] | None = None,
    already: Iterable[Suspicion] = (),
) -> tuple[Suspicion, ...]:
    """Suspected errors made when the capture was taken or described; empty if there are none.

    Physical effects that a model may lack are not errors. already : found before, placed first. Raises InputError for
    a faulty frame.
    """
    stacks = read_stacks(capture, dict(channels) if channels is not None else None)
    found = [
        *already,
        *check_numbers(capture),
        *check_tables(capture),
        *check_scene(capture),
        *check_frame_content(stacks),
        *check_spectra_content(capture),
        *check_names(capture, stacks),
        *check_exposures(stacks),
        *check_schedule(stacks),
        *check_counts(capture, stacks, dark, noise),
        *check_noise(capture, stacks, dark, noise),
        *check_repeats(capture, stacks, dark, noise),
        *check_darks(stacks, noise, capture.saturation_dn),
        *check_flat_shapes(stacks, dark),
        *check_fingerprint(stacks, dark),
        *check_constant(capture, radiometry, noise, fit, channels),
        *check_flats_and_references(capture, bands, radiometry, channels),
        *check_focal_length(capture, fit),
        *check_points(capture, fit),
    ]
    return tuple(dict.fromkeys(found))
