"""What the rays of a picture cost alone: the path tracer's own segments traced again, with nothing around."""

from __future__ import annotations

import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from cboxlab.render import lamp as lamp_module
from cboxlab.render import path_tracer
from cboxlab.render.path_points import PathPoints
from cboxlab.render.tracer import Tracer, build_tracer
from cboxlab.scenes import Camera, Scene

__all__ = ["floor_per_path", "record"]


def record(scene: Scene, camera: Camera, wavelengths: np.ndarray, samples: int) -> tuple[Any, Any]:
    """(7, n) origin, direction, length of all path segments and of all shadow rays of one small picture.

    The loop runs step by step while the functions that trace are watched.
    """
    tracer = build_tracer(scene)
    lamp = lamp_module.build_lamp_sampler(tracer)
    reflectances = np.array([m.reflectance.at(wavelengths) for m in scene.materials.values()])
    plain = path_tracer.intersect, lamp_module.visible, PathPoints.at_vertex
    paths: list[np.ndarray] = []
    shadows: list[np.ndarray] = []
    now: dict[str, Any] = {}

    def intersect(tracer: Tracer, ray: mi.Ray3f) -> Any:
        now["ray"] = ray
        return plain[0](tracer, ray)

    def at_vertex(self: PathPoints, index: mi.UInt32, depth: mi.UInt32) -> Any:
        now["running"] = index < samples
        paths.append(_columns(now["ray"], now["running"]))
        return plain[2](self, index, depth)

    def visible(tracer: Tracer, origin: mi.Point3f, target: mi.Point3f, active: mi.Bool) -> mi.Bool:
        ray = mi.Ray3f(origin, dr.normalize(target - origin))
        ray.maxt = dr.norm(target - origin) * (1 - 1e-4)
        shadows.append(_columns(ray, active & now["running"]))
        return plain[1](tracer, origin, target, active)

    try:
        path_tracer.intersect, lamp_module.visible = intersect, visible  # type: ignore[assignment]
        PathPoints.at_vertex = at_vertex  # type: ignore[method-assign]
        with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False):
            dr.eval(
                path_tracer._strip(tracer, lamp, reflectances, camera, 0, camera.height_px, samples, 1, None)
            )
    finally:
        path_tracer.intersect, lamp_module.visible = plain[:2]
        PathPoints.at_vertex = plain[2]  # type: ignore[method-assign]
    return np.concatenate(paths, axis=1), np.concatenate(shadows, axis=1)


def floor_per_path(
    scene: Scene, camera: Camera, wavelengths: np.ndarray, samples: int, runs: int
) -> tuple[float, float]:
    """CPU seconds of the rays of one path (median of ``runs``), and rays per path."""
    paths, shadows = record(scene, camera, wavelengths, samples)
    tracer = build_tracer(scene)
    segments, tests = _rays(paths), _rays(shadows)
    seconds = []
    for _ in range(runs + 1):
        start = time.process_time()
        found = tracer.mitsuba_scene.ray_intersect_preliminary(segments, coherent=False)
        blocked = tracer.mitsuba_scene.ray_test(tests)
        dr.eval(found.t, found.prim_index, found.prim_uv, blocked)
        dr.sync_thread()
        seconds.append(time.process_time() - start)
    count = camera.width_px * camera.height_px * samples
    return float(np.median(seconds[1:])) / count, (paths.shape[1] + shadows.shape[1]) / count


def _columns(ray: mi.Ray3f, active: mi.Bool) -> np.ndarray:
    width = dr.width(ray)
    parts = (*ray.o, *ray.d, ray.maxt)
    table = np.stack([np.broadcast_to(np.array(part), width) for part in parts])
    return table[:, np.broadcast_to(np.array(active), width)]


def _rays(columns: np.ndarray) -> mi.Ray3f:
    parts = [mi.Float(np.ascontiguousarray(column)) for column in columns]
    ray = mi.Ray3f(mi.Point3f(*parts[:3]), mi.Vector3f(*parts[3:6]))
    ray.maxt = parts[6]
    dr.eval(ray)
    return ray
