/* Data of one pixel: a record of numbers, and its panel with charts and tables. */

/** Number with `digits` significant digits and a minus sign; a dash where there is none. */
function shown(value, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  return String(+value.toPrecision(digits)).replace("-", "−");
}

/** Number with `places` decimal places and a sign. */
function signed(value, places = 2) {
  if (!Number.isFinite(value)) return "–";
  return ((value > 0 ? "+" : "") + value.toFixed(places)).replace("-", "−");
}

/** Data of pixel (x, y): plain numbers and names, NaN where there is no value. */
function pixelRecord(picture, x, y) {
  const count = picture.width * picture.height;
  const i = y * picture.width + x;
  const bands = picture.bands.map((band, b) => {
    const [measured, rendered, sigma, mask] = ["measured", "rendered", "sigma", "mask"].map(
      (name) => picture[name][b * count + i]);
    const reasons = picture.reasons.filter((r) => mask & r.bit).map((r) => r.name);
    return { ...band, measured, rendered, sigma, reasons, residual: mask ? NaN : (measured - rendered) / sigma };
  });
  const differences = picture.colour_differences.map((difference) => [difference.id, colourValue(picture, difference, i)]);
  const light = picture.light && picture.light.names.map((name, k) => ({
    name, share: picture.light.share[k * count + i],
  }));
  let spectrum = null;
  if (picture.spectrum) {
    const { wavelength_nm: nm, basis, coefficients, rank } = picture.spectrum;
    const values = nm.map((_, w) => {
      let sum = 0;
      for (let k = 0; k < rank; k++) sum += coefficients[k * count + i] * basis[k * nm.length + w];
      return sum;
    });
    spectrum = { wavelength_nm: nm, values, unit: picture.spectrum.unit };
  }
  return {
    x, y, bands, light, spectrum,
    surface: surfaceName(picture, i),
    xyz_measured: xyzOf(picture, picture.measured, i), xyz_rendered: xyzOf(picture, picture.rendered, i),
    ...Object.fromEntries(differences), luminance_percent: colourValue(picture, null, i),
  };
}

function svg(name, attributes, text) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

function html(name, attributes = {}, children = []) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...[].concat(children).map(unbroken));
  return element;
}

/** Round steps on an axis from low to high: at most about `most` of them. */
function ticks(low, high, most = 4) {
  const raw = (high - low) / most || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 2.5, 5, 10].find((s) => s * power >= raw * 0.999);
  const out = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) out.push(+v.toPrecision(10));
  return out;
}

const CHART = { width: 360, height: 190, left: 52, right: 18, top: 24, bottom: 38 };

/** An empty chart with axes: {svg, x(value), y(value)}. Lengths are CSS pixels at 360 px width. */
function chart(title, xAxis, yAxis) {
  const c = CHART;
  const root = svg("svg", { viewBox: `0 0 ${c.width} ${c.height}`, role: "img", "aria-label": title });
  const x = (v) => c.left + ((v - xAxis.low) / (xAxis.high - xAxis.low)) * (c.width - c.left - c.right);
  const y = (v) => c.height - c.bottom - ((v - yAxis.low) / (yAxis.high - yAxis.low)) * (c.height - c.top - c.bottom);
  root.append(svg("text", { x: 4, y: 14, class: "title" }, title));
  for (const v of yAxis.ticks || ticks(yAxis.low, yAxis.high)) {
    root.append(svg("line", { x1: c.left, x2: c.width - c.right, y1: y(v), y2: y(v), class: "grid" }));
    root.append(svg("text", { x: c.left - 5, y: y(v) + 4, "text-anchor": "end" }, shown(v)));
  }
  for (const v of ticks(xAxis.low, xAxis.high, 5)) {
    root.append(svg("line", { x1: x(v), x2: x(v), y1: c.height - c.bottom, y2: c.height - c.bottom + 4, class: "axis" }));
    root.append(svg("text", { x: x(v), y: c.height - c.bottom + 16, "text-anchor": "middle" }, shown(v)));
  }
  root.append(svg("line", { x1: c.left, x2: c.width - c.right, y1: c.height - c.bottom, y2: c.height - c.bottom, class: "axis" }));
  root.append(svg("text", { x: c.width - c.right, y: c.height - 6, "text-anchor": "end" }, xAxis.name));
  return { svg: root, x, y };
}

