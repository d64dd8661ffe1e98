"""A capture on disk: its manifest, frames and labels, and their checks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cboxlab.utils.lazy import lazy_names

if TYPE_CHECKING:
    from .capture import Capture, FrameTable, load_capture
    from .first_manifest import FirstManifest, ManifestEntry, draft_manifest, write_first_manifest
    from .frame_classes import FrameRole
    from .frames import split_name
    from .labels import Label
    from .manifest import (
        BandTable,
        BracketTable,
        DarkTable,
        FlatTable,
        LensTable,
        ReferenceTable,
        TargetTable,
        split_channel,
    )
    from .mosaic import (
        band_channels,
        brighter_channel_notes,
        channel_lattice,
        channel_letters,
        channel_mask,
        channel_of_filter,
        checked_pattern,
        chosen_channel_notes,
        file_mosaic_notes,
        pattern_rows,
        shares_frames,
    )
    from .reduction import Reduction, degrees_of_freedom, scatters

__all__ = [
    "BandTable",
    "BracketTable",
    "Capture",
    "DarkTable",
    "FirstManifest",
    "FlatTable",
    "FrameRole",
    "FrameTable",
    "Label",
    "LensTable",
    "ManifestEntry",
    "Reduction",
    "ReferenceTable",
    "TargetTable",
    "band_channels",
    "brighter_channel_notes",
    "channel_lattice",
    "channel_letters",
    "channel_mask",
    "channel_of_filter",
    "checked_pattern",
    "chosen_channel_notes",
    "degrees_of_freedom",
    "draft_manifest",
    "file_mosaic_notes",
    "load_capture",
    "pattern_rows",
    "scatters",
    "shares_frames",
    "split_channel",
    "split_name",
    "write_first_manifest",
]

__getattr__, __dir__ = lazy_names(__name__)
