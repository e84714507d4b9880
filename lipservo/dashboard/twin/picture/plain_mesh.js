// The head for a browser that draws with the processor alone: a quarter of the skin's triangles,
// moved here and not in the shader, with its light in the colours. Twice to four times as fast.

import { THREE } from "nicegui-scene";

/** Lamps as in `head.js`: position, strength. */
const LAMPS = [[[-350, 420, 600], 1.7], [[500, 120, 400], 0.6], [[200, 300, -500], 0.9]];
const SKY = 1.5, GROUND = 1.05;

/**
 * {mesh, move(targets)}: a part of the asset, lit beforehand and moved by the processor. colours: of its
 * vertices, linear, 0 to 1; look: options of the material.
 */
export function plainMesh(part, colours, look) {
  const triangles = part.name === "skin" ? quarter(part.triangles) : part.triangles;
  const used = [...new Set(triangles)].sort((a, b) => a - b);
  const number = new Map(used.map((row, i) => [row, i]));
  const chosen = (values) => Float32Array.from({ length: 3 * used.length }, (_, i) => values[3 * used[(i / 3) | 0] + (i % 3)]);
  const rest = chosen(part.places);
  const morphs = part.morphs.map((morph) => [morph.name, chosen(morph.moves)]);
  const lit = chosen(colours);
  const normals = chosen(part.normals);
  for (let i = 0; i < lit.length; i += 3) {
    const light = lightOn(normals[i], normals[i + 1], normals[i + 2]);
    for (const k of [0, 1, 2]) lit[i + k] *= light;
  }
  const geometry = new THREE.BufferGeometry();
  const position = new THREE.BufferAttribute(Float32Array.from(rest), 3).setUsage(THREE.DynamicDrawUsage);
  geometry.setAttribute("position", position);
  geometry.setAttribute("color", new THREE.BufferAttribute(lit, 3));
  geometry.setIndex(Array.from(triangles, (row) => number.get(row)));
  const mesh = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(look));
  const move = (targets) => {
    if (!morphs.length) return;
    const at = position.array;
    at.set(rest);
    for (const [name, moves] of morphs) {
      const amount = targets[name];
      if (amount) for (let i = 0; i < at.length; i += 1) at[i] += amount * moves[i];
    }
    position.needsUpdate = true;
  };
  return { mesh, move };
}

/** The triangles before the last subdivision: one for each four, by their outer corners. */
function quarter(triangles) {
  const found = [];
  for (let i = 0; i + 11 < triangles.length; i += 12) found.push(triangles[i], triangles[i + 4], triangles[i + 8]);
  return found;
}

/** Light on a matt surface with this normal, divided by pi as three.js's shaders do. */
function lightOn(x, y, z) {
  let light = GROUND + ((SKY - GROUND) * (y + 1)) / 2;
  for (const [[lx, ly, lz], strength] of LAMPS) {
    light += strength * Math.max(0, (x * lx + y * ly + z * lz) / Math.hypot(lx, ly, lz));
  }
  return light / Math.PI;
}
