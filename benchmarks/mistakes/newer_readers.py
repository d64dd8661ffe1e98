"""Readers of whole folders, boards, label images, layered pictures and data sets, with sound files, for the fuzzing."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from further_readers import ROOT, Pairs, text_file, written_file

sys.path.insert(0, str(ROOT / "tests"))

#: Files that a former version wrote.
OLD = ROOT / "tests" / "version_0_1"
#: Tables of a manifest that the capture of a former version lacks.
TABLES = """
[[bracket]]
band = "f550"
exposure_s = 0.02
start_s = 70.5
frames = ["frames/f550-0.tif"]
[[target]]
kind = "chessboard"
rows = 5
columns = 7
pitch_mm = 30.0
origin_mm = [100.0, 0.0, 200.0]
right = [1.0, 0.0, 0.0]
down = [0.0, 1.0, 0.0]
frames = ["board.tif"]
[labels]
image = "labels.png"
names = "labels.csv"
[crop]
u0_px = 4
v0_px = 6
full_width_px = 64
full_height_px = 64
"""


def _with_folder(source: Path, name: str) -> Callable[[Path], Path]:
    """A file with all that lies in its folder."""

    def sound(folder: Path) -> Path:
        shutil.copytree(source, folder, dirs_exist_ok=True)
        return folder / name

    return sound


def _full_capture(name: str) -> Callable[[Path], Path]:
    """The capture of a former version with further tables, a picture of labels and one of a board."""
    import numpy as np
    import tifffile
    from PIL import Image

    def sound(folder: Path) -> Path:
        shutil.copytree(OLD / "capture", folder, dirs_exist_ok=True)
        path = folder / "capture.toml"
        path.write_text(path.read_text(encoding="utf-8") + TABLES, encoding="utf-8")
        labels = np.zeros((32, 32), np.uint8)
        labels[4:12, 4:12], labels[20:28, 4:12] = 1, 2
        Image.fromarray(labels).save(folder / "labels.png")
        tifffile.imwrite(folder / "board.tif", np.full((32, 32), 90, np.uint16))
        (folder / "labels.csv").write_text("label,name,column\n1,floor,white\n2,wall,\n", encoding="utf-8")
        return folder / name

    return sound


def captures() -> Pairs:
    """Manifests of every table, label images, boards, and folders of frames without a manifest."""
    import numpy as np
    import tifffile
    from cboxlab.calibration.capture import draft_manifest, load_capture
    from cboxlab.calibration.frame_readers import read_pictures
    from cboxlab.calibration.geometry.targets import detect_target
    from helpers.files.frame_files import write_dng, write_fits

    rows, columns = np.indices((90, 120))
    board = np.where((rows // 15 + columns // 15) % 2, 3000, 400).astype(np.uint16)
    counts = np.arange(24 * 32, dtype=np.uint16).reshape(24, 32)
    stack = np.stack([counts, counts + 1])
    first = {"EXPTIME": 2.0, "FOCRATIO": 8, "FILTER": "f550", "IMAGETYP": "Light Frame", "DATE-OBS": "2026-01-02"}
    ome = {"axes": "TYX", "Plane": {"ExposureTime": [0.5, 0.5], "ExposureTimeUnit": ["s", "s"]}}

    def labelled(path: Path) -> object:
        capture = load_capture(path.parent)
        return None if capture.manifest.labels is None else (capture.labels(), capture.label_names())

    def drafted(path: Path) -> object:
        return draft_manifest(path.parent)

    def with_board(path: Path) -> object:
        return detect_target(np.asarray(read_pictures(path)[0]), "chessboard", 5, 7, 30.0, path.name)

    return {
        "manifest-tables": (_full_capture("capture.toml"), labelled),
        "label-image": (_full_capture("labels.png"), labelled),
        "label-names": (_full_capture("labels.csv"), labelled),
        "board": (written_file("board.tif", lambda path: tifffile.imwrite(path, board)), with_board),
        "ome": (
            written_file("a.ome.tif", lambda path: tifffile.imwrite(path, stack, ome=True, metadata=ome)),
            read_pictures,
        ),
        "folder-dng": (written_file("f550.dng", lambda path: write_dng(path, counts)), drafted),
        "folder-fits": (written_file("f550.fits", lambda path: write_fits(path, counts, **first)), drafted),
        "folder-tiff": (
            written_file("f550_2s.tif", lambda path: tifffile.imwrite(path, counts, description="Exposure: 2 s")),
            drafted,
        ),
    }


def pictures() -> Pairs:
    """Layers of OpenEXR, textures, and what another renderer hands back."""
    import numpy as np
    from cboxlab.rendering.dataset.textures import image_shares
    from cboxlab.rendering.export.neutral.raw_pixels import npy_pixels, raw_pixels
    from cboxlab.rendering.export.neutral.scene_files import read_layout, read_surfaces, read_warp
    from cboxlab.rendering.files.exr_channels import write_channels
    from cboxlab.validation.compare_renders.scene_pictures import read_scene_picture
    from PIL import Image

    plane = np.linspace(0.1, 1, 20, dtype=np.float32).reshape(4, 5)
    grey = np.arange(20, dtype=np.uint8).reshape(4, 5)
    codes = np.array([0x3F800001, 0x40000002], np.uint32).view(np.float32)[np.indices((4, 5))[1] // 3]
    layers = {f"ViewLayer.Combined.{c}": plane for c in "RGBA"} | {"ViewLayer.Depth.Z": plane}
    layers |= {f"ViewLayer.DiffCol.{c}": plane for c in "RGB"}
    layers |= {f"ViewLayer.CryptoObject00.{c}": value for c, value in zip("RG", (codes, plane * 0 + 1), strict=True)}
    matte: dict[str, Any] = {"cryptomatte/abc1234/name": "ViewLayer.CryptoObject"}
    matte["cryptomatte/abc1234/manifest"] = json.dumps({"wall": "3f800001", "floor": "40000002"})
    layout = {
        "format": "cboxlab-export/1",
        "wavelength_nm": [500.0, 600.0],
        "samples": 16,
        "batches": 2,
        "subpixels": 2,
        "width_px": 5,
        "height_px": 4,
        "film": {"width_px": 5, "height_px": 4},
        "lamp": {"reflects": False},
        "surfaces": [{"name": "floor"}, {"name": "wall"}],
    }

    def exported(name: str) -> Callable[[Path], Path]:
        def sound(folder: Path) -> Path:
            (folder / "scene.json").write_text(json.dumps(layout, indent=1), encoding="utf-8")
            Image.fromarray(grey // 12).save(folder / "surfaces.png")
            np.savez(folder / "warp.npz", row=[0, 1, 19], column=[0, 2, 5], weight=[1.0, 0.5, 0.5])
            return folder / name

        return sound

    def read_export(path: Path) -> object:
        return read_layout(path.parent), read_surfaces(path.parent), read_warp(path.parent)

    def texture(path: Path) -> object:
        return image_shares(path.name, path.parent, "recipe.toml: texture")

    shares = grey / 20
    return {
        "exr-layers": (written_file("a.exr", lambda path: write_channels(path, matte, layers)), read_scene_picture),
        "texture-png": (written_file("a.png", lambda path: Image.fromarray(grey).save(path)), texture),
        "texture-npy": (written_file("a.npy", lambda path: np.save(path, shares)), texture),
        "export": (exported("scene.json"), read_export),
        "export-surfaces": (exported("surfaces.png"), read_export),
        "export-warp": (exported("warp.npz"), read_export),
        "export-npy": (
            written_file("a.npy", lambda path: np.save(path, plane)),
            lambda path: npy_pixels(path, plane.shape),
        ),
        "export-raw": (written_file("a.bin", plane.tofile), lambda path: raw_pixels(path, plane.shape)),
    }


def results() -> Pairs:
    """Files of data sets, figures of results, and explanations that become effects."""
    from cboxlab.rendering.fitted_fields import effect_of_diagnosis
    from cboxlab.validation.dataset import open_dataset
    from cboxlab.validation.report.trend import read_trend_result

    field = {
        "acts": "gain",
        "bands": ["f450", "f550"],
        "nm": [450, 550],
        "size": [20, 15],
        "coefficients": [[0.1, 0.2, 0.3], [0.3, 0.4, 0.5]],
        "image": {"kind": "cosines", "order": 1},
    }
    explanation = {"family": "field", "form": "smooth", "told_apart": False, "runner_up": "haze", "field": field}
    diagnosis = {"format": "diagnosis/1", "selected": ["unknown"], "explanation": explanation}
    metrics = {
        "capture": "box",
        "chi2_per_dof": 1.2,
        "chi2_per_dof_sigma": 0.01,
        "lamp_scale": {"value": 1.0, "sigma": 0.01},
        "camera_refitted": {"position_mm": [1.0, 2.0, 3.0], "focal_length_px": 800.0, "k1": 0.1},
        "bands": {"f550": {"chi2_per_dof": 1.1, "chi2_per_dof_sigma": 0.1}},
        "path": [{"effects": ["veiling-glare"], "chi2_per_dof": 1.0}],
    }

    def data_set(name: str) -> tuple[Callable[[Path], Path], Callable[[Path], object]]:
        levels = len(Path(name).parents) - 1

        def read(path: Path) -> object:
            pictures = open_dataset(path.parents[levels])
            first = pictures.arrays("radiance", "depth")[0]
            return first, pictures.drawn_values(0), pictures.model(0), pictures.part("train")

        return _with_folder(OLD / "dataset", name), read

    def becomes_effect(path: Path) -> object:
        target = path.with_name("my-effect.toml")
        target.unlink(missing_ok=True)
        return effect_of_diagnosis(target, path)

    return {
        "dataset-state": data_set("dataset.json"),
        "dataset-index": data_set("index.csv"),
        "dataset-box": data_set("boxes/000000/box.json"),
        "dataset-model": data_set("boxes/000000/model.toml"),
        "dataset-picture": data_set("boxes/000000/main.nc"),
        "trend": (text_file("metrics.json", json.dumps(metrics)), lambda path: read_trend_result(path.parent)),
        "explanation": (text_file("diagnosis.json", json.dumps(diagnosis)), becomes_effect),
    }


def newer_readers() -> Pairs:
    """All of them."""
    return {**captures(), **pictures(), **results()}
