"""Coverage-guided fuzzing of every reader of files: what is no input ends in InputError, soon, and in little memory.

Run: python benchmarks/mistakes/fuzz_readers.py WORK [--inputs 5000] [--readers scene,points] [--plain]
Needs `pip install atheris`, unless --plain is given: changes of bytes are then random.

Each reader runs in a separate process, which begins with a sound file and changes it: half of the changes are of bytes
(libFuzzer's own, guided by the branches reached in cboxlab), half are of words, numbers and lines. An input fails if
anything but InputError is raised, if it takes longer than 2 s, or if the process's peak memory grows by more than
256 MiB. Failures, each kind once, are kept in WORK/READER/ with their inputs; printed is one line for each reader.
Exit code 1 with any failure.
"""

from __future__ import annotations

import argparse
import json
import os
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
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from further_readers import further_readers
from newer_readers import newer_readers

LONGEST_S, MOST_BYTES = 2.0, 256 * 2**20

#: What stands in place of a word or number now and then.
ODD = [
    b"",
    b"0",
    b"-1",
    b"1e99999999",
    b"nan",
    b"-inf",
    b"9" * 400,
    b"0x10",
    b"1,5",
    b"true",
    b"[]",
    b"{}",
    b"''",
    b'"\\u0000"',
    b'"../../../etc/passwd"',
    b'"/dev/zero"',
    b"'[red]'",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"\r",
    b"[[",
    b"18446744073709551616",
    b"1e-320",
    b"null",
    b'"."',
    b"2026-01-01",
    b"\xe2\x80\xae",
    b"=",
    b"#",
]
WORD = re.compile(rb"[A-Za-z_0-9.+-]+|\"[^\"\n]*\"|'[^'\n]*'")


def changed(content: bytes, chance: random.Random) -> bytes:
    """``content`` with one to four changes of its words, lines or ends."""
    for _ in range(chance.choice((1, 1, 2, 4))):
        tokens, lines = list(WORD.finditer(content)), content.splitlines(keepends=True)
        kind = chance.randrange(6)
        if kind < 3 and tokens:
            token, other = chance.choice(tokens), chance.choice(tokens)
            new = chance.choice(ODD) if kind else other.group()
            content = content[: token.start()] + new + content[token.end() :]
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


def changed_bytes(content: bytes, chance: random.Random) -> bytes:
    """``content`` with one to four changes of bytes, at places spread evenly over the file or near its beginning."""
    data = bytearray(content)
    for _ in range(chance.choice((1, 1, 2, 4))):
        if not data:
            break
        position = chance.randrange(min(len(data), chance.choice((512, len(data)))))
        size = chance.choice((1, 2, 4, 8))
        kind = chance.randrange(4)
        if kind == 0:
            data[position] ^= 1 << chance.randrange(8)
        elif kind == 1:
            data[position : position + size] = chance.choice((b"\0", b"\xff", b"\x80", b"\x7f")) * size
        elif kind == 2:
            data[position : position + size] = chance.randbytes(size)
        else:
            del data[position : position + size]
    return bytes(data)


@dataclass(frozen=True)
class Reader:
    """sound : writes a sound file into a folder and returns its path. read : is given the path of a changed one."""

    sound: Callable[[Path], Path]
    read: Callable[[Path], object]


