"""Views of a chessboard through exact rays, and a capture of them in which one is wrong."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile
from cboxlab.scenes.camera import Camera
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT, PITCH_MM = 320, 240, 20.0
FOCAL_LENGTH_PX, PRINCIPAL_POINT_PX, K1 = 420.0, np.array([163.0, 117.5]), -0.08
INTRINSICS = np.array([FOCAL_LENGTH_PX, *PRINCIPAL_POINT_PX, K1])
Tilt = tuple[float, float, float]
TILTS_DEG: list[Tilt] = [(30, 0, 5), (-30, 10, -10), (5, 35, 20), (-10, -35, 0), (25, 25, 50)]

Pattern = Callable[[np.ndarray, np.ndarray], np.ndarray]


def camera_before(centre_mm: np.ndarray, tilt_deg: Tilt, distance_mm: float) -> Camera:
    """A camera whose axis meets the target's centre; the target lies in z = 0."""
    rotation = Rotation.from_euler("xyz", tilt_deg, degrees=True).as_matrix()
    position = centre_mm - rotation.T @ np.array([0.0, 0.0, distance_mm])
    return Camera(WIDTH, HEIGHT, FOCAL_LENGTH_PX, PRINCIPAL_POINT_PX, K1, rotation, position)


def photograph(camera: Camera, pattern: Pattern, rng: np.random.Generator, samples: int = 4) -> np.ndarray:
    """The pattern seen through samples^2 exact rays per pixel, shaded, with noise, in DN."""
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    total = np.zeros((camera.height_px, camera.width_px))
    v, u = np.mgrid[: camera.height_px, : camera.width_px]
    for du in offsets:
        for dv in offsets:
            direction = camera.directions(u + du, v + dv)
            point = camera.position_mm - direction * (camera.position_mm[2] / direction[..., 2:])
            total += pattern(point[..., 0], point[..., 1])
    shading = 1 + 0.2 * (u / camera.width_px - 0.5) - 0.2 * (v / camera.height_px - 0.5)
    image = 3000 * shading * total / samples**2
    return image + rng.normal(0, 30, image.shape)


def chessboard(rows: int, columns: int) -> Pattern:
    def reflectance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        i, j = np.floor(x / PITCH_MM + 1).astype(int), np.floor(y / PITCH_MM + 1).astype(int)
        board = (i >= 0) & (i <= columns) & (j >= 0) & (j <= rows)
        return np.where(board & ((i + j) % 2 == 0), 0.05, 0.8)

    return reflectance


def centre(rows: int, columns: int) -> np.ndarray:
    return PITCH_MM * np.array([(columns - 1) / 2, (rows - 1) / 2, 0.0])


def board_capture(folder: Path) -> Path:
    """A capture with five views of a chessboard; the board of the third one is 10 % wider than stated."""
    rng = np.random.default_rng(7)
    names = [f"target-{index}.tif" for index in range(len(TILTS_DEG))]
    board = chessboard(5, 7)
    for index, tilt in enumerate(TILTS_DEG):
        wide = 1.1 if index == 2 else 1.0
        camera = camera_before(centre(5, 7) * [wide, 1, 1], tilt, 42.0 * 8)
        image = photograph(camera, lambda x, y, wide=wide: board(x / wide, y), rng)
        tifffile.imwrite(folder / names[index], np.clip(np.rint(image), 0, 4095).astype(np.uint16))
    tifffile.imwrite(folder / "scene.tif", np.full((HEIGHT, WIDTH), 1000, np.uint16))
    (folder / "capture.toml").write_text(
        f"""
format = "capture/1"

[camera]
width_px = {WIDTH}
height_px = {HEIGHT}
bit_depth = 12

[[band]]
id = "f550"
exposure_s = 1.0
frames = ["scene.tif"]

[[target]]
kind = "chessboard"
rows = 5
columns = 7
pitch_mm = {PITCH_MM}
frames = {names}
"""
    )
    return folder
