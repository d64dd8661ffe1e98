/* Layers of a picture: their values in every pixel, their scales and colours. */

/** Named ends of the scales; they are the same for every capture. `null`: the largest value in the picture. */
const SCALES = {
  standard: { name: "standard: 5 σ, ΔE 5, 10 %, FLIP 0.2", sigma: 5, colour: 5, percent: 10, flip: 0.2 },
  fine: { name: "fine: 1 σ, ΔE 1, 2 %, FLIP 0.04", sigma: 1, colour: 1, percent: 2, flip: 0.04 },
  coarse: { name: "coarse: 25 σ, ΔE 25, 50 %, FLIP 1", sigma: 25, colour: 25, percent: 50, flip: 1 },
  own: { name: "largest value of this picture", sigma: null, colour: null, percent: null, flip: null },
};

/** Colours of mask reasons, distinct in all common colour vision deficiencies. */
const REASON_COLOURS = ["#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#d55e00", "#0072b2", "#f0e442"];

/** The layers in the order of the lists. kind: picture, difference (signed), size (from 0), reason. signal: what a
    difference is computed from, a band or one of X, Y, Z. */
const fixedLayers = (picture) => [
  { id: "measured", name: "Photograph", kind: "picture" },
  { id: "rendered", name: "Rendering", kind: "picture" },
  { id: "residual", name: "Photograph minus rendering, σ", kind: "difference", end: "sigma", unit: "σ", perBand: true },
  { id: "absolute", name: "Photograph minus rendering", kind: "difference", signal: true },
  { id: "relative", name: "Photograph minus rendering, relative", kind: "difference", signal: true, end: "percent", unit: "%" },
  ...picture.colour_differences.map((difference) => ({
    id: difference.id, name: difference.title, kind: "size", end: "colour", unit: difference.unit, difference,
  })),
  { id: "flip", name: "FLIP", kind: "size", end: "flip", unit: "", values: picture.flip, 
    lacks: picture.flip || picture.flip_later ? "" : picture.flip_lacking },
  { id: "luminance", name: "Luminance difference", kind: "difference", end: "percent", unit: "%" },
  { id: "masks", name: "Pixels left out", kind: "reason" },
];

/** All layers of a picture: the fixed ones and the picture's own maps (signatures, steps). */
function layersOf(picture) {
  const own = (picture.maps || []).map((map) => ({
    id: map.id, name: map.name, kind: "difference", end: "sigma", unit: map.unit || "σ",
    perBand: map.perBand, values: map.values, red: map.red || "brighter with the effect",
  }));
  return [...fixedLayers(picture), ...own];
}

/** Name of the surface of pixel `i`. */
function surfaceName(picture, i) {
  const label = picture.surface[i];
  return label >= 0 ? picture.surfaces[label] : label === -1 ? "lamp" : "outside the box";
}

/** Axis of XYZ that `band` of the viewer's state stands for; Y for all bands. */
const axisOf = (band) => (band <= -2 ? -2 - band : 1);

/** Name of the signal that `band` stands for, with its unit. */
function signalName(picture, band) {
  const one = picture.bands[band];
  const name = one ? (one.nm === null ? one.id : `${one.nm.toFixed(0)} nm`) : "XYZ"[axisOf(band)];
  return `${name}, ${signalUnit(picture, band)}`;
}

const signalUnit = (picture, band) => (band >= 0 ? "DN" : picture.xyz_unit);

/** [measured, rendered, sigma] of pixel `i` in a band or in one of X, Y, Z; NaN where it is left out. */
function signalAt(picture, band, i) {
  const count = picture.width * picture.height;
  const k = band * count + i;
  if (band >= 0) return picture.mask[k] ? [NaN, NaN, NaN] : [picture.measured[k], picture.rendered[k], picture.sigma[k]];
  if (leftOut(picture, i)) return [NaN, NaN, NaN];
  const weights = picture.xyz_per_dn[axisOf(band)];
  const sum = (values, power) => weights.reduce((total, w, b) => total + (w * values[b * count + i]) ** power, 0);
  return [sum(picture.measured, 1), sum(picture.rendered, 1), Math.sqrt(sum(picture.sigma, 2))];
}

/** Whether pixel `i` is left out in some band. */
function leftOut(picture, i) {
  const count = picture.width * picture.height;
  for (let b = 0; b < picture.bands.length; b++) if (picture.mask[b * count + i]) return true;
  return false;
}

/** Sum of values (band, y, x) over the bands used at pixel `i`, over its standard deviation; NaN with none. */
function pooled(picture, values, i) {
  const count = picture.width * picture.height;
  let sum = 0;
  let bands = 0;
  for (let b = 0; b < picture.bands.length; b++) {
    const v = values[b * count + i];
    if (!picture.mask[b * count + i] && Number.isFinite(v)) {
      sum += v;
      bands++;
    }
  }
  return bands ? sum / Math.sqrt(bands) : NaN;
}

