"""Provenance of a report: command, date, versions, seeds."""

from __future__ import annotations

import platform
from datetime import UTC, datetime
from importlib.metadata import version

from cboxlab.utils.files import this_command

from ..compare import Validation

__all__ = ["provenance"]

#: Packages whose versions can change a figure.
_PACKAGES = (
    "cboxlab",
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "colour-science",
)


def provenance(result: Validation) -> list[tuple[str, str]]:
    """Provenance of a validation.

    Parameters
    ----------
    result
        The validation.

    Returns
    -------
    list
        (name, value); the command is that of this process, such as a user's program that calls the library.
    """
    manifest = result.prepared.calibration.capture
    settings = result.model.render
    return [
        ("command", this_command()),
        ("date", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"),
        ("capture", manifest.manifest.name or manifest.folder.name),
        ("model", f"{result.model.name}; effects {', '.join(e.id for e in result.model.effects) or 'none'}"),
        ("rendering seed", str(settings.seed)),
        ("seed of the noise in expected ΔE", "0"),
        ("requested rendering noise", f"{settings.noise:g} of the sensor's"),
        ("time of the validation", f"{result.seconds:.0f} s"),
        ("versions", ", ".join(f"{package} {version(package)}" for package in _PACKAGES)),
        ("Python and machine", f"{platform.python_version()}, {platform.system()} {platform.machine()}"),
    ]
