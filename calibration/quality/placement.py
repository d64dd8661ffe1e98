"""The photographs against a rough picture of a known scene from where the surveyed points put the camera."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..capture import Capture
from ..radiometry import register
from .bands import SceneView
from .suspicion import Suspicion

__all__ = ["check_orientation", "check_survey"]

#: Shift of the photograph's edges against the points' camera, px and relative to the width. The rough picture has no
#: shadows, which moves it by up to 0.5 px; a camera that was moved by as much as the catalogue's strong effects stays
#: below, too.
_SHIFT_PX, _SHIFT_SHARE = 1.2, 0.006

#: Largest difference of the magnification from 1.
_MAGNIFIED = 0.03

_TURNS = {
    "mirrored left to right": lambda image: image[..., ::-1],
    "upside down": lambda image: image[..., ::-1, :],
    "turned by 180 degrees": lambda image: image[..., ::-1, ::-1],
    "exchanged in rows and columns": lambda image: np.swapaxes(image, -1, -2),
    "turned by 90 degrees": lambda image: np.rot90(image, 1, (-2, -1)),
    "turned by 270 degrees": lambda image: np.rot90(image, 3, (-2, -1)),
    "exchanged about the other diagonal": lambda image: np.swapaxes(image[..., ::-1, ::-1], -1, -2),
}


def check_orientation(capture: Capture, view: SceneView | None) -> Iterator[Suspicion]:
    """The photographs, as they lie and in seven other ways, against a rough picture of the scene."""
    if view is None:
        return
    rough, seen = _rough(view)
    if np.count_nonzero(seen) < 100:
        return
    rough = np.log(rough)

    def agreement(pictures: NDArray[np.float64]) -> NDArray[np.float64]:
        with np.errstate(invalid="ignore"):
            logarithm = np.log(np.where(pictures > 0, pictures, np.nan))
        found = []
        for one, other in zip(logarithm, rough, strict=True):
            good = seen & np.isfinite(one)
            found.append(float(np.corrcoef(one[good], other[good])[0, 1]) if np.count_nonzero(good) > 50 else np.nan)
        return np.array(found)

    here = agreement(view.relative)
    turned = {
        how: agreement(turn(view.relative))
        for how, turn in _TURNS.items()
        if turn(view.relative).shape == view.relative.shape
    }
    how = max(turned, key=lambda h: float(np.nanmean(turned[h])))
    best, as_is = float(np.nanmean(turned[how])), float(np.nanmean(here))
    if best > as_is + 0.08 and best > 0.4:
        yield Suspicion(
            f"the photographs are {how} against the surveyed points",
            "band.frames, geometry.points",
            f"The picture that the points' camera would see agrees with the frames by a correlation of {as_is:.2f} as "
            f"they lie, of {best:.2f} when they are {how}.",
        )
        return
    for index, band in enumerate(capture.band_ids):
        for how, values in turned.items():
            if values[index] > here[index] + 0.15 and values[index] > 0.4:
                yield Suspicion(
                    f"the photograph of {band} is {how}",
                    f"band[{index}] ({band}).frames",
                    f"It agrees with the scene by a correlation of {here[index]:.2f} as it lies, of "
                    f"{values[index]:.2f} when it is {how}.",
                )
                break


def _rough(view: SceneView) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(band, y, x) what the bands would see of direct and ambient light, relative, and (y, x) where anything is."""
    surface, direct = view.sight.surface, view.sight.direct
    seen = (surface >= 0) & (surface < len(view.scene.surfaces))
    ambient = 0.5 * float(np.median(direct[seen])) if np.any(seen) else 1.0
    reflectance = view.reflectance[np.where(seen, surface, 0)].transpose(2, 0, 1)
    return reflectance * (direct + ambient), seen


def check_survey(capture: Capture, view: SceneView | None) -> Iterator[Suspicion]:
    """The photograph moved against what the points' camera would see: points of another capture."""
    if view is None or min(capture.shape) < 48:
        return
    rough, seen = _rough(view)
    if np.mean(seen) < 0.5:
        return
    with np.errstate(invalid="ignore"):
        scale = np.nanpercentile(view.relative, 99, axis=(1, 2))[:, None, None]
        parts = view.relative / scale
        photograph = np.nansum(parts, axis=0) / np.maximum(np.isfinite(parts).sum(axis=0), 1)
        photograph[~np.any(np.isfinite(parts), axis=0)] = 1.0
    picture = (rough / np.percentile(rough[:, seen], 99, axis=1)[:, None, None]).mean(axis=0)
    picture = np.where(seen, np.minimum(picture, 1.0), 1.0)
    found = register(picture, np.minimum(photograph, 1.0))
    if not found.found or found.correlation < 0.6:
        return
    if abs(found.magnification - 1) > _MAGNIFIED:
        yield Suspicion(
            "the photographs were cropped and enlarged, or the points are those of another focal length",
            "band.frames, geometry.points",
            f"The photographs are {found.magnification:.3f} times as large as what the points' camera sees.",
        )
    u, v = found.shift_px * view.sight.step
    limit = max(_SHIFT_PX, _SHIFT_SHARE * capture.shape[1])
    if np.hypot(u, v) > limit:
        yield Suspicion(
            "the points are those of another capture, or the camera was moved far after the survey",
            "geometry.points",
            f"The edges in the photographs lie ({u:+.1f}, {v:+.1f}) px from where the points' camera sees them; below "
            f"{limit:.1f} px is expected.",
        )
