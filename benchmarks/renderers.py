"""Other renderers on the published box against our picture: each surface's difference, as they really ran.

    python benchmarks/renderers.py [--with mitsuba,radiance,raysect] [--size 64] [--samples 256] [--batches 8]

Every surface counts that lies within 0.2 % of ours, its standard deviation being at most 0.1 %; a surface whose error
is larger is not decided. Raysect, whose paths are the noisiest, takes by far the longest.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from cboxlab.render.export import ExportSettings, exported_scene
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validate.renderers import compare_renderers

WAVELENGTHS = np.array([450.0, 500.0, 550.0, 600.0, 650.0, 700.0])
WITHIN, SIGMA = 0.002, 0.001


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--with", dest="names", default="mitsuba,radiance,raysect")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--batches", type=int, default=8)
    chosen = parser.parse_args(arguments)
    settings = ExportSettings(WAVELENGTHS, chosen.samples, chosen.batches)
    exported = exported_scene(cornell_box(), cornell_camera(chosen.size), settings)
    compared = compare_renderers(exported, chosen.names.split(","))
    for line in compared.left_out:
        print(line)
    for judged in compared.judged:
        print(f"\n{judged.renderer}: {judged.sentence}")
        print(f"  {judged.cpu_s:.0f} CPU s, variance x CPU s {judged.cost:.3g}")
        decided = {name: row for name, row in judged.surfaces.items() if row[1] <= SIGMA}
        near = [name for name, (difference, _) in decided.items() if abs(difference) <= WITHIN]
        for name, (difference, sigma) in judged.surfaces.items():
            print(f"  {name:12s} {difference:+.3%} +- {sigma:.3%}")
        print(
            f"  {len(near)} of {len(judged.surfaces)} surfaces within {WITHIN:.1%}; "
            f"{len(judged.surfaces) - len(decided)} with an error above {SIGMA:.1%}"
        )


if __name__ == "__main__":
    main()
