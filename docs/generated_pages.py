"""What the program itself knows, as text for the manual: commands, keys of the capture format, effects.

A page holds ``<!-- generated: NAME -->``, NAME a key of ``GENERATED``, where the text is to stand.
"""

import inspect
import json
import re
import types
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Union, get_args, get_origin

import typer
from cboxlab.calibration.capture.whole_manifest import Manifest
from cboxlab.rendering.chain import STAGES
from cboxlab.rendering.effects import Effect, Parameter, catalogue
from cboxlab.validation.app.commands.app import app
from decision_constants import table as decision_constants
from pydantic import BaseModel

__all__ = ["GENERATED", "fill_in"]

FIGURES = Path(__file__).parent / "figures" / "effects"
NOTEBOOKS = Path(__file__).parent / "notebooks"


def commands() -> str:
    """Every command with its arguments and options, from the application itself."""
    group = typer.main.get_command(app)
    return "\n".join(line for name, command in group.commands.items() for line in _command(name, command))


def _command(name: str, command) -> Iterator[str]:
    parameters = [p for p in command.params if p.name not in ("help", "quiet", "verbose")]
    arguments = [p for p in parameters if p.param_type_name == "argument"]
    usage = " ".join(["cbox", name, *(_argument(p) for p in arguments), "[options]"])
    yield from (
        f"## cbox {name}\n",
        _paragraphs(inspect.cleandoc(command.callback.__doc__ or "")),
        f"\n```text\n{usage}\n```\n",
    )
    yield from ("| argument or option | | default |", "|---|---|---|")
    for parameter in parameters:
        label = _argument(parameter) if parameter in arguments else ", ".join(parameter.opts)
        default = parameter.default
        default_text = "" if default in (None, False, "") or callable(default) or parameter.required else f"`{default}`"
        text = (parameter.help or "").replace("|", "\\|")
        yield f"| `{label}` | {_quoted_brackets(text)} | {'required' if parameter.required else default_text} |"
    yield ""


def _argument(parameter) -> str:
    label = (parameter.metavar or parameter.name).strip("{}").upper().removesuffix("...")
    return label + ("..." if parameter.nargs == -1 else "")


def _paragraphs(text: str | None) -> str:
    return _quoted_brackets(re.sub(r"\n(?!\n)", " ", (text or "").strip()))


def _quoted_brackets(text: str) -> str:
    """Tables of a file as code, so that Markdown makes no links of them."""
    return re.sub(r"(?<!`)(\[\[?[a-z]+\]?\])(?!`)", r"`\1`", text)


def capture_keys() -> str:
    """Every table of capture.toml with its keys, from the models that check them."""
    lines = ["### The top of the file\n", *_keys(Manifest)]
    for name, field in Manifest.model_fields.items():
        for table in _tables(field.annotation):
            brackets = "[[{}]]" if "tuple" in str(field.annotation) else "[{}]"
            lines += [f"### `{brackets.format(name)}`\n", f"{table.__doc__}\n", *_keys(table)]
    return "\n".join(lines)


def _keys(table: type[BaseModel]) -> Iterator[str]:
    yield from ("| key | what it is | example | |", "|---|---|---|---|")
    for key, field in table.model_fields.items():
        if field.description:
            left_out = "" if field.default in (None, "") else f"{field.default} if left out"
            need = "required" if field.is_required() else left_out
            yield f"| `{key}` | {_plain(field.description)} | `{field.examples[0]}` | {need} |"
    yield ""


def _plain(text: str) -> str:
    """Text without Markdown's meanings."""
    return re.sub(r"([*^_|])", r"\\\1", text)


def _tables(annotation) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Union, types.UnionType, tuple) or get_args(annotation):
        return [table for part in get_args(annotation) for table in _tables(part)]
    return []


def effects() -> str:
    """Every effect: what happens, its parameters, its signature, how it is confirmed, its sources."""
    lines = []
    for stage in STAGES:
        effects_of_stage = [effect for effect in catalogue().values() if effect.stage == stage]
        for effect in effects_of_stage:
            lines += _effect(effect)
    return "\n".join(lines)


def _effect(effect: Effect) -> Iterator[str]:
    yield f"## {effect.id}\n"
    yield f"*{effect.short_title}* · acts on: {effect.stage}\n"
    yield _plain(effect.summary) + "\n"
    if (FIGURES / f"{effect.id}.png").exists():
        yield f"![Relative change of the picture by {effect.id}, band by band](../figures/effects/{effect.id}.png)\n"
    yield from ("| parameter | unit | null value | from | to |", "|---|---|---|---|---|")
    for p in effect.parameters:
        yield f"| `{p.name}` | {_range(p)} |"
    yield f"\n**In the laboratory.** {effect.confirm}\n"
    if effect.sources:
        yield "Sources: " + "; ".join(effect.sources) + ".\n"


def _range(p: Parameter) -> str:
    if p.choices:
        return f"one of {', '.join(p.choices)} | | | "
    null = "–" if p.null is None else f"{p.null:g}"
    return f"{p.unit} | {null} | {p.low:g} | {p.high:g}"


def notebook(path: Path) -> str:
    """A notebook's cells: text as it is, code as blocks."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    parts = [
        "".join(cell["source"]) if cell["cell_type"] == "markdown" else f"```python\n{''.join(cell['source'])}\n```"
        for cell in cells
    ]
    parts.insert(1, f"{{download}}`The notebook <{path.name}>`")
    return "\n\n".join(parts) + "\n"


GENERATED: dict[str, Callable[[], str]] = {
    "commands": commands,
    "capture-keys": capture_keys,
    "effects": effects,
    "decision-constants": decision_constants,
    **{f"notebook-{path.stem}": partial(notebook, path) for path in sorted(NOTEBOOKS.glob("*.ipynb"))},
}


def fill_in(_app, _name: str, source: list[str]) -> None:
    """Replace the marks of a page by their text (a handler of Sphinx's event ``source-read``)."""
    source[0] = re.sub(r"<!-- generated: ([\w-]+) -->", lambda mark: GENERATED[mark[1]](), source[0])
