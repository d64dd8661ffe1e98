/* Colour: XYZ of band signals, CIELab, colour differences, sRGB. The formulas are those of
   validate/compare/colour_difference.py, whose table names the function of each difference; a test compares the two. */

/** XYZ [X, Y, Z] of pixel `i` of band signals (band, y, x). */
function xyzOf(picture, signals, i) {
  const out = [0, 0, 0];
  const count = picture.width * picture.height;
  for (let c = 0; c < 3; c++)
    for (let b = 0; b < picture.bands.length; b++) out[c] += picture.xyz_per_dn[c][b] * signals[b * count + i];
  return out;
}

/** CIELab [L, a, b] of XYZ, relative to the white {x, y, luminance}. */
function labOf(xyz, white) {
  const tristimulus = [white.x / white.y, 1, (1 - white.x - white.y) / white.y];
  const f = xyz.map((value, c) => {
    const t = value / (white.luminance * tristimulus[c]);
    return t > 216 / 24389 ? Math.cbrt(t) : (t * (24389 / 27) + 16) / 116;
  });
  return [116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])];
}

/** Delta E*ab of 1976. */
function deltaE1976(p, q) {
  return Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]);
}

/** CIEDE2000 with kL = kC = kH = 1. */
function deltaE2000(p, q) {
  const radian = Math.PI / 180;
  const seventh = (v) => v ** 7 / (v ** 7 + 25 ** 7);
  const chroma = (Math.hypot(p[1], p[2]) + Math.hypot(q[1], q[2])) / 2;
  const stretch = 1.5 - 0.5 * Math.sqrt(seventh(chroma));
  const [a1, a2] = [p[1] * stretch, q[1] * stretch];
  const [c1, c2] = [Math.hypot(a1, p[2]), Math.hypot(a2, q[2])];
  const angle = (b, a) => (a === 0 && b === 0 ? 0 : (Math.atan2(b, a) / radian + 360) % 360);
  const [h1, h2] = [angle(p[2], a1), angle(q[2], a2)];
  const grey = c1 * c2 === 0;
  let turn = grey ? 0 : h2 - h1;
  if (turn > 180) turn -= 360;
  if (turn < -180) turn += 360;
  let hue = h1 + h2;
  if (!grey) hue = (Math.abs(h1 - h2) > 180 ? hue + (hue < 360 ? 360 : -360) : hue) / 2;
  const lightness = (p[0] + q[0]) / 2 - 50;
  const mean = (c1 + c2) / 2;
  const cosine = (times, shift) => Math.cos((times * hue + shift) * radian);
  const t = 1 - 0.17 * cosine(1, -30) + 0.24 * cosine(2, 0) + 0.32 * cosine(3, 6) - 0.2 * cosine(4, -63);
  const dL = (q[0] - p[0]) / (1 + (0.015 * lightness ** 2) / Math.sqrt(20 + lightness ** 2));
  const dC = (c2 - c1) / (1 + 0.045 * mean);
  const dH = (2 * Math.sqrt(c1 * c2) * Math.sin((turn / 2) * radian)) / (1 + 0.015 * mean * t);
  const rotation =
    -2 * Math.sqrt(seventh(mean)) * Math.sin(60 * Math.exp(-(((hue - 275) / 25) ** 2)) * radian);
  return Math.sqrt(Math.max(dL ** 2 + dC ** 2 + dH ** 2 + rotation * dC * dH, 0));
}

/** Functions of two CIELab colours, by the name that the table of differences gives them. */
const COLOUR_DIFFERENCES = { deltaE1976, deltaE2000 };

/** A colour difference {script} of the table, or the luminance difference in %, of measured and rendered pixel `i`. */
function colourValue(picture, difference, i) {
  if (leftOut(picture, i) || picture.surface[i] < 0) return NaN;
  const measured = xyzOf(picture, picture.measured, i);
  const rendered = xyzOf(picture, picture.rendered, i);
  if (!difference) return rendered[1] > 0 ? 100 * (measured[1] / rendered[1] - 1) : NaN;
  return COLOUR_DIFFERENCES[difference.script](labOf(measured, picture.white), labOf(rendered, picture.white));
}

/** Bytes RGBA of sRGB of band signals at an exposure in stops; the white is 255 at 0 stops. */
function srgbPicture(picture, signals, stops) {
  const count = picture.width * picture.height;
  const gain = 2 ** stops / picture.white.luminance;
  const rgba = new Uint8ClampedArray(4 * count).fill(255);
  picture.srgb.forEach((row, channel) => {
    const linear = new Float64Array(count);
    picture.bands.forEach((_, b) => {
      const weight = gain * (row[0] * picture.xyz_per_dn[0][b] + row[1] * picture.xyz_per_dn[1][b] +
        row[2] * picture.xyz_per_dn[2][b]);
      for (let i = 0, k = b * count; i < count; i++, k++) linear[i] += weight * signals[k];
    });
    for (let i = 0; i < count; i++) {
      const v = linear[i];
      const shade = v <= 0.0031308 ? 12.92 * Math.max(v, 0) : 1.055 * Math.min(v, 1) ** (1 / 2.4) - 0.055;
      rgba[4 * i + channel] = Number.isNaN(v) ? 128 : Math.round(255 * shade);
    }
  });
  return rgba;
}

/** Table of 256 colours [r, g, b] from hexadecimal stops at equal distances. */
function colourTable(stops) {
  const rgb = stops.map((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)));
  return Array.from({ length: 256 }, (_, k) => {
    const place = (k / 255) * (rgb.length - 1);
    const low = Math.min(Math.floor(place), rgb.length - 2);
    return rgb[low].map((v, c) => Math.round(v + (place - low) * (rgb[low + 1][c] - v)));
  });
}
