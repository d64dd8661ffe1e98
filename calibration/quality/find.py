"""All checks of a capture that need no rendering of its scene, in order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from ..capture import Capture
from ..correction import CorrectedBands, DarkLibrary, NoiseModel
from ..geometry import CameraFit
from ..radiometry import Radiometry
from .content import check_frame_content, check_names, check_same_view, check_spectra_content, check_stated_exposures
from .filters import check_filter_shift
from .frame_checks import (
    Stack,
    Suspicion,
    check_bias_drift,
    check_black_levels,
    check_brackets,
    check_counts,
    check_dark_temperature,
    check_darks,
    check_division,
    check_exposures,
    check_fields,
    check_fingerprint,
    check_flat_shapes,
    check_independence,
    check_level_of_darks,
    check_light_in_darks,
    check_lines,
    check_noise,
    check_pattern,
    check_repeats,
    check_schedule,
    check_warm_up,
    read_stacks,
)
from .levels import check_constant, check_flats_and_references, check_focal_length
from .points import check_points
from .tables import check_numbers, check_scene, check_tables

__all__ = ["find_suspicions"]


def _check_counts(
    capture: Capture, stacks: Sequence[Stack], dark: DarkLibrary, noise: NoiseModel
) -> Iterator[Suspicion]:
    """Checks that need whole counts of a sensor, which merged pictures are not."""
    yield from check_counts(capture, stacks, dark, noise)
    yield from check_black_levels(capture, stacks, dark, noise)
    yield from check_darks(stacks, noise, capture.saturation_dn)
    yield from check_warm_up(stacks, dark, capture.saturation_dn, capture.manifest.camera.readout_s)
    yield from check_lines(stacks, dark, capture.saturation_dn)
    yield from check_flat_shapes(stacks, dark, capture.saturation_dn)
    moved = [*check_fingerprint(stacks, dark)]
    yield from moved
    moved_tables = {suspicion.where for suspicion in moved}
    in_place = [stack for stack in stacks if f"{stack.key}.frames" not in moved_tables]
    yield from check_division(in_place, dark)
    yield from check_dark_temperature(in_place, capture.saturation_dn)
    yield from check_fields(capture, stacks, dark)


def _check_sensor(
    capture: Capture,
    stacks: Sequence[Stack],
    dark: DarkLibrary,
    noise: NoiseModel,
    channels: Mapping[str, str] | None,
) -> tuple[list[Suspicion], bool]:
    """Suspicions by counts and mosaic; True where flats and references can be compared.

    A mistake that explains others is named alone. Frames that were resampled have no statistics of a sensor, light in
    the darks looks like noise, behind a wrong pattern channels have the levels of others. No dark level holds where the
    bias drifts.
    """
    if capture.is_merged:
        return [], True
    resampled, tables = check_independence(capture, stacks, dark, noise)
    as_read = [stack for stack in stacks if stack.key not in tables]
    drift = [*check_bias_drift(as_read, capture.manifest.camera.readout_s)]
    if drift:
        return [*resampled, *drift], False
    lit_darks = [*check_light_in_darks(as_read, dark)] or [*check_level_of_darks(capture, as_read, dark, noise)]
    suspicions = [*resampled, *lit_darks, *_check_counts(capture, as_read, dark, noise)]
    if not lit_darks:
        suspicions += check_repeats(capture, as_read, dark, noise)
    if not (lit_darks or resampled):
        suspicions += check_noise(capture, stacks, dark, noise)
    pattern = [*check_pattern(capture, as_read, dark, channels)]
    fields_as_read = not any(stack.kind in ("flat", "reference") for stack in stacks if stack.key in tables)
    return [*suspicions, *pattern], fields_as_read and not pattern


def _check_levels(
    capture: Capture,
    bands: CorrectedBands,
    noise: NoiseModel,
    radiometry: Radiometry,
    fit: CameraFit | None,
    channels: Mapping[str, str] | None,
) -> Iterator[Suspicion]:
    """Checks of the levels of flats and references, by the sensor equation."""
    yield from check_constant(capture, radiometry, noise, fit, channels)
    yield from check_flats_and_references(capture, bands, radiometry, channels)
    yield from check_filter_shift(capture, radiometry)


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
    of_sensor, comparable = _check_sensor(capture, stacks, dark, noise, channels)
    suspicions = [
        *already,
        *check_numbers(capture),
        *check_tables(capture),
        *check_scene(capture),
        *check_frame_content(stacks),
        *check_same_view(capture, stacks, dark, noise),
        *check_spectra_content(capture),
        *check_names(capture, stacks),
        *check_stated_exposures(capture, stacks),
        *check_exposures(stacks),
        *check_brackets(bands),
        *check_schedule(stacks),
        *of_sensor,
        *(_check_levels(capture, bands, noise, radiometry, fit, channels) if comparable else ()),
        *check_focal_length(capture, fit),
        *check_points(capture, fit),
    ]
    return tuple(dict.fromkeys(suspicions))
