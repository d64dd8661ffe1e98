"""``cboxlab.validate``: a capture compared with the rendering of a model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
import xarray as xr
from cboxlab.rendering.files import AS_STATED, Declared
from cboxlab.utils.arguments import require_progress, require_type, required_folder, required_path
from cboxlab.utils.progress import NO_PROGRESS, Progress
from cboxlab.utils.table import Table

from ..compare import HEADLINE, Validation, failures, validate_capture
from ..report import chi2_by_place, comparison_figure, named_bands, report_verdict, validation_record, write_validation
from ..report.viewer import viewer_data, viewer_fragment
from .calibration import suspicion_lines
from .inputs import CaptureLike, ModelLike, as_capture, as_model
from .result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ValidationResult", "validate"]

#: Largest number of places listed where the model fails: more are in the report.
MAX_FAILURES = 5


@dataclass(frozen=True, eq=False, repr=False)
class ValidationResult(Result):
    """A capture compared with the rendering of a model."""

    #: Calibration, rendering, fitted camera and lamp, and comparison as objects.
    validation: Validation

    def to_dict(self) -> dict[str, Any]:
        """Content of metrics.json (docs/metrics.md).

        Returns
        -------
        dict
            Chi-square, colour differences and relative differences, by band and by surface.
        """
        return validation_record(self.validation)

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write report.html, metrics.json and the maps (EXR).

        Parameters
        ----------
        folder
            Folder of the files.

        Returns
        -------
        tuple of Path
            report.html first.
        """
        return write_validation(self.validation, required_folder("folder", folder))

    def lines(self) -> list[str]:
        """Verdict, main figures, suspicions, and the places where the model fails most.

        Returns
        -------
        list of str
            The sentences.
        """
        result, c = self.validation, self.validation.comparison
        manifest = result.prepared.calibration.capture.manifest
        name = manifest.name or result.prepared.calibration.capture.folder.name
        ranked = failures(result)[1][:MAX_FAILURES]
        scale = result.prepared.free_scale
        lamp = f"lamp power × {result.fit.lamp_scale:.4f}, " if scale is None or scale.absolute else ""
        return [
            f"{name} against {result.model.name}: {report_verdict(c).headline}",
            f"χ² per degree of freedom {c.chi2.per_dof:.3f} ({chi2_by_place(c)}), mean {HEADLINE.label} "
            f"{c.colour[HEADLINE.id].mean:.2f} (noise alone {c.colour_noise[HEADLINE.id].mean:.2f}), "
            f"rendering noise over sensor noise {c.render_sigma_over_sensor_sigma:.2f}, "
            f"{lamp}took {result.seconds:.0f} s",
            *result.prepared.unknown_sentences,
            *suspicion_lines(result.prepared.calibration),
            *(f"{rank}. {failure.sentence}" for rank, failure in enumerate(ranked, 1)),
        ]

    def tables(self) -> list[Table]:
        """Relative differences of surfaces by band.

        Returns
        -------
        list of Table
            One table; a dash stands for a surface without interior pixels.
        """
        comparison = self.validation.comparison
        bands = named_bands(comparison.bands, self.validation.prepared.responses)
        rows = tuple(
            (
                name,
                *(_cell(100 * row.relative[index], "+.2f") for index, _ in bands),
                _cell(row.colour[HEADLINE.id], ".2f"),
                _cell(row.chi2.per_dof, ".2f"),
            )
            for name, row in comparison.by_surface.items()
        )
        columns = ("surface", *(label.removesuffix(" nm") for _, label in bands), HEADLINE.label, "χ²/dof")
        folder = self.validation.prepared.calibration.capture.folder.name
        return [Table(f"{folder}: (photograph − rendering) / rendering, interiors, %; bands in nm", columns, rows)]

    @cached_property
    def maps(self) -> xr.Dataset:
        """Images of the comparison, with a wavelength for each band.

        Dataset over (band, y, x), bands in the order of wavelength: ``measured`` and ``rendered`` signals (DN, lamp
        scale included), ``difference`` (DN), ``sigma`` (DN) and ``residual`` (difference over sigma). Pixels that are
        not used are NaN in difference and residual. The coordinate ``wavelength`` is the effective one, nm.
        """
        prepared, rendered = self.validation.prepared, self.validation.rendered
        nm = {r.band: float(np.sum(r.weights * r.wavelength_nm) / np.sum(r.weights)) for r in prepared.responses}
        order = np.argsort([nm[response.band] for response in prepared.responses])
        signal = rendered.fit.lamp_scale * rendered.signal
        variance = prepared.calibration.predicted_variance(signal) + rendered.fit.lamp_scale**2 * rendered.variance
        difference = np.where(rendered.used, prepared.measured - signal, np.nan)
        images = {
            "measured": (prepared.measured, "DN"),
            "rendered": (signal, "DN"),
            "difference": (difference, "DN"),
            "sigma": (np.sqrt(variance), "DN"),
            "residual": (difference / np.sqrt(variance), "1"),
        }
        names = [prepared.responses[index].band for index in order]
        return xr.Dataset(
            {key: (("band", "y", "x"), values[order], {"units": unit}) for key, (values, unit) in images.items()},
            {"band": names, "wavelength": ("band", [nm[name] for name in names], {"units": "nm"})},
        )

    def plot(self) -> Figure:
        """Figure of the difference over its standard deviation, by band.

        Returns
        -------
        Figure
            ``figure("difference")``, which a notebook shows.
        """
        return self.figure("difference")

    def figure(self, what: str = "difference") -> Figure:
        """Figure for a publication, with units and in colours for all colour vision.

        Parameters
        ----------
        what
            "difference" (over sigma, by band), "relative" (%, by band), "photograph", "rendering" (DN, by band, on one
            scale), "colour" (ΔE), "luminance" (%), "residuals" (distribution), or "surfaces" (means by band).

        Returns
        -------
        Figure
            Matplotlib figure, ready for ``savefig``.

        Raises
        ------
        InputError
            For another name.
        """
        comparison = self.validation.comparison
        return comparison_figure(comparison, named_bands(comparison.bands, self.validation.prepared.responses), what)

    def _repr_html_(self) -> str:
        """Lines, table, and the viewer of photograph and rendering, for notebooks."""
        return super()._repr_html_() + viewer_fragment(viewer_data(self.validation), f"viewer-{uuid4().hex}")


