"""Base models that are not Lambertian: their pictures against every path traced at every wavelength, and a validation
whose model has the coat that was photographed.

False alarms: each comparison of means fails by chance with a probability of 1e-6 (Student's t).
"""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cboxlab.scenes
import numpy as np
import pytest
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain.settings import RenderSettings
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.general_path_tracer import render_general_path_tracer
from cboxlab.rendering.model.model_file import Model
from cboxlab.rendering.radiosity.final_gather import solve_light
from cboxlab.rendering.synthetic.capture_writer import tungsten_lamp
from cboxlab.rendering.synthetic.photographer import CaptureSettings
from cboxlab.scenes import Material, Medium, Spectrum, Texture, cornell_box, cornell_camera, load_scene
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.compare.pipeline import validate_capture
from cboxlab.validation.predict.traced_picture import traced_picture
from cboxlab.validation.report.write import write_validation
from cboxlab.validation.synthetic.model_capture import perturbed_camera, photograph_image
from scipy.stats import t as student

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer: compiled integrators")

BATCHES = 16
T_LIMIT = float(student.isf(0.5e-6, 2 * BATCHES - 2))
SETTINGS = RenderSettings(seed=4)
COAT = '{ type = "roughplastic", alpha = 0.2, int_ior = 1.5, diffuse_reflectance = "reflectance" }'
HAZE = Spectrum(np.array([400.0, 700.0]), np.array([4e-4, 1e-4]))


def picture_of(scene, camera, samples, batches):
    light = solve_light(scene.lambertian, WAVELENGTH_NM)
    return traced_picture(scene, camera, light, SETTINGS)(samples, 0, batches, NO_PROGRESS)


def coated(folder):
    """The published box under a tungsten lamp, its white paint coated, as a scene file in ``folder``."""
    data = Path(cboxlab.scenes.__file__).parent / "data"
    lamp = tungsten_lamp()
    rows = [f"{nm},{value}" for nm, value in zip(lamp.wavelength_nm, lamp.values, strict=True)]
    (folder / "lamp.csv").write_text("\n".join(["wavelength_nm,radiance", *rows]))
    for name in ("cornell-box-emission.csv", "cornell-box-reflectance.csv"):
        (folder / name).write_bytes((data / name).read_bytes())
    text = (data / "cornell-box.toml").read_text()
    text = text.replace('"cornell-box-emission.csv:emission"', '"lamp.csv:radiance"')
    path = folder / "coated.toml"
    path.write_text(text.replace("[material.white]", f"[material.white]\nbsdf = {COAT}"))
    return path


def painted(scene):
    """A picture of two paints on the back wall, a second lamp on the left one, and a block full of milk."""
    share = np.random.default_rng(3).random((4, 5, 1))
    paints = tuple(scene.materials[name].reflectance for name in ("white", "green"))
    picture = Texture(np.concatenate([share, 1 - share], axis=2), paints)
    skin = Material("skin", paints[0], {"type": "null"})
    materials = {"poster": Material("poster", picture.mean, texture=picture), "skin": skin}
    milk, corners = (
        Medium(HAZE.scaled(20.0), HAZE, 0.6),
        np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
    )
    changed = {
        "back": {"material": "poster", "texture_uv": corners},
        "short-block": {"material": "skin", "inside": milk},
    }
    surfaces = tuple(replace(s, **changed.get(s.name, {})) for s in scene.surfaces)
    vertices = scene.lamp.surface.vertices_mm[::-1][:, [1, 0, 2]] * [0.0, 0.5, 1.0] + [540.0, 150.0, 0.0]
    level = float(scene.lamp.radiance.at(550.0))
    blue = Spectrum(np.array([400.0, 700.0]), level * np.array([3.0, 0.2]))
    second = replace(
        scene.lamp, surface=replace(scene.lamp.surface, name="second", vertices_mm=vertices), radiance=blue
    )
    return replace(scene, surfaces=surfaces, materials={**scene.materials, **materials}, further_lamps=(second,))


