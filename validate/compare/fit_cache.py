"""Cache of fits of camera and lamp on disk, by a digest of everything that decides them."""

from __future__ import annotations

import logging
from dataclasses import fields, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.rendering.perturbation import Warp
from cboxlab.scenes.camera import Camera
from cboxlab.utils.files import load_checked, store_checked
from numpy.typing import NDArray

from ..predict import digest_of
from .nuisances import NuisanceFit, fit_nuisances

__all__ = ["cached_fit"]

_log = logging.getLogger(__name__)

#: Files in the folder, of a few hundred bytes each; beyond this number the oldest are deleted.
_MAX_FILES = 1000

#: Fields of a camera that a fit changes.
_FITTED_FIELDS = ("position_mm", "rotation", "principal_point_px", "focal_length_px", "k1")


def cached_fit(
    folder: Path | None,
    *,
    measured: NDArray,
    variance: NDArray,
    used: NDArray,
    signal: NDArray,
    warp: Warp,
    calibrated: Camera,
    lamp_sigma: float | None,
    settled: bool = False,
    draft: bool = False,
) -> NuisanceFit:
    """Fit of ``fit_nuisances`` for the same arguments, from the cache if it holds one.

    A cache that cannot be read or written is no fault: the fit is computed again.

    Parameters
    ----------
    folder
        Folder of the cache; None for no cache.
    measured
        (band, y, x) measured signal, DN.
    variance
        (band, y, x) variance of measured minus rendered, DN^2.
    used
        (band, y, x) True for the samples used.
    signal
        (band, y, x) signal rendered through the warp's camera, DN.
    warp
        Warp of the picture.
    calibrated
        Surveyed camera.
    lamp_sigma
        Relative standard deviation of the lamp's power; None if not stated.
    settled
        Whether the warp's camera was fitted before.
    draft
        Whether the fit only gives the camera of the next rendering.

    Returns
    -------
    NuisanceFit
        The fit, the same bits from the cache as computed.
    """
    arguments = (measured, variance, used, signal, warp, calibrated, lamp_sigma)
    if folder is None:
        return fit_nuisances(*arguments, settled=settled, draft=draft)
    code = Path(__file__).with_name("nuisances.py").read_bytes()
    warp_values = [getattr(warp, field.name) for field in fields(warp) if field.name != "tracer"]
    priors = (calibrated, lamp_sigma, settled, draft)
    key = digest_of(code, measured, variance, used, signal, warp.tracer.scene, warp_values, *priors)
    path = folder / f"{key}.fit"
    fit = _read(path, key, warp.camera)
    if fit is None:
        fit = fit_nuisances(*arguments, settled=settled, draft=draft)
        _store(path, key, fit)
    else:
        _log.info("fit of camera and lamp taken from the cache: %s", path)
    return fit


def _read(path: Path, key: str, camera: Camera) -> NuisanceFit | None:
    """The stored fit with other fields of ``camera``; None without a readable one."""
    content = load_checked(path, key)
    if content is None:
        return None
    try:
        with np.load(BytesIO(content)) as file:
            values = {name: file[name] for name in (*_FITTED_FIELDS, "lamp")}
        scale, sigma = values.pop("lamp").tolist()
        changed: dict[str, Any] = {name: value if value.ndim else float(value) for name, value in values.items()}
    except Exception:  # another version's content
        return None
    return NuisanceFit(replace(camera, covariance=None, **changed), scale, sigma)


def _store(path: Path, key: str, fit: NuisanceFit) -> None:
    """Store a fit, and delete the oldest ones beyond the limit."""
    stream = BytesIO()
    values = {name: getattr(fit.camera, name) for name in _FITTED_FIELDS}
    np.savez(stream, lamp=[fit.lamp_scale, fit.lamp_scale_sigma], **values)
    try:
        store_checked(path, key, stream.getvalue())
        entries = sorted(path.parent.glob("*.fit"), key=lambda entry: entry.stat().st_mtime, reverse=True)
        for entry in entries[_MAX_FILES:]:
            entry.unlink(missing_ok=True)
    except OSError:
        return
