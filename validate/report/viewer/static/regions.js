/* Regions of a picture: pixels of a rectangle, polygon or line, their figures, and their panel. Points are pixels. */

/** Kinds of regions: name, and number of points from which on there are figures. */
const REGIONS = {
  rectangle: { name: "Rectangle", points: 2 },
  polygon: { name: "Polygon", points: 3 },
  line: { name: "Line", points: 2 },
};

/** A region with one more point; a complete rectangle or line begins again. */
function withPoint(region, kind, point) {
  const grows = region && region.kind === kind && (kind === "polygon" || region.points.length < 2);
  return { kind, points: grows ? [...region.points, point] : [point] };
}

/** Whether pixel (x, y) is in a polygon; pixels on its border are. */
function inPolygon(points, x, y) {
  let inside = false;
  for (let k = 0, before = points.length - 1; k < points.length; before = k++) {
    const [[x1, y1], [x2, y2]] = [points[before], points[k]];
    const cross = (x2 - x1) * (y - y1) - (y2 - y1) * (x - x1);
    const within = x >= Math.min(x1, x2) && x <= Math.max(x1, x2) && y >= Math.min(y1, y2) && y <= Math.max(y1, y2);
    if (cross === 0 && within) return true;
    if (y1 > y !== y2 > y && x < ((x2 - x1) * (y - y1)) / (y2 - y1) + x1) inside = !inside;
  }
  return inside;
}

/** Pixels [x, y] of a region, along a line in its order; none before it has enough points. */
function regionPixels(region) {
  const { kind, points } = region;
  if (points.length < REGIONS[kind].points) return [];
  if (kind === "line") {
    const [[x1, y1], [x2, y2]] = points;
    const steps = Math.max(Math.abs(x2 - x1), Math.abs(y2 - y1), 1);
    return Array.from({ length: steps + 1 }, (_, k) =>
      [Math.round(x1 + ((x2 - x1) * k) / steps), Math.round(y1 + ((y2 - y1) * k) / steps)]);
  }
  const [xs, ys] = [points.map((p) => p[0]), points.map((p) => p[1])];
  const found = [];
  for (let y = Math.min(...ys); y <= Math.max(...ys); y++)
    for (let x = Math.min(...xs); x <= Math.max(...xs); x++)
      if (kind === "rectangle" || inPolygon(points, x, y)) found.push([x, y]);
  return found;
}

/** Mean and standard deviation over the values; NaN where there are too few. */
function meanAndScatter(values) {
  const mean = values.reduce((sum, v) => sum + v, 0) / values.length;
  const squares = values.reduce((sum, v) => sum + (v - mean) ** 2, 0);
  return { mean, scatter: values.length > 1 ? Math.sqrt(squares / (values.length - 1)) : NaN };
}

/** Figures of the pixels used, by band: means, scatter, and the standard deviation of the measured mean. */
function regionFigures(picture, region) {
  const count = picture.width * picture.height;
  const pixels = regionPixels(region).map(([x, y]) => y * picture.width + x);
  return picture.bands.map((band, b) => {
    const used = pixels.map((i) => b * count + i).filter((k) => !picture.mask[k] && picture.sigma[k] > 0);
    const [measured, rendered] = ["measured", "rendered"].map((name) => meanAndScatter(used.map((k) => picture[name][k])));
    const sigma = Math.sqrt(used.reduce((sum, k) => sum + picture.sigma[k] ** 2, 0)) / used.length;
    return {
      ...band, pixels: used.length, measured: measured.mean, rendered: rendered.mean,
      scatter: measured.scatter, scatter_rendered: rendered.scatter, sigma,
      percent: 100 * (measured.mean / rendered.mean - 1), percent_sigma: (100 * sigma) / rendered.mean,
    };
  });
}

/** The profile along a line: one record per pixel, NaN where the pixel is left out; `band` as in the viewer's state. */
function profile(picture, region, band) {
  const [x1, y1] = region.points[0];
  return regionPixels(region).map(([x, y]) => {
    const i = y * picture.width + x;
    const [measured, rendered, sigma] = signalAt(picture, band, i);
    return { x, y, distance: Math.hypot(x - x1, y - y1), measured, rendered, sigma };
  });
}