@pytest.mark.parametrize("kind", ["coat", "haze", "picture and milk"])
def test_traced_at_few_wavelengths_it_is_right_between_them(kind, tmp_path):
    """The mean over all surfaces, at wavelengths half-way between the traced ones."""
    scene = load_scene(coated(tmp_path))
    if kind == "haze":
        scene = replace(scene.lambertian, medium=Medium(HAZE, HAZE.scaled(0.3), 0.4))
    if kind == "picture and milk":
        scene = painted(scene.lambertian)
    between, camera = np.array([405.0, 475.0, 545.0, 695.0]), cornell_camera(16)
    image = picture_of(scene, camera, 256, BATCHES // 4)
    exact = render_general_path_tracer(RenderJob(scene, camera, between, 64, BATCHES, seed=9))
    used = image.single_surface & (image.surface >= 0)
    at = np.searchsorted(WAVELENGTH_NM, between)
    a = (image.coefficients[:, used] @ image.spectra[:, at]).mean(axis=1)
    b = (exact.coefficients[:, used] @ exact.spectra).mean(axis=1)
    error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
    assert np.all(error < 0.02 * b.mean(axis=0))
    assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < T_LIMIT * error)


def test_at_the_traced_wavelengths_it_is_what_was_traced(tmp_path):
    scene, camera, nm = load_scene(coated(tmp_path)), cornell_camera(16), np.arange(400.0, 701.0, 10.0)
    image = picture_of(scene, camera, 64, 2)
    traced = render_general_path_tracer(RenderJob(scene, camera, nm, 16, 8, seed=SETTINGS.seed))
    traced_spectrum = image.coefficients @ image.spectra[:, np.searchsorted(WAVELENGTH_NM, nm)]
    expected = traced.coefficients @ traced.spectra
    assert np.abs(traced_spectrum - expected).max() < 1e-5 * expected.max()


def test_what_obeys_lambert_keeps_its_picture():
    """A diffuse BSDF of Mitsuba is Lambert's law: nothing is beyond it, within the traced paths' error."""
    box = cornell_box()
    white = replace(box.materials["white"], bsdf={"type": "diffuse", "reflectance": "reflectance"})
    scene = replace(box, materials={**box.materials, "white": white})
    image = picture_of(scene, cornell_camera(16), 256, BATCHES // 4)
    used = image.single_surface & (image.surface >= 0)  # the published lamp is dark at 400 nm
    beyond = (image.coefficients[:, used, -30:] * image.spectra[-30:].max(axis=1)).mean(axis=1)
    error = np.sqrt(beyond.var(axis=0, ddof=1) / BATCHES)
    level = (image.coefficients[:, used] @ image.spectra).mean()
    assert np.all(error < 0.01 * level)
    assert np.all(np.abs(beyond.mean(axis=0)) < student.isf(0.5e-6, BATCHES - 1) * error + 3e-4 * level)


@pytest.mark.usefixtures("large_patches")
def test_a_coated_base_model_explains_a_coated_box(tmp_path):
    """Camera moved and noise added: with the coat noise explains the capture, by Lambert's law alone nothing does."""
    path, camera = coated(tmp_path), perturbed_camera(32, 5)
    scene = load_scene(path)
    image = picture_of(scene, camera, 512, 4)
    settings = CaptureSettings(read_noise_e=300.0)
    photograph_image(tmp_path / "capture", image, (), None, scene, camera, settings=settings, seed=5)
    result = validate_capture(load_capture(tmp_path / "capture"), Model(load_scene(path)))
    assert result.comparison.chi2.per_dof < 1.2
    write_validation(result, tmp_path / "report")
    assert "white (roughplastic)" in (tmp_path / "report" / "report.html").read_text()
    plain = path.with_name("plain.toml")
    plain.write_text(path.read_text().replace(f"bsdf = {COAT}\n", ""))
    assert validate_capture(load_capture(tmp_path / "capture"), Model(load_scene(plain))).comparison.chi2.per_dof > 3


def test_parts_of_later_batches_are_other_paths(monkeypatch):
    """Four parts of each batch: batches 3 and 4 are the parts from the twelfth to the nineteenth."""
    jobs = []

    def refused(job, progress):
        jobs.append(job)
        raise InputError("a test", "enough", "nothing more")

    traced = sys.modules[traced_picture.__module__]
    flat = SimpleNamespace(coefficients=np.ones((1, 1)), spectra=np.ones((1, WAVELENGTH_NM.size)))
    monkeypatch.setattr(traced, "gather", lambda *_: flat)
    monkeypatch.setattr(traced, "render_image", refused)
    picture = traced_picture(cornell_box(), cornell_camera(8), None, SETTINGS)
    with pytest.raises(InputError, match="enough"):
        picture(64, 3, 2, NO_PROGRESS)
    assert [(job.samples, job.first_batch, job.batches) for job in jobs] == [(16, 12, 8)]
