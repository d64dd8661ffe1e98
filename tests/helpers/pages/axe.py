"""Faults of a page that axe-core finds, and names that a screen reader lacks."""

from importlib import resources

import pytest

from .browser import Page

__all__ = ["nameless", "violations"]

#: Rules of WCAG 2 A and AA, and those that axe calls best practice.
_TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]

#: Roles whose nodes a screen reader announces by their names.
_NAMED_ROLES = {"button", "checkbox", "combobox", "image", "link", "progressbar", "radio", "slider", "textbox"}


def violations(page: Page) -> list[str]:
    """Rules that the page breaks, each with the first element that does."""
    package = pytest.importorskip("axe_core_python")
    if not page.run("typeof axe === 'object'"):
        page.run(resources.files(package).joinpath("axe.min.js").read_text(encoding="utf-8") + ";0")
    return page.run(
        f"axe.run(document, {{resultTypes: ['violations'], runOnly: {{type: 'tag', values: {_TAGS}}}}})"
        ".then((found) => found.violations.map((v) => `${v.id}: ${v.nodes[0].html.slice(0, 120)}`))"
    )


def nameless(page: Page) -> list[str]:
    """Roles of nodes without a name in the tree that a screen reader gets."""
    page.call("Accessibility.enable")
    nodes = page.call("Accessibility.getFullAXTree")["nodes"]
    page.call("Accessibility.disable")
    return [
        node["role"]["value"]
        for node in nodes
        if not node["ignored"]
        and node["role"]["value"] in _NAMED_ROLES
        and not node.get("name", {}).get("value", "").strip()
    ]
