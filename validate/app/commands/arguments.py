"""Arguments and options that several commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..terminal import JsonOption

__all__ = [
    "LARGEST_SIZE",
    "CaptureFolder",
    "DeclareOption",
    "DeclarePairOption",
    "JsonOption",
    "ModelArgument",
    "NoCacheOption",
    "RenderOption",
    "complete_effect",
]

#: Largest number of pixels per side.
LARGEST_SIZE = 8192

CaptureFolder = Annotated[
    Path, typer.Argument(help="A folder of the capture format (capture.toml).", show_default=False)
]

ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL",
        help="Model or scene file (TOML), or a packaged scene: cornell-box.",
        show_default=False,
    ),
]

RenderOption = Annotated[
    Path | None,
    typer.Option(help="Spectral cube of another renderer (.nc, .exr, .hdr), with the capture's calibrated camera."),
]

NoCacheOption = Annotated[
    bool, typer.Option("--no-cache", help="Do not use or write rendered pictures in the user's cache folder.")
]

#: Values that a file of pictures does not state.
_DECLARED = (
    "What a file does not state: units='W m^-2 sr^-1 nm^-1' ('cd m^-2' in colour), scale=FACTOR to them, "
    "wavelengths=400:700:20, wavelength-unit=nm (of a list without one), colour-space=rec709 (rec2020, p3-d65, aces, "
    "acescg, radiance). May be repeated."
)
DeclareOption = Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE", help=_DECLARED, show_default=False)]
DeclarePairOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[SIDE:]KEY=VALUE",
        help=f"{_DECLARED} For one of the two alone with its name before the key: A: or B:, of regress baseline: or "
        "candidate:.",
        show_default=False,
    ),
]


def complete_effect(incomplete: str) -> list[str]:
    """Identifiers for the shell's completion."""
    from cboxlab.rendering.effects import catalogue

    return [name for name in catalogue() if name.startswith(incomplete)]
