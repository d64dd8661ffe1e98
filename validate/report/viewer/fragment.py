"""Script, style and data of the viewer as text, for a self-contained page or a server."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["viewer_fragment", "viewer_part", "viewer_script", "viewer_style"]

_STATIC = Path(__file__).parent / "static"

#: Files of the script, each after those that it uses.
_PARTS = ("text.js", "arrays.js", "colour.js", "layers.js", "pixel.js", "regions.js", "export.js", "viewer.js")


@cache
def viewer_script() -> str:
    """JavaScript that defines ``CBoxViewer``.

    Returns
    -------
    str
        One script in strict mode.
    """
    body = "\n".join(viewer_part(name) for name in _PARTS)
    return f'(function () {{\n"use strict";\n{body}\nglobalThis.CBoxViewer = CBoxViewer;\n}})();\n'


def viewer_part(name: str) -> str:
    """One file of the script, whose functions another page uses.

    Parameters
    ----------
    name
        Name of the file.

    Returns
    -------
    str
        JavaScript.
    """
    return (_STATIC / name).read_text(encoding="utf-8")


@cache
def viewer_style() -> str:
    """CSS of the viewer; no rule applies to other elements.

    Returns
    -------
    str
        The style sheet.
    """
    return (_STATIC / "viewer.css").read_text(encoding="utf-8")


def viewer_fragment(
    data: Mapping[str, Any], identifier: str = "viewer", options: Mapping[str, Any] | None = None
) -> str:
    """HTML of a viewer with its script, style and data, for a page or a notebook's cell.

    In the page, the viewer is ``document.getElementById(identifier).viewer``.

    Parameters
    ----------
    data
        Data of the viewer, see ``viewer_data``.
    identifier
        Identifier of the element, unique in the page.
    options
        First state of the viewer.

    Returns
    -------
    str
        HTML that is also well-formed XML.
    """
    call = f"new CBoxViewer(element, {_json(data)}, {_json(options or {})})"
    return (
        f"<style>\n{viewer_style()}</style>\n"
        f'<div id="{identifier}"><p>This picture needs JavaScript.</p></div>\n'
        f"<script>\n//<![CDATA[\n{viewer_script()}"
        f'{{\n  const element = document.getElementById("{identifier}");\n  element.viewer = {call};\n}}\n'
        "//]]>\n</script>"
    )


def _json(value: Mapping[str, Any]) -> str:
    """JSON that cannot end a script."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
