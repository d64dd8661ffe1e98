"""Shades of Grey on a data set: the colour of the light from pictures, against the lamps' true colour.

    python benchmarks/rendering/illuminant_estimation.py DATASET

The method of Finlayson and Trezzi 2004 estimates the light as the Minkowski mean of order p of the pixels, in linear
sRGB of the cube. p = 1 is Grey World, a large p is White Patch. The order is chosen on the train part; printed are the
angular errors, in degrees, on validation and test parts, next to those of the train part's mean light.
"""

from __future__ import annotations

import argparse

import cboxlab
import numpy as np
from cboxlab.rendering.files import xyz_weights
from cboxlab.scenes.wavelength_grid import WAVELENGTH_NM
from numpy.typing import NDArray

#: Orders that are tried.
ORDERS = (1.0, 2.0, 4.0, 6.0, 9.0, 20.0)

#: Linear sRGB of X, Y, Z (IEC 61966-2-1).
TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


def lamp_rgb(dataset: cboxlab.Dataset, number: int) -> NDArray[np.float64]:
    """(3,) colour of the lamps' light in a picture's box, by their power."""
    scene = dataset.model(number).scene
    return TO_RGB @ (scene.lamp_radiance(WAVELENGTH_NM) @ xyz_weights(WAVELENGTH_NM))


def pixels(dataset: cboxlab.Dataset, number: int) -> NDArray[np.float64]:
    """(n, 3) linear sRGB of the pixels that show surfaces."""
    with dataset[number] as picture:
        light = picture["radiance"].values[picture["surface"].values >= 0]
        return np.maximum(light @ xyz_weights(picture["wavelength"].values) @ TO_RGB.T, 0.0)


def angle_deg(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Angle between two colours, degrees."""
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


def errors(dataset: cboxlab.Dataset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(picture, order) angular errors, degrees, and (picture, 3) true colours of length 1."""
    rows, truths = [], []
    for number in range(len(dataset)):
        truth, values = lamp_rgb(dataset, number), pixels(dataset, number)
        values = values / values.max()
        rows.append([angle_deg(np.mean(values**p, axis=0) ** (1 / p), truth) for p in ORDERS])
        truths.append(truth / np.linalg.norm(truth))
    return np.array(rows), np.array(truths)


def main() -> None:
    """Print the errors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset")
    dataset = cboxlab.open_dataset(parser.parse_args().dataset)
    (train, lights), (later, truths) = errors(dataset.part("train")), _later(dataset)
    best = int(np.argmin(train.mean(axis=0)))
    mean = lights.mean(axis=0)
    always = [angle_deg(mean, truth) for truth in truths]
    print(f"{len(train)} pictures to choose the order, {len(later)} to test it")
    for name, column in (
        ("Grey World", 0),
        (f"Shades of Grey, p = {ORDERS[best]:g}", best),
        ("White Patch, p = 20", -1),
    ):
        print(f"{name}: mean {later[:, column].mean():.2f}, median {np.median(later[:, column]):.2f} degrees")
    print(f"the mean light of the train part: mean {np.mean(always):.2f}, median {np.median(always):.2f} degrees")


def _later(dataset: cboxlab.Dataset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors and colours of the validation and test parts together."""
    parts = [errors(part) for name in ("validation", "test") if len(part := dataset.part(name))]
    return np.concatenate([rows for rows, _ in parts]), np.concatenate([truths for _, truths in parts])


if __name__ == "__main__":
    main()
