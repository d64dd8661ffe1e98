"""Blind practice: a hidden effect drawn by chance, an answer under seal, and its opening and scoring.

The seal is a commitment: ``sealed.json`` holds the SHA-256 of a random salt and the answer. The answer
itself, masked so that nobody reads it by accident, lies beside it in ``answer.sealed``; it names the digest
of the capture's own files. Who keeps the published hash notices any later change of answer or capture.
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
from cboxlab.scenes.errors import InputError
from cboxlab.scenes.faults import suggestion
from cboxlab.scenes.files import replacing

from .effects import AppliedEffect, Effect, Parameter, catalogue
from .synthetic import SIMULATED_STAGES

__all__ = ["Answer", "EffectScore", "Score", "draw_effect", "open_seal", "read_diagnosis", "score", "seal"]

_SEAL, _ANSWER = "sealed.json", "answer.sealed"
_SALT_BYTES = 16

#: Strengths lie between one and so many of the effect's own small steps away from its null value.
STRONGEST_STEPS = 20.0


@dataclass(frozen=True)
class Answer:
    """What a capture contains. effects : (identifier, parameters) in order. capture : its files' digest."""

    effects: tuple[tuple[str, Mapping[str, str | float]], ...]
    capture: str


def draw_effect(generator: np.random.Generator, allowed: Sequence[str] = ()) -> AppliedEffect:
    """One effect of the catalogue with parameters by chance; ``allowed`` : identifiers, all where empty.

    Interreflection, which only a model that stops too early can lack, is drawn only where it is named.

    A number lies step * 10^U away from its null, U uniform from 0 to log10(STRONGEST_STEPS), on either side
    that its bounds leave; without a finite null, as far from its lower bound. Names are drawn evenly.
    Raises InputError for an unknown identifier, or an effect that no capture can contain.
    """
    known = catalogue()
    possible = {
        name: effect
        for name, effect in known.items()
        if effect.stage in SIMULATED_STAGES or (name in allowed and name == "interreflection")
    }
    for name in allowed:
        if name not in possible:
            hint = suggestion(name, possible)
            raise InputError("--effects", repr(name), f"one or more of {', '.join(possible)}", hint)
    effect = possible[str(generator.choice(sorted(allowed or possible)))]
    if effect.stage == "settings":
        return AppliedEffect(effect, {"max_bounces": np.inf})
    return AppliedEffect(effect, {p.name: _drawn(p, generator) for p in effect.parameters})


def _drawn(parameter: Parameter, generator: np.random.Generator) -> str | float:
    if parameter.choices:
        return str(generator.choice(parameter.choices))
    distance = parameter.step * 10 ** generator.uniform(0, np.log10(STRONGEST_STEPS))
    sign = generator.choice([-1.0, 1.0])
    if parameter.null is None and np.isfinite(parameter.low) and np.isfinite(parameter.high):
        return float(generator.uniform(parameter.low, parameter.high))
    null = parameter.null if parameter.null is not None and np.isfinite(parameter.null) else parameter.low
    inside = [s for s in (sign, -sign) if parameter.low <= null + s * distance <= parameter.high]
    if inside:
        return float(null + inside[0] * distance)
    return parameter.high if parameter.high - null > null - parameter.low else parameter.low


def _capture_digest(folder: Path) -> str:
    """SHA-256 over the names and contents of the capture's files, the seal's own left out."""
    digest = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p.name not in (_SEAL, _ANSWER)):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def _masked(content: bytes) -> bytes:
    """Its own inverse: hides text from a reader, not from somebody who wants to know."""
    blocks = -(-len(content) // 32)
    stream = b"".join(hashlib.sha256(f"cboxlab sealed answer {i}".encode()).digest() for i in range(blocks))
    return bytes(a ^ b for a, b in zip(content, stream, strict=False))


def seal(folder: Path, effects: Sequence[AppliedEffect], generator: np.random.Generator) -> str:
    """Seal the answer to the capture in ``folder``; returns the hash to be kept."""
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

    Raises InputError where there is none, or where answer or capture are not those that were sealed.
    """
    expected = "a capture made with `cbox capture --hide`"
    try:
        stated = json.loads((folder / _SEAL).read_text(encoding="utf-8"))["sha256_of_salt_and_answer"]
        content = _masked(base64.b64decode((folder / _ANSWER).read_bytes()))
    except OSError as error:
        raise InputError(error.filename or folder, error.strerror or str(error), expected) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(folder / _SEAL, "no seal", expected) from None
    if hashlib.sha256(content).hexdigest() != stated:
        raise InputError(folder / _ANSWER, "another answer than the sealed one", f"the hash {stated}")
    record = json.loads(content[_SALT_BYTES:])
    if record["capture"] != _capture_digest(folder):
        raise InputError(folder, "files that differ from the sealed capture", "the capture as it was made")
    return Answer(tuple((e["effect"], e["parameters"]) for e in record["effects"]), record["capture"])


@dataclass(frozen=True)
class EffectScore:
    """One hidden effect.

    rank : its place in the ranking, from 1; None where it is not listed. selected : whether it was added.
    errors : by parameter the relative error of the change from null, for numbers that were fitted; for names
    0 where right and infinity where wrong.
    """

    effect: str
    rank: int | None
    selected: bool
    errors: Mapping[str, float]


@dataclass(frozen=True)
class Score:
    """first : whether the ranking's first is hidden. exact : whether what was selected is what was hidden."""

    effects: tuple[EffectScore, ...]
    first: bool
    exact: bool
    falsely_selected: tuple[str, ...]


def read_diagnosis(path: Path) -> Mapping[str, Any]:
    """What ``cbox diagnose --json`` wrote. Raises InputError for anything else."""
    expected = "the JSON that `cbox diagnose --json` writes"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        ranking, selected = content["ranking"], content["selected"]
        sound = all(isinstance(r["effect"], str) and isinstance(r["parameters"], dict) for r in ranking)
        sound = sound and all(isinstance(name, str) for name in selected)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), expected) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(path, "something else", expected) from None
    if not sound:
        raise InputError(path, "entries of another kind", expected)
    return content


def score(answer: Answer, diagnosis: Mapping[str, Any]) -> Score:
    """How a diagnosis (see ``read_diagnosis``) compares with the truth; with nothing hidden nothing may be
    selected.
    """
    order = [entry["effect"] for entry in diagnosis["ranking"]]
    selected = list(diagnosis["selected"])
    hidden = [name for name, _ in answer.effects]
    rows = []
    for name, truth in answer.effects:
        place = order.index(name) if name in order else None
        fitted = {} if place is None else diagnosis["ranking"][place]["parameters"]
        effect = catalogue().get(name)
        errors = {} if effect is None else _errors(effect, truth, fitted)
        rows.append(EffectScore(name, None if place is None else place + 1, name in selected, errors))
    first = bool(order) and order[0] in hidden if hidden else not selected
    return Score(
        tuple(rows), first, set(selected) == set(hidden), tuple(s for s in selected if s not in hidden)
    )


def _errors(effect: Effect, truth: Mapping[str, str | float], fitted: Mapping[str, Any]) -> dict[str, float]:
    errors = {}
    for parameter in effect.parameters:
        true, found = truth.get(parameter.name), fitted.get(parameter.name)
        if found is None or true is None:
            continue
        if parameter.choices:
            errors[parameter.name] = 0.0 if found == true else float("inf")
        else:
            null = parameter.null if parameter.null is not None and np.isfinite(parameter.null) else 0.0
            change = float(true) - null
            errors[parameter.name] = (float(found) - null) / change - 1 if change else float("nan")
    return errors
