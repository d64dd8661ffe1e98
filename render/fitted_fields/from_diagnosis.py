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

#: Longest title of an effect, characters.
_LONGEST_TITLE = 50

#: Name of the required file in messages.
_EXPECTED = "the diagnosis.json of a capture with a difference that no effect explains"


def effect_of_diagnosis(path: Path, diagnosis: Path) -> tuple[Effect, str]:
    """Write an effect file from the explanation in a diagnosis.

    Parameters
    ----------
    path
        The new effect file, .toml. Its name without the ending is the effect's identifier.
    diagnosis
        The diagnosis.json of a capture.

    Returns
    -------
    effect : Effect
        The effect of the file.
    caution : str
        A sentence on the families that this capture does not distinguish; empty if there are none.

    Raises
    ------
    InputError
        If the name is not an identifier or is used, or the diagnosis has no explanation with a field.
    """
    name = path.stem
    if path.suffix != ".toml" or not re.fullmatch(r"[a-z][a-z0-9-]*", name) or name in catalogue():
        expected = "an unused name of small letters, digits and hyphens, such as my-effect"
        raise InputError("name of the effect", f"'{name}'", expected)
    if path.exists():
        raise InputError(path, "a file that is there already", "a new name, or the old file removed")
    explanation = _explanation(diagnosis)
    form = str(explanation.get("form", ""))
    where = f" on {explanation['surface']}" if explanation.get("surface") else ""
    summary = (
        f"Fitted to a capture, as {explanation['family']} ({form}){where}: the fitted field times amplitude, "
        "1 as fitted, 0 nothing."
    )
    title = shorten(f"{explanation['family']}: {form}", _LONGEST_TITLE, placeholder="…")
    effect = write_effect_file(path, title, summary, explanation["field"])
    return effect, _caution(explanation)


def _explanation(diagnosis: Path) -> Mapping[str, Any]:
    """Explanation of a diagnosis.json; InputError if it has none with a field."""
    content = read_json(diagnosis, _EXPECTED)
    explanation = content.get("explanation") if isinstance(content, dict) else None
    if not isinstance(explanation, dict) or not isinstance(explanation.get("family"), str):
        raise InputError(diagnosis, "no explanation", _EXPECTED)
    if explanation["family"] == "none":
        selected = ", ".join(content.get("selected") or []) or "nothing"
        raise InputError(
            f"{diagnosis}: explanation.family",
            f"'none', with {selected} selected",
            "the family of a field that explains what remains",
        )
    if not explanation.get("field"):
        hint = "Diagnose the capture again with this version"
        raise InputError(f"{diagnosis}: explanation.field", "nothing", "the fitted field", hint)
    return explanation


def _caution(explanation: Mapping[str, Any]) -> str:
    """Sentence on the family that the capture does not distinguish; empty if it does."""
    if explanation.get("told_apart", True) or not explanation.get("runner_up"):
        return ""
    return (
        f"The capture does not distinguish {explanation['family']} from {explanation['runner_up']}; a second capture "
        "from another position of the camera can."
    )
