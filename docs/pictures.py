"""Renders the pictures of the manual again: python docs/pictures.py [effects | ID ...] [readme]

effects : the signature of every effect, docs/figures/effects/ID.png (about ten minutes); ID : that of one.
readme : photograph, render and difference of the bundled capture, docs/figures/readme-comparison.png.
"""

import sys
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

FIGURES = Path(__file__).parent / "figures"
#: Dots per inch and colours of the signatures, so that all of them take about a megabyte.
DPI, COLOURS = 64, 128


def small_png(path: Path) -> None:
    """The picture with few colours, written over itself."""
    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(COLOURS)
    buffer = BytesIO()
    few.save(buffer, format="PNG", optimize=True)
    path.write_bytes(buffer.getvalue())


def effect_pictures(names: Sequence[str] = ()) -> None:
    """The effects of these names, or of the whole catalogue, at the example values of their parameters."""
    from cboxlab.rendering.effects import catalogue
    from cboxlab.validation.app.commands.effect_picture import pictured_light, write_effect_picture

    light = pictured_light()
    for effect in [catalogue()[name] for name in names or catalogue()]:
        path = FIGURES / "effects" / f"{effect.id}.png"
        caption = write_effect_picture(path, effect, light, DPI)
        small_png(path)
        print(f"{path.name}: {caption}", flush=True)


def readme_pictures() -> None:
    """The bundled capture against the published box, and against that with the hidden effect fitted to it."""
    import cboxlab
    from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
    from cboxlab.validation.predict import default_cache
    from cboxlab.validation.synthetic import open_seal

    before = cboxlab.Study.open(DEMO_CAPTURE, cache=default_cache())
    after = before.add(open_seal(DEMO_CAPTURE).effects[0][0]).fit().render()
    print(before, after, sep="\n")
    draw(FIGURES / "readme-comparison.png", before.validations()[0], after.validations()[0])


def draw(path: Path, before, after) -> None:
    """Photograph, render, and residual over noise before and after."""
    from cboxlab.validation.compare.colour_difference import srgb_preview
    from matplotlib.figure import Figure

    maps, white = before.comparison.maps, before.comparison.white
    panels = [
        ("photograph", srgb_preview(maps.xyz_measured.values, white), {}),
        ("render of the model", srgb_preview(maps.xyz_rendered.values, white), {}),
        ("difference, in σ", middle(before), {"cmap": "RdBu_r", "vmin": -5, "vmax": 5}),
        ("after the effect is added", middle(after), {"cmap": "RdBu_r", "vmin": -5, "vmax": 5}),
    ]
    with matplotlib.rc_context({"font.size": 9}):
        figure = Figure(figsize=(9.6, 2.6), layout="constrained")
        for axis, (title, picture, style) in zip(figure.subplots(1, 4), panels, strict=True):
            image = axis.imshow(picture, **style)
            axis.set_title(title)
            axis.set(xticks=[], yticks=[])
        figure.colorbar(image, ax=axis, shrink=0.8)
        figure.savefig(path, dpi=80, pil_kwargs={"optimize": True})


def middle(validation) -> np.ndarray:
    """Residual over noise in the band in the middle (y, x)."""
    return validation.comparison.maps.residual_over_sigma.values[len(validation.comparison.bands) // 2]


if __name__ == "__main__":
    targets = sys.argv[1:] or ["effects", "readme"]
    single = [name for name in targets if name not in ("effects", "readme")]
    if single or "effects" in targets:
        effect_pictures(single)
    if "readme" in targets:
        readme_pictures()
