"""Comparison of a renderer with ours: by surface and band, bias map, noise, named cause."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from cboxlab.rendering.export import Exported
from cboxlab.rendering.files import NOTES
from cboxlab.rendering.integrators import BATCHES, RenderJob, render_image
from cboxlab.rendering.model import labelled_cube
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.numbers import json_value
from cboxlab.utils.progress import NO_PROGRESS, Progress
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from ...report import STYLE
from ..regress import UNKNOWN, Outcome, View, regress_pictures, side_of
from .running import RendererRun

__all__ = ["REFERENCE_SAMPLES", "Judged", "judge", "noise_of", "reference_cube", "write_bias_map"]

#: Samples per pixel and batch of our own rendering: its noise is then far below that of 256 samples of others.
REFERENCE_SAMPLES = 512
#: Relative difference of a surface below which it agrees: 0.2 %, the target of docs/renderers.md.
_AGREEMENT = 0.002
#: Standard deviations of a surface's difference within which it agrees: 95 %.
_AGREEMENT_SIGMAS = 2


@dataclass(frozen=True, eq=False)
class Judged(FrozenMappings):
    """Comparison of one renderer with ours."""

    #: Identifier of the renderer.
    renderer: str
    #: Outcome of the regression, with the named cause.
    outcome: Outcome
    #: (w,) wavelengths, nm.
    wavelength_nm: NDArray[np.float64]
    #: By surface: relative difference and its standard deviation, over all wavelengths, inside the surface. Inside are
    #: pixels whose neighbours see the same surface.
    surfaces: Mapping[str, tuple[float, float]]
    #: By surface: (w, 2) the same at each wavelength; NaN or infinite without light.
    bands: Mapping[str, NDArray[np.float64]]
    #: Mean of the squared relative standard error over pixels inside surfaces and wavelengths.
    variance: float
    #: CPU seconds of the run; NaN where it ran elsewhere.
    cpu_s: float
    #: Elapsed seconds of the run; NaN where it ran elsewhere.
    wall_s: float
    #: (y, x) difference over our rendering, summed over wavelengths; NaN without light.
    relative: NDArray[np.float64]
    #: Difference of the renderer's scene, and with it of ours, from the one asked for; empty where there is none.
    remark: str = ""

    @property
    def cost(self) -> float:
        """Variance times CPU seconds; NaN where the renderer ran elsewhere."""
        return self.variance * self.cpu_s

    @property
    def agreeing(self) -> tuple[str, ...]:
        """Surfaces within 0.2 % of ours, or within two standard deviations."""
        return tuple(n for n, (d, s) in self.surfaces.items() if abs(d) <= max(_AGREEMENT, _AGREEMENT_SIGMAS * s))

    @property
    def sentence(self) -> str:
        """Finding in words."""
        mean = self.outcome.picture_mean
        size = f"mean light {mean.difference:+.3%} ± {mean.sigma:.3%}"
        if self.outcome.same:
            return f"right: {size}, equal within {self.outcome.equivalence_95:.2%} at 95 %"
        cause = self.outcome.changes[0] if self.outcome.changes else None
        if cause is None:
            return f"different: {size}"
        values = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in cause.parameters.items())
        change = f"{cause.change}{f' ({values})' if values else ''}"
        if cause.change == UNKNOWN or cause.fits:
            return f"different: {size}; cause: {change}, probability {cause.probability:.2f}"
        return f"different: {size}; most like: {change}, probability {cause.probability:.2f}"

    def to_dict(self) -> dict[str, Any]:
        """All figures, with the outcome of the regression.

        Returns
        -------
        dict
            Finite numbers or None, ready for JSON.
        """
        return {
            "renderer": self.renderer,
            "finding": self.sentence,
            "remark": self.remark,
            "surfaces": {n: {"relative_difference": d, "sigma": s} for n, (d, s) in self.surfaces.items()},
            "wavelength_nm": self.wavelength_nm.tolist(),
            "bands": {
                n: {"relative_difference": v[:, 0].tolist(), "sigma": v[:, 1].tolist()} for n, v in self.bands.items()
            },
            "variance": self.variance,
            "cpu_s": json_value(self.cpu_s),
            "wall_s": json_value(self.wall_s),
            "variance_times_cpu_s": json_value(self.cost),
            "regression": self.outcome.to_dict(),
        }


def reference_cube(
    exported: Exported, progress: Progress = NO_PROGRESS, samples: int = REFERENCE_SAMPLES
) -> xr.Dataset:
    """Our own rendering of an export's scene, in BATCHES batches.

    Parameters
    ----------
    exported
        The export.
    progress
        Receiver of the finished part.
    samples
        Samples per pixel and batch.

    Returns
    -------
    Dataset
        Cube with standard error and map of surfaces.
    """
    image = render_image(
        RenderJob(
            exported.scene,
            exported.camera,
            exported.settings.wavelength_nm,
            samples,
            BATCHES,
            max_bounces=exported.max_bounces,
        ),
        progress=progress,
    )
    return labelled_cube(image)


def judge(
    renderer: str,
    cube: xr.Dataset,
    reference: xr.Dataset,
    exported: Exported,
    run: RendererRun | None = None,
    progress: Progress = NO_PROGRESS,
) -> Judged:
    """Compare a renderer's cube with our rendering of the same scene.

    Parameters
    ----------
    renderer
        Identifier of the renderer.
    cube
        The renderer's cube, with standard error.
    reference
        Our cube of the same scene, with standard error and map of surfaces.
    exported
        The scene that both show (``as_rendered``).
    run
        Times of the run; None where it ran elsewhere.
    progress
        Receiver of the finished part.

    Returns
    -------
    Judged
        The comparison.
    """
    view = View(exported.scene, exported.camera, True)
    ours, theirs = side_of([reference], ["reference"]), side_of([cube], [renderer])
    outcome = regress_pictures(ours, theirs, view, progress=progress)
    names = [n.strip() for n in str(reference["surface"].attrs["names"]).split(",")]
    surface = reference["surface"].values
    interior = maximum_filter(surface, 3) == minimum_filter(surface, 3)
    surfaces, bands = {}, {}
    for index, name in enumerate(names):
        mask = (surface == index) & interior
        level = reference["radiance"].values[mask].astype(float).sum(axis=0)
        if not mask.any() or level.sum() <= 0:
            continue
        values = cube["radiance"].values[mask].astype(float).sum(axis=0) - level
        errors = [c["standard_error"].values[mask].astype(float) for c in (cube, reference)]
        sigma = np.sqrt(sum((e**2).sum(axis=0) for e in errors))
        # a path carries all wavelengths, so that their errors are correlated
        summed = np.sqrt(sum((e.sum(axis=-1) ** 2).sum() for e in errors))
        surfaces[name] = float(values.sum() / level.sum()), float(summed / level.sum())
        with np.errstate(divide="ignore", invalid="ignore"):
            bands[name] = np.stack([values / level, sigma / level], axis=1)
    return Judged(
        renderer,
        outcome,
        reference["wavelength"].values,
        surfaces,
        bands,
        noise_of(cube, reference),
        math.nan if run is None else run.cpu_s,
        math.nan if run is None else run.wall_s,
        outcome.relative,
        str(cube.attrs.get(NOTES, "")),
    )


def noise_of(cube: xr.Dataset, reference: xr.Dataset) -> float:
    """Mean of the squared relative standard error of a cube, inside surfaces.

    Parameters
    ----------
    cube
        Cube with ``standard_error``.
    reference
        Cube with ``radiance``, by which errors are divided, and ``surface``.

    Returns
    -------
    float
        The mean over pixels whose neighbours see the same surface, at wavelengths with light.
    """
    surface = reference["surface"].values
    inside = (maximum_filter(surface, 3) == minimum_filter(surface, 3)) & (surface >= 0)
    samples = (reference["radiance"].values > 0) & inside[..., None]
    error = cube["standard_error"].values[samples].astype(float) / reference["radiance"].values[samples]
    return float(np.mean(error**2))


def write_bias_map(path: Path, judged: Judged) -> None:
    """Write the relative difference of each pixel as a PNG, red where the renderer is brighter.

    Parameters
    ----------
    path
        The file; an existing one is replaced.
    judged
        The comparison.
    """
    percent = 100 * judged.relative
    reach = max(float(np.nanpercentile(np.abs(percent), 98)), 1e-3)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(5.4, 4.6), layout="constrained")
        axis = figure.subplots()
        image = axis.imshow(percent, cmap="RdBu_r", vmin=-reach, vmax=reach)
        axis.set(xticks=[], yticks=[])
        axis.set_title(judged.renderer)
        figure.colorbar(image, ax=axis, label="difference to the reference, %")
        with replacing(path) as temporary:
            figure.savefig(temporary, format="png", dpi=110)
