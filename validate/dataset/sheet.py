"""Pages in HTML: the quality sheet of a data set, and the preview of a recipe."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from cboxlab.rendering.dataset import Recipe
from cboxlab.rendering.files import cube_to_srgb
from cboxlab.utils.errors import InputError
from cboxlab.utils.files import replacing
from cboxlab.utils.page_text import unbroken
from jinja2 import Environment
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from .formats import open_picture
from .layout import Layout, read_box

__all__ = ["drawn_values", "thumbnail", "write_page", "write_sheet"]

#: Pictures on the sheet.
_THUMBNAILS = 20

#: Principal components of the mean spectra that are stated.
_COMPONENTS = 6

#: Resolution of plots: twice that of a page, for sharp text.
_DOTS_PER_INCH = 200

#: The page; it refers to no other files.
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width,initial-scale=1"><title>{{ title }}</title><style>
body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}
figure{display:inline-block;margin:.3rem;text-align:center}figcaption{font-size:12px;color:#555}
table{border-collapse:collapse}td,th{padding:.15rem .7rem;text-align:left;border-bottom:1px solid #ddd}
div.wide{overflow-x:auto}
img.thumb{width:128px;image-rendering:pixelated}
div.plots{display:flex;flex-wrap:wrap;gap:.5rem}div.plots img{width:240px;flex:0 1 240px}
div.plots img:only-child{flex-basis:640px}div.plots img{max-width:100%;height:auto}
@media(prefers-color-scheme:dark){body{color:#ddd;background:#181818}td,th{border-color:#444}figcaption{color:#aaa}}
</style></head><body><main><h1>{{ title }}</h1>
{% for line in lines %}<p>{{ line }}</p>{% endfor %}
{% if faults %}<h2>Pictures that failed a check</h2>
<div class="wide" tabindex="0" role="region" aria-label="Pictures that failed a check"><table>
{% for name, fault in faults %}<tr><td>{{ name }}</td><td>{{ fault }}</td></tr>{% endfor %}</table></div>{% endif %}
<h2>Pictures</h2>{% for name, data in pictures %}
<figure><img class="thumb" alt="{{ name }}" src="data:image/png;base64,{{ data }}"><figcaption>{{ name }}</figcaption>
</figure>{% endfor %}
{% for name, images in plots %}<h2>{{ name }}</h2><div class="plots">{% for alt, data in images %}
<img alt="{{ alt }}" src="data:image/png;base64,{{ data }}">{% endfor %}</div>{% endfor %}
</main></body></html>
"""


def write_page(
    path: Path,
    title: str,
    lines: Sequence[str],
    pictures: Sequence[tuple[str, str]],
    plots: Sequence[tuple[str, Sequence[tuple[str, str]]]],
    faults: Sequence[tuple[str, str]] = (),
) -> None:
    """Write a page of sentences, pictures and plots.

    Parameters
    ----------
    path
        The file.
    title
        Its title.
    lines
        Sentences.
    pictures
        Names, and PNG files in base64.
    plots
        Titles, and the plots below each: names, and PNG files in base64.
    faults
        Names of pictures with their faults.
    """
    page = Environment(autoescape=True, finalize=unbroken).from_string(_PAGE)
    with replacing(path) as temporary:
        text = page.render(title=title, lines=lines, pictures=pictures, plots=plots, faults=faults)
        temporary.write_text(text, encoding="utf-8")


def thumbnail(cube: xr.Dataset) -> str:
    """Preview of a picture: in colour, or of its brightness where no light is visible.

    Parameters
    ----------
    cube
        Radiance and surface.

    Returns
    -------
    str
        PNG file in base64.
    """
    stream = io.BytesIO()
    try:
        picture = cube_to_srgb(cube)
    except InputError:  # no visible light: brightness alone
        light = cube["radiance"].values.sum(axis=-1)
        picture = np.rint(255 * np.clip(light / max(float(np.percentile(light, 99)), 1e-300), 0, 1)).astype(np.uint8)
    Image.fromarray(picture).save(stream, format="PNG")
    return base64.b64encode(stream.getvalue()).decode()