def _cell(value: float, form: str) -> str:
    """The formatted value; a dash for NaN."""
    return f"{value:{form}}" if math.isfinite(value) else "–"


def validate(
    capture: CaptureLike,
    *,
    model: ModelLike = None,
    render: str | Path | None = None,
    noise: float | None = None,
    seed: int | None = None,
    cache: str | Path | None = None,
    declared: Declared = AS_STATED,
    progress: Progress = NO_PROGRESS,
) -> ValidationResult:
    """Calibrate a capture, render a model through its camera, compare.

    Parameters
    ----------
    capture
        A capture, or its folder.
    model
        A model, a scene, a model file, a scene file, or the name of a packaged scene. None for the box that the capture
        states, or the published one.
    render
        Spectral cube of another renderer (.nc, .exr, .hdr), in place of our rendering.
    noise
        Noise of the rendering, in place of the model's: median over the pixels of the rendering's standard deviation
        over the sensor's. The model's is 0.3 by default.
    seed
        Seed of the rendering, in place of the model's.
    cache
        Folder that keeps renderings for later calls; None keeps nothing.
    declared
        Units and wavelengths of ``render`` that its file does not state.
    progress
        Receiver of stages and of the completed share.

    Returns
    -------
    ValidationResult
        Verdict, chi-square, colour differences and maps.

    Raises
    ------
    InputError
        If an input is faulty, or the capture lacks data that a comparison with a rendering needs.

    Examples
    --------
    >>> validation = cboxlab.validate("capture", model="cornell-box")  # doctest: +SKIP
    >>> print(validation)  # doctest: +SKIP
    """
    loaded = as_capture(capture)
    checked_model = as_model(model, [loaded], noise=noise, seed=seed)
    require_progress(progress)
    require_type("declared", declared, Declared, "a Declared")
    cube = None if render is None else required_path("render", render, "a spectral cube (.nc, .exr, .hdr)")
    folder = None if cache is None else required_folder("cache", cache)
    return ValidationResult(validate_capture(loaded, checked_model, progress, cube, folder, declared))
