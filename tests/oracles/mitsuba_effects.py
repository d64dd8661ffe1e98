"""Effects of light transport by Mitsuba's own integrators: references that share no code with the effects.

Three wavelengths a render stand in the place of red, green and blue, which never mix.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from cboxlab.rendering.device import dr, mi
from cboxlab.rendering.integrators.stock import sensor_dict
from cboxlab.rendering.visibility.pinhole import film_for
from cboxlab.scenes import Camera, Scene, Spectrum, Surface
from numpy.typing import NDArray

__all__ = ["coat", "haze", "oren_nayar", "reference"]

VARIANT = "llvm_ad_rgb"


def haze(
    scene: Scene, camera: Camera, extinction_per_m: float, albedo: float, aside_mm: float = 350.0
) -> dict[str, Any]:
    """A cuboid of air from just behind the camera to the back wall; for ``reference``.

    aside_mm : how far it reaches beyond the box to the sides.
    """
    corners = np.concatenate([s.vertices_mm for s in scene.surfaces])
    low, high = corners.min(axis=0) - aside_mm, corners.max(axis=0) + aside_mm
    low[2], high[2] = camera.position_mm[2] - 1.0, corners[:, 2].max() + 1.0
    with mi.scoped_set_variant(VARIANT):
        transform = mi.ScalarTransform4f().translate(((low + high) / 2).tolist())
        transform = transform @ mi.ScalarTransform4f().scale(((high - low) / 2).tolist())
    return {"sigma_t": extinction_per_m * 1e-3, "albedo": albedo, "to_world": transform}


def reference(
    scene: Scene,
    camera: Camera,
    wavelength_nm: NDArray,
    samples: int,
    seed: int = 0,
    batches: int = 8,
    max_bounces: int | None = None,
    paint: tuple[str, dict[str, Any]] | None = None,
    air: dict[str, Any] | None = None,
    surround: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radiance over the lamp's (3, y, x) and the variance of its mean, at three wavelengths.

    camera : without distortion. paint : a material's name and the BSDF that replaces it, to which its reflectance
    is given. air : see ``haze``. surround : radiance of all directions in which nothing stands.
    """
    assert camera.k1 == 0 and len(wavelength_nm) == 3
    pictures = []
    with mi.scoped_set_variant(VARIANT):
        bsdfs = {}
        for name, material in scene.materials.items():
            rgb = _rgb(material.reflectance, wavelength_nm)
            mask = paint is not None and paint[0] == name
            bsdfs[name] = {**paint[1], "reflectance": rgb} if mask and paint else _diffuse(rgb)
        parts: dict[str, Any] = {s.name: _mesh(s, {"bsdf": bsdfs[s.material]}) for s in scene.surfaces}
        panel = _diffuse(_rgb(scene.lamp.reflectance, wavelength_nm))
        glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
        parts["lamp"] = _mesh(scene.lamp.surface, {"bsdf": panel, "emitter": glow})
        sensor = sensor_dict(film_for(camera, 1), camera, {"pixel_format": "rgb"})
        if surround:
            parts["surround"] = {"type": "constant", "radiance": {"type": "rgb", "value": surround}}
        if air is not None:
            medium = mi.load_dict(
                {
                    "type": "homogeneous",
                    "albedo": air["albedo"],
                    "sigma_t": air["sigma_t"],
                    "phase": {"type": "isotropic"},
                }
            )
            parts["air"] = {
                "type": "cube",
                "to_world": air["to_world"],
                "bsdf": {"type": "null"},
                "interior": medium,
            }
            sensor["medium"] = medium
        depth = -1 if max_bounces is None else max_bounces + 1
        integrator = mi.load_dict({"type": "path" if air is None else "volpath", "max_depth": depth, "rr_depth": 8})
        loaded = mi.load_dict({"type": "scene", **parts}, optimize=False)
        eye = mi.load_dict(sensor)
        for batch in range(batches):
            number = (seed + 7919 * (batch + 1)) & 0xFFFFFFFF
            picture = mi.render(loaded, sensor=eye, integrator=integrator, spp=samples, seed=number)
            pictures.append(np.moveaxis(np.array(picture, float), -1, 0))
    stack = np.array(pictures)
    return stack.mean(axis=0), stack.var(axis=0, ddof=1) / batches


def _rgb(reflectance: Spectrum, wavelength_nm: NDArray) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(r) for r in reflectance.at(wavelength_nm)]}


def _diffuse(reflectance: Any) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": reflectance}


