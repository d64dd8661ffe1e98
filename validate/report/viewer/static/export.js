/* What leaves the viewer: numbers as CSV, a picture with caption and scale as PNG, and a view as a link. */

/** A field of a CSV file. */
function field(value) {
  if (typeof value === "number") return Number.isFinite(value) ? String(value) : "";
  return /[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value;
}

/** Rows of fields as the text of a CSV file. */
function csvText(rows) {
  return rows.map((row) => row.map(field).join(",")).join("\n") + "\n";
}

/** Values of layers in every pixel as rows. columns: [{name, values}]. */
function pixelRows(picture, columns) {
  const rows = [["x", "y", "surface", ...columns.map((column) => column.name)]];
  for (let i = 0; i < picture.width * picture.height; i++)
    rows.push([i % picture.width, Math.floor(i / picture.width), surfaceName(picture, i), ...columns.map((c) => c.values[i])]);
  return rows;
}

/** Figures of a region, or the profile of a line, as rows. */
function regionRows(picture, region, band) {
  if (region.kind === "line") {
    const unit = signalUnit(picture, band);
    return [["x", "y", "distance_px", `measured (${unit})`, `predicted (${unit})`, `sigma (${unit})`],
      ...profile(picture, region, band).map((p) => [p.x, p.y, p.distance, p.measured, p.rendered, p.sigma])];
  }
  return [["band", "nm", "pixels", "measured_dn", "measured_scatter_dn", "measured_mean_sigma_dn", "predicted_dn",
    "predicted_scatter_dn", "difference_percent", "difference_sigma_percent"],
  ...regionFigures(picture, region).map((f) => [f.id, f.nm ?? NaN, f.pixels, f.measured, f.scatter, f.sigma, f.rendered,
    f.scatter_rendered, f.percent, f.percent_sigma])];
}

/** Canvas with a picture as it is shown, its caption above, and the scale of each layer below. bars: [{scale, text}]. */
function figureCanvas(shownCanvas, caption, bars) {
  const ratio = Math.max(1, 640 / shownCanvas.width);
  const [width, height] = [shownCanvas.width * ratio, shownCanvas.height * ratio].map(Math.round);
  const canvas = html("canvas", { width: width + 32, height: height + 44 + 62 * bars.length });
  const context = canvas.getContext("2d");
  context.fillStyle = "#fff";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.imageSmoothingEnabled = false;
  context.drawImage(shownCanvas, 16, 34, width, height);
  context.fillStyle = "#1d2226";
  context.font = "600 16px system-ui, sans-serif";
  context.fillText(caption, 16, 22, width);
  context.font = "13px system-ui, sans-serif";
  bars.forEach(({ scale, text }, n) => {
    const top = height + 44 + 62 * n;
    scale.table.forEach((colour, k) => {
      context.fillStyle = `rgb(${colour.join(" ")})`;
      context.fillRect(16 + (k * width) / 256, top, width / 256 + 1, 12);
    });
    context.fillStyle = "#1d2226";
    context.textAlign = "center";
    for (const v of ticks(scale.low, scale.high, 4))
      context.fillText(shown(v), 16 + (width * (v - scale.low)) / (scale.high - scale.low), top + 28);
    context.textAlign = "left";
    context.fillText(text, 16, top + 48, width);
  });
  return canvas;
}

/** Give the user a file. */
function download(name, blob) {
  const address = URL.createObjectURL(blob);
  html("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}

/** Begin of the page's fragment that holds a view. */
const LINK = "#view&";

/** Keys of the state that a link holds, and how each is read from text; a value that cannot be read is undefined. */
const LINKED = (() => {
  const number = (text) => (text.trim() !== "" && Number.isFinite(Number(text)) ? Number(text) : undefined);
  const pixel = (text) => {
    const found = text.split(",").map(number);
    return found.length === 2 && found.every((v) => Number.isInteger(v) && v >= 0) ? found : undefined;
  };
  const of = (...names) => (text) => (names.includes(text) ? text : undefined);
  const region = (text) => {
    const [kind, rest = ""] = text.split(":");
    const points = rest.split(";").map(pixel);
    return kind in REGIONS && points.length < 100 && points.every(Boolean) ? { kind, points } : undefined;
  };
  return {
    mode: of("slider", "flip", "side"), a: String, b: String, c: String, band: number, exposure: number,
    scale: of(...Object.keys(SCALES)), zoom: number, x: number, y: number, split: number, showing: of("a", "b"),
    tool: of("pixel", ...Object.keys(REGIONS)), pixel, region,
  };
})();

/** The fragment of a view. */
function linkOf(state) {
  const text = (value) => (Array.isArray(value) ? value.join(",") :
    typeof value === "object" ? `${value.kind}:${value.points.map((p) => p.join(",")).join(";")}` :
    typeof value === "number" ? String(+value.toFixed(3)) : value);
  const given = Object.keys(LINKED).filter((key) => state[key] !== null && state[key] !== undefined);
  return LINK + new URLSearchParams(given.map((key) => [key, text(state[key])]));
}

/** The part of a state that a fragment holds and that this picture has; other entries are dropped. */
function linkedState(fragment, picture) {
  if (!fragment.startsWith(LINK)) return {};
  const state = {};
  for (const [key, text] of new URLSearchParams(fragment.slice(LINK.length)))
    if (Object.hasOwn(LINKED, key) && LINKED[key](text) !== undefined) state[key] = LINKED[key](text);
  const layers = layersOf(picture).map((layer) => layer.id);
  for (const key of ["a", "b", "c"]) if (key in state && !layers.includes(state[key])) delete state[key];
  if ("band" in state && !(Number.isInteger(state.band) && state.band >= -4 && state.band < picture.bands.length)) delete state.band;
  if ("exposure" in state) state.exposure = Math.min(Math.max(state.exposure, -4), 8);
  const inside = ([x, y]) => x < picture.width && y < picture.height;
  if (state.pixel && !inside(state.pixel)) delete state.pixel;
  if (state.region && !state.region.points.every(inside)) delete state.region;
  return state;
}
