"""Spectral recovery on a data set: spectra from the three channels of a camera, by published regressions.

    python benchmarks/rendering/spectral_recovery.py DATASET [--camera nikon-d5100] [--target albedo] [--without F2 F11]

The target is the radiance, seen without noise of the sensor, or the albedo, seen as the paint's light over that of a
white tile in its place. Boxes with a lamp of the names after --without are left out. From the train part, and with a
regularisation that is chosen on the validation part, spectra are estimated by

- the mean spectrum of the train part, scaled to each pixel's channels;

- three principal components that reproduce the channels exactly (Maloney and Wandell 1986);

- ridge regression from the channels (the Wiener filter), or from their root polynomials of degree 2 or 4, which like
  the first three scale with the exposure (Finlayson, Mackiewicz and Hurlbert 2015; Lin and Finlayson 2019).

Printed are means over the test pictures, with the standard error over their boxes: relative RMS error of a pixel's
spectrum, spectral angle in degrees, and CIEDE2000, of an albedo in light of equal energy. Those of the test spectra's
best approximation by three components follow, the bound of every estimate from these components.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from itertools import combinations_with_replacement
from math import gcd
from typing import NamedTuple

import cboxlab
import numpy as np
from cboxlab.rendering.files import xyz_weights
from cboxlab.rendering.sensor import integration_weights, load_camera
from numpy.typing import NDArray

#: Pixels of a picture from which the regressions learn.
PIXELS = 400

#: Regularisations that are tried, relative to the mean square of a feature.
RIDGES = 10.0 ** np.arange(-9, 1)

#: Quantile of the luminance that is white, since a box need not show a white surface in full light.
WHITE = 0.99


class Pixels(NamedTuple):
    """Pixels of surfaces of one picture."""

    #: Number of the box.
    box: int
    #: (n, w) radiance, or albedo.
    spectra: NDArray[np.float64]
    #: (n, 3) channels of the camera.
    channels: NDArray[np.float64]
    #: (w,) spectrum that is white.
    white: NDArray[np.float64]


def pictures(
    dataset: cboxlab.Dataset, most: int | None, sensitivities: NDArray[np.float64], albedo: bool
) -> list[Pixels]:
    """Pixels of each picture, at most some of them by a fixed seed."""
    rows = []
    for number, row in enumerate(dataset.index):
        with dataset[number] as picture:
            visible = (picture["surface"].values >= 0) & (picture["radiance"].values.sum(axis=-1) > 0)
            if albedo:
                visible &= picture["coverage"].values.max(axis=-1) > 1 - 1e-6
            names = ("albedo", "irradiance") if albedo else ("radiance",)
            values = [picture[name].values[visible].astype(np.float64) for name in names]
            grid = picture["wavelength"].values
        if most is not None and len(values[0]) > most:
            some = np.random.default_rng(number).choice(len(values[0]), most, replace=False)
            values = [array[some] for array in values]
        if albedo:
            channels = (values[0] * values[1]) @ sensitivities / (values[1] @ sensitivities)
            rows.append(Pixels(int(row["box"]), values[0], channels, np.ones(grid.size)))
        else:
            lamp = dataset.model(number).scene.lamp_radiance(grid)
            rows.append(Pixels(int(row["box"]), values[0], values[0] @ sensitivities, lamp))
    return rows


def without(dataset: cboxlab.Dataset, lamps: list[str]) -> cboxlab.Dataset:
    """Pictures of boxes without a lamp of some names."""
    rows = [
        row
        for number, row in enumerate(dataset.index)
        if not {lamp["spectrum"] for lamp in dataset.drawn_values(number)["lamps"]} & set(lamps)
    ]
    return cboxlab.Dataset(dataset.folder, tuple(rows))


def root_polynomials(channels: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """(n, k) features of (n, 3) channels that scale with the exposure; those of lower degrees are included."""
    logs, features = np.log(np.maximum(channels, 1e-30)), {}
    for order in range(1, degree + 1):
        for exponents in combinations_with_replacement(range(3), order):
            counts = tuple(exponents.count(k) for k in range(3))
            divisor = gcd(*counts)  # powers of lower degrees come again
            features[tuple(count // divisor for count in counts)] = np.exp(logs[:, list(exponents)].mean(axis=1))
    return np.stack(list(features.values()), axis=1)


def scaled(spectra: NDArray[np.float64], features: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Spectra and features over each spectrum's root mean square: dark pixels count as much as bright ones."""
    size = np.sqrt(np.mean(spectra**2, axis=1, keepdims=True))
    return spectra / size, features / size