/** Measured and predicted signals along a line, with one standard deviation. */
function profileChart(picture, region, band) {
  const points = profile(picture, region, band);
  const finite = points.filter((p) => Number.isFinite(p.measured));
  const ends = finite.flatMap((p) => [p.measured - p.sigma, p.measured + p.sigma, p.rendered]);
  const [low, high] = ends.length ? [Math.min(...ends), Math.max(...ends)] : [0, 1];
  const margin = 0.05 * (high - low || 1);
  const along = { low: 0, high: points[points.length - 1].distance || 1, name: "distance, px" };
  const plot = chart(`${signalName(picture, band)} along the line`, along, { low: low - margin, high: high + margin });
  const parts = [];
  points.forEach((p, k) => {
    if (!Number.isFinite(p.measured)) return;
    const x = plot.x(p.distance);
    const begins = k === 0 || !Number.isFinite(points[k - 1].measured);
    parts.push(`${begins ? "M" : "L"}${x.toFixed(1)} ${plot.y(p.rendered).toFixed(1)}`);
    const bar = `M${x} ${plot.y(p.measured - p.sigma)}V${plot.y(p.measured + p.sigma)}`;
    plot.svg.append(svg("path", { d: bar, class: "measured" }));
    plot.svg.append(svg("circle", { cx: x, cy: plot.y(p.measured), r: 2.2, class: "measured" }));
  });
  if (parts.length) plot.svg.append(svg("path", { d: parts.join(""), class: "predicted" }));
  return plot.svg;
}

/** Difference of the means in percent by wavelength, with one standard deviation of the measured mean. */
function percentChart(picture, figures) {
  const axis = wavelengthAxis(picture);
  const ends = figures.map((f) => Math.abs(f.percent) + f.percent_sigma).filter(Number.isFinite);
  const end = 1.1 * Math.max(0.1, ...ends);
  const plot = chart("Means, (photograph − rendering) / rendering, %", axis, { low: -end, high: end });
  plot.svg.append(svg("line", { x1: CHART.left, x2: CHART.width - CHART.right, y1: plot.y(0), y2: plot.y(0), class: "axis" }));
  figures.forEach((f, b) => {
    if (!Number.isFinite(f.percent)) return;
    const x = plot.x(axis.of(f, b));
    const [low, up] = [f.percent - f.percent_sigma, f.percent + f.percent_sigma].map(plot.y);
    plot.svg.append(svg("path", { d: `M${x - 3} ${low}h6M${x - 3} ${up}h6M${x} ${low}V${up}`, class: "measured" }));
    plot.svg.append(svg("circle", { cx: x, cy: plot.y(f.percent), r: 3, class: "measured" }));
  });
  return plot.svg;
}

/** Histogram of the differences in sigma of all bands, with the curve of noise alone. */
function histogramChart(picture, region) {
  const count = picture.width * picture.height;
  const step = 0.5;
  const bins = new Array(20).fill(0);
  let total = 0;
  for (const [x, y] of regionPixels(region))
    for (let b = 0; b < picture.bands.length; b++) {
      const k = b * count + y * picture.width + x;
      if (picture.mask[k] || !(picture.sigma[k] > 0)) continue;
      const value = (picture.measured[k] - picture.rendered[k]) / picture.sigma[k];
      bins[Math.min(Math.max(Math.floor((value + 5) / step), 0), bins.length - 1)]++;
      total++;
    }
  const noise = (v) => total * step * Math.exp(-0.5 * v * v) / Math.sqrt(2 * Math.PI);
  const plot = chart("Number of differences; line: noise alone", { low: -5, high: 5, name: "difference, σ (ends: beyond)" },
    { low: 0, high: 1.05 * Math.max(...bins, noise(0), 1) });
  bins.forEach((number, k) => {
    const [x, y] = [plot.x(-5 + k * step), plot.y(number)];
    plot.svg.append(svg("rect", { x, y, width: plot.x(step) - plot.x(0) - 1, height: plot.y(0) - y, class: "bin" }));
  });
  const curve = Array.from({ length: 101 }, (_, k) => -5 + k / 10);
  plot.svg.append(svg("path", { d: "M" + curve.map((v) => `${plot.x(v).toFixed(1)} ${plot.y(noise(v)).toFixed(1)}`).join("L"), class: "predicted" }));
  return plot.svg;
}

