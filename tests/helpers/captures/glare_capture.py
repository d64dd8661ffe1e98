"""A small capture with a veiling glare that the published box lacks, for tests of the study and the workbench."""

from pathlib import Path

from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.model import Model
from cboxlab.rendering.synthetic import CaptureSettings
from cboxlab.validation.synthetic import perturbed_camera, write_model_capture

__all__ = ["GLARE", "glare_capture"]

#: The fraction of light that is spread over the picture.
GLARE = 0.02


def glare_capture(folder: Path, size: int = 32) -> Path:
    """Writes the capture into a new folder, which is returned."""
    glare = apply_checked("veiling-glare", {"fraction": GLARE}, "test")
    camera = perturbed_camera(size, 3)
    write_model_capture(folder, Model(effects=(glare,)), camera, CaptureSettings(), 3, relative_error=0.05)
    return folder
