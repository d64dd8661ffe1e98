"""Arguments and options that several commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..terminal import JsonOption

__all__ = [
    "LARGEST_SIZE",
    "CaptureFolder",
    "DeclareComparedOption",
    "DeclareOption",
    "DeclareRegressedOption",
    "JsonOption",
    "ModelArgument",
    "NoCacheOption",
    "RenderOption",
    "complete_effect",
]

#: Largest number of pixels per side.
LARGEST_SIZE = 8192

CaptureFolder = Annotated[Path, typer.Argument(help="Folder of a capture, with capture.toml.", show_default=False)]

ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL",
        help="Model or scene file (TOML), or the packaged scene cornell-box.",
        show_default=False,
    ),
]

RenderOption = Annotated[
    Path | None,
    typer.Option(
        help="Spectral cube of another renderer (.nc, .exr, .hdr) to compare. It must show the view of the capture's "
        "calibrated camera."
    ),
]

NoCacheOption = Annotated[
    bool, typer.Option("--no-cache", help="Neither read nor write stored renderings in your cache folder.")
]

#: Help of values that a file does not state.
_DECLARED = (
    "Property that a file does not state, as KEY=VALUE. Repeat the option for several properties. The keys are units "
    "('W m^-2 sr^-1 nm^-1', or 'cd m^-2' in colour), scale (factor to these units), wavelengths (400:700:20), "
    "wavelength-unit (nm) and colour-space (rec709, rec2020, p3-d65, aces, acescg or radiance)."
)
DeclareOption = Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE", help=_DECLARED, show_default=False)]
DeclareComparedOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[SIDE:]KEY=VALUE",
        help=f"{_DECLARED} For one of the two inputs, put A: or B: before the key.",
        show_default=False,
    ),
]
DeclareRegressedOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[SIDE:]KEY=VALUE",
        help=f"{_DECLARED} The key layer names the picture in a file of several layers. For one of the two sides, put "
        "baseline: or candidate: before the key.",
        show_default=False,
    ),
]


def complete_effect(incomplete: str) -> list[str]:
    """Identifiers of effects for the shell's completion.

    Parameters
    ----------
    incomplete
        Typed beginning of an identifier.

    Returns
    -------
    list of str
        Identifiers with that beginning.
    """
    from cboxlab.rendering.effects import catalogue

    return [name for name in catalogue() if name.startswith(incomplete)]
