"""Checks of a finished picture: energy, range, parts of light, labels against geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from cboxlab.rendering.dataset import Box
from cboxlab.rendering.image import NOTHING
from cboxlab.rendering.model import model_cube_inputs
from cboxlab.scenes.camera import Camera
from cboxlab.utils.frozen import FrozenMappings
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.stats import rankdata

__all__ = ["Checks", "check_picture"]

#: Standard errors that a radiance may lie below 0, or above the brightest lamp: one sample in 10^9.
_SIGMAS = 6.0

#: Radiance below 0 of dark pixels, relative to the brightest pixel, that few batches do not state: 4 of 400 pictures of
#: 128 x 128 x 31 had up to 1.4e-6, the most where gloss changes 0.4 % of an edge's pixel.
_DARK = 1e-5

#: Largest distance between a point's image and its pixel's centre, px: single precision of positions.
_REPROJECTION_PX = 0.01

#: Largest relative difference between the radiance and the sum of its parts, beyond the rounding of stored numbers.
_SUM = 1e-5

#: Largest share of pixels of one surface where a ray meets another: single precision at edges.
_OTHER_LABELS = 1e-3


@dataclass(frozen=True, eq=False)
class Checks(FrozenMappings):
    """Outcome of the checks of one picture."""

    #: Faults, one sentence each; empty for a sound picture.
    faults: tuple[str, ...]
    #: Figures by name.
    figures: Mapping[str, float]


def check_picture(cube: xr.Dataset, box: Box, noise: float, mantissa_bits: int) -> Checks:
    """Check a picture.

    Parameters
    ----------
    cube
        The picture.
    box
        Its box.
    noise
        Relative standard error that the median pixel and wavelength may have.
    mantissa_bits
        Bits of the stored numbers.

    Returns
    -------
    Checks
        Faults and figures.
    """
    faults: list[str] = []
    radiance, error = (cube[name].values.astype(np.float64) for name in ("radiance", "standard_error"))
    reached = float(cube.attrs["relative_standard_error"])
    figures = {"relative_standard_error": reached}
    if not (np.isfinite(radiance).all() and np.isfinite(error).all()):
        return Checks(("range: a radiance or standard error is not finite",), figures)
    figures["largest_radiance"] = float(radiance.max())
    if (radiance < -_SIGMAS * error - _DARK * radiance.max()).any():
        faults.append(f"range: radiance down to {radiance.min():.3g}, below 0 by more than {_SIGMAS:g} standard errors")
    if not radiance.any():
        faults.append("range: no light in the picture")
    if reached > noise * 1.02:
        faults.append(f"noise: the relative standard error is {reached:.2%}, asked for was {noise:.2%}")
    rounding = 2.0 ** -(mantissa_bits + 1)
    faults += _energy_faults(cube, box, radiance, error, rounding)
    camera = model_cube_inputs(box.model, box.cameras[cube.attrs["camera_name"]])[1]
    faults += _label_faults(cube, camera, rounding)
    figures["edge_fit"] = _edge_fit(cube)
    return Checks(tuple(faults), figures)


def _energy_faults(cube: xr.Dataset, box: Box, radiance: NDArray, error: NDArray, rounding: float) -> list[str]:
    """Faults of energy: light brighter than the lamps, and parts that do not sum to the whole.

    A surface that reflects at most all light is no brighter than the brightest thing it sees, so no surface is brighter
    than the brightest lamp. A coat or a fluorescent paint may be.
    """
    faults = []
    if not any(effect.stage == "transport" for effect in box.model.effects):
        scene, _, _ = model_cube_inputs(box.model, next(iter(box.cameras.values())))
        lamps = np.array([lamp.radiance.at(cube["wavelength"].values) for lamp in scene.lamps]).max(axis=0)
        peak = np.max([_peak(lamp) for lamp in scene.lamps])
        above = radiance - _SIGMAS * error > lamps * peak * (1 + 4 * rounding)
        if above.any():
            faults.append(f"energy: {int(above.any(axis=-1).sum())} pixels are brighter than the brightest lamp")
    if "reflections" in cube and "effects_light" in cube:
        parts = cube["reflections"].values.astype(np.float64).sum(axis=0) + cube["effects_light"].values
        size = float(radiance.max())
        off = np.abs(parts - radiance).max() / size if size > 0 else 0.0
        if off > _SUM + 6 * rounding:
            faults.append(f"energy: the parts of the light differ from the radiance by {off:.2g} of the brightest")
    faults += _split_faults(cube, box, radiance, rounding)
    if "albedo" in cube and not (0 <= cube["albedo"].values.min() and cube["albedo"].values.max() <= 1 + 1e-6):
        faults.append("range: an albedo outside 0 to 1")
    return faults


def _split_faults(cube: xr.Dataset, box: Box, radiance: NDArray, rounding: float) -> list[str]:
    """Faults of the split into lamp, albedo times irradiance over pi, and specular light.

    Pixels of one flat surface that do not touch a sphere count, in boxes whose only effects on light transport are
    coats.
    """
    truths = {"albedo", "irradiance", "specular", "reflections", "coverage"}
    if not truths <= set(cube) or any(e.stage == "transport" and not e.effect.is_coat for e in box.model.effects):
        return []
    coverage = cube["coverage"].values
    balls = [index for index, surface in enumerate(box.model.scene.surfaces) if surface.ball]
    near = maximum_filter((coverage[..., balls] > 0).any(axis=-1), 3)  # their silhouettes are found by rays
    alone = (coverage > 1 - 1e-6).any(axis=-1) & ~near
    parts = {name: cube[name].values.astype(np.float64) for name in ("albedo", "irradiance", "specular")}
    split = cube["reflections"].values[0] + parts["albedo"] * parts["irradiance"] / np.pi + parts["specular"]
    off = (np.abs(split - radiance)[alone] > (_SUM + 6 * rounding) * radiance.max()).any(axis=-1)
    if off.sum() <= _OTHER_LABELS * len(off):  # one sample of a pixel may have met the surface next to it
        return []
    return [f"energy: in {int(off.sum())} pixels albedo times irradiance and specular light are not the radiance"]


def _peak(lamp: object) -> float:
    """Largest radiance of a lamp over its mean along the normal."""
    pattern, edge = getattr(lamp, "pattern", None), float(getattr(lamp, "edge_ratio", 1.0))
    return float(np.max(pattern)) if pattern is not None else 1 / (edge + (1 - edge) * 4 / 9)


def _label_faults(cube: xr.Dataset, camera: Camera, rounding: float) -> list[str]:
    """Faults of labels and points against the camera."""
    faults = []
    surface = cube["surface"].values
    if "position" in cube:
        position = cube["position"].values.astype(np.float64)
        visible = np.isfinite(position).all(axis=-1)
        rows, columns = np.nonzero(visible)
        image = camera.project(position[visible])
        off = np.abs(image - np.stack([columns, rows], axis=1)).max() if len(image) else 0.0
        if off > _REPROJECTION_PX + 4 * rounding * max(surface.shape) * 10:
            faults.append(f"labels: a point lies {off:.3g} px from its pixel's centre")
        toward = camera.position_mm - position[visible]
        if "normal" in cube and (np.sum(toward * cube["normal"].values[visible], axis=1) <= 0).any():
            faults.append("labels: a normal points away from the camera")
        alone = cube["coverage"].values.max(axis=-1) > 0.999999 if "coverage" in cube else np.zeros_like(visible)
        other = alone & ~visible & (surface != NOTHING)
        if alone.any() and other.sum() > _OTHER_LABELS * alone.sum():
            faults.append(f"labels: {int(other.sum())} pixels of one surface have no point at their centre")
    if "coverage" in cube:
        total = cube["coverage"].values.sum(axis=-1)
        if total.max() > 1 + 1e-4:
            faults.append(f"labels: coverages of a pixel sum to {total.max():.6g}")
    return faults


def _edge_fit(cube: xr.Dataset) -> float:
    """Mean rank of the luminance steps at label edges among those everywhere, 0 to 1.

    The largest step within a pixel of each place counts. Chance gives 0.5. NaN for a picture without edges.
    """
    label, light = cube["surface"].values, np.log(np.maximum(cube["radiance"].values.sum(axis=-1), 1e-30))
    ranks = []
    for axis in (0, 1):
        edge = np.diff(label, axis=axis) != 0
        step = maximum_filter(np.abs(np.diff(light, axis=axis)), 3)
        order = rankdata(step).reshape(step.shape) / step.size
        ranks.append(order[edge])
    every = np.concatenate(ranks)
    return float(every.mean()) if every.size else float("nan")
