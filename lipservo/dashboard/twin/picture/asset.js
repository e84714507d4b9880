// Reads what lipsync/twin/packed.py and lipservo/display/photo_packed.py write: a header in JSON,
// then arrays.

const ARRAYS = { "<f4": Float32Array, "<u2": Uint16Array, u1: Uint8Array };
const SCALED = { "<i2": Int16Array, i1: Int8Array };

/**
 * {header, array}: the header of a packed buffer, and a function that returns the array at a place that
 * the header names, {at, count, type, step}; integers with a `step` are scaled by it.
 */
export function readPacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const body = 4 + length;

  function array({ at, count, type, step }) {
    if (type in ARRAYS) return new ARRAYS[type](buffer, body + at, count);
    const scaled = Float32Array.from(new SCALED[type](buffer, body + at, count));
    // A loop: `from` with a function takes ten times as long.
    for (let i = 0; i < count; i += 1) scaled[i] *= step;
    return scaled;
  }

  return { header, array };
}

/** The header of a twin, with arrays in the place of what says where they lie; lengths in mm. */
export function readAsset(buffer) {
  const { header, array } = readPacked(buffer);
  for (const part of header.parts) {
    for (const name of ["places", "triangles", "normals", "colours"]) part[name] = array(part[name]);
    for (const morph of part.morphs) {
      morph.moves = array(morph.moves);
      morph.turns = array(morph.turns);
    }
  }
  return header;
}

export async function loadAsset(url) {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${url}: ${answer.status}`);
  return readAsset(await answer.arrayBuffer());
}
