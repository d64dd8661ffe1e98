"""Causes of a difference, each as data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from cboxlab.rendering.perturbation import PatchLight
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.scene import Scene
from numpy.typing import NDArray

__all__ = ["Cause", "Pictures", "SceneLight", "Trial", "fixed_values"]


class SceneLight(Protocol):
    """Rendering of the scene that the pictures show, prepared for changes."""

    @property
    def scene(self) -> Scene:
        """The scene."""

    @property
    def camera(self) -> Camera:
        """The camera."""

    @property
    def light(self) -> PatchLight:
        """Light of the scene."""

    @property
    def picture(self) -> NDArray[np.float64]:
        """(c, y, x) radiance over the lamp's."""

    @property
    def surface_index(self) -> NDArray[np.int64]:
        """(y, x) index of the surface that each pixel shows; negative for the lamp and outside."""

    def ratio(self, picture: NDArray[np.float64]) -> NDArray[np.float64]:
        """(y, x, w) another rendering over that of the scene.

        Parameters
        ----------
        picture
            (c, y, x) the other rendering, radiance over the lamp's.

        Returns
        -------
        NDArray
            (y, x, w) ratio of the radiances.
        """

    def rebuilt(self, scene: Scene) -> SceneLight:
        """Rendering of another scene through the same camera.

        Parameters
        ----------
        scene
            The other scene.

        Returns
        -------
        SceneLight
            The rendering, prepared for changes.
        """


@dataclass(frozen=True, eq=False)
class Pictures:
    """Pictures that a cause has to explain."""

    #: (y, x, w) baseline without outliers.
    baseline: NDArray[np.float64]
    #: (y, x, w) candidate without outliers.
    candidate: NDArray[np.float64]
    #: (b, y, x, w) pictures of each file: those of the baseline, those of the candidate.
    files: tuple[NDArray[np.float64], NDArray[np.float64]]
    #: (w,) wavelengths, nm; None in colour.
    wavelength_nm: NDArray[np.float64] | None
    #: (y, x) variance of the difference, summed over wavelengths.
    variance: NDArray[np.float64]
    #: Camera that a file or the user states; None without one.
    camera: Camera | None
    #: Rendering of the scene; None where it is unknown.
    scene: SceneLight | None
    #: Function of templates and a fixed change that fits amplitudes.
    fit: Callable[[Sequence[NDArray[np.float64]], NDArray[np.float64] | None], NDArray[np.float64]]
    #: Function of the same arguments that states the chi-square that the fit leaves.
    chi2: Callable[[Sequence[NDArray[np.float64]], NDArray[np.float64] | None], float]

    def change(self, picture: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change of the baseline where the scene's rendering becomes another.

        Parameters
        ----------
        picture
            (c, y, x) the other rendering, radiance over the lamp's.

        Returns
        -------
        NDArray
            (y, x, w) change of the radiance.

        Raises
        ------
        ValueError
            If the scene is unknown.
        """
        if self.scene is None:
            raise ValueError("the scene is unknown")
        return self.baseline * (self.scene.ratio(picture) - 1)

    def across(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Coordinates of the pixels.

        Returns
        -------
        x, y : NDArray
            (y, x) distances from the picture's centre over half its width.
        """
        height, width = self.baseline.shape[:2]
        y, x = np.indices((height, width), float)
        half = max(width - 1, 1) / 2
        return (x - (width - 1) / 2) / half, (y - (height - 1) / 2) / half


@dataclass(frozen=True, eq=False)
class Trial:
    """One change that a cause may have made: a fixed part, and templates with free amplitudes."""

    #: Function that states the parameters for amplitudes, or None where they are not possible.
    parameters: Callable[[NDArray[np.float64]], Mapping[str, Any] | None]
    #: (y, x, w) changes of amplitude 1.
    templates: tuple[NDArray[np.float64], ...] = ()
    #: (y, x, w) change without a free number; None without one.
    fixed: NDArray[np.float64] | None = None
    #: Count of numbers that were fitted or selected before.
    selected: int = 0


def fixed_values(values: Mapping[str, Any]) -> Callable[[NDArray[np.float64]], Mapping[str, Any]]:
    """Parameters that depend on no amplitude.

    Parameters
    ----------
    values
        The parameters.

    Returns
    -------
    Callable
        Function of amplitudes for ``Trial``.
    """
    return lambda amplitudes: values


@dataclass(frozen=True)
class Cause:
    """Something that renderers do to a picture."""

    #: Identifier, which names the change.
    id: str
    #: Cause in one sentence.
    summary: str
    #: Function of the pictures that yields trials.
    trials: Callable[[Pictures], Iterator[Trial]]
    #: Whether it needs a rendering of the scene.
    needs_scene: bool = False
    #: Whether it is tried only where nothing of fewer parameters fits, since it renders the scene many times.
    costly: bool = False
    #: Part of the change's chi-square that the error of its shape leaves in cells.
    shape_error: float = 0.01
    #: The same in single pixels.
    edge_error: float = 0.1
    #: Whether it is a factor on each pixel, the same in all bands, whose shape is exact.
    is_factor: bool = False
