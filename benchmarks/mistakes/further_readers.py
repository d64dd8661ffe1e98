"""Readers of frames, spectra, cubes, recipes, lenses, meshes and effects, each with sound files, for the fuzzing."""

from __future__ import annotations

import gzip
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

#: By name of a reader, what writes a sound file into a folder, and what reads a changed one.
Pairs = dict[str, tuple[Callable[[Path], Path], Callable[[Path], object]]]


def written_file(name: str, write: Callable[[Path], object]) -> Callable[[Path], Path]:
    """What writes a file of that name."""

    def sound(folder: Path) -> Path:
        write(folder / name)
        return folder / name

    return sound


def text_file(name: str, content: str) -> Callable[[Path], Path]:
    return written_file(name, lambda path: path.write_text(content, encoding="utf-8"))


def _copy(name: str, source: Path) -> Callable[[Path], Path]:
    return written_file(name, lambda path: path.write_bytes(source.read_bytes()))


def frames() -> Pairs:
    """Formats of photographs next to a plain TIFF."""
    import numpy as np
    import tifffile
    from cboxlab.calibration.frame_readers import read_pictures, read_values
    from cboxlab.rendering.files.exr_channels import write_channels
    from helpers.files.frame_files import write_dng, write_fits
    from helpers.files.rgbe import write_rgbe

    counts = np.arange(24 * 32, dtype=np.uint16).reshape(24, 32)
    repeats = np.stack([counts, counts + 1, counts + 2])
    grey = {"photometric": "minisblack"}
    merged = counts.astype(np.float32)

    def packed(path: Path) -> None:
        plain = path.with_name("plain.fits")
        write_fits(plain, repeats, EXPTIME=2.0)
        path.write_bytes(gzip.compress(plain.read_bytes()))

    keywords = {"EXPTIME": 2.0, "FOCRATIO": 8}
    return {
        "dng": (written_file("a.dng", lambda path: write_dng(path, counts)), read_pictures),
        "fits-cube": (
            written_file("a.fits", lambda path: write_fits(path, repeats, **keywords)),
            read_pictures,
        ),
        "fits-gz": (written_file("a.fits.gz", packed), read_pictures),
        "fits-fz": (written_file("a.fits.fz", lambda path: write_fits(path, repeats, GAIN=3)), read_pictures),
        "tiff-pages": (
            written_file("a.tif", lambda path: tifffile.imwrite(path, repeats, compression="zlib", **grey)),
            read_pictures,
        ),
        "tiff-merged": (
            written_file("a.tif", lambda path: tifffile.imwrite(path, merged)),
            read_values,
        ),
        "imagej": (
            written_file("a.tif", lambda path: tifffile.imwrite(path, repeats, imagej=True, metadata={"axes": "TYX"})),
            read_pictures,
        ),
        "hdr-frame": (written_file("a.hdr", lambda path: write_rgbe(path, np.ones((8, 12, 3)))), read_values),
        "exr-frame": (written_file("a.exr", lambda path: write_channels(path, {}, {"f550": merged})), read_values),
    }


