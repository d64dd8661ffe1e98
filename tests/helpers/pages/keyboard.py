"""Controls of a page that the keyboard alone reaches."""

from .browser import Page

__all__ = ["reached_by_tab"]

#: Controls in view that can have the focus; of a group of radio buttons one.
_CONTROLS = """
[...document.querySelectorAll(
  'a[href], button, input, select, textarea, summary, canvas[tabindex], [tabindex="0"]')].filter(
  (e) => e.checkVisibility() && !e.disabled && e.tabIndex >= 0 && !(e.type === 'radio' && !e.checked))
"""


def reached_by_tab(page: Page) -> list[list[str]]:
    """Names of controls that Tab does not reach, and of those that show no focus."""
    page.run(f"document.activeElement.blur(); window.scrollTo(0, 0); globalThis.wanted = new Set({_CONTROLS})")
    page.run("globalThis.unseen = []")
    for _ in range(page.run("wanted.size") + 12):
        page.key("Tab")
        page.run(
            "(() => {const e = document.activeElement; wanted.delete(e); const s = getComputedStyle(e);"
            "if (e !== document.body && (s.outlineStyle === 'none' || parseFloat(s.outlineWidth) < 2))"
            "unseen.push(e.outerHTML.slice(0, 80))})()"
        )
    return page.run("[[...wanted].map((e) => e.outerHTML.slice(0, 80)), unseen]")