/** (measured - rendered) / sigma in all bands, NaN where left out: Float32Array (band, y, x). */
function residuals(picture) {
  const out = new Float32Array(picture.measured.length);
  for (let i = 0; i < out.length; i++)
    out[i] = picture.mask[i] ? NaN : (picture.measured[i] - picture.rendered[i]) / picture.sigma[i];
  return out;
}

/**
 * Values of a layer in every pixel: Float32Array (y, x), NaN where left out. band: number of the band, or -1 for all
 * of them together (sum over its standard deviation). Pictures have values for a band or one of X, Y, Z (-2, -3, -4).
 */
function layerValues(picture, layer, band) {
  const count = picture.width * picture.height;
  const out = new Float32Array(count);
  if (layer.kind === "picture") {
    const signals = picture[layer.id];
    if (band >= 0) return signals.subarray(band * count, (band + 1) * count);
    for (let i = 0; i < count; i++) out[i] = xyzOf(picture, signals, i)[axisOf(band)];
    return out;
  }
  if (layer.signal) {
    for (let i = 0; i < count; i++) {
      const [measured, rendered] = signalAt(picture, band, i);
      out[i] = layer.id === "absolute" ? measured - rendered : rendered > 0 ? 100 * (measured / rendered - 1) : NaN;
    }
    return out;
  }
  if (layer.perBand) {
    const values = layer.id === "residual" ? residuals(picture) : layer.values;
    if (band >= 0) return values.subarray(band * count, (band + 1) * count);
    for (let i = 0; i < count; i++) out[i] = pooled(picture, values, i);
    return out;
  }
  if (layer.values) return layer.values;
  if (layer.id === "flip") return out.fill(NaN);
  for (let i = 0; i < count; i++) {
    if (layer.kind === "reason") {
      for (let b = 0; b < picture.bands.length; b++)
        if (band < 0 || band === b) out[i] |= picture.mask[b * count + i];
      continue;
    }
    out[i] = colourValue(picture, layer.difference, i);
  }
  return out;
}

/** Largest finite magnitude of values; 1 without any. */
function largest(values) {
  let most = 0;
  for (const v of values) if (Number.isFinite(v)) most = Math.max(most, Math.abs(v));
  return most || 1;
}

/** The scale of a layer: {low, high, unit, table}, or null for colour pictures and reasons. */
function layerScale(picture, layer, state, values) {
  if (layer.kind === "reason") return null;
  const { diverging, sequential } = picture.tables;
  if (layer.kind === "picture") {
    if (state.band === -1) return null;
    const both = ["measured", "rendered"].map((id) =>
      largest(layerValues(picture, { id, kind: "picture" }, state.band)));
    const unit = state.band >= 0 ? "DN" : picture.xyz_unit;
    return { low: 0, high: Math.max(...both) / 2 ** state.exposure, unit, table: sequential };
  }
  const end = SCALES[state.scale][layer.end] ?? largest(values);
  if (layer.kind === "size") return { low: 0, high: end, unit: layer.unit, table: sequential };
  return { low: -end, high: end, unit: layer.unit ?? signalUnit(picture, state.band), table: diverging };
}

/** RGBA bytes of a layer, pixel by pixel; clear where there is no value. */
function painted(picture, layer, state) {
  const count = picture.width * picture.height;
  if (layer.kind === "picture" && state.band === -1)
    return { rgba: srgbPicture(picture, picture[layer.id], state.exposure), values: null, scale: null };
  const rgba = new Uint8ClampedArray(4 * count);
  const put = (i, colour) => {
    for (let channel = 0; channel < 3; channel++) rgba[4 * i + channel] = colour[channel];
    rgba[4 * i + 3] = 255;
  };
  const values = layerValues(picture, layer, state.band);
  if (layer.kind === "reason") {
    for (let i = 0; i < count; i++) {
      const first = picture.reasons.findIndex((reason) => values[i] & reason.bit);
      if (first >= 0) put(i, parts(REASON_COLOURS[first % REASON_COLOURS.length]));
    }
    return { rgba, values, scale: null };
  }
  const scale = layerScale(picture, layer, state, values);
  for (let i = 0; i < count; i++) {
    if (!Number.isFinite(values[i])) continue;
    const place = (values[i] - scale.low) / (scale.high - scale.low);
    put(i, scale.table[Math.round(255 * Math.min(Math.max(place, 0), 1))]);
  }
  return { rgba, values, scale };
}

function parts(hex) {
  return [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
}
