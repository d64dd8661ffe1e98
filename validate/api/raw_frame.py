"""``cboxlab.simulate``: one raw frame of a spectral cube by a camera."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.rendering.files import open_cube, raw_to_srgb, require_stored, scene_white, write_dng, write_raw
from cboxlab.rendering.sensor import SensorCamera, auto_exposure, load_camera, simulate_frame
from cboxlab.scenes.spectra import Spectrum
from cboxlab.utils.arguments import (
    MAX_SEED,
    require_type,
    required_folder,
    required_number,
    required_path,
    required_whole_number,
)
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from numpy.typing import NDArray
from PIL import Image

from .cube import CubeResult
from .result import Result

__all__ = ["RawFrame", "simulate"]


@dataclass(frozen=True, eq=False, repr=False)
class RawFrame(Result):
    """Raw frame of a spectral cube by a camera."""

    #: Camera of the frame.
    camera: SensorCamera
    #: Exposure time, s.
    exposure_s: float
    #: Seed of the noise.
    seed: int
    #: (y, x) counts, DN.
    counts: NDArray[np.uint16]
    #: Light that is white in a picture of the cube.
    white: Spectrum

    def preview(self) -> NDArray[np.uint8]:
        """Demosaiced and white-balanced picture.

        Returns
        -------
        NDArray
            (y, x, 3) sRGB, 8 bits.

        Raises
        ------
        InputError
            For a mosaic other than Bayer's.
        """
        return raw_to_srgb(self.counts, self.camera, self.exposure_s, self.white)

    def to_dict(self) -> dict[str, Any]:
        """Camera, exposure, seed, size and range of the counts.

        Returns
        -------
        dict
            Ready for JSON; the counts are in ``counts``.
        """
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
        """Write raw.tif, and raw.png if the sensor has Bayer's mosaic or none.

        Parameters
        ----------
        folder
            Folder of the files.

        Returns
        -------
        tuple of Path
            raw.tif first.
        """
        target = required_folder("folder", folder)
        counts = self.write_counts(target / "raw.tif")
        try:
            return counts, self.write_preview(target / "raw.png")
        except InputError:
            return (counts,)

    def write_counts(self, path: str | Path) -> Path:
        """Write the counts.

        Parameters
        ----------
        path
            A .dng file; any other ending gives a 16-bit TIFF that states camera, exposure and seed.

        Returns
        -------
        Path
            The file.
        """
        path = required_path("path", path)
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
        """Write the demosaiced picture as PNG.

        Parameters
        ----------
        path
            The file.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            For a mosaic other than Bayer's.
        """
        picture = Image.fromarray(self.preview())
        path = required_path("path", path)
        with replacing(path) as temporary:
            picture.save(temporary, format="PNG", optimize=True)
        return path

    def lines(self) -> list[str]:
        """Size, camera, exposure and range of the counts.

        Returns
        -------
        list of str
            One sentence.
        """
        height, width = self.counts.shape
        return [
            f"Raw frame of {width} x {height} px by {self.camera.name}: {self.exposure_s:.4g} s, "
            f"{self.counts.min()} to {self.counts.max()} DN"
        ]


@contextmanager
def _opened(cube: CubeResult | xr.Dataset | str | Path) -> Iterator[xr.Dataset]:
    """Dataset of a result, a dataset or a file, which is open in the context."""
    if isinstance(cube, CubeResult):
        yield cube.cube
    elif isinstance(cube, xr.Dataset):
        require_stored(cube, Path("cube"))
        yield cube
    else:
        with open_cube(required_path("cube", cube, "a result of render, a dataset or a file of a cube")) as dataset:
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
    """Simulate one raw frame of a spectral cube; repeatable by ``seed``.

    Parameters
    ----------
    cube
        A result of ``render``, a dataset with radiance (y, x, wavelength), or a file (.nc, .exr, .hdr).
    camera
        A camera, a camera file, or a name: dcs200, dcs420, pxl1300l, nikon-d5100, sigma-sd-merrill, sony-a7r2.
    exposure_s
        Exposure time, s; None for the camera's automatic exposure.
    f_number
        Working f-number, in place of the camera's.
    channel
        Filter, for a camera with several filters and no mosaic.
    seed
        Seed of the noise.

    Returns
    -------
    RawFrame
        Counts, exposure and camera.

    Raises
    ------
    InputError
        If the cube lacks light that the camera sees, or an argument is faulty.

    Examples
    --------
    >>> cube = cboxlab.render("cornell-box", size=32, noise=0.05)  # doctest: +SKIP
    >>> print(cboxlab.simulate(cube, "dcs200", exposure_s=0.004))  # doctest: +SKIP
    """
    sensor = camera if isinstance(camera, SensorCamera) else load_camera(camera)
    if f_number is not None:
        sensor = sensor.at_f_number(required_number("f_number", f_number, above=0.0))
    if channel is not None:
        require_type("channel", channel, str, "the name of a filter")
    stated_s = None if exposure_s is None else required_number("exposure_s", exposure_s, above=0.0)
    seed = required_whole_number("seed", seed, 0, MAX_SEED)
    with _opened(cube) as dataset:
        seconds = auto_exposure(dataset, sensor, channel) if stated_s is None else stated_s
        counts = simulate_frame(dataset, sensor, seconds, seed, channel)
        return RawFrame(sensor, seconds, seed, counts, scene_white(dataset))