def _plot(figure: Figure) -> str:
    """PNG file of a figure in base64."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DOTS_PER_INCH, metadata={"Software": None})
    return base64.b64encode(stream.getvalue()).decode()


def _spectra_plot(grid: NDArray[np.float64], spectra: NDArray[np.float64]) -> str:
    """Mean spectra of the pictures, each over its mean."""
    figure = Figure(figsize=(5.2, 3), layout="constrained")
    axes = figure.add_subplot()
    mean = spectra.mean(axis=1, keepdims=True)
    axes.plot(grid, np.divide(spectra, mean, out=np.zeros_like(spectra), where=mean > 0).T, lw=0.6, alpha=0.5)
    axes.set(xlabel="wavelength, nm", ylabel="mean radiance over its mean")
    return _plot(figure)


def histograms(values: Mapping[str, Sequence[float]]) -> list[tuple[str, str]]:
    """Distributions of drawn values as plots.

    Parameters
    ----------
    values
        Values by name.

    Returns
    -------
    list
        Names, and PNG files in base64.
    """
    plots = []
    for name, column in values.items():
        if not len(column):
            continue
        figure = Figure(figsize=(2.4, 1.9), layout="constrained")
        axes = figure.add_subplot()
        axes.hist(np.asarray(column, float), bins=20)
        axes.set_xlabel(name, fontsize=9)
        axes.set_ylabel("number", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
        plots.append((f"Histogram: {name}", _plot(figure)))
    return plots


def drawn_values(records: Sequence[Mapping[str, Any]]) -> dict[str, list[float]]:
    """Columns of the values that were drawn for some boxes.

    Parameters
    ----------
    records
        Records of boxes, as in box.json.

    Returns
    -------
    dict
        Values by name.
    """
    columns: dict[str, list[float]] = {
        "room width, mm": [r["room_mm"][0] for r in records],
        "room height, mm": [r["room_mm"][1] for r in records],
        "room depth, mm": [r["room_mm"][2] for r in records],
        "number of blocks": [len(r["blocks"]) for r in records],
        "block height, mm": [b["size_mm"][1] for r in records for b in r["blocks"]],
        "block turn, degrees": [b["yaw_deg"] for r in records for b in r["blocks"] if b["shape"] == "box"],
        "number of lamps": [len(r["lamps"]) for r in records],
        "lamp power, W": [lamp["power_w"] for r in records for lamp in r["lamps"]],
        "lamp temperature, K": [
            lamp["temperature_k"] for r in records for lamp in r["lamps"] if "temperature_k" in lamp
        ],
        "camera distance, mm": [-c[2] for r in records for c in r["cameras"].values()],
        "focal length, px": [c[6] for r in records for c in r["cameras"].values()],
        "distortion k1": [c[9] for r in records for c in r["cameras"].values()],
        "number of effects": [len(r["effects"]) for r in records],
        "rejected draws": [sum(r["rejected"].values()) for r in records],
    }
    return columns


def write_sheet(layout: Layout, recipe: Recipe, records: Sequence[Mapping[str, Any]]) -> None:
    """Write quality.html of a data set.

    Parameters
    ----------
    layout
        Files of the data set.
    recipe
        The recipe.
    records
        Records of all pictures, sound and failed.
    """
    sound = [record for record in records if not record["faults"]]
    faults = [(r["file"], "; ".join(r["faults"])) for r in records if r["faults"]]
    lines = [f"{len(sound)} pictures pass all checks, {len(faults)} fail and are kept apart."]
    pictures, plots = [], []
    if sound:
        noise = np.array([r["relative_standard_error"] for r in sound])
        light = np.array([r["mean_luminance"] for r in sound])
        lines.append(
            f"Relative standard error {np.median(noise):.2%} (median), {noise.max():.2%} (largest); asked for was "
            f"{recipe.picture.noise:.2%}. Mean luminance {light.min():.3g} to {light.max():.3g} cd/m²."
        )
        fits = [r["figures"]["edge_fit"] for r in sound if r["figures"].get("edge_fit") is not None]
        if fits:
            lines.append(
                f"Luminance steps at label edges have a mean rank of {np.median(fits):.2g} among all steps (median "
                f"picture; chance gives 0.5). It is below 0.5 in {sum(fit < 0.5 for fit in fits)} of {len(fits)} "
                "pictures."
            )
        spectra = np.array([r["mean_spectrum"] for r in sound])
        lines.append(_components(spectra))
        some = [sound[i] for i in np.unique(np.linspace(0, len(sound) - 1, _THUMBNAILS).astype(int))]
        for record in some:
            with open_picture(layout.folder / record["file"]) as cube:
                pictures.append(
                    (f"{record['box']:06d} {record['camera']}", thumbnail(cube[["radiance", "surface"]].load()))
                )
        boxes = [read_box(layout, number) for number in sorted({r["box"] for r in sound})]
        plots = [
            ("Mean spectra", [("Mean spectra", _spectra_plot(recipe.picture.wavelength_nm, spectra))]),
            ("Drawn values", histograms(drawn_values(boxes))),
        ]
    write_page(layout.folder / "quality.html", f"Quality of {recipe.name}", lines, pictures, plots, faults)


def _components(spectra: NDArray[np.float64]) -> str:
    """Sentence about the principal components of the pictures' mean spectra."""
    shape = spectra / np.maximum(spectra.mean(axis=1, keepdims=True), 1e-300)
    variance = np.linalg.svd(shape - shape.mean(axis=0), compute_uv=False) ** 2
    if not variance.sum() > 0:
        return "All pictures have the same mean spectrum."
    shares = np.cumsum(variance / variance.sum())[:_COMPONENTS]
    return "Principal components of the mean spectra explain " + ", ".join(f"{share:.1%}" for share in shares) + "."
