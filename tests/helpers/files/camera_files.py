"""Camera files as `cbox export` writes them."""

import json

from cboxlab.rendering.export.neutral import camera_entry

__all__ = ["write_camera"]


def write_camera(path, camera):
    path.write_text(json.dumps(camera_entry(camera)))
