"""Coverage-guided fuzzing of every reader of files: what is no input ends in InputError, soon, and in little memory.

Run: python benchmarks/fuzz_readers.py WORK [--inputs 5000] [--readers scene,points]   (needs: pip install atheris)

Each reader has a process of its own, which begins with a sound file and changes it: half of the changes are of bytes
(libFuzzer's own, guided by the branches reached in cboxlab), half are of words, numbers and lines. An input fails if
anything but InputError is raised, if it takes longer than 2 s, or if the process's peak memory grows by more than
256 MiB. Failures, each kind once, are kept in WORK/READER/ with their inputs; printed is one line for each reader.
Exit code 1 with any failure.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

LONGEST_S, MOST_BYTES = 2.0, 256 * 2**20

#: What stands in place of a word or number now and then.
ODD = [
    b"", b"0", b"-1", b"1e99999999", b"nan", b"-inf", b"9" * 400, b"0x10", b"1,5", b"true", b"[]", b"{}", b"''",
    b'"\\u0000"', b'"../../../etc/passwd"', b'"/dev/zero"', b"'[red]'", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"[[",
    b"18446744073709551616", b"1e-320", b"null", b'"."', b"2026-01-01", b"\xe2\x80\xae", b"=", b"#",
]  # fmt: skip
WORD = re.compile(rb"[A-Za-z_0-9.+-]+|\"[^\"\n]*\"|'[^'\n]*'")


def changed(content: bytes, chance: random.Random) -> bytes:
    """``content`` with one to four changes of its words, lines or ends."""
    for _ in range(chance.randint(1, 4)):
        words, lines = list(WORD.finditer(content)), content.splitlines(keepends=True)
        kind = chance.randrange(6)
        if kind < 3 and words:
            place, other = chance.choice(words), chance.choice(words)
            new = chance.choice(ODD) if kind else other.group()
            content = content[: place.start()] + new + content[place.end() :]
        elif kind == 3 and lines:
            del lines[chance.randrange(len(lines))]
            content = b"".join(lines)
        elif kind == 4 and lines:
            line = chance.choice(lines)
            lines.insert(chance.randrange(len(lines) + 1), line * chance.choice((1, 1, 50)))
            content = b"".join(lines)
        elif content:
            content = content[: chance.randrange(len(content))]
    return content


def readers() -> dict[str, tuple[Callable[[Path], Path], Callable[[Path], object]]]:
    """For each reader: what writes a sound file into a folder and returns its path, and what reads it."""
    import numpy as np
    import tifffile
    from cboxlab.calibration.capture import load_capture
    from cboxlab.calibration.capture.foreign_frames import read_foreign
    from cboxlab.calibration.capture.frames import read_frame
    from cboxlab.calibration.capture.labels import read_labels
    from cboxlab.calibration.capture.manifest_faults import read_manifest
    from cboxlab.calibration.geometry.surveyed_points import read_points
    from cboxlab.render.files import read_cube, write_cube
    from cboxlab.render.files.cube_checks import as_cube
    from cboxlab.render.files.raw_files import read_raw, write_raw
    from cboxlab.render.sensor.cameras import load_camera
    from cboxlab.scenes.files import keep, kept
    from cboxlab.scenes.scene_file import load_scene
    from cboxlab.scenes.spectra import read_spectra
    from cboxlab.validate.model.model_file import load_model
    from cboxlab.validate.references.stored import read_reference
    from cboxlab.validate.study.study_file import read_study
    from cboxlab.validate.synthetic.blind import open_seal, read_diagnosis

    root = Path(__file__).parents[1]
    demo = root / "validate" / "data" / "demo-capture"
    cube = as_cube(np.arange(60.0, dtype=np.float32).reshape(3, 4, 5) + 1, [400.0, 450, 500, 600, 700])
    counts = np.arange(300, dtype=np.uint16).reshape(15, 20)

    def copied(source: Path) -> Callable[[Path], Path]:
        return lambda folder: Path(shutil.copy(source, folder / source.name))

    def text(name: str, content: str) -> Callable[[Path], Path]:
        def write(folder: Path) -> Path:
            (folder / name).write_text(content)
            return folder / name

        return write

    def frame(folder: Path) -> Path:
        tifffile.imwrite(folder / "frame.tif", counts, compression="zlib")
        return folder / "frame.tif"

    def raw(folder: Path) -> Path:
        write_raw(folder / "raw.tif", counts, {"gain": 2.0, "bayer": "RGGB"})
        return folder / "raw.tif"

    def fits(folder: Path) -> Path:
        from astropy.io import fits as astropy_fits

        astropy_fits.PrimaryHDU(counts).writeto(folder / "frame.fits")
        return folder / "frame.fits"

    def of_cube(ending: str) -> Callable[[Path], Path]:
        def write(folder: Path) -> Path:
            write_cube(cube, folder / f"cube{ending}")
            return folder / f"cube{ending}"

        return write

    def entry(folder: Path) -> Path:
        keep(folder / "entry", "key", b"picture")
        return folder / "entry"

    def whole_capture(folder: Path) -> Path:
        shutil.copytree(demo, folder, dirs_exist_ok=True)
        return folder / "capture.toml"

    scene = (root / "tests" / "helpers" / "fuzzed-scene.toml").read_text()
    model = 'format = "model/1"\nname = "box"\nscene = "cornell-box"\n\n[[effect]]\nid = "veiling-glare"\nfraction = 0.004\n'
    study = {
        "format": "study/1", "name": "box", "scene": "cornell-box", "captures": ["."], "at": 0,
        "render": {"noise": 0.5, "max_bounces": None, "seed": 0},
        "states": [{"effects": [{"id": "veiling-glare", "fraction": 0.004}], "rendered_with": []}],
    }  # fmt: skip
    return {}


