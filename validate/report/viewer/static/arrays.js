/* Arrays as the page receives them, and as the viewer works on them (Float32Array, row by row). */

/** Bytes of base64 text, unpacked where they were deflated. */
async function unpacked(text, deflated) {
  const letters = atob(text);
  const packed = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) packed[i] = letters.charCodeAt(i);
  if (!deflated) return packed.buffer;
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

/** Little-endian numbers of a buffer. Bytes stand in planes: all first bytes, then all second ones. */
function joined(buffer, size) {
  const planes = new Uint8Array(buffer);
  const count = planes.length / size;
  const bytes = new Uint8Array(planes.length);
  for (let plane = 0, from = 0; plane < size; plane++)
    for (let i = 0, to = plane; i < count; i++, to += size) bytes[to] = planes[from++];
  return bytes.buffer;
}

/**
 * A flat Float32Array of `given`: null stays null, a typed array or list is taken as it is, an encoded array
 * {type, shape, scale, offset, data, deflated} is decoded: value = offset + scale * stored, with one scale and
 * offset for each entry of the first axis. Stored NaN is the largest number of the type u2.
 */
async function decoded(given) {
  if (given === null || given === undefined) return null;
  if (given instanceof Float32Array) return given;
  if (Array.isArray(given) || ArrayBuffer.isView(given)) return Float32Array.from(given);
  const size = { f4: 4, u2: 2, i2: 2, u1: 1 }[given.type];
  if (!size) throw new Error("viewer: unknown type of numbers '" + given.type + "'");
  const buffer = joined(await unpacked(given.data, given.deflated), size);
  if (given.type === "f4") return new Float32Array(buffer);
  const stored = new { u2: Uint16Array, i2: Int16Array, u1: Uint8Array }[given.type](buffer);
  const out = new Float32Array(stored.length);
  const planes = given.scale ? given.scale.length : 1;
  const each = stored.length / planes;
  for (let p = 0; p < planes; p++) {
    const scale = given.scale ? given.scale[p] : 1;
    const offset = given.offset ? given.offset[p] : 0;
    for (let i = p * each; i < (p + 1) * each; i++)
      out[i] = given.scale && given.type === "u2" && stored[i] === 65535 ? NaN : offset + scale * stored[i];
  }
  return out;
}
