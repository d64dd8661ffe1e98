"""Fits of camera and lamp kept from run to run, found again by everything that they were made from."""

from __future__ import annotations

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

__all__ = ["kept_fit"]

#: Files of a few hundred bytes; the oldest beyond so many go.
_MOST_KEPT = 1000

#: What a fit changes of a camera.
_FITTED = ("position_mm", "rotation", "principal_point_px", "focal_length_px", "k1")


def kept_fit(
    folder: Path | None,
    *,
    measured: NDArray,
    variance: NDArray,
    used: NDArray,
    signal: NDArray,
    warp: Warp,
    calibrated: Camera,
    lamp_sigma: float | None,
) -> NuisanceFit:
    """What ``fit_nuisances`` makes of the same arguments, to the bit: kept in ``folder`` from before, or made and kept.

    folder : None keeps nothing. A file that cannot be read or written is no fault: the fit is made anew.
    """
    arguments = (measured, variance, used, signal, warp, calibrated, lamp_sigma)
    if folder is None:
        return fit_nuisances(*arguments)
    code = Path(__file__).with_name("nuisances.py").read_bytes()
    known = [getattr(warp, field.name) for field in fields(warp) if field.name != "tracer"]
    key = digest_of(code, measured, variance, used, signal, warp.tracer.scene, known, calibrated, lamp_sigma)
    path = folder / f"{key}.fit"
    found = _read(path, key, warp.camera)
    if found is None:
        found = fit_nuisances(*arguments)
        _keep(path, key, found)
    return found


def _read(path: Path, key: str, camera: Camera) -> NuisanceFit | None:
    content = load_checked(path, key)
    if content is None:
        return None
    try:
        with np.load(BytesIO(content)) as file:
            values = {name: file[name] for name in (*_FITTED, "lamp")}
        scale, sigma = values.pop("lamp").tolist()
        changed: dict[str, Any] = {name: value if value.ndim else float(value) for name, value in values.items()}
    except Exception:  # another version's content
        return None
    return NuisanceFit(replace(camera, covariance=None, **changed), scale, sigma)


def _keep(path: Path, key: str, fit: NuisanceFit) -> None:
    stream = BytesIO()
    values = {name: getattr(fit.camera, name) for name in _FITTED}
    np.savez(stream, lamp=[fit.lamp_scale, fit.lamp_scale_sigma], **values)
    try:
        store_checked(path, key, stream.getvalue())
        there = sorted(path.parent.glob("*.fit"), key=lambda one: one.stat().st_mtime, reverse=True)
        for old in there[_MOST_KEPT:]:
            old.unlink(missing_ok=True)
    except OSError:
        return
