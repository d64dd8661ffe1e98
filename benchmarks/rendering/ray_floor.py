"""What the rays of a picture cost alone: an integrator's own segments traced again, with nothing around."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
from cboxlab.rendering.device import dr, mi
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.path_points import PathPoints
from cboxlab.rendering.integrators.path_tracer import trace_paths
from cboxlab.rendering.radiosity import final_gather
from cboxlab.rendering.visibility.flat_faces import FlatFaces
from cboxlab.rendering.visibility.tracer import build_tracer
from cboxlab.scenes import Camera, Scene

__all__ = ["bare_seconds", "own_rays"]


class _Watched:
    """An accelerator, which keeps the rays that it is asked for, each with who asks: (rays, active lanes)."""

    def __init__(self, scene: mi.Scene | FlatFaces) -> None:
        self._scene = scene
        self.segments: list[tuple[mi.Ray3f, Any]] = []
        self.tests: list[tuple[mi.Ray3f, Any]] = []
        self.running: Any = True

    def ray_intersect_preliminary(self, ray: mi.Ray3f, coherent: bool, active: Any) -> Any:
        if not coherent:  # coherent rays find what covers a pixel
            self.segments.append((ray, active))
        return self._scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)

    def ray_test(self, ray: mi.Ray3f, active: Any) -> Any:
        self.tests.append((ray, active & self.running))
        return self._scene.ray_test(ray, active=active)


def own_rays(
    name: str, scene: Scene, camera: Camera, wavelengths: np.ndarray, samples: int
) -> tuple[mi.Ray3f, mi.Ray3f]:
    """All path segments and all shadow rays of one small picture by ``name``: path or default."""
    if name == "path":
        light, tracer = None, build_tracer(scene)
    else:
        light = final_gather.solve_light(scene, wavelengths)
        tracer = light.tracer
    watched = _Watched(tracer.accelerator)
    tracer = replace(tracer, accelerator=watched)  # type: ignore[arg-type]
    plain = PathPoints.at_vertex

    def at_vertex(self: PathPoints, index: mi.UInt32, depth: mi.UInt32) -> Any:
        watched.running = index < samples  # lanes that have all their paths stay in the loop
        ray, active = watched.segments.pop()
        watched.segments.append((ray, active & watched.running))
        return plain(self, index, depth)

    stepwise = dr.JitFlag.SymbolicLoops, dr.JitFlag.SymbolicConditionals
    with (
        dr.scoped_set_flag(stepwise[0], False),
        dr.scoped_set_flag(stepwise[1], False),
    ):  # each step with its rays
        if light is None:
            with mock.patch.object(PathPoints, "at_vertex", at_vertex):
                trace_paths(tracer, RenderJob(tracer.scene, camera, wavelengths, samples, 1, seed=1))
        else:
            view = final_gather._view(light, camera)  # its rays do not grow with the samples
            with mock.patch.object(final_gather, "_view", return_value=view):
                final_gather.gather(replace(light, tracer=tracer), camera, samples, 1)
    return tuple(  # type: ignore[return-value]
        _rays(np.concatenate([_columns(*columns) for columns in rays], axis=1))
        for rays in (watched.segments, watched.tests)
    )


def bare_seconds(scene: Scene, rays: tuple[mi.Ray3f, mi.Ray3f], for_s: float) -> float:
    """CPU seconds in which ``rays`` (as of ``own_rays``) are traced once: the mean over ``for_s`` of them."""
    segments, tests = rays
    bare = build_tracer(scene).accelerator

    def trace() -> None:
        hit = bare.ray_intersect_preliminary(segments, coherent=False)
        # shadow rays end on surfaces
        blocked = bare.ray_test(tests, enclosed=True) if isinstance(bare, FlatFaces) else bare.ray_test(tests)
        dr.eval(hit.t, hit.prim_index, hit.prim_uv, blocked)
        dr.sync_thread()

    trace()
    start, turns = time.process_time(), 0
    while time.process_time() - start < for_s:
        trace()
        turns += 1
    return (time.process_time() - start) / turns


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