def readers() -> dict[str, Reader]:
    """Every reader of files by name."""
    import numpy as np
    import tifffile
    from astropy.io import fits
    from cboxlab.calibration.capture import load_capture
    from cboxlab.calibration.capture.frames import read_frame
    from cboxlab.calibration.capture.labels import read_labels
    from cboxlab.calibration.frame_readers import read_pictures
    from cboxlab.calibration.geometry.surveyed_points import read_points
    from cboxlab.rendering.files import read_cube, write_cube
    from cboxlab.rendering.files.cube_checks import as_cube
    from cboxlab.rendering.files.raw_files import write_raw
    from cboxlab.rendering.model.model_file import load_model
    from cboxlab.rendering.sensor.cameras import load_camera
    from cboxlab.scenes.scene_file import load_scene
    from cboxlab.scenes.spectra import read_spectra
    from cboxlab.utils.files import load_checked, store_checked
    from cboxlab.validation.compare_renders.stored_references.stored import read_reference
    from cboxlab.validation.study.study_file import read_study
    from cboxlab.validation.synthetic.blind import open_seal, read_diagnosis

    root = Path(__file__).parents[2]
    demo = root / "validate" / "data" / "demo-capture"
    cube = as_cube(np.arange(60, dtype=np.float32).reshape(3, 4, 5) + 1, [400.0, 450, 500, 600, 700])
    counts = np.arange(300, dtype=np.uint16).reshape(15, 20)

    def with_neighbours(source: Path) -> Callable[[Path], Path]:
        """A file with all that lies next to it."""

        def sound(folder: Path) -> Path:
            shutil.copytree(source.parent, folder, dirs_exist_ok=True)
            return folder / source.name

        return sound

    def written(name: str, write: Callable[[Path], object]) -> Callable[[Path], Path]:
        def sound(folder: Path) -> Path:
            write(folder / name)
            return folder / name

        return sound

    def text(name: str, content: object) -> Callable[[Path], Path]:
        return written(name, lambda path: path.write_text(content if isinstance(content, str) else json.dumps(content)))

    def of_cube(ending: str) -> Reader:
        return Reader(written(f"cube{ending}", lambda path: write_cube(path, cube)), read_cube)

    def of_folder(read: Callable[[Path], object]) -> Callable[[Path], object]:
        return lambda path: read(path.parent)

    glare = {"id": "veiling-glare", "fraction": 0.004}
    return {
        "capture": Reader(with_neighbours(demo / "capture.toml"), of_folder(load_capture)),
        "seal": Reader(with_neighbours(demo / "sealed.json"), of_folder(open_seal)),
        "answer": Reader(with_neighbours(demo / "answer.sealed"), of_folder(open_seal)),
        "scene": Reader(with_neighbours(root / "scenes/data/cornell-box.toml"), load_scene),
        "camera": Reader(with_neighbours(root / "render/sensor/data/dcs200.toml"), load_camera),
        "model": Reader(
            text(
                "model.toml",
                'format = "model/1"\nname = "box"\nscene = "cornell-box"\n[render]\nnoise = 0.5\nseed = 0\n'
                '[[effect]]\nid = "veiling-glare"\nfraction = 0.004\n'
                '[[effect]]\nid = "gloss"\nmaterial = "white"\nspecular = 0.05\nroughness = 0.2\n',
            ),
            load_model,
        ),
        "study": Reader(
            text(
                "study.json",
                {
                    "format": "study/1",
                    "name": "box",
                    "scene": "cornell-box",
                    "captures": ["."],
                    "at": 0,
                    "render": {"noise": 0.5, "max_bounces": None, "seed": 0},
                    "states": [{"effects": [glare], "rendered_with": []}],
                },
            ),
            read_study,
        ),
        "reference": Reader(
            text(
                "reference.json",
                {
                    "format": "light-reference/1",
                    "means": {"floor": 1.0},
                    "sigma": {"floor": 1e-4},
                    "degrees": 7.0,
                    "seed": 1,
                    "samples": 64,
                    "versions": {"cboxlab": "1"},
                },
            ),
            read_reference,
        ),
        "diagnosis": Reader(
            text(
                "diagnosis.json",
                {
                    "ranking": [{"effect": "veiling-glare", "parameters": {"fraction": 0.004}, "probability": 0.9}],
                    "selected": ["veiling-glare"],
                },
            ),
            read_diagnosis,
        ),
        "spectra": Reader(with_neighbours(demo / "spectra" / "filters.csv"), read_spectra),
        "points": Reader(with_neighbours(demo / "points.csv"), read_points),
        "labels": Reader(text("labels.csv", "label,name,column\n1,floor,white\n2,wall,red\n"), read_labels),
        "frame": Reader(
            written("frame.tif", lambda path: tifffile.imwrite(path, counts, compression="zlib")),
            lambda path: read_frame(path, 15, 20, 12),
        ),
        "raw": Reader(
            written("raw.tif", lambda path: write_raw(path, counts, {"gain": 2.0})),
            lambda path: read_frame(path, 15, 20, 16),
        ),
        "tiff": Reader(written("a.tiff", lambda path: tifffile.imwrite(path, counts)), read_pictures),
        "fits": Reader(written("a.fits", lambda path: fits.PrimaryHDU(counts).writeto(path)), read_pictures),
        "netcdf": of_cube(".nc"),
        "exr": of_cube(".exr"),
        "envi": of_cube(".hdr"),
        "kept": Reader(
            written("entry", lambda path: store_checked(path, "key", b"picture")),
            lambda path: load_checked(path, "key"),
        ),
        **{name: Reader(sound, read) for name, (sound, read) in (further_readers() | newer_readers()).items()},
    }


