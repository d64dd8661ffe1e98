"""Picture of the camera fit: surveyed points, residuals and edges over the photograph."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cboxlab.scenes import Scene
from cboxlab.scenes.camera import Camera
from numpy.typing import NDArray

from ..geometry import CameraFit, SurveyedPoints

__all__ = ["plot_geometry", "wireframe"]

#: Pieces into which an edge is divided, since distortion curves it.
_PIECES = 24
#: Faces whose normals have a larger cosine than this are coplanar.
_FLAT_COSINE = 0.999


def wireframe(scene: Scene) -> NDArray[np.float64]:
    """Edges of all surfaces and of the lamps, without diagonals inside flat faces.

    Parameters
    ----------
    scene
        Model of the box.

    Returns
    -------
    NDArray
        (n, 2, 3) end points of the edges, mm; those of the lamps are the last.
    """
    edges = []
    for surface in scene.all_surfaces:
        vertices = surface.vertices_mm
        normals = np.cross(
            vertices[surface.faces[:, 1]] - vertices[surface.faces[:, 0]],
            vertices[surface.faces[:, 2]] - vertices[surface.faces[:, 0]],
        )
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        owners: dict[tuple[bytes, bytes], list[int]] = {}
        ends: dict[tuple[bytes, bytes], NDArray[np.float64]] = {}
        for index, face in enumerate(surface.faces):
            for begin, end in ((0, 1), (1, 2), (2, 0)):
                pair = vertices[[face[begin], face[end]]]
                # Compare positions, not indices: meshes may repeat vertices.
                first, second = sorted(np.round(p, 3).tobytes() for p in pair)
                owners.setdefault((first, second), []).append(index)
                ends[first, second] = pair
        for key, faces in owners.items():
            if len(faces) == 1 or abs(float(normals[faces[0]] @ normals[faces[1]])) < _FLAT_COSINE:
                edges.append(ends[key])
    return np.stack(edges)


def _projected(camera: Camera, edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, pieces + 1, 2) px, subdivided, since distortion curves straight edges."""
    share = np.linspace(0, 1, _PIECES + 1)[None, :, None]
    points = edges[:, :1] * (1 - share) + edges[:, 1:] * share
    return camera.project(points.reshape(-1, 3)).reshape(len(edges), -1, 2)


def plot_geometry(
    photograph: NDArray[np.float64],
    points: SurveyedPoints,
    fit: CameraFit,
    camera: Camera,
    scene: Scene | None,
    path: Path,
) -> None:
    """Write the picture of the camera fit.

    Parameters
    ----------
    photograph
        (y, x) photograph in any unit.
    points
        Surveyed points.
    fit
        Camera fit with the selection of points.
    camera
        Camera that projects points and edges.
    scene
        Model of the box; None draws no edges.
    path
        File to write (PNG).
    """
    residuals = points.image_px - camera.project(points.points_mm)
    length = float(np.median(np.linalg.norm(residuals[fit.in_use], axis=1)))
    # The enlargement is a round number; a typical residual is about a fortieth of the picture.
    enlarged = float(f"{photograph.shape[1] / 40 / max(length, 1e-6):.1g}")
    from matplotlib.collections import LineCollection  # slow to import, and only needed here
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 8 * photograph.shape[0] / photograph.shape[1] + 0.5), layout="constrained")
    axes = figure.subplots()
    low, high = np.nanpercentile(photograph, [1, 99])
    axes.imshow(photograph, cmap="gray", vmin=low, vmax=max(high, low + 1e-12))
    if scene is not None:
        lines = LineCollection(list(_projected(camera, wireframe(scene))), colors="tab:cyan", linewidths=0.8)
        axes.add_collection(lines)
    for selected, colour, label in ((fit.in_use, "yellow", "used"), (~fit.in_use, "red", "outliers")):
        if not np.any(selected):
            continue
        u, v = points.image_px[selected].T
        axes.plot(u, v, "o", mfc="none", mec=colour, ms=5, label=label)
        du, dv = residuals[selected].T
        axes.quiver(u, v, du, dv, color=colour, angles="xy", scale_units="xy", scale=1 / enlarged, width=0.003)
    axes.set(
        title=f"Surveyed points, residuals x {enlarged:g}: rms {fit.reprojection_rms_px:.3f} px per coordinate",
        xlabel="u (px)",
        ylabel="v (px)",
        xlim=(-0.5, photograph.shape[1] - 0.5),
        ylim=(photograph.shape[0] - 0.5, -0.5),
    )
    axes.legend(fontsize="small", loc="lower left")
    figure.savefig(path, dpi=110, metadata={"Software": None})
