"""``cboxlab.simulate``: one raw frame of a spectral cube by a camera, developed, and as files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.rendering.files import open_cube, raw_to_srgb, scene_white, write_dng, write_raw
from cboxlab.rendering.sensor import SensorCamera, auto_exposure, load_camera
from cboxlab.rendering.sensor import simulate as simulated
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from numpy.typing import NDArray
from PIL import Image

from .cube import CubeResult
from .result import Result

__all__ = ["RawFrame", "simulate"]


@dataclass(frozen=True, eq=False, repr=False)
class RawFrame(Result):
    """counts : (y, x) DN. white : the light that is white in a picture of the cube."""

    camera: SensorCamera
    exposure_s: float
    seed: int
    counts: NDArray[np.uint16]
    white: Spectrum

    def preview(self) -> NDArray[np.uint8]:
        """(y, x, 3) sRGB, white balanced, demosaiced. Raises InputError for a mosaic that is not Bayer's."""
        return raw_to_srgb(self.counts, self.camera, self.exposure_s, self.white)

    def to_dict(self) -> dict[str, Any]:
        """How the frame was taken, and its range; the counts themselves are in ``counts``."""
        height, width = self.counts.shape
        return {
            "camera": self.camera.name,
            "exposure_s": self.exposure_s,
            "seed": self.seed,
            "width_px": width,
            "height_px": height,
            "least_dn": int(self.counts.min()),
            "most_dn": int(self.counts.max()),
        }

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """raw.tif, its counts, and raw.png, developed from it where the mosaic is Bayer's or none."""
        place = Path(folder)
        counts = self.write_counts(place / "raw.tif")
        try:
            return counts, self.write_preview(place / "raw.png")
        except InputError:
            return (counts,)

    def write_counts(self, path: str | Path) -> Path:
        """The counts as .dng, or as a 16-bit TIFF that says how they were taken."""
        path = Path(path)
        if path.suffix.lower() == ".dng":
            write_dng(path, self.counts, self.camera, self.exposure_s, self.white)
        else:
            notes: dict[str, float | int | str] = {
                "camera": self.camera.name,
                "exposure_s": self.exposure_s,
                "seed": self.seed,
            }
            write_raw(path, self.counts, notes)
        return path

    def write_preview(self, path: str | Path) -> Path:
        """The preview as PNG."""
        picture = Image.fromarray(self.preview())
        with replacing(Path(path)) as temporary:
            picture.save(temporary, format="PNG", optimize=True)
        return Path(path)

    def lines(self) -> list[str]:
        """Camera, exposure and range of the counts."""
        height, width = self.counts.shape
        return [
            f"Raw frame of {width} x {height} px by {self.camera.name}: {self.exposure_s:.4g} s, "
            f"{self.counts.min()} to {self.counts.max()} DN"
        ]


@contextmanager
def _opened(cube: CubeResult | xr.Dataset | str | Path) -> Iterator[xr.Dataset]:
    if isinstance(cube, CubeResult):
        yield cube.cube
    elif isinstance(cube, xr.Dataset):
        yield cube
    else:
        with open_cube(Path(cube)) as dataset:
            yield dataset


def simulate(
    cube: CubeResult | xr.Dataset | str | Path,
    camera: SensorCamera | str | Path = "dcs200",
    *,
    exposure_s: float | None = None,
    f_number: float | None = None,
    channel: str | None = None,
    seed: int = 0,
) -> RawFrame:
    """One raw frame of a spectral cube, repeatable by ``seed``.

    cube : what ``render`` returned, a dataset with radiance (y, x, wavelength), or a file (.nc, .exr, .hdr).
    camera : a name (dcs200, dcs420, pxl1300l, nikon-d5100, sigma-sd-merrill, sony-a7r2) or a camera file.
    exposure_s : chosen by the camera where None. f_number : in place of the camera's. channel : the filter, of a
    camera that has several and no mosaic.

    Raises InputError for a cube that does not hold what the camera sees.
    """
    chosen = camera if isinstance(camera, SensorCamera) else load_camera(camera)
    if f_number is not None:
        chosen = chosen.at_f_number(f_number)
    with _opened(cube) as dataset:
        seconds = auto_exposure(dataset, chosen, channel) if exposure_s is None else exposure_s
        counts = simulated(dataset, chosen, seconds, seed, channel)
        return RawFrame(chosen, seconds, seed, counts, scene_white(dataset))
