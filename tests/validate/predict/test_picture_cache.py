"""Kept pictures change no bit of an answer: the key is all that a picture is made from, and damage is noticed."""

import hashlib
import io
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.radiosity.final_gather import gather, solve_light
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from cboxlab.utils.progress import Cancelled, ProgressReporter, stoppable
from cboxlab.validation.predict import picture_cache
from cboxlab.validation.predict.picture_cache import cached_picture, picture_key, sources
from helpers.places import ROOT

pytestmark = pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")

SCENE, CAMERA = cornell_box(), cornell_camera(16)
SAMPLES, BATCHES, SEED = 8, 2, 3


def light_of(scene=SCENE, **options):
    return solve_light(scene, WAVELENGTH_NM[::30], patch_edge_mm=250.0, patch_samples=32, **options)


@pytest.fixture(scope="module")
def light():
    return light_of()


@pytest.fixture
def renderings(monkeypatch):
    """The cameras of the pictures that were not found."""
    cameras = []

    def counted(light, camera, *rest):
        cameras.append(camera)
        return gather(light, camera, *rest)

    monkeypatch.setattr(picture_cache, "gather", counted)
    return cameras


def same_bits(first, second):
    for name in ("coefficients", "spectra", "wavelength_nm", "coverage", "facet_surface"):
        first_value, other = getattr(first, name), getattr(second, name)
        assert first_value.dtype == other.dtype and first_value.tobytes() == other.tobytes(), name
    return first.surface_names == second.surface_names


def picture(folder, light, camera=CAMERA):
    return cached_picture(folder, light, camera, SAMPLES, BATCHES, SEED)


def test_a_picture_has_the_same_bits_without_a_cache_from_a_cold_and_from_a_warm_one(tmp_path, light, renderings):
    without, cold, warm = (picture(folder, light) for folder in (None, tmp_path, tmp_path))
    assert len(renderings) == 2
    assert same_bits(without, cold) and same_bits(without, warm)
    assert same_bits(without, gather(light, CAMERA, SAMPLES, BATCHES, SEED))


def test_reading_stops_at_each_checkpoint_and_renders_nothing(tmp_path, light, renderings):
    class Counted(ProgressReporter):
        def check(self):
            self.left -= 1
            if self.left == 0:
                self.cancel()
            super().check()

    stored, stops = picture(tmp_path, light), 0
    while True:
        reporter = Counted()
        reporter.left = stops + 1
        try:
            with stoppable(reporter):
                again = picture(tmp_path, light)
            break
        except Cancelled:
            stops += 1
    assert stops >= 4 and len(renderings) == 1 and same_bits(stored, again)


def test_a_solution_found_again_has_the_same_key(light):
    """Else a second run would find nothing of the first one's."""
    assert picture_key(light_of(), CAMERA, SAMPLES, BATCHES, SEED) == picture_key(light, CAMERA, SAMPLES, BATCHES, SEED)


def test_a_camera_however_near_has_its_own_picture(tmp_path, light, renderings):
    picture(tmp_path, light)
    moved = np.nextafter(CAMERA.position_mm[0], np.inf)
    near = replace(CAMERA, position_mm=np.array([moved, *CAMERA.position_mm[1:]]))
    picture(tmp_path, light, near)
    assert len(renderings) == 2
    surveyed = replace(CAMERA, covariance=np.eye(10))  # how well it is known changes no picture
    picture(tmp_path, light, surveyed)
    assert len(renderings) == 2


def test_the_key_is_all_that_the_picture_is_made_from(light, monkeypatch):
    """Another paint, lamp, place, cut, size, seed, version or code is another key."""
    calls = [
        (light, CAMERA, SAMPLES, BATCHES, SEED),
        (light, CAMERA, 2 * SAMPLES, BATCHES, SEED),
        (light, CAMERA, SAMPLES, BATCHES + 1, SEED),
        (light, CAMERA, SAMPLES, BATCHES, SEED + 1),
        (light, cornell_camera(17), SAMPLES, BATCHES, SEED),
        (light_of(seed=1), CAMERA, SAMPLES, BATCHES, SEED),
        (light_of(max_bounces=3), CAMERA, SAMPLES, BATCHES, SEED),
    ]
    scenes = [
        apply_checked(effect, values, "test").apply(SCENE)
        for effect, values in (
            ("wall-reflectance", {"material": "red", "scale": 1.01}),
            ("lamp-power", {"scale": 1.01}),
            ("lamp-directional", {"exponent": 0.1}),
            ("block-pose", {"block": "tall", "dx_mm": 0.1}),
        )
    ]
    scenes.append(replace(SCENE, lamp=replace(SCENE.lamp, pattern=np.array([[0.5, 1.5]]))))
    calls += [(light_of(scene), CAMERA, SAMPLES, BATCHES, SEED) for scene in scenes]
    keys = [picture_key(*each) for each in calls]
    for target, value in (
        ("mi.__version__", "0"),
        ("dr.__version__", "0"),
        ("np.__version__", "0"),
        ("_code", bytes),
    ):
        with monkeypatch.context() as changed:
            changed.setattr(f"{picture_cache.__name__}.{target}", value)
            keys.append(picture_key(*calls[0]))
    assert len(set(keys)) == len(keys)


