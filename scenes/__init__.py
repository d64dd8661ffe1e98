"""The scene: surfaces, materials, spectra, the lamp, the camera's geometry, scene files."""

from cboxlab.utils.errors import InputError

from .camera import Camera
from .cornell_box import cornell_box, cornell_camera
from .named_cameras import NAMED_CAMERA, camera_columns, camera_names, named_camera_channel
from .physical_limits import PHYSICAL_LIMITS, numbers_of, within_limits
from .scene import Lamp, Material, Medium, Scene, Surface, Texture
from .scene_file import load_scene
from .spectra import Spectrum, read_spectra, read_spectrum

__all__ = [
    "NAMED_CAMERA",
    "PHYSICAL_LIMITS",
    "Camera",
    "InputError",
    "Lamp",
    "Material",
    "Medium",
    "Scene",
    "Spectrum",
    "Surface",
    "Texture",
    "camera_columns",
    "camera_names",
    "cornell_box",
    "cornell_camera",
    "load_scene",
    "named_camera_channel",
    "numbers_of",
    "read_spectra",
    "read_spectrum",
    "within_limits",
]