def peak_bytes() -> int:
    """The process's largest memory so far, bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


class Fuzzed:
    """One reader's inputs: how many, and which failed in which way."""

    def __init__(self, reader: Reader, allowed: type[Exception], work: Path) -> None:
        self.reader, self.known, self.work = reader, allowed, work
        self.place = Path(tempfile.mkdtemp())
        self.path = reader.sound(self.place)
        self.content = self.path.read_bytes()
        reader.read(self.path)
        self.inputs = self.refused = 0
        self.failures: dict[str, str] = {}
        self.slowest = 0.0

    def __call__(self, content: bytes) -> None:
        self.path.write_bytes(content)
        self.inputs += 1
        before, start = peak_bytes(), time.process_time()
        try:
            self.reader.read(self.path)
        except self.known:
            self.refused += 1
        except BaseException as error:  # any other is a failure
            if isinstance(error, KeyboardInterrupt):
                raise
            last = traceback.extract_tb(error.__traceback__)[-1]
            self._failed(f"{type(error).__name__} in {Path(last.filename).name}:{last.lineno}", content)
        seconds = time.process_time() - start
        self.slowest = max(self.slowest, seconds)
        if seconds > LONGEST_S:
            self._failed("too slow", content)
        if peak_bytes() - before > MOST_BYTES:
            self._failed("too much memory", content)

    def _failed(self, kind: str, content: bytes) -> None:
        if kind not in self.failures:
            self.failures[kind] = traceback.format_exc()
            (self.work / f"failure-{len(self.failures)}").write_bytes(content)
            (self.work / f"failure-{len(self.failures)}.txt").write_text(f"{kind}\n{self.failures[kind]}")


def fuzz(name: str, inputs: int, seed: int, work: Path, plain: bool) -> None:
    """All inputs of one reader, in this process, which ends with it; the counts go to WORK/READER/counts.json."""
    if plain:
        reader = readers()[name]
    else:
        import atheris

        with atheris.instrument_imports(include=["cboxlab"]):
            reader = readers()[name]
    from cboxlab.utils.errors import InputError

    fuzzed = Fuzzed(reader, InputError, work)
    chance = random.Random(seed)

    def change(data: bytes, most: int, own_seed: int) -> bytes:
        chance.seed(own_seed)
        return (atheris.Mutate(data, most) if chance.random() < 0.5 else changed(data, chance))[:most]

    def judged(data: bytes) -> None:
        fuzzed(data)
        if fuzzed.inputs % 100 == 0 or fuzzed.inputs >= inputs:
            counts = {
                "inputs": fuzzed.inputs,
                "refused": fuzzed.refused,
                "slowest_s": fuzzed.slowest,
                "failures": fuzzed.failures,
            }
            (work / "counts.json").write_text(json.dumps(counts))

    if plain:
        for _ in range(inputs):
            judged((changed_bytes if chance.random() < 0.5 else changed)(fuzzed.content, chance))
        return
    corpus = work / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    (corpus / "sound").write_bytes(fuzzed.content)
    longest = 2 * len(fuzzed.content) + 4096
    options = [
        f"-runs={inputs}",
        f"-seed={seed}",
        f"-max_len={longest}",
        "-rss_limit_mb=0",
        f"-artifact_prefix={work}/",
        "-print_final_stats=0",
    ]
    atheris.Setup([sys.argv[0], *options, str(corpus)], judged, custom_mutator=change)
    atheris.Fuzz()


def forked(log: TextIO, name: str, options: argparse.Namespace) -> int:
    """Exit code of a copy of this process that fuzzes one reader: all libraries are imported already."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
        fuzz(name, options.inputs, options.seed, options.work / name, plain=True)
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        os._exit(1)


def main() -> int:
    """Fuzz every reader, each in its own process, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("--inputs", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--readers", help="some of them, by comma")
    parser.add_argument("--plain", action="store_true", help="without atheris")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        fuzz(options.one, options.inputs, options.seed, options.work / options.one, plain=False)
    failed = 0
    for name in options.readers.split(",") if options.readers else readers():
        folder = options.work / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        command = [sys.executable, __file__, str(options.work), "--one", name]
        command += ["--inputs", str(options.inputs), "--seed", str(options.seed)]
        with (folder / "log").open("w") as log:
            if options.plain:
                code = forked(log, name, options)
            else:
                code = subprocess.run(command, stdout=log, stderr=log, check=False).returncode
        try:
            counts = json.loads((folder / "counts.json").read_text())
        except FileNotFoundError:
            counts = {"inputs": 0, "refused": 0, "slowest_s": 0.0, "failures": {}}
        kinds = list(counts["failures"]) + ([f"exit code {code}"] if code else [])
        failed += len(kinds)
        print(
            f"{name:18s} {counts['inputs']:7d} inputs, {counts['refused']:7d} refused, "
            f"slowest {counts['slowest_s']:.2f} s, {len(kinds)} failures {', '.join(kinds)}",
            flush=True,
        )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
