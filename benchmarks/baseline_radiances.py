"""Measured band signals and XYZ of every surface of a capture against an own render from its true camera.

    python benchmarks/baseline_radiances.py CAPTURE ANSWERS.json [--error 0.01]

ANSWERS.json holds, under the capture folder's name, ``true_camera`` (R, position_mm, fx_px, cx_px, cy_px, k1).
One factor, the lamp's scale (stated to 2 %), is fitted to all bands and surfaces. XYZ: exact integrals of the
render, and through each kind of filter weights from the measured signals.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.instrument import LUMINOUS_EFFICACY, colour_matching_functions
from cboxlab.calibration.result.calibrate import calibrate
from cboxlab.rendering.chain.bands import render_bands
from cboxlab.rendering.image import RenderJob
from cboxlab.rendering.integrators.precision import render_to_precision
from cboxlab.rendering.model.model_file import Model
from cboxlab.scenes.camera import Camera
from cboxlab.scenes.wavelength_grid import INTEGRAL_GRID, WAVELENGTH_NM
from cboxlab.validation.synthetic.model_capture import photographed_scene
from scipy.ndimage import binary_erosion


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("answers", type=Path)
    parser.add_argument("--error", type=float, default=1e-2, help="relative error of a rendered pixel")
    arguments = parser.parse_args()
    capture = load_capture(arguments.capture)
    calibration = calibrate(capture)
    true = json.loads(arguments.answers.read_text())[arguments.capture.name]["true_camera"]
    camera = Camera(
        capture.shape[1],
        capture.shape[0],
        true["fx_px"],
        np.array([true["cx_px"], true["cy_px"]]),
        true["k1"],
        np.array(true["R"]),
        np.array(true["position_mm"]),
    )
    assert capture.manifest.lamp is not None and calibration.responses is not None
    scene = photographed_scene(Model()).with_lamp(capture.light(capture.manifest.lamp.radiance))
    image = render_to_precision(RenderJob(scene, camera, WAVELENGTH_NM, seed=1), arguments.error)
    rendered = render_bands(image, calibration.responses)["signal"].values
    measured = calibration.images["signal"].values
    cmfs = LUMINOUS_EFFICACY * colour_matching_functions() * INTEGRAL_GRID.weights
    exact = image.project(cmfs.T)[0]
    usable = np.all(calibration.images["mask"].values == 0, axis=0)
    names, bands, xyz = [], [], []
    for index, surface in enumerate(scene.surfaces):
        inside = binary_erosion((image.surface == index) & image.single_surface, iterations=3) & usable
        if inside.sum() < 20:
            continue
        names.append(surface.name)
        bands.append(measured[:, inside].mean(axis=1) / rendered[:, inside].mean(axis=1))
        xyz.append((measured[:, inside].mean(axis=1), exact[inside].mean(axis=0)))
    ratio = np.array(bands)
    scale = float(np.median(ratio))
    print(f"lamp scale {scale:.5f}; measured / rendered - 1 in %, bands {' '.join(calibration.images.band.values)}")
    for name, values in zip(names, ratio, strict=True):
        print(f"{name:14}", " ".join(f"{100 * (v / scale - 1):+6.2f}" for v in values))
    print(f"largest {100 * np.abs(ratio / scale - 1).max():.2f} %")
    factors = np.array([r.factor for r in calibration.responses])
    assert calibration.colour is not None
    for method, weights in calibration.colour.weights.items():
        print(f"XYZ by {method} weights, measured / exact - 1 in %")
        for name, (signal, truth) in zip(names, xyz, strict=True):
            found = LUMINOUS_EFFICACY * weights.weights @ (signal / factors)
            print(f"{name:14}", " ".join(f"{100 * (v - 1):+6.2f}" for v in found / truth / scale))


if __name__ == "__main__":
    main()
