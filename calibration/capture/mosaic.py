"""Sensors with a colour filter array: which pixels belong to which channel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray

from ..frame_readers import frame_header
from .capture import Capture, FrameTable
from .frames import pictures_by_file
from .manifest import BandTable, channel_letters, checked_pattern, is_channel, pattern_rows, split_channel

__all__ = [
    "band_channels",
    "brighter_channel_notes",
    "channel_lattice",
    "channel_letters",
    "channel_mask",
    "channel_of_filter",
    "checked_pattern",
    "chosen_channel_notes",
    "file_mosaic_notes",
    "pattern_rows",
    "shares_frames",
]

#: Wavelength at which the blue and green sensitivities of common colour filter arrays cross, nm.
_BLUE_TO_GREEN_NM = 490.0
#: Wavelength at which their green and red sensitivities cross, nm.
_GREEN_TO_RED_NM = 580.0
#: Share of the chosen channel's light from which another channel is worth its pixels: it lowers the noise by 10 %.
_GOOD_PART = 0.2


def channel_mask(pattern: str, shape: tuple[int, int], channel: str) -> NDArray[np.bool_]:
    """Pixels of one channel of a mosaic.

    Parameters
    ----------
    pattern
        Letters of one repeat from the upper left pixel on, row by row, such as "GBRG" for 2 x 2 pixels; rows of another
        repeat are separated by a space.
    shape
        (height, width) of the frame, px.
    channel
        Letter of the pattern for all its pixels; "G2" for the second pixel of G in the repeat, in reading order.

    Returns
    -------
    NDArray
        (y, x) True where the mosaic has the channel.

    Raises
    ------
    ValueError
        If the channel is not in the pattern.
    """
    if not is_channel(pattern, channel):
        raise ValueError(f"channel '{channel}' is not in the pattern '{pattern}'")
    letter, number = split_channel(channel)
    cell = np.array([[pixel == letter for pixel in row] for row in pattern_rows(pattern)])
    if number is not None:
        cell &= np.cumsum(cell).reshape(cell.shape) == number
    height, width = shape
    return np.tile(cell, (-(-height // cell.shape[0]), -(-width // cell.shape[1])))[:height, :width]


def channel_lattice(pattern: str, channel: str) -> tuple[int, int, int]:
    """Densest square lattice of pixels that all belong to one channel.

    With a Bayer pattern it is the channel's first pixel of every 2 x 2, with X-Trans green one pixel of every 3 x 3.

    Parameters
    ----------
    pattern
        Letters of one repeat, see ``channel_mask``.
    channel
        Channel, see ``channel_mask``.

    Returns
    -------
    tuple
        Row and column of the first pixel, and the step in both directions, px.
    """
    rows = pattern_rows(pattern)
    period = int(np.lcm(len(rows), len(rows[0])))
    mask = channel_mask(pattern, (period, period), channel)
    for step in range(1, period + 1):
        if period % step == 0:
            everywhere = mask.reshape(period // step, step, period // step, step).all(axis=(0, 2))
            if everywhere.any():
                row, column = divmod(int(everywhere.argmax()), step)
                return row, column, step
    raise AssertionError("a step of the whole period has one pixel of every channel")


def band_channels(capture: Capture) -> dict[str, str] | None:
    """The channel used for each band.

    It is the one that the band's table states. Otherwise it is chosen:

    With stated quantum efficiencies it is the channel with the largest response within the filter's pass band. Without
    them it is the channel that usually passes the filter's peak: B below 490 nm, R above 580 nm, G between. Without a
    transmittance it is the channel with the largest mean count. The brightest channel is not always the right one:
    light outside the pass band and crosstalk can make another channel brighter.

    Parameters
    ----------
    capture
        The capture.

    Returns
    -------
    dict | None
        By band identifier, the channel, such as "R", or "G2" where a table states it; None without a mosaic.
    """
    if capture.manifest.mosaic is None:
        return None
    return {band.id: band.channel or channel_of_filter(capture, band) for band in capture.manifest.band}


def chosen_channel_notes(capture: Capture, channels: Mapping[str, str] | None) -> list[str]:
    """Note on the channels that no table states.

    Parameters
    ----------
    capture
        The capture.
    channels
        By band identifier, the channel used; None without a mosaic.

    Returns
    -------
    list
        One sentence, and another one on channels that are left out; empty if every band states its channel, and without
        a mosaic.
    """
    if channels is None:
        return []
    selected = [f"{band.id} {channels[band.id]}" for band in capture.manifest.band if band.channel is None]
    if not selected:
        return []
    notes = [f"no channel of the mosaic is stated, so the bands see: {', '.join(selected)}"]
    if others := _further_channels(capture, channels):
        notes.append(
            f"further channels see these filters: {', '.join(others)}. A further [[band]] of the same frames with "
            'channel = "..." uses their pixels'
        )
    return notes


def _further_channels(capture: Capture, channels: Mapping[str, str]) -> list[str]:
    """Bands with the letters of other channels worth their pixels, by stated efficiencies."""
    mosaic, others = capture.manifest.mosaic, []
    if mosaic is None or capture.manifest.camera.quantum_efficiency is None:
        return []
    for band in capture.manifest.band:
        if band.channel is None and band.transmittance is not None:
            filter_curve = capture.light(band.transmittance)
            light = {letter: _in_band(capture, filter_curve, letter) for letter in channel_letters(mosaic.pattern)}
            used = channels[band.id]
            further = [each for each in light if each != used and light[each] > _GOOD_PART * light[used] > 0]
            others += [f"{band.id} {' '.join(further)}"] if further else []
    return others


def _in_band(capture: Capture, filter_curve: Spectrum, channel: str) -> float:
    """Response of a channel within a filter's pass band, in any scale."""
    efficiency = capture.quantum_efficiency(channel)
    return 0.0 if efficiency is None else float(np.sum(efficiency.at(filter_curve.wavelength_nm) * filter_curve.values))