function wavelengthAxis(picture) {
  if (picture.bands.some((band) => band.nm === null))
    return { low: -0.5, high: picture.bands.length - 0.5, name: "band", of: (_, b) => b };
  const own = picture.filters ? picture.filters.wavelength_nm : picture.bands.map((band) => band.nm);
  const [low, high] = [Math.min(...own), Math.max(...own)];
  const margin = picture.filters ? 0 : 0.06 * (high - low || 100);
  return { low: low - margin, high: high + margin, name: "wavelength, nm", of: (band) => band.nm };
}

/** Measured (dot, bar of one standard deviation) and predicted (square) signals by wavelength. */
function signalChart(picture, record) {
  const axis = wavelengthAxis(picture);
  const high = Math.max(1, ...record.bands.map((b) => Math.max(b.measured + b.sigma || 0, b.rendered || 0)));
  const plot = chart("Band signals, DN", axis, { low: 0, high: 1.05 * high });
  record.bands.forEach((band, b) => {
    const x = plot.x(axis.of(band, b));
    plot.svg.append(svg("rect", { x: x - 5, y: plot.y(band.rendered) - 5, width: 10, height: 10, class: "predicted" }));
    const [low, up] = [plot.y(band.measured - band.sigma), plot.y(band.measured + band.sigma)];
    plot.svg.append(svg("path", { d: `M${x - 3} ${low}h6M${x - 3} ${up}h6M${x} ${low}V${up}`, class: "measured" }));
    plot.svg.append(svg("circle", { cx: x, cy: plot.y(band.measured), r: 3, class: "measured" }));
  });
  return plot.svg;
}

/** Residuals over sigma by wavelength, in a fixed scale of 5 sigma. */
function residualChart(picture, record) {
  const axis = wavelengthAxis(picture);
  const plot = chart("Measured − predicted, σ (± 1 σ)", axis, { low: -5, high: 5, ticks: [-5, -2.5, 0, 2.5, 5] });
  plot.svg.append(svg("line", { x1: CHART.left, x2: CHART.width - CHART.right, y1: plot.y(0), y2: plot.y(0), class: "axis" }));
  record.bands.forEach((band, b) => {
    if (!Number.isFinite(band.residual)) return;
    const x = plot.x(axis.of(band, b));
    const value = Math.max(-5, Math.min(5, band.residual));
    if (value !== band.residual) {
      const way = value > 0 ? 1 : -1;
      plot.svg.append(svg("path", { d: `M${x - 5} ${plot.y(value) + 8 * way}h10l-5 ${-8 * way}z`, class: "measured" }));
      return;
    }
    const [low, up] = [plot.y(Math.max(-5, value - 1)), plot.y(Math.min(5, value + 1))];
    plot.svg.append(svg("path", { d: `M${x} ${low}V${up}`, class: "measured" }));
    plot.svg.append(svg("circle", { cx: x, cy: plot.y(value), r: 3, class: "measured" }));
  });
  return plot.svg;
}

/** The rendered spectrum over the responses of the bands, each relative to its largest value. */
function spectrumChart(picture, record) {
  const { wavelength_nm: nm, values, unit } = record.spectrum;
  const axis = { low: nm[0], high: nm[nm.length - 1], name: "wavelength, nm" };
  const high = Math.max(...values, 1e-30);
  const power = Math.floor(Math.log10(high));
  const factor = 10 ** -power;
  const plot = chart(`Rendered light, 10${superscript(power)} ${unit}`, axis, { low: 0, high: 1.05 * high * factor });
  const path = (wavelengths, curve, scale) =>
    "M" + wavelengths.map((w, k) => `${plot.x(w).toFixed(1)} ${plot.y(curve[k] * scale).toFixed(1)}`).join("L");
  if (picture.filters) {
    const { wavelength_nm: own, curves } = picture.filters;
    picture.bands.forEach((_, b) => {
      const curve = curves.subarray(b * own.length, (b + 1) * own.length);
      plot.svg.append(svg("path", { d: path(own, curve, 0.9 * high * factor), class: "filter" }));
    });
  }
  plot.svg.append(svg("path", { d: path(nm, values, factor), class: "spectrum" }));
  return plot.svg;
}