def ridge(spectra: NDArray[np.float64], features: NDArray[np.float64], weight: float) -> NDArray[np.float64]:
    """(k, w) matrix from features to spectra."""
    targets, inputs = scaled(spectra, features)
    inner = inputs.T @ inputs
    inner += weight * np.trace(inner) / len(inner) * np.eye(len(inner))
    return np.linalg.solve(inner, inputs.T @ targets)


def errors(estimate: NDArray[np.float64], pixels: Pixels, to_xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) relative RMS error, spectral angle in degrees, and CIEDE2000, means over pixels."""
    from colour import XYZ_to_Lab, XYZ_to_xy, delta_E

    true = pixels.spectra
    size = np.linalg.norm(true, axis=1)
    relative = np.linalg.norm(estimate - true, axis=1) / size
    cosine = np.sum(estimate * true, axis=1) / size / np.maximum(np.linalg.norm(estimate, axis=1), 1e-30)
    white_xyz = pixels.white @ to_xyz
    luminance = white_xyz[1] if (pixels.white == 1).all() else np.quantile((true @ to_xyz)[:, 1], WHITE)
    white = XYZ_to_xy(white_xyz)
    labs = [XYZ_to_Lab(np.maximum(spectra @ to_xyz, 0) / luminance, white) for spectra in (estimate, true)]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return np.array([relative.mean(), angle.mean(), delta_E(*labs, method="CIE 2000").mean()])


def main() -> None:
    """Print the errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset")
    parser.add_argument("--camera", default="nikon-d5100")
    parser.add_argument("--target", choices=("radiance", "albedo"), default="radiance")
    parser.add_argument("--without", nargs="+", default=[])
    options = parser.parse_args()
    warnings.filterwarnings("ignore", module="colour")
    dataset = without(cboxlab.open_dataset(options.dataset), options.without)
    with dataset[0] as picture:
        grid = picture["wavelength"].values.astype(float)
    to_xyz, camera = xyz_weights(grid), load_camera(options.camera)
    sensitivities = np.stack([integration_weights(channel, grid) for channel in camera.channels.values()], axis=1)
    sensitivities /= sensitivities.sum(axis=0)
    train, validation, test = (
        pictures(dataset.part(name), most, sensitivities, options.target == "albedo")
        for name, most in (("train", PIXELS), ("validation", PIXELS), ("test", None))
    )
    spectra, channels = (np.concatenate([getattr(p, name) for p in train]) for name in ("spectra", "channels"))
    unit, unit_channels = scaled(spectra, channels)
    mean, (_, _, axes) = unit.mean(axis=0), np.linalg.svd(unit, full_matrices=False)

    def regression(degree: int) -> tuple[float, Callable[[Pixels], NDArray]]:
        """Ridge regression, its weight by the validation part."""
        learnt = [ridge(spectra, root_polynomials(channels, degree), weight) for weight in RIDGES]
        scores = [
            np.mean([errors(root_polynomials(p.channels, degree) @ m, p, to_xyz)[0] for p in validation])
            for m in learnt
        ]
        best = int(np.argmin(scores))
        return float(RIDGES[best]), lambda p: root_polynomials(p.channels, degree) @ learnt[best]

    three, level = axes[:3], unit_channels.mean(axis=0)
    to_three = np.linalg.inv(three @ sensitivities) @ three
    methods: dict[str, Callable[[Pixels], NDArray]] = {
        "mean spectrum": lambda p: (p.channels @ level / (level @ level))[:, None] * mean,
        "three components": lambda p: p.channels @ to_three,
    }
    for degree, name in ((1, "ridge, linear"), (2, "ridge, roots of degree 2"), (4, "ridge, roots of degree 4")):
        weight, method = regression(degree)
        methods[f"{name} ({weight:.0e})"] = method
    methods["(best three components)"] = lambda p: p.spectra @ three.T @ three
    boxes = sorted({pixels.box for pixels in test})
    counts = f"{len(train)} pictures to learn, {len(validation)} to choose, {len(test)} of {len(boxes)} boxes to test"
    print(f"{options.target} by {camera.name}: {counts}")
    for name, method in methods.items():
        rows = [(pixels.box, errors(method(pixels), pixels, to_xyz)) for pixels in test]
        of_box = np.array([np.mean([row for box, row in rows if box == number], axis=0) for number in boxes])
        average, error = of_box.mean(axis=0), of_box.std(axis=0, ddof=1) / np.sqrt(len(boxes))
        figures = (f"{100 * average[0]:.1f} +- {100 * error[0]:.1f} %", f"{average[1]:.1f} +- {error[1]:.1f} deg")
        print(f"{name}: {', '.join(figures)}, CIEDE2000 {average[2]:.1f} +- {error[2]:.1f}", flush=True)


if __name__ == "__main__":
    main()