function regionTable(figures) {
  const names = bandNames(figures);
  const alike = figures.every((f) => f.pixels === figures[0].pixels);
  const head = ["band", ...(alike ? [] : ["px"]), "measured ± σ of the mean, DN", "predicted, DN", "difference, %", "scatter, both, DN"];
  const rows = figures.map((f, b) => [
    names[b], ...(alike ? [] : [String(f.pixels)]), `${shown(f.measured, 5)} ±\u00a0${shown(f.sigma, 2)}`, shown(f.rendered, 5),
    `${signed(f.percent)} ±\u00a0${shown(f.percent_sigma, 2)}`, `${shown(f.scatter, 3)} ${shown(f.scatter_rendered, 3)}`,
  ]);
  return valueTable(head, rows);
}

/** Title of a region: kind, size, and the surfaces under it, the largest first. */
function regionTitle(picture, region) {
  const pixels = regionPixels(region);
  const parts = new Map();
  for (const [x, y] of pixels) {
    const name = surfaceName(picture, y * picture.width + x);
    parts.set(name, (parts.get(name) || 0) + 1);
  }
  const names = [...parts].sort((p, q) => q[1] - p[1]).slice(0, 3).map(([name]) => name);
  const [from, to] = [region.points[0], region.points[region.points.length - 1]];
  const where = region.kind === "polygon" ? "" : ` from ${from.join(", ")} to ${to.join(", ")}`;
  return `${REGIONS[region.kind].name}${where}, ${pixels.length} px: ${names.join(", ")}`;
}

/** The panel of a region as elements; a hint before it has enough points. */
function regionPanel(picture, region, band) {
  const { name, points } = REGIONS[region.kind];
  if (region.points.length < points)
    return [html("p", {}, `${name}: ${region.points.length} of ${points} points.`)];
  const line = region.kind === "line";
  const figures = line ? null : regionFigures(picture, region);
  const bars = line ? "● measured ± 1 σ of a pixel" : "● mean ± scatter of the pixels, and ± 1 σ of the mean";
  const scattered = figures && { bands: figures.map((f) => ({ ...f, sigma: f.scatter })) };
  const charts = line ? [profileChart(picture, region, band)] :
    [signalChart(picture, scattered), percentChart(picture, figures), histogramChart(picture, region)];
  const note = line ? "Pixels that are left out have no point." :
    "σ of the mean holds where the noise of the pixels is independent. Pixels that are left out do not count.";
  return [
    html("h3", {}, regionTitle(picture, region)),
    html("p", { class: "cbv-key" }, [
      html("span", { class: "measured" }, bars), html("span", { class: "predicted" }, line ? "— predicted" : "□ predicted"),
    ]),
    html("div", { class: "cbv-charts" }, charts),
    ...(figures ? [regionTable(figures)] : []),
    html("p", { class: "cbv-help" }, note),
  ];
}

/** The outline of a region on a picture; `at(x, y)` is the place of a pixel's centre, `cell` the side of a pixel. */
function drawRegion(context, region, at, cell) {
  const places = region.points.map(([x, y]) => at(x, y));
  for (const [width, colour] of [[3.5, "#000"], [1.5, "#fff"]]) {
    context.lineWidth = width;
    context.strokeStyle = colour;
    context.beginPath();
    if (region.kind === "rectangle" && places.length === 2) {
      const [[x1, y1], [x2, y2]] = places;
      context.rect(Math.min(x1, x2) - cell / 2, Math.min(y1, y2) - cell / 2, Math.abs(x2 - x1) + cell, Math.abs(y2 - y1) + cell);
    } else {
      places.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
      if (region.kind === "polygon") context.closePath();
      for (const [x, y] of places) context.rect(x - 2, y - 2, 4, 4);
    }
    context.stroke();
  }
}
