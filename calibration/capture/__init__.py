"""A capture on disk: its manifest, frames and labels, and their checks."""

from .capture import Capture, FrameTable, load_capture
from .first_manifest import FirstManifest, write_first_manifest
from .labels import Label
from .manifest import BandTable, BracketTable, DarkTable, FlatTable, ReferenceTable
from .manifest_faults import nearest
from .mosaic import (
    band_channels,
    brighter_channel_notes,
    channel_lattice,
    channel_letters,
    channel_mask,
    checked_pattern,
    chosen_channel_notes,
    file_mosaic_notes,
    pattern_rows,
    shares_frames,
)

__all__ = [
    "BandTable",
    "BracketTable",
    "Capture",
    "DarkTable",
    "FirstManifest",
    "FlatTable",
    "FrameTable",
    "Label",
    "ReferenceTable",
    "band_channels",
    "brighter_channel_notes",
    "channel_lattice",
    "channel_letters",
    "channel_mask",
    "checked_pattern",
    "chosen_channel_notes",
    "file_mosaic_notes",
    "load_capture",
    "nearest",
    "pattern_rows",
    "shares_frames",
    "write_first_manifest",
]
