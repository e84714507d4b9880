// Plain ears for the head, which the face mesh does not have: a shell and its rim, of simple shapes.
// They are made up, as the back of the head is, and nothing moves them but the head.

import { THREE } from "nicegui-scene";

/** The skin's vertices before the ears, by side; which way the ear points. */
const BEFORE_EAR = { right: [234, -1], left: [454, 1] };
/** From there to the middle of the ear, mm: outwards, up, and back; and its half axes. */
const AWAY_MM = [7, 8, -17];
const SHELL_MM = [4.5, 26, 14];
const TILT_RAD = 0.2; // the upper end leans back
const OUT_RAD = 0.45; // the rear edge stands off

/** Both ears as parts of an asset, a shell and a rim each, in the colour of the skin before the ear. */
export function earParts(asset) {
  const skin = asset.parts[0];
  return Object.values(BEFORE_EAR).flatMap(([vertex, out]) => {
    const at = [0, 1, 2].map((axis) => skin.places[3 * vertex + axis]);
    const colour = skin.colours.slice(3 * vertex, 3 * vertex + 3);
    const place = new THREE.Matrix4()
      .makeTranslation(at[0] + out * AWAY_MM[0], at[1] + AWAY_MM[1], at[2] + AWAY_MM[2])
      .multiply(new THREE.Matrix4().makeRotationY(-out * OUT_RAD))
      .multiply(new THREE.Matrix4().makeRotationX(-TILT_RAD));
    const shell = new THREE.SphereGeometry(1, 18, 14).scale(...SHELL_MM);
    const rim = new THREE.TorusGeometry(0.86, 0.13, 8, 28)
      .rotateY(Math.PI / 2)
      .scale(12, SHELL_MM[1], SHELL_MM[2])
      .translate(out * 3, 0, 0);
    return [[shell, 0.93], [rim, 1]].map(([geometry, shade]) => {
      geometry.applyMatrix4(place);
      const { position, normal } = geometry.attributes;
      const colours = Uint8Array.from({ length: position.array.length }, (_, i) => shade * colour[i % 3]);
      return {
        name: "ear", places: position.array, normals: normal.array, colours,
        triangles: Uint16Array.from(geometry.index.array), morphs: [], stays: false,
      };
    });
  });
}