function superscript(number) {
  return String(number).replace(/./g, (d) => (d === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[d]));
}

/** The light by number of reflections as one bar with a line of text for each part. */
function lightBar(record) {
  const bar = html("div", { class: "cbv-light" });
  const list = html("ul");
  record.light.forEach((part, k) => {
    const percent = (100 * part.share).toFixed(1);
    bar.append(html("span", { class: "part" + k, style: `width:${Math.max(100 * part.share, 0)}%` }));
    list.append(html("li", { class: "part" + k }, `${part.name}: ${percent} %`));
  });
  return html("figure", { "aria-label": "Light by number of reflections" }, [
    html("figcaption", {}, "Rendered light by number of reflections, share of luminance"), bar, list,
  ]);
}

/** Names of bands: their wavelengths where these are known and differ, else their identifiers. */
function bandNames(bands) {
  const names = bands.map(({ nm }) => (nm === null ? null : `${nm.toFixed(0)} nm`));
  return !names.includes(null) && new Set(names).size === names.length ? names : bands.map(({ id }) => id);
}

function bandTable(record) {
  const head = ["band", "measured, DN", "predicted, DN", "σ, DN", "difference, σ"];
  const names = bandNames(record.bands);
  const rows = record.bands.map((band, b) => [
    names[b], shown(band.measured, 5), shown(band.rendered, 5),
    shown(band.sigma, 3), band.reasons.length ? band.reasons.join(", ") : signed(band.residual),
  ]);
  return valueTable(head, rows);
}

/** A table of texts; the first cell of a row names it. */
function valueTable(head, rows) {
  return html("div", { class: "cbv-scroll", tabindex: "0", role: "group", "aria-label": "Table of values" }, html("table", {}, [
    html("thead", {}, html("tr", {}, head.map((h) => html("th", { scope: "col" }, h)))),
    html("tbody", {}, rows.map((row) =>
      html("tr", {}, row.map((cell, k) => html(k ? "td" : "th", k ? {} : { scope: "row" }, cell))))),
  ]));
}

/** The panel of a pixel as elements. */
function pixelPanel(picture, record) {
  const values = [
    ...picture.colour_differences.map((difference) => [difference.label, shown(record[difference.id], 3)]),
    ["luminance", Number.isFinite(record.luminance_percent) ? signed(record.luminance_percent) + " %" : "–"],
    [`XYZ measured, ${picture.xyz_unit}`, record.xyz_measured.map((v) => shown(v, 4)).join(", ")],
    [`XYZ rendered, ${picture.xyz_unit}`, record.xyz_rendered.map((v) => shown(v, 4)).join(", ")],
  ];
  const charts = [signalChart(picture, record), residualChart(picture, record)];
  if (record.spectrum) charts.push(spectrumChart(picture, record));
  return [
    html("h3", {}, `Pixel ${record.x}, ${record.y}: ${record.surface}`),
    html("p", { class: "cbv-key" }, [
      html("span", { class: "measured" }, "● measured ± 1 σ"), html("span", { class: "predicted" }, "□ predicted"),
      ...(picture.filters && record.spectrum ? [html("span", { class: "filter" }, "╌ responses of the bands, relative")] : []),
    ]),
    html("div", { class: "cbv-charts" }, charts),
    ...(record.light && record.light.every((part) => Number.isFinite(part.share)) ? [lightBar(record)] : []),
    bandTable(record),
    html("dl", {}, values.flatMap(([name, value]) => [html("dt", {}, name), html("dd", {}, value)])),
  ];
}
