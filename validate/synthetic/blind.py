"""Blind captures: draw of a hidden effect, sealed answer, opening and score.

The seal is a cryptographic commitment: ``sealed.json`` holds the SHA-256 of a random salt and the answer. The answer,
masked so that it is not read by accident, is in ``answer.sealed``; it includes the digest of the capture's files.
With the published hash, any later change of the answer or the capture can be detected.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cboxlab.rendering.chain import PHOTOGRAPHED
from cboxlab.rendering.effects import (
    AppliedEffect,
    Effect,
    Kind,
    Parameter,
    apply_checked,
    catalogue,
    names_in,
)
from cboxlab.scenes.scene import Scene
from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import suggestion
from cboxlab.utils.files import replacing
from cboxlab.utils.frozen import FrozenMappings
from cboxlab.utils.input_files import read_json, read_text
from cboxlab.utils.table import Table

__all__ = ["Answer", "EffectScore", "Score", "draw_effect", "open_seal", "read_diagnosis", "score", "seal"]

#: File of the commitment, in the folder of a capture.
_SEAL = "sealed.json"

#: File of the masked answer.
_ANSWER = "answer.sealed"

#: Length of the random salt, bytes: answers are few, so that without it a hash could be guessed.
_SALT_BYTES = 16

#: Largest distance of a drawn parameter from its null value, in steps of the effect; the smallest is one step.
STRONGEST_STEPS = 20.0


#: Largest magnitude of a number that an answer or a diagnosis may hold: no number of an effect is larger.
_MAX_NUMBER = 1e9


@dataclass(frozen=True)
class Answer(FrozenMappings):
    """Hidden effects of a capture."""

    #: (identifier, values by parameter) of each effect, in order.
    effects: tuple[tuple[str, Mapping[str, str | float]], ...]
    #: SHA-256 digest of the capture's files.
    capture: str
    #: The seal's hash, which was published when the capture was sealed.
    sha256: str = ""

    def lines(self) -> list[str]:
        """Sentences that the table does not state.

        Returns
        -------
        list of str
            One sentence if no effect was hidden; otherwise none.
        """
        return [] if self.effects else ["No effect was hidden."]

    def tables(self) -> list[Table]:
        """Hidden effects with their parameters.

        Returns
        -------
        list of Table
            One table; none if no effect was hidden.
        """
        rows = tuple(
            (name, ", ".join(f"{k} = {v if isinstance(v, str) else format(v, '.4g')}" for k, v in values.items()))
            for name, values in self.effects
        )
        return [Table("Hidden effects", ("effect", "parameters"), rows, text_columns=(0, 1))] if rows else []


def draw_effect(
    generator: np.random.Generator, scene: Scene, bands: tuple[str, ...], allowed: Sequence[str] = ()
) -> AppliedEffect:
    """A random effect of the catalogue with random parameters, in a scene and its bands.

    A number is drawn at the distance step * 10^U from its null value, in the coordinate of its scale. U is uniform from
    0 to log10(STRONGEST_STEPS); the side is random, within the bounds. A number without a null value is drawn uniformly
    between its bounds. Names are drawn uniformly from those in the scene and of the bands.

    Parameters
    ----------
    generator
        Source of randomness.
    scene
        Scene of the capture.
    bands
        Identifiers of its bands.
    allowed
        Identifiers of effects to draw from; all if empty. Effects on the settings, which a model with truncated
        interreflection lacks, are drawn only if named, with their default parameters.

    Returns
    -------
    AppliedEffect
        The effect with its parameters.

    Raises
    ------
    InputError
        For an unknown identifier, an effect that a capture cannot contain, and one on an object that is absent.
    """
    present = names_in(scene, bands)
    possible = {
        name: effect.within(scene)
        for name, effect in catalogue().items()
        if (effect.stage in PHOTOGRAPHED or (name in allowed and effect.stage == "settings"))
        and all(present[p.kind] for p in effect.parameters if p.kind)
    }
    for name in allowed:
        if name not in possible:
            hint = suggestion(name, possible)
            raise InputError("effects", repr(name), f"one or more of {', '.join(possible)}", hint)
    effect = possible[str(generator.choice(sorted(allowed or possible)))]
    if effect.stage == "settings":
        return apply_checked(effect.id, {}, "effects")
    return AppliedEffect(effect, {p.name: _random_value(p, present, generator) for p in effect.parameters})


def _random_value(
    parameter: Parameter, present: Mapping[Kind, Sequence[str]], generator: np.random.Generator
) -> str | float:
    """A random value of a parameter, see `draw_effect`."""
    if parameter.choices:
        return str(generator.choice(present[parameter.kind] if parameter.kind else parameter.choices))
    distance = parameter.step * 10 ** generator.uniform(0, np.log10(STRONGEST_STEPS))
    sign = generator.choice([-1.0, 1.0])
    low, high = parameter.coordinate_bounds
    if parameter.null is None and np.isfinite(low) and np.isfinite(high):
        return parameter.from_coordinate(float(generator.uniform(low, high)))
    null = low if parameter.null is None else parameter.null_coordinate
    inside = [s for s in (sign, -sign) if low <= null + s * distance <= high]
    end = high if high - null > null - low else low
    return parameter.from_coordinate(null + inside[0] * distance if inside else end)


def _capture_digest(folder: Path) -> str:
    """SHA-256 over the names and contents of the capture's files, without those of the seal."""
    digest = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p.name not in (_SEAL, _ANSWER)):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def _masked(content: bytes) -> bytes:
    """XOR with a fixed stream (its inverse) against accidental reading; not encryption."""
    blocks = -(-len(content) // 32)
    stream = b"".join(hashlib.sha256(f"cboxlab sealed answer {i}".encode()).digest() for i in range(blocks))
    return bytes(a ^ b for a, b in zip(content, stream, strict=False))


def seal(folder: Path, effects: Sequence[AppliedEffect], generator: np.random.Generator) -> str:
    """Write the sealed answer of a capture.

    Parameters
    ----------
    folder
        Folder of the complete capture.
    effects
        Its hidden effects.
    generator
        Source of the salt.

    Returns
    -------
    str
        Hash of salt and answer, hexadecimal, to be published.
    """
    salt = generator.bytes(_SALT_BYTES)
    record = {
        "effects": [{"effect": e.id, "parameters": dict(e.values)} for e in effects],
        "capture": _capture_digest(folder),
    }
    answer = json.dumps(record, sort_keys=True).encode()
    digest = hashlib.sha256(salt + answer).hexdigest()
    with replacing(folder / _ANSWER) as temporary:
        temporary.write_bytes(base64.encodebytes(_masked(salt + answer)))
    with replacing(folder / _SEAL) as temporary:
        content = {"format": "sealed/1", "sha256_of_salt_and_answer": digest}
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return digest


def open_seal(folder: Path) -> Answer:
    """The sealed answer of a capture.

    Parameters
    ----------
    folder
        Folder of the capture.

    Returns
    -------
    Answer
        The hidden effects.

    Raises
    ------
    InputError
        Without a sealed answer, or where the answer or the capture was changed after sealing.
    """
    expected = "a capture with a hidden effect and its sealed answer"
    sealed = read_json(folder / _SEAL, expected)
    commitment = sealed.get("sha256_of_salt_and_answer") if isinstance(sealed, dict) else None
    try:
        content = _masked(base64.b64decode(read_text(folder / _ANSWER, expected)))
    except InputError:
        raise
    except ValueError:
        raise InputError(folder / _ANSWER, "no sealed answer", expected) from None
    if hashlib.sha256(content).hexdigest() != commitment:
        raise InputError(folder / _ANSWER, "an answer that differs from the sealed one", f"the hash {commitment}")
    try:
        record = json.loads(content[_SALT_BYTES:])
        hidden = tuple((str(e["effect"]), _hidden_values(e)) for e in record["effects"])
        capture = record["capture"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(folder / _ANSWER, "an answer in another format", expected) from None
    if capture != _capture_digest(folder):
        raise InputError(folder, "files that differ from the sealed capture", "the unchanged capture")
    return Answer(hidden, capture, str(commitment))


def _hidden_values(entry: Mapping[str, Any]) -> dict[str, str | float]:
    """The parameters of one hidden effect; ValueError for values that its effect cannot have."""
    values = dict(entry["parameters"])
    effect = catalogue().get(str(entry["effect"]))
    names = {p.name for p in effect.parameters if p.choices} if effect else ()
    for key, value in values.items():
        if not (isinstance(value, str) if key in names else _is_number(value) or effect is None):
            raise ValueError(key)
    return values


def _is_number(value: object) -> bool:
    """Whether a value is a number of a size that an effect may have."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _MAX_NUMBER


@dataclass(frozen=True)
class EffectScore(FrozenMappings):
    """Score of one hidden effect."""

    #: Identifier of the effect.
    effect: str
    #: Its rank in the diagnosis, from 1; None if it is not listed.
    rank: int | None
    #: Whether the diagnosis selected it.
    selected: bool
    #: By parameter, the relative error of the change from null, for fitted numbers. For names 0 if right, infinity if
    #: wrong.
    errors: Mapping[str, float]


@dataclass(frozen=True)
class Score:
    """Score of a diagnosis of a blind capture."""

    #: Score of each hidden effect.
    effects: tuple[EffectScore, ...]
    #: Whether the first effect of the ranking is hidden.
    first: bool
    #: Whether exactly the hidden effects were selected.
    exact: bool
    #: Identifiers of selected effects that are not hidden.
    falsely_selected: tuple[str, ...]

    def lines(self) -> list[str]:
        """Whether ranking and selection are right.

        Returns
        -------
        list of str
            One sentence, and one on selected effects that are not hidden.
        """
        first = "is hidden" if self.first else "is not hidden"
        selection = "exactly the hidden effects" if self.exact else "not exactly the hidden effects"
        lines = [f"The first effect of the ranking {first}. The diagnosis selected {selection}."]
        if self.falsely_selected:
            lines.append(f"Effects selected, but not hidden: {', '.join(self.falsely_selected)}.")
        return lines

    def tables(self) -> list[Table]:
        """Rank, selection and errors of each hidden effect.

        Returns
        -------
        list of Table
            One table; none if no effect was hidden. A dash stands for an effect that is not listed.
        """
        rows = tuple(
            (
                row.effect,
                str(row.rank or "–"),
                "yes" if row.selected else "no",
                ", ".join(f"{key} {100 * error:+.1f}%" for key, error in row.errors.items()) or "–",
            )
            for row in self.effects
        )
        columns = ("effect", "rank", "selected", "relative error of each parameter")
        return [Table("Score of the diagnosis", columns, rows, text_columns=(0, 3))] if rows else []

    def to_dict(self) -> dict[str, Any]:
        """The score ready for JSON; errors are relative, infinite for a wrong name.

        Returns
        -------
        dict
            With the keys first, exact, effects and falsely_selected.
        """
        rows = [
            {"effect": e.effect, "rank": e.rank, "selected": e.selected, "errors": dict(e.errors)} for e in self.effects
        ]
        falsely_selected = list(self.falsely_selected)
        return {"first": self.first, "exact": self.exact, "effects": rows, "falsely_selected": falsely_selected}


def read_diagnosis(path: Path) -> Mapping[str, Any]:
    """A diagnosis written by ``cbox diagnose --json``.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Mapping
        Its content; ranking and selected effects are checked.

    Raises
    ------
    InputError
        For any other file.
    """
    expected = "the JSON of a diagnosis"
    content = read_json(path, expected)
    try:
        ranking, selected = content["ranking"], content["selected"]
        sound = all(isinstance(r["effect"], str) and isinstance(r["parameters"], dict) for r in ranking)
        sound = sound and all(isinstance(name, str) for name in selected)
        values = [value for r in ranking for value in r["parameters"].values()]
        sound = sound and all(v is None or isinstance(v, str) or _is_number(v) for v in values)
    except (AttributeError, KeyError, TypeError):
        raise InputError(path, "other content", expected) from None
    if not sound:
        raise InputError(path, "entries of another type", expected)
    return content


def score(answer: Answer, diagnosis: Mapping[str, Any]) -> Score:
    """Score of a diagnosis against the sealed answer.

    Where nothing is hidden, the right diagnosis selects nothing.

    Parameters
    ----------
    answer
        The hidden effects.
    diagnosis
        Content of a diagnosis, see `read_diagnosis`.

    Returns
    -------
    Score
        Score of each hidden effect, and of the selection.
    """
    order = [entry["effect"] for entry in diagnosis["ranking"]]
    selected = list(diagnosis["selected"])
    hidden = [name for name, _ in answer.effects]
    rows = []
    for name, truth in answer.effects:
        position = order.index(name) if name in order else None
        fitted = {} if position is None else diagnosis["ranking"][position]["parameters"]
        effect = catalogue().get(name)
        errors = {} if effect is None else _errors(effect, truth, fitted)
        rows.append(EffectScore(name, None if position is None else position + 1, name in selected, errors))
    first = bool(order) and order[0] in hidden if hidden else not selected
    return Score(tuple(rows), first, set(selected) == set(hidden), tuple(s for s in selected if s not in hidden))


def _errors(effect: Effect, truth: Mapping[str, str | float], fitted: Mapping[str, Any]) -> dict[str, float]:
    """By parameter, the relative error of the change from null; NaN where it is not defined."""
    errors = {}
    for parameter in effect.parameters:
        true, fitted_value = truth.get(parameter.name), fitted.get(parameter.name)
        if fitted_value is None or true is None:
            continue
        if parameter.choices:
            errors[parameter.name] = 0.0 if fitted_value == true else float("inf")
        else:
            null = parameter.null if parameter.null is not None and np.isfinite(parameter.null) else 0.0
            change = float(true) - null
            defined = change and _is_number(fitted_value)
            errors[parameter.name] = (float(fitted_value) - null) / change - 1 if defined else float("nan")
    return errors
