"""Six scenes in Blender's Cycles, for `regress_scene_table.py`: a script for a Python with the package bpy.

    python cycles_scenes.py JOBS.json

A job is a list of scene, whether it is changed, seed, samples and file, which holds several layers. All that biases a
picture is off.
"""

from __future__ import annotations

import json
import math
import random
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

if __name__ == "__main__":  # only a Python with Blender's module runs the script; others read its list of scenes
    import bpy
    from mathutils import Vector

SIZE = 48
Colour = tuple[float, float, float]


def shaded(node: str, **inputs: Any) -> Any:
    """Material of one node."""
    material = bpy.data.materials.new(node)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    shader, out = nodes.new(node), nodes.new("ShaderNodeOutputMaterial")
    for name, value in inputs.items():
        shader.inputs[name.replace("_", " ")].default_value = value
    links.new(shader.outputs[0], out.inputs["Volume" if "Volume" in node else "Surface"])
    return material


def paint(*colour: float) -> Any:
    return shaded("ShaderNodeBsdfDiffuse", Color=(*colour, 1.0))


def lamp(strength: float) -> Any:
    return shaded("ShaderNodeEmission", Color=(1.0, 0.95, 0.85, 1.0), Strength=strength)


def checks(scale: float, seed: int) -> Any:
    """Diffuse material with squares on a noise texture."""
    material = paint(0.5, 0.5, 0.5)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    squares, noise = nodes.new("ShaderNodeTexChecker"), nodes.new("ShaderNodeTexNoise")
    squares.inputs["Scale"].default_value, noise.inputs["Scale"].default_value = scale, 12.0 + seed
    squares.inputs["Color2"].default_value = (0.1, 0.15, 0.2, 1.0)
    where = nodes.new("ShaderNodeTexCoord")
    links.new(where.outputs["Object"], squares.inputs["Vector"])
    links.new(noise.outputs["Color"], squares.inputs["Color1"])
    diffuse = next(node for node in nodes if node.type == "BSDF_DIFFUSE")
    links.new(squares.outputs["Color"], diffuse.inputs["Color"])
    return material


def add(
    shape: str, at: Sequence[float], size: Sequence[float], material: Any, turned: Sequence[float] = (0, 0, 0)
) -> None:
    """A cube of edge 2, a sphere or a tube of radius 1, or a plane of edge 2, scaled."""
    more = {"plane": {"size": 2}, "cube": {"size": 2}, "tube": {"vertices": 12, "depth": 2}}.get(
        shape, {"segments": 48}
    )
    make = {"plane": "plane", "cube": "cube", "tube": "cylinder", "sphere": "uv_sphere"}[shape]
    getattr(bpy.ops.mesh, f"primitive_{make}_add")(location=at, rotation=turned, **more)
    shape_ = bpy.context.object
    shape_.scale = size
    shape_.data.materials.append(material)
    if shape == "sphere":
        bpy.ops.object.shade_smooth()


