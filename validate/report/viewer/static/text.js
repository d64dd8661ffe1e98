/* Text of pages: a line never ends between a number and its unit. cboxlab/utils/page_text.py has the same units. */

const BEFORE_UNIT = /(\d) (?=(?:%|°|σ|°C|K|nm|µm|mm|cm|m|px|DN|e⁻|s|ms|min|h|kB|MB|GB|W|lm|lx|cd)(?![\p{L}\p{N}_]))/gu;

/** Text with a non-breaking space between each number and its unit; other values as they are. */
function unbroken(text) {
  return typeof text === "string" ? text.replace(BEFORE_UNIT, "$1\u00a0") : text;
}