def test_all_code_that_makes_a_picture_is_in_the_key():
    """Every function of ours that runs while a picture is made lies in a file that the key covers."""
    run = set()
    sys.setprofile(lambda frame, event, _: run.add(frame.f_code.co_filename))
    try:
        gather(light_of(), CAMERA, SAMPLES, BATCHES, SEED)
    finally:
        sys.setprofile(None)
    files = {Path(name).resolve() for name in run if name.endswith(".py")}
    rooms = [ROOT / room for room in ("scenes", "render", "calibration", "validate")]
    ours = {path for path in files if any(path.is_relative_to(room) for room in rooms)}
    assert len(ours) > 10
    assert ours <= {path.resolve() for path in sources()}


def test_a_damaged_entry_is_replaced(tmp_path, light, renderings, monkeypatch):
    """Every one of a thousand flipped bits and truncations is noticed: the picture is made again and kept."""
    expected = picture(tmp_path, light)
    (entry,) = tmp_path.iterdir()
    sound = entry.read_bytes()
    generator = np.random.default_rng(7)
    size = len(sound)
    monkeypatch.setattr(picture_cache, "gather", lambda *_: renderings.append(1) or expected)
    ends = [*range(120), *(size - 1 - np.arange(120))]  # checksum and headers, the directory of the archive
    positions = np.concatenate([ends, generator.integers(0, size, 260)])
    damaged = []
    for position, bit in zip(positions, generator.integers(0, 8, len(positions)), strict=True):
        flipped = bytearray(sound)
        flipped[position] ^= 1 << bit
        damaged.append(bytes(flipped))
    damaged += [sound[:length] for length in (*range(40), *generator.integers(40, size, 460))]
    renderings.clear()
    for count, content in enumerate(damaged, 1):
        entry.write_bytes(content)
        assert same_bits(picture(tmp_path, light), expected)
        assert len(renderings) == count
        assert entry.read_bytes() == sound


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays.pop("coverage"),
        lambda arrays: arrays.update(coefficients=arrays["coefficients"][:1]),
        lambda arrays: arrays.update(coefficients=arrays["coefficients"].astype(float)),
        lambda arrays: arrays.update(coverage=arrays["coverage"][..., 0]),
        lambda arrays: arrays.update(coverage=np.array([{}], dtype=object)),
        lambda arrays: arrays.clear(),
    ],
)
def test_an_entry_of_another_shape_is_replaced(tmp_path, light, renderings, change):
    """Also one whose checksum is right."""
    expected = picture(tmp_path, light)
    (entry,) = tmp_path.iterdir()
    arrays = {"coefficients": expected.coefficients, "coverage": expected.coverage}
    change(arrays)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    entry.write_bytes(hashlib.sha256(entry.stem.encode() + stream.getvalue()).digest() + stream.getvalue())
    for _ in range(2):
        assert same_bits(picture(tmp_path, light), expected)
        assert len(renderings) == 2


def test_an_entry_under_another_name_is_not_taken(tmp_path, light, renderings):
    picture(tmp_path, light)
    (entry,) = tmp_path.iterdir()
    moved = CAMERA.with_parameters(CAMERA.parameters + np.eye(10)[0])
    entry.rename(tmp_path / f"{picture_key(light, moved, SAMPLES, BATCHES, SEED)}.picture")
    assert same_bits(picture(tmp_path, light, moved), gather(light, moved, SAMPLES, BATCHES, SEED))


def test_a_cache_that_cannot_be_written_is_no_fault(tmp_path, light, renderings):
    path = tmp_path / "file"
    path.write_text("no folder")
    for _ in range(2):
        picture(path, light)
    assert len(renderings) == 2
