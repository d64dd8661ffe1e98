"""All checks of a capture that need no rendering of its scene, in order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from ..capture import Capture
from ..correction import CorrectedBands, DarkLibrary, NoiseModel
from ..geometry import CameraFit
from ..radiometry import Radiometry
from .constants import check_constant, check_flats_and_references, check_focal_length
from .content import check_frame_content, check_names, check_same_view, check_spectra_content
from .counts import check_counts
from .dark_light import check_dark_temperature, check_light_in_darks
from .darks import check_bias_drift, check_darks
from .fields import check_fields, check_pattern
from .filters import check_filter_shift
from .fingerprint import check_division, check_fingerprint, check_flat_shapes
from .points import check_points
from .repeats import check_noise, check_repeats
from .schedule import check_brackets, check_exposures, check_schedule
from .stacks import Stack, read_stacks
from .suspicion import Suspicion
from .tables import check_numbers, check_scene, check_tables
from .warm_up import check_warm_up

__all__ = ["find_suspicions"]


def _check_counts(
    capture: Capture,
    stacks: Sequence[Stack],
    dark: DarkLibrary,
    noise: NoiseModel,
    channels: Mapping[str, str] | None,
) -> Iterator[Suspicion]:
    """Checks that need whole counts of a sensor, which merged pictures are not."""
    yield from check_counts(capture, stacks, dark, noise)
    yield from check_noise(capture, stacks, dark, noise)
    yield from check_repeats(capture, stacks, dark, noise)
    yield from check_darks(stacks, noise, capture.saturation_dn)
    yield from check_bias_drift(stacks, capture.manifest.camera.readout_s)
    yield from check_warm_up(stacks, dark, capture.saturation_dn, capture.manifest.camera.readout_s)
    yield from check_flat_shapes(stacks, dark, capture.saturation_dn)
    yield from check_fingerprint(stacks, dark)
    yield from check_division(stacks, dark)
    yield from check_light_in_darks(stacks, dark)
    yield from check_dark_temperature(stacks, capture.saturation_dn)
    yield from check_fields(capture, stacks, dark)
    yield from check_pattern(capture, stacks, dark, channels)


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
    """Suspected errors of a capture by its frames, tables and numbers.

    Physical effects that a model may lack are not errors. ``cboxlab.validation.capture_checks`` adds the checks that
    compare the photographs with a rendering.

    Parameters
    ----------
    capture
        A capture.
    bands
        The capture's corrected signals.
    dark
        The capture's dark frames.
    noise
        Gain and read noise by its frames.
    radiometry
        The capture's constant C.
    fit
        Camera fitted to its surveyed points; None without one.
    channels
        Channel of each band of a sensor with a mosaic; None without one.
    already
        Suspicions of earlier steps, placed first.

    Returns
    -------
    tuple of Suspicion
        In the order of the checks, none twice; empty for a sound capture.

    Raises
    ------
    InputError
        For a faulty frame.
    """
    stacks = read_stacks(capture, dict(channels) if channels is not None else None)
    stacks = tuple(stack for stack in stacks if stack.band not in bands.faint)
    suspicions = [
        *already,
        *check_numbers(capture),
        *check_tables(capture),
        *check_scene(capture),
        *check_frame_content(stacks),
        *check_same_view(capture, stacks, dark, noise),
        *check_spectra_content(capture),
        *check_names(capture, stacks),
        *check_exposures(stacks),
        *check_brackets(bands),
        *check_schedule(stacks),
        *(() if capture.is_merged else _check_counts(capture, stacks, dark, noise, channels)),
        *check_constant(capture, radiometry, noise, fit, channels),
        *check_flats_and_references(capture, bands, radiometry, channels),
        *check_filter_shift(capture, radiometry),
        *check_focal_length(capture, fit),
        *check_points(capture, fit),
    ]
    return tuple(dict.fromkeys(suspicions))
