"""Raw frames as ``cbox simulate`` writes them, read back."""

import json

import tifffile


def read_raw(path):
    """Counts (y, x), and the metadata of their description; {} without."""
    with tifffile.TiffFile(path) as file:
        description = file.pages.first.description
        return file.asarray(), json.loads(description) if description else {}