def tables() -> Pairs:
    """Spectra of every instrument, and tables of text."""
    from cboxlab.rendering.dataset import load_recipe
    from cboxlab.rendering.export.neutral import read_camera
    from cboxlab.rendering.fitted_fields import load_effect_file
    from cboxlab.scenes.shapes import file_mesh
    from cboxlab.scenes.spectrum_readers import read_instrument_file
    from cboxlab.validation.api import verify
    from helpers.files.instrument_texts import INSTRUMENTS
    from helpers.scenes.recipes import PLAIN

    entry = {"bytes": 3, "sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"}
    manifest = {"format": "result-manifest/1", "inputs": {}, "outputs": {"a.txt": entry}}
    camera = {
        "format": "camera/1",
        "width_px": 20,
        "height_px": 15,
        "position_mm": [278, 273, -800],
        "look_at_mm": [278, 273, 0],
        "focal_length_px": 28.0,
        "principal_point_px": [9.5, 7.0],
        "k1": -0.01,
        "lens": {"model": "polynomial", "k2": 0.001, "p1": 1e-4, "aspect": 1.0},
    }
    field = (
        'format = "effect/1"\ntitle = "a gradient"\n[field]\nacts = "gain"\nbands = ["f450", "f550"]\nnm = [450, 550]\n'
        "size = [20, 15]\ncoefficients = [[0.1, 0.2, 0.3], [0.3, 0.4, 0.5]]\n"
        '[field.image]\nkind = "cosines"\norder = 1\n'
    )
    corners = "v 0 0 0 1\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1\nf -1 -2 -3\n"
    heading = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    heading += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ball = "solid a\nfacet normal 0 0 1\nouter loop\n"
    ball += "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"

    def mesh(path: Path) -> object:
        return file_mesh(path, 1.0)

    instruments = {
        f"spectrum-{name}": (text_file("spectrum.txt", sample.text), read_instrument_file)
        for name, sample in INSTRUMENTS.items()
    }
    return instruments | {
        "recipe": (text_file("recipe.toml", PLAIN), load_recipe),
        "lens": (text_file("camera.json", json.dumps(camera, indent=1)), read_camera),
        "effect": (text_file("gradient.toml", field), load_effect_file),
        "obj": (text_file("mesh.obj", corners), mesh),
        "ply": (text_file("mesh.ply", heading + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), mesh),
        "stl": (text_file("mesh.stl", ball), mesh),
        "result": (text_file("manifest.json", json.dumps(manifest, indent=1)), lambda path: verify(path.parent)),
    }


def cubes() -> Pairs:
    """Cubes of other programs, and pictures as ``cbox regress`` reads them."""
    import numpy as np
    from cboxlab.rendering.files import Declared, read_cube, read_picture
    from cboxlab.rendering.files.exr_channels import write_channels
    from cboxlab.rendering.files.headers.envi_header import read_header
    from cboxlab.validation.compare_renders.stacks import read_stack
    from helpers.files.envi_files import LIGHT, RADIANCE, header_text, write
    from helpers.files.rgbe import write_rgbe

    headers = sorted((ROOT / "tests" / "render" / "files" / "envi_headers").glob("*.hdr"))
    plane = np.linspace(0.1, 1, 20, dtype=np.float32).reshape(4, 5)
    colours = dict.fromkeys("RGB", plane)
    radiance = Declared(units="cd m^-2", scale=179.0, colour_space="radiance")
    read_radiance = partial(read_stack, declared=radiance)
    unit = {"emissiveUnits": RADIANCE}
    spectral = {f"S0.{nm},000000nm": plane for nm in (450, 550, 650)}

    scaled = {"data_type": 2, "reflectance_scale_factor": 10000, "bbl": "{1,1,0,1,1,1}"}
    swapped = {"byte_order": 1, "data_gain_values": "{1,1,1,1,1,2}", "fwhm": "{9,9,9,9,9,9}"}
    variants = {
        "envi-bil": partial(write, text=header_text(interleave="bil"), order="bil"),
        "envi-scaled": partial(write, text=header_text(**scaled), values=1000 * LIGHT, kind="<i2"),
        "envi-swapped": partial(write, text=header_text(**swapped), kind=">f4"),
    }
    formats = {name: (sound, read_cube) for name, sound in variants.items()}
    return {
        **{f"envi-{source.stem}": (_copy("a.hdr", source), read_header) for source in headers},
        **formats,
        "regress-exr": (written_file("a.exr", lambda path: write_channels(path, {}, colours)), read_stack),
        "regress-hdr": (written_file("a.hdr", lambda path: write_rgbe(path, np.ones((6, 8, 3)))), read_radiance),
        "spectral-exr": (written_file("a.exr", lambda path: write_channels(path, unit, spectral)), read_picture),
    }


def further_readers() -> Pairs:
    """All of them."""
    return {**frames(), **tables(), **cubes()}
