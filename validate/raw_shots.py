"""One raw frame of a spectral cube by a camera with a preview, and both as files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.render.previews import raw_to_srgb, scene_white
from cboxlab.render.raw_files import write_raw
from cboxlab.render.sensor import SensorCamera
from cboxlab.render.sensor_simulation import auto_exposure, simulate
from cboxlab.scenes.files import replacing
from numpy.typing import NDArray
from PIL import Image

__all__ = ["RawShot", "shoot", "write_preview", "write_shot"]


@dataclass(frozen=True, eq=False)
class RawShot:
    """counts : (y, x) DN. preview : (y, x, 3) sRGB, white balanced for the cube's lamp, demosaiced."""

    camera: SensorCamera
    exposure_s: float
    seed: int
    counts: NDArray[np.uint16]
    preview: NDArray[np.uint8]


def shoot(
    cube: xr.Dataset,
    camera: SensorCamera,
    exposure_s: float | None = None,
    seed: int = 0,
    channel: str | None = None,
) -> RawShot:
    """Photograph a cube. exposure_s : chosen by the camera where None. channel : see ``simulate``.

    Raises InputError for a cube that does not hold what the camera sees, or a preview that cannot be made.
    """
    seconds = auto_exposure(cube, camera, channel) if exposure_s is None else exposure_s
    counts = simulate(cube, camera, seconds, seed, channel)
    return RawShot(camera, seconds, seed, counts, raw_to_srgb(counts, camera, seconds, scene_white(cube)))


def write_shot(path: Path, shot: RawShot) -> None:
    """Write the counts as a 16-bit TIFF that says how they were taken."""
    write_raw(
        path, shot.counts, {"camera": shot.camera.name, "exposure_s": shot.exposure_s, "seed": shot.seed}
    )


def write_preview(path: Path, shot: RawShot) -> None:
    """Write the preview as PNG, complete or not at all."""
    with replacing(path) as temporary:
        Image.fromarray(shot.preview).save(temporary, format="PNG", optimize=True)
