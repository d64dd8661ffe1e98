"""A disk that takes a part of a file: every writer says so, and leaves nothing."""

import subprocess
import sys

# Libraries have various errors for it, and some crash; hence a separate process.
WRITING = """
import resource, signal, sys
from pathlib import Path
import numpy as np, xarray as xr
from cboxlab.rendering.files import RADIANCE_UNIT, WRITABLE, write_channels, write_cube, write_raw
from cboxlab.utils.errors import InputError

light = np.random.default_rng(1).random((40, 40, 3)).astype(np.float32)
cube = xr.Dataset(
    {"radiance": (("y", "x", "wavelength"), light, {"units": RADIANCE_UNIT})},
    {"wavelength": ("wavelength", [450.0, 550.0, 650.0], {"units": "nm"})},
)
counts = (60000 * light[..., 0]).astype(np.uint16)
folder = Path(sys.argv[1])
writers = {f"cube{ending}": lambda path: write_cube(path, cube) for ending in WRITABLE}
writers |= {"map.exr": lambda path: write_channels(path, {}, {"a": light[..., 0].copy()})}
writers |= {"raw.tif": lambda path: write_raw(path, counts)}
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for most in (0, 300, 2000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    for name, write in writers.items():
        try:
            write(folder / name)
            print(most, name, "written")
        except (InputError, OSError) as error:
            assert str(folder / name) in str(error) and "unfinished" not in str(error), error
        left = [path.name for path in folder.iterdir()]
        assert not left, (most, name, left)
print(sorted(writers))
"""


def test_every_format_refuses_a_full_disk_and_leaves_nothing(tmp_path):
    done = subprocess.run([sys.executable, "-c", WRITING, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "['cube.exr', 'cube.hdr', 'cube.nc', 'cube.png', 'map.exr', 'raw.tif']\n"
