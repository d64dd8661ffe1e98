"""Blender's Cycles by a Python script, three wavelengths a run as red, green and blue.

Cycles' defaults are made for pictures: weak lights are left out, samples are clamped, sampling stops early, pixels are
filtered and denoised. All of these are off. Values go into the scene's linear space as they are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..neutral import Exported, channel_groups, exr_radiance, mesh_path
from .renderer import PYTHON_SCRIPT, Renderer

__all__ = ["RENDERER"]

#: Most bounces that Cycles takes; roulette ends paths long before.
_MAX_BOUNCES = 1024
#: Wavelengths of a scene: red, green and blue.
_CHANNELS = 3
#: Length of Blender's unit, mm: the box is some units wide, as Cycles' offsets of rays expect.
_UNIT_MM = 100.0
#: Width of Blender's sensor, mm; any one gives the same rays with a focal length in proportion.
_SENSOR_MM = 36.0

_SCRIPT = '''#!/usr/bin/env python3
"""Renders the batches that are missing: python run.py. Needs the package bpy (Blender as a Python module)."""

from pathlib import Path

import bpy
from mathutils import Matrix

FOLDER = Path(__file__).resolve().parent
BATCHES, SAMPLES, COLUMNS, ROWS, BOUNCES = @NUMBERS@
UNIT_MM = @UNIT@
LENS_MM, SHIFT_X, SHIFT_Y = @LENS@
CAMERA = Matrix(@CAMERA@)
GROUPS = [  # reflectance by material; radiance and reflectance by lamp
@GROUPS@
]
SURFACES = [  # name, mesh, material
@SURFACES@
]
LAMPS = [  # name, mesh
@LAMPS@
]


def corners_and_faces(path):
    head, _, body = (FOLDER.parent / path).read_text().partition("end_header")
    words, lines = head.split(), body.strip().splitlines()
    corners, faces = (int(words[words.index(kind) + 1]) for kind in ("vertex", "face"))
    points = [[float(number) / UNIT_MM for number in line.split()[:3]] for line in lines[:corners]]
    return points, [[int(number) for number in line.split()[1:4]] for line in lines[corners : corners + faces]]


def material(name, reflectance, radiance=None):
    """Lambertian front, black back."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    front = nodes.new("ShaderNodeBsdfDiffuse")
    front.inputs["Color"].default_value = (*reflectance, 1.0)
    front.inputs["Roughness"].default_value = 0.0
    if radiance is not None:
        light, both = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeAddShader")
        largest = max(radiance)
        light.inputs["Color"].default_value = (*(value / largest for value in radiance), 1.0)
        light.inputs["Strength"].default_value = largest
        links.new(front.outputs[0], both.inputs[0])
        links.new(light.outputs[0], both.inputs[1])
        front = both
        made.cycles.emission_sampling = "FRONT"
    back, side = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeNewGeometry")
    mix = nodes.new("ShaderNodeMixShader")
    back.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    links.new(side.outputs["Backfacing"], mix.inputs["Fac"])
    links.new(front.outputs[0], mix.inputs[1])
    links.new(back.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return made


def build(paints, lights):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    materials = {name: material(name, values) for name, values in paints.items()}
    shapes = [(name, path, materials[paint]) for name, path, paint in SURFACES]
    shapes += [(name, path, material(name, *reversed(lights[name]))) for name, path in LAMPS]
    for name, path, surface in shapes:
        mesh = bpy.data.meshes.new(name)
        points, faces = corners_and_faces(path)
        mesh.from_pydata(points, [], faces)
        mesh.materials.append(surface)
        scene.collection.objects.link(bpy.data.objects.new(name, mesh))
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit, camera.sensor_width, camera.lens = "HORIZONTAL", @SENSOR@, LENS_MM
    camera.shift_x, camera.shift_y = SHIFT_X, SHIFT_Y
    camera.clip_start, camera.clip_end = 0.1 / UNIT_MM, 1e6 / UNIT_MM
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world = CAMERA
    settings(scene)
    return scene


def settings(scene):
    """All that biases a picture is off."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = COLUMNS, ROWS, 100
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode, render.image_settings.exr_codec = "RGB", "ZIP"
    render.dither_intensity = 0.0
    render.use_compositing = render.use_sequencer = False
    cycles.device, cycles.samples, cycles.use_adaptive_sampling = "CPU", SAMPLES, False
    cycles.use_denoising, cycles.light_sampling_threshold = False, 0.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    cycles.max_bounces = cycles.diffuse_bounces = BOUNCES
    cycles.pixel_filter_type, cycles.filter_width, cycles.film_exposure = "BOX", 1.0, 1.0
    scene.world = bpy.data.worlds.new("black")
    scene.world.use_nodes = False
    scene.world.color = (0.0, 0.0, 0.0)


(FOLDER / "out").mkdir(exist_ok=True)
for group, (paints, lights) in enumerate(GROUPS):
    for batch in range(BATCHES):
        out = FOLDER / "out" / f"batch-{batch}-group-{group}.exr"
        if out.exists():
            continue
        scene = build(paints, lights)
        scene.cycles.seed = 1 + batch + BATCHES * group
        part = out.with_suffix(".part.exr")
        scene.render.filepath = str(part)
        bpy.ops.render.render(write_still=True)
        part.replace(out)
'''


def _write(folder: Path, exported: Exported) -> None:
    """Write run.py.

    Without reflections all surfaces are black, since Cycles' fewest bounces include direct light.
    """
    settings, bounces, film = exported.settings, exported.max_bounces, exported.film
    reflecting = bounces != 0
    columns, rows = (int(size) for size in film.size)
    deepest = _MAX_BOUNCES if bounces is None else max(bounces - 1, 0)
    # Blender's shifts are parts of the film's width; the film's coordinates are tangents, y down
    middle = film.low + film.size / (2 * film.scale)
    width = columns / film.scale
    numbers = settings.batches, exported.film_samples, columns, rows, deepest
    groups = channel_groups(settings.wavelength_nm.size, _CHANNELS)
    filled = {
        "NUMBERS": ", ".join(str(number) for number in numbers),
        "UNIT": repr(_UNIT_MM),
        "LENS": ", ".join(repr(float(v)) for v in (_SENSOR_MM / width, middle[0] / width, -middle[1] / width)),
        "SENSOR": repr(_SENSOR_MM),
        "CAMERA": repr(_pose(exported).tolist()),
        "GROUPS": "\n".join(_group(exported, np.resize(group, _CHANNELS), reflecting) for group in groups),
        "SURFACES": "\n".join(f"    {(s.name, mesh_path(s), s.material)!r}," for s in exported.scene.surfaces),
        "LAMPS": "\n".join(f"    {(lamp.key, mesh_path(lamp.surface))!r}," for lamp in exported.lamps),
    }
    script = _SCRIPT
    for key, text in filled.items():
        script = script.replace(f"@{key}@", text)
    (folder / "run.py").write_text(script, encoding="ascii")


def _pose(exported: Exported) -> NDArray[np.float64]:
    """(4, 4) pose of Blender's camera, which looks along -z with y up."""
    camera = exported.camera
    right, down, forward = camera.rotation
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, -down, -forward], axis=1)
    pose[:3, 3] = camera.position_mm / _UNIT_MM
    return pose


def _group(exported: Exported, group: NDArray[np.int64], reflecting: bool) -> str:
    """Reflectances and radiances of three wavelengths."""
    paints = {
        name: (reflecting * row[group]).tolist()
        for name, row in zip(exported.scene.materials, exported.reflectances, strict=True)
    }
    lights = {
        lamp.key: (lamp.radiance[group].tolist(), (reflecting * lamp.reflectance[group]).tolist())
        for lamp in exported.lamps
    }
    return f"    {(paints, lights)!r},"


RENDERER = Renderer("cycles", "Blender Cycles", _write, exr_radiance, PYTHON_SCRIPT, "film", package="bpy")
