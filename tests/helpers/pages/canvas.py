"""What a page draws over a photograph."""

from __future__ import annotations

from .browser import Page

__all__ = ["colour_at", "grey_at"]


def colour_at(page: Page, u: float, v: float) -> tuple[int, int, int]:
    """Red, green and blue of the canvas at a position in the photograph, px: a pixel's centre is whole."""
    red, green, blue, _ = page.run(
        "(() => {const copy = new OffscreenCanvas(1, 1).getContext('2d', {willReadFrequently: true});"
        f"const [x, y] = [{u}, {v}].map((px) => -Math.floor((px + 0.5) * photograph.zoom));"
        "copy.drawImage(photograph.canvas, x, y); return [...copy.getImageData(0, 0, 1, 1).data]})()"
    )
    return red, green, blue


def grey_at(page: Page, u: float, v: float) -> bool:
    """Whether the photograph alone is seen there."""
    return len(set(colour_at(page, u, v))) == 1
