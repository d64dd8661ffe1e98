"""One raw frame of a spectral cube by a camera, developed, and as files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from cboxlab.render.dng import write_dng
from cboxlab.render.previews import raw_to_srgb, scene_white
from cboxlab.render.raw_files import write_raw
from cboxlab.render.sensor import SensorCamera
from cboxlab.render.sensor_simulation import auto_exposure, simulate
from cboxlab.scenes.files import replacing
from cboxlab.scenes.spectra import Spectrum
from numpy.typing import NDArray
from PIL import Image

__all__ = ["RawShot", "shoot", "write_preview", "write_shot"]


@dataclass(frozen=True, eq=False)
class RawShot:
    """counts : (y, x) DN. white : the light that is white in a picture of the cube."""

    camera: SensorCamera
    exposure_s: float
    seed: int
    counts: NDArray[np.uint16]
    white: Spectrum

    def preview(self) -> NDArray[np.uint8]:
        """(y, x, 3) sRGB, white balanced, demosaiced. Raises InputError for a mosaic that is not Bayer's."""
        return raw_to_srgb(self.counts, self.camera, self.exposure_s, self.white)


def shoot(
    cube: xr.Dataset,
    camera: SensorCamera,
    exposure_s: float | None = None,
    seed: int = 0,
    channel: str | None = None,
) -> RawShot:
    """Photograph a cube. exposure_s : chosen by the camera where None. channel : see ``simulate``.

    Raises InputError for a cube that does not hold what the camera sees.
    """
    seconds = auto_exposure(cube, camera, channel) if exposure_s is None else exposure_s
    return RawShot(camera, seconds, seed, simulate(cube, camera, seconds, seed, channel), scene_white(cube))


def write_shot(path: Path, shot: RawShot) -> None:
    """Write the counts as .dng, or as a 16-bit TIFF that says how they were taken."""
    if path.suffix.lower() == ".dng":
        write_dng(path, shot.counts, shot.camera, shot.exposure_s, shot.white)
        return
    write_raw(
        path, shot.counts, {"camera": shot.camera.name, "exposure_s": shot.exposure_s, "seed": shot.seed}
    )


def write_preview(path: Path, shot: RawShot) -> None:
    """Write the preview as PNG, complete or not at all."""
    picture = Image.fromarray(shot.preview())
    with replacing(path) as temporary:
        picture.save(temporary, format="PNG", optimize=True)
