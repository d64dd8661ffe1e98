"""The scene: surfaces, materials, spectra, the lamp, the camera's geometry, scene files."""

from cboxlab.utils.errors import InputError

from .camera import Camera
from .cornell_box import cornell_box, cornell_camera
from .scene import Lamp, Material, Medium, Scene, Surface, Texture
from .scene_file import load_scene
from .spectra import Spectrum, read_spectra, read_spectrum

__all__ = [
    "Camera",
    "InputError",
    "Lamp",
    "Material",
    "Medium",
    "Scene",
    "Spectrum",
    "Surface",
    "Texture",
    "cornell_box",
    "cornell_camera",
    "load_scene",
    "read_spectra",
    "read_spectrum",
]
