// A robot's own model as joints with the names of servos: from glTF's nodes, or from a URDF.
//
// A joint is {name, turn(deg)}; the angle is that of its servo's encoder, 0 as the model stands.

import { STLLoader, THREE } from "nicegui-scene";

const MM_PER_M = 1000;

/** A name without spaces, dots and case, which programs that export models change. Pure. */
export function plain(name) {
  return String(name ?? "").toLowerCase().replace(/[\s._:-]+/g, "");
}

/**
 * Joints of a glTF scene: nodes that are named as servos. A node turns about its own x axis by the
 * right-hand rule; extras may say {"axis": [x, y, z]}, and {"mm_per_deg": 0.2} for one that slides.
 */
export function nodeJoints(root, servos) {
  const wanted = new Map(servos.map((name) => [plain(name), name]));
  const found = [];
  root.traverse((node) => {
    const name = wanted.get(plain(node.name));
    if (!name || found.some((each) => each.name === name)) return;
    const { axis = [1, 0, 0], mm_per_deg: mmPerDeg } = node.userData ?? {};
    found.push({ name, turn: turning(node, axis, mmPerDeg === undefined ? null : mmPerDeg / MM_PER_M) });
  });
  return found;
}

/** How a node is moved by degrees from where it stands; metresPerDeg: it slides. */
function turning(node, axis, metresPerDeg) {
  const along = new THREE.Vector3(...axis);
  if (along.length() < 1e-9) throw new Error(`joint ${node.name}: its axis is no direction`);
  along.normalize();
  const turned = node.quaternion.clone();
  const placed = node.position.clone();
  const by = new THREE.Quaternion();
  if (metresPerDeg !== null) {
    const way = along.clone().applyQuaternion(turned);
    return (deg) => node.position.copy(placed).addScaledVector(way, deg * metresPerDeg);
  }
  return (deg) => {
    by.setFromAxisAngle(along, THREE.MathUtils.degToRad(deg));
    node.quaternion.copy(turned).multiply(by);
  };
}

/**
 * A robot of a URDF: {root, joints, missing}. meshes: Map of a file's name, without folders and in
 * lower case, to its ArrayBuffer; STL alone. missing: names of meshes that are not among them.
 */
export function urdfModel(text, meshes, servos) {
  const xml = new DOMParser().parseFromString(text, "application/xml");
  if (xml.querySelector("parsererror") || xml.documentElement.tagName !== "robot") {
    throw new Error("it is no URDF: its root is no <robot>");
  }
  const missing = new Set();
  const materials = colours(xml.documentElement);
  const links = new Map();
  for (const link of children(xml.documentElement, "link")) {
    const group = new THREE.Group();
    group.name = link.getAttribute("name");
    for (const visual of children(link, "visual")) {
      const mesh = shape(visual, meshes, materials, missing);
      if (mesh) group.add(mesh);
    }
    links.set(group.name, group);
  }
  const root = new THREE.Group();
  // A URDF has x ahead, y to the left and z up; here z is to the viewer and y is up.
  root.rotation.set(-Math.PI / 2, 0, -Math.PI / 2);
  const moved = new Map();
  const joints = [];
  const wanted = new Map(servos.map((name) => [plain(name), name]));
  for (const joint of children(xml.documentElement, "joint")) {
    const [parent, child] = ["parent", "child"].map((tag) =>
      links.get(children(joint, tag)[0]?.getAttribute("link")),
    );
    if (!parent || !child || moved.has(child)) continue;
    const node = new THREE.Group();
    node.name = joint.getAttribute("name");
    place(node, children(joint, "origin")[0]);
    parent.add(node);
    node.add(child);
    moved.set(child, node);
    const type = joint.getAttribute("type");
    const name = wanted.get(plain(node.name));
    if (!name || type === "fixed") continue;
    const axis = numbers(children(joint, "axis")[0]?.getAttribute("xyz"), [1, 0, 0]);
    joints.push({ name, turn: turning(node, axis, type === "prismatic" ? 1 / MM_PER_M : null) });
  }
  for (const link of links.values()) if (!moved.has(link)) root.add(link);
  const whole = new THREE.Group();
  whole.add(root);
  return { root: whole, joints, missing: [...missing] };
}

function children(element, tag) {
  return [...element.children].filter((each) => each.tagName === tag);
}

/** The numbers in a text, as many as in `otherwise`; `otherwise` itself where they are not. */
function numbers(text, otherwise) {
  const found = (text ?? "").trim().split(/\s+/).map(Number);
  return found.length === otherwise.length && found.every(Number.isFinite) ? found : otherwise;
}

/** Fixed axes, roll then pitch then yaw, as the URDF has them. */
function place(node, origin) {
  node.position.set(...numbers(origin?.getAttribute("xyz"), [0, 0, 0]));
  node.rotation.set(...numbers(origin?.getAttribute("rpy"), [0, 0, 0]), "ZYX");
}

function colours(robot) {
  return new Map(children(robot, "material").map((one) => [one.getAttribute("name"), colourOf(one)]));
}

function colourOf(material) {
  const rgba = material && children(material, "color")[0]?.getAttribute("rgba");
  return rgba ? new THREE.Color(...numbers(rgba, [0.8, 0.8, 0.8, 1]).slice(0, 3)) : null;
}

/** The mesh of a URDF's <visual>, with place and colour; null where its geometry is not available. */
function shape(visual, meshes, materials, missing) {
  const form = children(visual, "geometry")[0]?.firstElementChild;
  if (!form) return null;
  const geometry = geometryOf(form, meshes, missing);
  if (!geometry) return null;
  const named = children(visual, "material")[0];
  const color = colourOf(named) ?? materials.get(named?.getAttribute("name")) ?? 0xb8c2cc;
  const mesh = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color, roughness: 0.6 }));
  place(mesh, children(visual, "origin")[0]);
  return mesh;
}

/** The geometry of a URDF's shape element; null for a mesh that is not among the files, noted in `missing`. */
function geometryOf(form, meshes, missing) {
  const number = (name) => Number(form.getAttribute(name)) || 0.01;
  if (form.tagName === "box") return new THREE.BoxGeometry(...numbers(form.getAttribute("size"), [0.01, 0.01, 0.01]));
  if (form.tagName === "sphere") return new THREE.SphereGeometry(number("radius"), 24, 16);
  if (form.tagName === "cylinder") {
    const radius = number("radius");
    return new THREE.CylinderGeometry(radius, radius, number("length"), 24).rotateX(Math.PI / 2);
  }
  const file = (form.getAttribute("filename") ?? "").split(/[/\\]/).at(-1).toLowerCase();
  const buffer = meshes.get(file);
  if (!buffer || !file.endsWith(".stl")) {
    missing.add(file || form.tagName);
    return null;
  }
  return new STLLoader().parse(buffer).scale(...numbers(form.getAttribute("scale"), [1, 1, 1]));
}