def seen_from(at: Sequence[float], target: Sequence[float], degrees: float) -> None:
    data = bpy.data.cameras.new("camera")
    data.angle = math.radians(degrees)
    camera = bpy.data.objects.new("camera", data)
    camera.location = at
    camera.rotation_euler = (Vector(target) - Vector(at)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.collection.objects.link(camera)
    bpy.context.scene.camera = camera


def room() -> None:
    """A box of edge 2 without a front, with a lamp below its ceiling."""
    quarter = math.pi / 2
    white = paint(0.75, 0.75, 0.7)
    add("plane", (0, 0, 0), (1, 1, 1), white)
    add("plane", (0, 0, 2), (1, 1, 1), white)
    add("plane", (0, 1, 1), (1, 1, 1), white, (quarter, 0, 0))
    add("plane", (-1, 0, 1), (1, 1, 1), paint(0.6, 0.06, 0.06), (0, quarter, 0))
    add("plane", (1, 0, 1), (1, 1, 1), paint(0.1, 0.4, 0.1), (0, quarter, 0))
    add("plane", (0, 0, 1.98), (0.3, 0.3, 1), lamp(12.0), (math.pi, 0, 0))
    seen_from((0, -3.8, 1), (0, 0, 1), 40)


def interior(changed: bool) -> None:
    room()
    add("cube", (0.2, 0.1, 0.4), (0.5, 0.3, 0.04), paint(*(0.2, 0.12, 0.05) if changed else (0.5, 0.35, 0.2)))
    add("sphere", (-0.5, 0.2, 0.35), (0.35, 0.35, 0.35), shaded("ShaderNodeBsdfGlossy", Roughness=0.3))


def glass(changed: bool) -> None:
    room()
    ball = shaded("ShaderNodeBsdfGlass", IOR=1.1 if changed else 1.5, Roughness=0.0)
    add("sphere", (0.2, 0, 0.5), (0.45, 0.45, 0.45), ball)


def hair(changed: bool) -> None:
    room()
    rng, brown = random.Random(1), paint(*(0.3, 0.17, 0.06) if changed else (0.42, 0.26, 0.1))
    for _ in range(60):
        x, y, lean = rng.uniform(-0.7, 0.7), rng.uniform(-0.7, 0.7), rng.uniform(-0.15, 0.15)
        add("tube", (x, y, 0.8), (0.012, 0.012, 0.8), brown, (lean, rng.uniform(-0.15, 0.15), 0))


def volume(changed: bool) -> None:
    room()
    add("cube", (0.1, 0.2, 0.4), (0.3, 0.3, 0.4), paint(0.7, 0.7, 0.7), (0, 0, 0.4))
    fog = shaded("ShaderNodeVolumePrincipled", Density=0.55 if changed else 0.35)
    add("cube", (0, 0, 1), (0.98, 0.98, 0.98), fog)


def textured(changed: bool) -> None:
    add("plane", (0, 0, 0), (4, 4, 1), checks(2.0, 0))
    add("sphere", (0, 0, 0.6), (0.6, 0.6, 0.6), checks(5.5 if changed else 5.0, 3))
    add("plane", (1, -1, 3), (0.5, 0.5, 1), lamp(25.0), (math.pi, 0, 0))
    sky((0.2, 0.25, 0.3))
    seen_from((0, -3, 2), (0, 0, 0.3), 50)


def outdoor(changed: bool) -> None:
    add("plane", (0, 0, 0), (50, 50, 1), paint(0.3, 0.35, 0.2))
    add("cube", (-1.0 + 0.15 * changed, 0, 0.8), (0.9, 0.8, 0.8), paint(0.7, 0.6, 0.5))
    add("sphere", (1.6, -0.4, 1.3), (0.8, 0.8, 0.8), paint(0.1, 0.4, 0.1))
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 3.0, 0.02
    shining = bpy.data.objects.new("sun", sun)
    shining.rotation_euler = (0.7, 0.4, 0)
    bpy.context.collection.objects.link(shining)
    sky(None)
    seen_from((0, -6, 1.5), (0, 0, 1), 45)


def sky(colour: Colour | None) -> None:
    """Light from all around: of one colour, or of a clear sky."""
    world = bpy.context.scene.world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    background = nodes["Background"]
    if colour is not None:
        background.inputs["Color"].default_value = (*colour, 1.0)
        return
    clear = nodes.new("ShaderNodeTexSky")
    clear.sky_type = "HOSEK_WILKIE"
    links.new(clear.outputs[0], background.inputs["Color"])


SCENES: dict[str, Callable[[bool], None]] = {f.__name__: f for f in (interior, glass, hair, volume, textured, outdoor)}


def built(name: str, changed: bool, samples: int) -> Any:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    SCENES[name](changed)
    render, cycles = scene.render, scene.cycles
    render.engine, render.threads_mode, render.threads = "CYCLES", "FIXED", 1
    render.resolution_x = render.resolution_y = SIZE
    render.resolution_percentage = 100
    render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    render.image_settings.color_depth = "32"
    render.dither_intensity = 0.0
    render.use_compositing = render.use_sequencer = False
    cycles.device, cycles.samples, cycles.use_adaptive_sampling = "CPU", samples, False
    cycles.use_denoising, cycles.light_sampling_threshold = False, 0.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = 12
    cycles.volume_bounces, cycles.pixel_filter_type, cycles.filter_width = 8, "BOX", 1.0
    view = scene.view_layers[0]
    view.use_pass_z = view.use_pass_normal = view.use_pass_cryptomatte_object = True
    view.cycles.denoising_store_passes = True
    return scene


def main() -> None:
    for name, changed, seed, samples, file in json.loads(Path(sys.argv[1]).read_text()):
        scene = built(name, changed, samples)
        scene.cycles.seed = seed
        scene.render.filepath = file
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
