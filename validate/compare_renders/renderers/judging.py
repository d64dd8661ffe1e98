"""What a renderer made of a box, against our own picture: by surface and band, bias map, noise, a named cause."""

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
from cboxlab.rendering.integrators import BATCHES, RenderJob, render
from cboxlab.rendering.model import labelled_cube
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import OwnMappings
from cboxlab.utils.progress import NO_PROGRESS, Progress
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from ...report import STYLE
from ..regress import Outcome, View, regress_pictures, side_of
from .running import Run

__all__ = ["REFERENCE_SAMPLES", "Judged", "judge", "noise_of", "reference_cube", "write_bias_map"]

#: Samples per pixel and batch of our own picture.
REFERENCE_SAMPLES = 512
#: A renderer is right where every surface agrees, or differs by less than this and the error of the difference.
_TELLING = 0.002


@dataclass(frozen=True, eq=False)
class Judged(OwnMappings):
    """One renderer. surfaces : name to relative difference and its standard deviation, over all wavelengths and the
    pixels whose neighbours see the same surface.

    bands : surface to (w, 2) the same by wavelength. variance : mean over these pixels and wavelengths of the squared
    relative standard error. cost : variance times CPU seconds; NaN where the renderer was not run here.
    relative : (y, x) difference over our picture, summed over wavelengths, NaN without light. remark : how the
    renderer's scene, and with it ours, differs from the one asked for; empty where it does not.
    """

    renderer: str
    outcome: Outcome
    wavelength_nm: NDArray[np.float64]
    surfaces: Mapping[str, tuple[float, float]]
    bands: Mapping[str, NDArray[np.float64]]
    variance: float
    cpu_s: float
    wall_s: float
    relative: NDArray[np.float64]
    remark: str = ""

    @property
    def cost(self) -> float:
        """Variance times CPU seconds."""
        return self.variance * self.cpu_s

    @property
    def agreeing(self) -> tuple[str, ...]:
        """Surfaces within 0.2 % of ours, or within two standard deviations."""
        return tuple(n for n, (d, s) in self.surfaces.items() if abs(d) <= max(_TELLING, 2 * s))

    @property
    def sentence(self) -> str:
        """The finding in words."""
        whole = self.outcome.whole
        size = f"mean light {whole.difference:+.3%} ± {whole.sigma:.3%}"
        if self.outcome.same:
            return f"right: {size}, equal within {self.outcome.equivalence_95:.2%} at 95 %"
        named = self.outcome.named[0] if self.outcome.named else None
        if named is None:
            return f"different: {size}"
        values = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in named.parameters.items())
        told = f"{named.change}{f' ({values})' if values else ''}"
        return f"different: {size}; cause: {told}, probability {named.probability:.2f}"

    def to_dict(self) -> dict[str, Any]:
        """All figures, the outcome of the regression among them."""
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
            "cpu_s": _finite(self.cpu_s),
            "wall_s": _finite(self.wall_s),
            "variance_times_cpu_s": _finite(self.cost),
            "regression": self.outcome.to_dict(),
        }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def reference_cube(
    exported: Exported, progress: Progress = NO_PROGRESS, samples: int = REFERENCE_SAMPLES
) -> xr.Dataset:
    """Our own picture of the export's scene, in BATCHES batches of so many samples per pixel."""
    image = render(
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
    run: Run | None = None,
    progress: Progress = NO_PROGRESS,
) -> Judged:
    """cube : what the renderer made. exported : the scene it shows (``as_rendered``). reference : our picture of that.

    run : its times, None where it ran elsewhere.
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
        # a path carries all wavelengths, so that their errors go together
        whole = np.sqrt(sum((e.sum(axis=-1) ** 2).sum() for e in errors))
        surfaces[name] = float(values.sum() / level.sum()), float(whole / level.sum())
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
    """Mean of the squared relative standard error of a cube over the insides of surfaces and lit wavelengths."""
    surface = reference["surface"].values
    inside = (maximum_filter(surface, 3) == minimum_filter(surface, 3)) & (surface >= 0)
    lit = (reference["radiance"].values > 0) & inside[..., None]
    error = cube["standard_error"].values[lit].astype(float) / reference["radiance"].values[lit]
    return float(np.mean(error**2))


def write_bias_map(path: Path, judged: Judged) -> None:
    """A picture (PNG) of the relative difference in each pixel, red where the renderer is brighter."""
    percent = 100 * judged.relative
    reach = max(float(np.nanpercentile(np.abs(percent), 98)), 1e-3)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(5.4, 4.6), layout="constrained")
        axis = figure.subplots()
        shown = axis.imshow(percent, cmap="RdBu_r", vmin=-reach, vmax=reach)
        axis.set(xticks=[], yticks=[])
        axis.set_title(judged.renderer)
        figure.colorbar(shown, ax=axis, label="difference to the reference, %")
        with replacing(path) as temporary:
            figure.savefig(temporary, format="png", dpi=110)
