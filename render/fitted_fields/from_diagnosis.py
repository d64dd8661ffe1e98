"""An effect file from the explanation in a diagnosis."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from textwrap import shorten
from typing import Any

from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import read_json

from ..effects import Effect, catalogue
from .effect_file import write_effect_file

__all__ = ["effect_of_diagnosis"]

_LONGEST_TITLE = 50

_EXPECTED = "the diagnosis.json of a capture that something remains of"


def effect_of_diagnosis(path: Path, diagnosis: Path) -> tuple[Effect, str]:
    """Write the effect file ``path`` from a diagnosis.json, and return its effect with what is to be known of it.

    Raises InputError where the name is none or taken, and where the diagnosis has no explanation with a field.
    """
    name = path.stem
    if path.suffix != ".toml" or not re.fullmatch(r"[a-z][a-z0-9-]*", name) or name in catalogue():
        expected = "a name of its own, of small letters, digits and hyphens, such as my-effect"
        raise InputError("name of the effect", f"'{name}'", expected)
    if path.exists():
        raise InputError(path, "a file that is there already", "a new name, or the old file removed")
    explanation = _explanation(diagnosis)
    words = str(explanation.get("form", ""))
    where = f" on {explanation['surface']}" if explanation.get("surface") else ""
    summary = (
        f"Found in a capture, as {explanation['family']} ({words}){where}: the fitted field times amplitude, "
        "1 as found, 0 nothing."
    )
    title = shorten(f"{explanation['family']}: {words}", _LONGEST_TITLE, placeholder="…")
    effect = write_effect_file(path, title, summary, explanation["field"])
    return effect, _caution(explanation)


def _explanation(diagnosis: Path) -> Mapping[str, Any]:
    content = read_json(diagnosis, _EXPECTED)
    found = content.get("explanation") if isinstance(content, dict) else None
    if not isinstance(found, dict) or not isinstance(found.get("family"), str):
        raise InputError(diagnosis, "no explanation", _EXPECTED)
    if found["family"] == "none":
        selected = ", ".join(content.get("selected") or []) or "nothing"
        raise InputError(
            f"{diagnosis}: explanation.family",
            f"'none', {selected} being selected",
            "the family of a field that explains what remains",
        )
    if not found.get("field"):
        hint = "Diagnose the capture again with this version"
        raise InputError(f"{diagnosis}: explanation.field", "nothing", "the fitted field", hint)
    return found


def _caution(explanation: Mapping[str, Any]) -> str:
    """What this capture cannot tell, in one sentence; empty where it can."""
    if explanation.get("told_apart", True) or not explanation.get("runner_up"):
        return ""
    return (
        f"The capture cannot tell {explanation['family']} from {explanation['runner_up']}; a second capture with "
        "another place of the camera can."
    )
