"""Ray casting, visibility, and the coverage of pixels by surfaces."""

from .flat_faces import FlatFaces
from .form_factor import point_to_polygon
from .pinhole import Film, film_for, resampling
from .planar_pixels import PlanarPixels, planar_pixels
from .primary import border_pixels, facet_coverage, pixel_coverage, pixel_faces
from .seen_lamps import part_of_lamps
from .square_faces import MARGIN_PX, RAYS_ACROSS, FaceLight, faces_around, light_around
from .tracer import (
    RAY_OFFSET_MM,
    Hit,
    Tracer,
    build_tracer,
    facets,
    intersect,
    normal_and_material,
    pixel_rays,
    visible,
)

__all__ = [
    "MARGIN_PX",
    "RAYS_ACROSS",
    "RAY_OFFSET_MM",
    "FaceLight",
    "Film",
    "FlatFaces",
    "Hit",
    "PlanarPixels",
    "Tracer",
    "border_pixels",
    "build_tracer",
    "faces_around",
    "facet_coverage",
    "facets",
    "film_for",
    "intersect",
    "light_around",
    "normal_and_material",
    "part_of_lamps",
    "pixel_coverage",
    "pixel_faces",
    "pixel_rays",
    "planar_pixels",
    "point_to_polygon",
    "resampling",
    "visible",
]