def channel_of_filter(capture: Capture, band: BandTable) -> str:
    """Channel of a mosaic that suits a band's filter best, see ``band_channels``.

    Parameters
    ----------
    capture
        A capture with a mosaic.
    band
        One of its bands; the channel that it states does not count.

    Returns
    -------
    str
        Letter of the channel.

    Raises
    ------
    ValueError
        Without a mosaic.
    """
    if capture.manifest.mosaic is None:
        raise ValueError("the sensor has no mosaic")
    pattern = capture.manifest.mosaic.pattern
    if band.transmittance is None:
        return _brightest_channel(capture, band, pattern)
    filter_curve = capture.light(band.transmittance)
    if capture.manifest.camera.quantum_efficiency is not None:
        return max(channel_letters(pattern), key=lambda channel: _in_band(capture, filter_curve, channel))
    peak = filter_curve.wavelength_nm[np.argmax(filter_curve.values)]
    usual = "B" if peak < _BLUE_TO_GREEN_NM else "R" if peak > _GREEN_TO_RED_NM else "G"
    return usual if usual in pattern else _brightest_channel(capture, band, pattern)


def _brightest_channel(capture: Capture, band: BandTable, pattern: str) -> str:
    """The channel with the largest mean count in the band's frames."""
    frame = capture.frames(band).mean(axis=0)
    return max(
        channel_letters(pattern), key=lambda channel: frame[channel_mask(pattern, capture.shape, channel)].mean()
    )


def shares_frames(capture: Capture, channels: Mapping[str, str] | None, first: str, second: str) -> bool:
    """Whether two bands are different channels of the same frames.

    Parameters
    ----------
    capture
        The capture.
    channels
        By band identifier, the channel used; None without a mosaic.
    first
        Identifier of a band.
    second
        Identifier of another band.

    Returns
    -------
    bool
        False without a mosaic.
    """
    if channels is None or channels[first] == channels[second]:
        return False
    return capture.band(first).frames == capture.band(second).frames


def file_mosaic_notes(capture: Capture) -> list[str]:
    """Notes on frames whose files state another mosaic than the manifest.

    Parameters
    ----------
    capture
        The capture.

    Returns
    -------
    list
        One sentence per mosaic that files state; empty for files that state nothing.
    """
    mosaic = capture.manifest.mosaic
    pattern = None if mosaic is None else mosaic.pattern
    files: dict[str, list[str]] = {}
    tables: list[FrameTable] = [*capture.manifest.band, *capture.manifest.flats, *capture.manifest.darks]
    for table in tables:
        for path, _ in pictures_by_file(capture.folder, table.frames):
            stated_pattern = frame_header(path).facts.pattern
            if stated_pattern is not None and stated_pattern != pattern:
                files.setdefault(stated_pattern, []).append(path.name)
    taken_as = "a sensor without mosaic" if pattern is None else f"the mosaic {pattern}"
    return [
        f"{names[0]}{f' and {len(names) - 1} more' if names[1:] else ''}: the file states the mosaic {stated_pattern}, "
        f"capture.toml {taken_as}: the latter was used"
        for stated_pattern, names in files.items()
    ]


def brighter_channel_notes(capture: Capture, channels: Mapping[str, str] | None) -> list[str]:
    """Notes on bands in which another channel is brighter than the one chosen.

    A band whose table states its channel may see the darker one.

    Parameters
    ----------
    capture
        The capture.
    channels
        By band identifier, the channel used; None without a mosaic.

    Returns
    -------
    list
        One sentence per such band; empty without a mosaic.
    """
    mosaic = capture.manifest.mosaic
    if channels is None or mosaic is None:
        return []
    notes = []
    for band in capture.manifest.band:
        if band.channel is not None:
            continue
        brightest = _brightest_channel(capture, band, mosaic.pattern)
        if brightest != channels[band.id]:
            notes.append(
                f"{band.id}: channel {brightest} is brighter than the channel used, {channels[band.id]}: "
                "the frames contain light from outside the pass band"
            )
    return notes
