"""A renderer of another package: every pixel has the radiance 1, but for a little noise."""

from dataclasses import replace

import numpy as np
from cboxlab.rendering.export import Renderer, npy_pixels

SCRIPT = """
import os
import numpy as np
os.makedirs("out", exist_ok=True)
for batch in range({batches}):
    noise = np.random.default_rng(batch).standard_normal({shape})
    np.save(f"out/batch-{{batch}}.npy", 1 + 0.01 * noise)
"""


def write(folder, exported):
    """run.py, which knows the film's size."""
    layout = exported.layout
    shape = layout.film_height_px, layout.film_width_px, layout.channels
    (folder / "run.py").write_text(SCRIPT.format(batches=layout.settings.batches, shape=shape))


def read(folder, layout):
    """(batch, film y, film x, w)."""
    shape = layout.film_height_px, layout.film_width_px, layout.channels
    batches = range(layout.settings.batches)
    return np.stack([npy_pixels(folder / "out" / f"batch-{batch}.npy", shape) for batch in batches])


RENDERER = Renderer("flat", "Flat", write, read, ("{python}", "run.py"), "film", package="numpy")
ABSENT = replace(RENDERER, id="absent", name="Absent", package="", programs=("no-such-program",))
