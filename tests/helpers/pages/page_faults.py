"""Faults of a page that a reader would meet, by a script."""

__all__ = ["FAULTS"]

#: Texts smaller than 11 px, or with less contrast than 4.5 to 1 (WCAG AA), and controls without a name.
FAULTS = """
(() => {
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const level = ([r, g, b]) => [r, g, b].reduce((sum, v, i) => {
    const c = v / 255, linear = c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
    return sum + linear * [0.2126, 0.7152, 0.0722][i];
  }, 0);
  const ground = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const colour = rgb(getComputedStyle(e).backgroundColor);
      if (colour.length < 4 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  const found = [];
  for (const element of document.querySelectorAll('body *')) {
    if (!element.checkVisibility() || element.disabled) continue;
    if (['BUTTON', 'INPUT', 'SELECT'].includes(element.tagName)) {
      const name = element.innerText || element.getAttribute('aria-label') || (element.labels && element.labels.length);
      if (!name && !element.title) found.push('no name: ' + element.outerHTML.slice(0, 80));
    }
    if (![...element.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())) continue;
    const style = getComputedStyle(element);
    if (parseFloat(style.fontSize) < 11) found.push('small: ' + element.outerHTML.slice(0, 80));
    const [a, b] = [level(rgb(style.color)), level(ground(element))].sort((x, y) => y - x);
    if (!(element instanceof SVGElement) && (a + 0.05) / (b + 0.05) < 4.5)
      found.push('contrast ' + ((a + 0.05) / (b + 0.05)).toFixed(2) + ': ' + element.outerHTML.slice(0, 80));
  }
  return found;
})()
"""
