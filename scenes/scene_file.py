"""Scenes read from TOML files; docs/scene-format.md describes the format."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.utils.arguments import required_path
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import combined, faults_of_validation, referred, suggestion
from cboxlab.utils.input_files import read_toml
from pydantic import ValidationError

from .checks import inside_faults, surface_faults, texture_faults
from .named_lights import LIGHT_NAMES, named_light
from .scene import Lamp, Material, Medium, Scene, SceneOrigin, Surface, Texture
from .scene_entries import (
    LampEntry,
    MaterialEntry,
    MediumEntry,
    SceneFile,
    SpectrumTable,
    lamp_mesh,
    lamp_pattern,
    surface_mesh,
    surface_uv,
    texture_weights,
)
from .spectra import Outside, Spectrum, read_spectrum
from .spectrum_checks import radiance_faults, reflectance_faults

__all__ = ["check_scene_file", "files_of_scene", "load_scene", "packaged_scenes"]

#: Folder of the packaged scenes and their data.
PACKAGED = Path(__file__).parent / "data"


def packaged_scenes() -> list[str]:
    """Names of the scenes that come with the program.

    Returns
    -------
    list[str]
        Names in alphabetical order.

    Examples
    --------
    >>> from cboxlab.scenes.scene_file import packaged_scenes
    >>> "cornell-box" in packaged_scenes()
    True
    """
    return sorted(path.stem for path in PACKAGED.glob("*.toml"))


def load_scene(path_or_name: str | Path) -> Scene:
    """Scene of a file, or packaged scene of a name.

    Parameters
    ----------
    path_or_name
        A scene file (.toml), or the name of a packaged scene such as "cornell-box".

    Returns
    -------
    Scene
        The scene; its ``origin`` names the file and all files that it refers to.

    Raises
    ------
    InputError
        If a file is missing or faulty. One error lists all faults of the scene file.

    Examples
    --------
    >>> import cboxlab
    >>> [surface.name for surface in cboxlab.load_scene("cornell-box").surfaces]
    ['floor', 'ceiling', 'back', 'right', 'left', 'short-block', 'tall-block']
    """
    file_path = required_path("load_scene", path_or_name, "a scene file or a packaged scene's name")
    packaged = str(path_or_name) in packaged_scenes()
    path = PACKAGED / f"{path_or_name}.toml" if packaged else file_path
    file = _read(path)
    scene = _built(path, file)
    if packaged:
        return scene.read_from(SceneOrigin(str(path_or_name)))
    absolute = path.resolve()
    return scene.read_from(SceneOrigin(str(absolute), _files(absolute, file)))


def files_of_scene(path: Path) -> tuple[Path, ...]:
    """Scene file and the files that it names.

    Parameters
    ----------
    path
        A scene file, .toml.

    Returns
    -------
    tuple[Path, ...]
        The file, then its tables, meshes and images, which need not exist.

    Raises
    ------
    InputError
        If it is no scene file.
    """
    return _files(path, _read(path))


def _files(path: Path, file: SceneFile) -> tuple[Path, ...]:
    """Scene file, and the tables, meshes and images that it names."""
    spectra = [material.reflectance for material in file.material.values()]
    spectra += [spectrum for lamp in file.lamp for spectrum in (lamp.radiance, lamp.reflectance)]
    media = [file.medium, *(surface.inside for surface in file.surface)]
    spectra += [x for medium in media if medium for x in (medium.scattering_per_mm, medium.absorption_per_mm)]
    textures = [material.texture for material in file.material.values() if material.texture is not None]
    spectra += [spectrum for texture in textures for spectrum in texture.spectra]
    names = [spectrum.rpartition(":")[0] for spectrum in spectra if isinstance(spectrum, str) and ":" in spectrum]
    names += [texture.image for texture in textures]
    names += [surface.mesh for surface in file.surface if surface.mesh is not None]
    return path, *(path.parent / name for name in dict.fromkeys(names))


def _read(path: Path) -> SceneFile:
    """Content of a scene file; InputError with all faults of its keys."""
    packaged = packaged_scenes()
    hint = suggestion(str(path), packaged) or f"Packaged scenes: {', '.join(packaged)}"
    return check_scene_file(path, read_toml(path, "a scene file in TOML", hint))


def check_scene_file(path: Path, content: dict[str, Any]) -> SceneFile:
    """Content of a scene file with checked keys.

    Parameters
    ----------
    path
        The file, for messages.
    content
        Its tables.

    Returns
    -------
    SceneFile
        The content. Files that it names are not looked at.

    Raises
    ------
    InputError
        With all faults of the keys.
    """
    try:
        return SceneFile.model_validate(content)
    except ValidationError as error:
        faults = faults_of_validation(path, error, SceneFile)
        if not isinstance(content.get("lamp"), list):  # the keys of one [lamp] have no number
            faults = [
                InputError(f.where.replace(": lamp[0]", ": lamp", 1), f.found, f.expected, f.hint) for f in faults
            ]
        raise combined(faults) from None


@contextmanager
def _gathered(faults: list[InputError]) -> Iterator[None]:
    """Collect the fault raised in the block; reading continues with the next part of the file."""
    try:
        yield
    except InputError as fault:
        faults.append(fault)


def _built(path: Path, file: SceneFile) -> Scene:
    """Scene of the content of a file; InputError with all faults of its values."""
    faults: list[InputError] = []
    materials: dict[str, Material] = {}
    surfaces: list[Surface] = []
    lamps: list[Lamp] = []
    for name, material in file.material.items():
        with _gathered(faults):
            materials[name] = _material(path, name, material, faults)
    names: list[str] = []
    for index, light in enumerate(file.lamp):
        where = f"{path}: lamp" if len(file.lamp) == 1 else f"{path}: lamp[{index}]"
        with _gathered(faults):
            names.append(_unused(light.name, names, where))
            lamps.append(_lamp(path, light, where, faults))
    medium = None
    with _gathered(faults):
        medium = None if file.medium is None else _medium(path, file.medium, f"{path}: medium")
    for index, entry in enumerate(file.surface):
        where = f"{path}: surface[{index}] ({entry.name})"
        with _gathered(faults):
            names.append(_unused(entry.name, names, where))
            if entry.material not in file.material:
                faults.append(_missing_material(entry.material, list(file.material), f"{where}.material"))
            mesh = surface_mesh(entry, file.lamp, path.parent, where)
            surface = Surface(entry.name, entry.material, *mesh, ball=entry.sphere is not None)
            if entry.material in file.material and file.material[entry.material].texture is not None:
                surface = replace(surface, texture_uv=surface_uv(entry, path.parent, where))
            faults += surface_faults(surface, where)
            if entry.inside is not None:
                surface = replace(surface, inside=_medium(path, entry.inside, f"{where}.inside"))
                if entry.material in materials:
                    faults += inside_faults(surface, materials[entry.material], f"{where}.inside")
            surfaces.append(surface)
    if faults:
        raise combined(faults)
    return Scene(file.name, tuple(surfaces), materials, lamps[0], file.source, medium, tuple(lamps[1:]))


def _unused(name: str, names: list[str], where: str) -> str:
    """The name; InputError if it is one of ``names``."""
    if name in names:
        raise InputError(where, "a name used before", "a unique name for each surface and the lamp")
    return name


def _material(path: Path, name: str, entry: MaterialEntry, faults: list[InputError]) -> Material:
    """Material of an entry; faults of its reflectance are appended to ``faults``."""
    where = f"{path}: material.{name}"
    if entry.texture is not None:
        if entry.bsdf is not None or entry.reflectance is not None:
            other = "bsdf" if entry.bsdf is not None else "reflectance"
            raise InputError(f"{where}.texture", f"a texture and a {other}", "one of the two")
        at = f"{where}.texture"
        spectra = tuple(
            _spectrum(path, item, f"{at}.spectra[{k}]", "hold") for k, item in enumerate(entry.texture.spectra)
        )
        texture = Texture(texture_weights(entry.texture, path.parent, at), spectra)
        faults += texture_faults(texture, at)
        return Material(name, texture.mean, texture=texture)
    if entry.reflectance is None:
        raise InputError(f"{where}.reflectance", "nothing", "a value, or a texture")
    reflectance = _spectrum(path, entry.reflectance, f"{where}.reflectance", "hold")
    faults += reflectance_faults(reflectance, f"{where}.reflectance")
    if entry.bsdf is not None and not isinstance(entry.bsdf.get("type"), str):
        hint = 'for example bsdf = { type = "roughplastic", diffuse_reflectance = "reflectance" }'
        faults.append(InputError(f"{where}.bsdf", "no type", "the name of a Mitsuba BSDF", hint))
    return Material(name, reflectance, entry.bsdf)


def _lamp(path: Path, entry: LampEntry, where: str, faults: list[InputError]) -> Lamp:
    """Lamp of an entry; faults of its values are appended to ``faults``."""
    radiance = _light(path, entry.radiance, f"{where}.radiance")
    surface = Surface(entry.name, entry.name, *lamp_mesh(entry, where))
    reflectance = _spectrum(path, entry.reflectance, f"{where}.reflectance", "hold")
    faults += reflectance_faults(reflectance, f"{where}.reflectance")
    faults += radiance_faults(radiance, f"{where}.radiance")
    faults += surface_faults(surface, f"{where}.quads_mm")
    return Lamp(surface, radiance, pattern=lamp_pattern(entry, where), reflectance=reflectance)


def _medium(path: Path, entry: MediumEntry, at: str) -> Medium:
    """Medium of an entry; InputError for a negative coefficient."""
    coefficients = []
    for key in ("scattering_per_mm", "absorption_per_mm"):
        where = f"{at}.{key}"
        spectrum = _spectrum(path, getattr(entry, key), where, "hold")
        if (lowest := spectrum.values.min()) < 0:
            raise InputError(where, f"{lowest:g}", "coefficients of 0 or more")
        coefficients.append(spectrum)
    scattering, absorption = coefficients
    return Medium(scattering, absorption, entry.anisotropy)


def _missing_material(name: str, materials: list[str], where: str) -> InputError:
    """Fault of a material that is not among those of the file."""
    expected = f"one of {', '.join(materials)}" if materials else "a [material.NAME] table"
    return InputError(where, f"'{name}', which the file does not define", expected, suggestion(name, materials))


def _light(path: Path, entry: object, where: str) -> Spectrum:
    """Radiance of a lamp: as `_spectrum`, or the relative spectrum of a named light."""
    if not isinstance(entry, str) or ":" in entry:
        return _spectrum(path, entry, where, "zero")
    try:
        light = named_light(entry)
    except InputError as error:
        raise referred(error, where) from None
    if light is None:
        raise InputError(where, repr(entry[:40]), f"'file.csv:column', or one of {LIGHT_NAMES}")
    return light


def _spectrum(path: Path, entry: object, where: str, outside: Outside) -> Spectrum:
    """Spectrum of an entry: "file.csv:column", a table, or one number unless it is a radiance."""
    try:
        if isinstance(entry, str):
            return read_spectrum(path.parent, entry, outside)
        if isinstance(entry, dict):
            table = SpectrumTable.model_validate(entry)
            return Spectrum(np.array(table.wavelength_nm), np.array(table.values), outside)
        if isinstance(entry, int | float) and not isinstance(entry, bool) and outside == "hold":
            return Spectrum(np.array([550.0]), np.array([float(entry)]), outside)
    except ValidationError as error:
        raise combined(faults_of_validation(Path(where), error, SpectrumTable)) from None
    except OverflowError:
        raise InputError(where, "an integer too large for a float", "a reflectance") from None
    except InputError as error:
        raise referred(error, where) from None
    constant = ", or one number" if outside == "hold" else ""
    expected = f"'file.csv:column', or {{ wavelength_nm = [...], values = [...] }}{constant}"
    raise InputError(where, repr(entry), expected)
