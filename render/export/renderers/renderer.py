"""Record of one renderer: requirements, writer of its files, command, reader of renderings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from numpy.typing import NDArray

from ..neutral import Exported, Layout

__all__ = ["PYTHON_SCRIPT", "SHELL_SCRIPT", "Renderer"]

#: Command of renderers that a Python script drives; {python} stands for the interpreter.
PYTHON_SCRIPT = ("{python}", "run.py")
#: Command of renderers that a shell script drives.
SHELL_SCRIPT = ("sh", "run.sh")


def _same_environment() -> Mapping[str, str]:
    """No variables beyond those of this process."""
    return {}


@dataclass(frozen=True)
class Renderer:
    """One renderer: all that this program knows about it.

    A package adds one under the entry point group ``cboxlab.renderers``. Its folder of an export bears its
    identifier; ``write`` fills the folder, ``command`` runs in it and leaves renderings in its subfolder ``out``.
    """

    #: Identifier: the name of its folder, and in ``cbox renderers --with``.
    id: str
    #: Name in sentences.
    name: str
    #: Writes the scene into the renderer's folder, which is empty.
    write: Callable[[Path, Exported], None]
    #: Reads its renderings from its folder: (batch, row, column, w) radiance, W m^-2 sr^-1 nm^-1, rows from the top.
    read: Callable[[Path, Layout], NDArray]
    #: Program and arguments that render, run in its folder; {python} stands for the interpreter. It goes on where an
    #: interrupted run stopped, and exits with another code than 0 where it fails.
    command: tuple[str, ...]
    #: Pixels of the renderings: those of the pinhole film, or one for each ray of the ray file.
    pixels: Literal["film", "rays"]
    #: Python package that it needs; empty where it needs none.
    package: str = ""
    #: Programs that it needs, all of them.
    programs: tuple[str, ...] = ()
    #: Python package that brings the programs along, by way of ``environment``; empty where there is none.
    package_of_programs: str = ""
    #: Environment variables of its run beyond those of this process.
    environment: Callable[[], Mapping[str, str]] = _same_environment
    #: Whether its lamps can reflect. Otherwise it is compared with a scene of black lamps.
    lamp_reflects: bool = True
    #: Whether ``cbox renderers`` runs it when no renderer is asked for.
    by_default: bool = False

    @property
    def needs(self) -> str:
        """Requirements in words."""
        parts = [f"the package {self.package}"] if self.package else []
        if self.programs:
            alternative = f", or the package {self.package_of_programs}" if self.package_of_programs else ""
            parts.append(" and ".join(self.programs) + alternative)
        return " and ".join(parts)
