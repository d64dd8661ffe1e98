"""How many narrow filters, and which, are enough for colour: error of trained weights against their number.

    python benchmarks/calibration/filter_count.py

Candidates: 31 Gaussian filters from 400 to 700 nm, 10 nm wide at half height, before the PXL 1300L and its lens.
"""

from __future__ import annotations

import argparse

import numpy as np
from cboxlab.calibration.colour.colour_error import choose_filters
from cboxlab.calibration.colour.radiance_ensemble import (
    evaluation_radiances,
    general_lamps,
    training_radiances,
)
from cboxlab.rendering.synthetic.capture_writer import unit_factors
from cboxlab.rendering.synthetic.photographer import CaptureSettings
from cboxlab.scenes.spectra import Spectrum
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width-nm", type=float, default=10.0, help="full width at half height")
    parser.add_argument("--noise", type=float, default=0.003, help="relative noise of a band's signal")
    arguments = parser.parse_args()
    sigma = arguments.width_nm / np.sqrt(8 * np.log(2))
    filters = {
        f"{centre}": Spectrum(WAVELENGTH_NM, 0.7 * np.exp(-0.5 * ((WAVELENGTH_NM - centre) / sigma) ** 2), "zero")
        for centre in range(400, 701, 10)
    }
    candidates = unit_factors(CaptureSettings(filters=filters), 256).responses()
    for name, lamps in (("3200 K", {"3200 K": general_lamps()["3200.0 K"]}), ("nine lamps", general_lamps())):
        print(f"{name}: filters, X Y Z rms %, Delta E*ab mean max, CIEDE2000 mean max, which")
        choices = choose_filters(
            candidates,
            training_radiances(lamps),
            evaluation_radiances(lamps),
            (3, 4, 5, 6, 7, 8, 10, 12, 16),
            arguments.noise,
        )
        for choice in choices:
            error = choice.error
            rms = " ".join(f"{100 * value:5.2f}" for value in error.rms)
            ab, ciede = error.delta_e_ab, error.delta_e_2000
            print(
                f"{len(choice.bands):3d}  {rms}  {ab.mean():5.2f} {ab.max():5.1f}  "
                f"{ciede.mean():5.2f} {ciede.max():5.1f}  {' '.join(choice.bands)}"
            )


if __name__ == "__main__":
    main()
