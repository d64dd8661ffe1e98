"""A small capture with a veiling glare that the published box lacks, for tests of the study and the workbench."""

import shutil
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture

from .large_patches import large_patches

__all__ = ["GLARE", "glare_capture"]

#: The fraction of light that is spread over the picture.
GLARE = 0.02


def glare_capture(folder: Path, size: int = 32, fraction: float = GLARE, relative_error: float = 0.05) -> Path:
    """Writes the capture into a new folder, which is returned; it is rendered once a process."""
    return shutil.copytree(f"{_written(size, fraction, relative_error).name}/capture", folder)


@cache
def _written(size: int, fraction: float, relative_error: float) -> TemporaryDirectory:
    folder, glare = TemporaryDirectory(), apply_checked("veiling-glare", {"fraction": fraction}, "test")
    model, camera = Model(effects=(glare,)), perturbed_camera(size, 3)
    with large_patches():
        write_model_capture(
            Path(folder.name, "capture"), model, camera, CaptureSettings(), 3, relative_error=relative_error
        )
    return folder