def _mesh(surface: Surface, parts: dict[str, Any]) -> mi.Mesh:
    """Triangles without shared corners, so that Mitsuba smooths no normal."""
    properties = mi.Properties()
    for name, part in parts.items():
        properties[name] = mi.load_dict(part)
    corners = surface.vertices_mm[surface.faces].reshape(-1, 3).astype(np.float32)
    mesh = mi.Mesh(surface.name, len(corners), len(surface.faces), properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = corners.ravel()
    parameters["faces"] = np.arange(len(corners), dtype=np.uint32)
    parameters.update()
    return mesh


def oren_nayar(sigma_rad: float) -> dict[str, Any]:
    """Oren and Nayar's qualitative model, without the interreflection term; for ``reference``."""
    _register()
    return {"type": "test_oren_nayar", "sigma": sigma_rad}


def coat(specular: float, roughness: float) -> dict[str, Any]:
    """A GGX coat of index 1.5, reflecting ``specular`` times Fresnel's part, above a diffuse base."""
    _register()
    return {"type": "test_coat", "specular": specular, "alpha": roughness}


_registered = False


def _register() -> None:
    global _registered
    if _registered:
        return
    _registered = True
    with mi.scoped_set_variant(VARIANT):

        class Reflection(mi.BSDF):  # type: ignore[misc]
            """Samples cosine-weighted directions; subclasses give ``value``, reflection function times cosine."""

            def __init__(self, props: Any) -> None:
                mi.BSDF.__init__(self, props)
                self.reflectance = mi.Color3f(props["reflectance"])
                self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
                self.m_components = [self.m_flags]

            def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
                ok = (mi.Frame3f.cos_theta(si.wi) > 0) & (mi.Frame3f.cos_theta(wo) > 0) & active
                return dr.select(ok, self.density(si, wo), 0)

            def density(self, si: Any, wo: Any) -> Any:
                return mi.warp.square_to_cosine_hemisphere_pdf(wo)

            def direction(self, si: Any, s1: Any, s2: Any) -> Any:
                return mi.warp.square_to_cosine_hemisphere(s2)

            def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
                ok = (mi.Frame3f.cos_theta(si.wi) > 0) & (mi.Frame3f.cos_theta(wo) > 0) & active
                return dr.select(ok, self.value(si, wo), 0)

            def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
                return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

            def sample(self, ctx: Any, si: Any, s1: Any, s2: Any, active: Any = True) -> Any:
                wo = self.direction(si, s1, s2)
                bs = mi.BSDFSample3f()
                bs.wo, bs.eta = wo, 1.0
                bs.pdf = self.pdf(ctx, si, wo, active)
                bs.sampled_type = +mi.BSDFFlags.DiffuseReflection
                bs.sampled_component = 0
                good = active & (bs.pdf > 0)
                return bs, dr.select(good, self.eval(ctx, si, wo, active) / bs.pdf, 0)

        class OrenNayar(Reflection):
            def __init__(self, props: Any) -> None:
                Reflection.__init__(self, props)
                square = props["sigma"] ** 2
                self.a, self.b = 1 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)

            def value(self, si: Any, wo: Any) -> Any:
                theta_i, theta_r = dr.acos(wo.z), dr.acos(si.wi.z)
                difference = dr.atan2(wo.y, wo.x) - dr.atan2(si.wi.y, si.wi.x)
                lobe = dr.maximum(0, dr.cos(difference)) * dr.sin(dr.maximum(theta_i, theta_r))
                lobe *= dr.tan(dr.minimum(theta_i, theta_r))
                return self.reflectance * (self.a + self.b * lobe) * wo.z / dr.pi

        class Coated(Reflection):
            def __init__(self, props: Any) -> None:
                Reflection.__init__(self, props)
                self.s = props["specular"]
                self.lobe = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, props["alpha"])

            def value(self, si: Any, wo: Any) -> Any:
                half = dr.normalize(si.wi + wo)
                through = [1 - self.s * mi.fresnel(w.z, 1.5)[0] for w in (si.wi, wo)]
                base = self.reflectance * through[0] * through[1] * wo.z / dr.pi
                facets = self.lobe.eval(half) * self.lobe.G(si.wi, wo, half) / (4 * si.wi.z)
                return base + self.s * mi.fresnel(dr.dot(wo, half), 1.5)[0] * facets

            def density(self, si: Any, wo: Any) -> Any:
                half = dr.normalize(si.wi + wo)
                mirrored = self.lobe.pdf(si.wi, half) / (4 * dr.dot(wo, half))
                return 0.5 * (mi.warp.square_to_cosine_hemisphere_pdf(wo) + mirrored)

            def direction(self, si: Any, s1: Any, s2: Any) -> Any:
                half, _ = self.lobe.sample(si.wi, s2)
                return dr.select(s1 < 0.5, mi.reflect(si.wi, half), mi.warp.square_to_cosine_hemisphere(s2))

        mi.register_bsdf("test_oren_nayar", OrenNayar)
        mi.register_bsdf("test_coat", Coated)
