// The head in three.js, of NiceGUI's scene module. Draws only when something has changed.

import { OrbitControls, THREE } from "nicegui-scene";
import { earParts } from "./ears.js";
import { eyeTexture } from "./eye_texture.js";
import { plainMesh } from "./plain_mesh.js";
import { lipGapMm } from "./pose.js";

const LOOK_AT_MM = [0, -52, -45];
const DISTANCE_MM = 640;
const FIELD_OF_VIEW_DEG = 27;
/** The same for a close-up: the middle of the mouth, and the distance from which it is seen. */
const MOUTH_AT_MM = [0, -84, 5];
const NEAR_MM = 205;
/** Light inside the mouth: the least share, and the lip gaps between which it rises to 1. */
const MOUTH_LIGHT = { least: 0.12, fromMm: 0.9, toMm: 5 };
const IN_MOUTH = ["teeth_upper", "teeth_lower", "tongue", "mouth"];
const MATERIALS = {
  skin: { roughness: 0.62 },
  teeth_upper: { roughness: 0.35 },
  teeth_lower: { roughness: 0.35 },
  tongue: { roughness: 0.5 },
  mouth: { roughness: 0.8, side: THREE.DoubleSide },
  lids_left: { roughness: 0.7, side: THREE.DoubleSide },
  lids_right: { roughness: 0.7, side: THREE.DoubleSide },
  neck: { roughness: 0.6 },
  ear: { roughness: 0.62 },
};

/**
 * Draw the head by WebGL in `container`. Returns {show(pose), closeUp(isNear), stop(), triangles,
 * element}; onDrawn is called after every redraw. What a processor draws alone is simpler (plain_mesh.js), and its edges are not smoothed.
 */
export function makeHead(container, asset, onDrawn, { inSoftware }) {
  const renderer = new THREE.WebGLRenderer({ antialias: !inSoftware, alpha: true });
  renderer.setPixelRatio(inSoftware ? 1 : Math.min(window.devicePixelRatio, 2));
  // Asking after errors waits for every shader to be compiled, one after the other.
  renderer.debug.checkShaderErrors = false;
  container.append(renderer.domElement);
  const scene = new THREE.Scene();
  renderer.setClearColor(0, 0); // the page is seen behind it, light or dark
  light(scene);

  const pivot = new THREE.Vector3(...asset.pivot_mm);
  const head = new THREE.Group();
  head.position.copy(pivot);
  scene.add(head);
  const meshes = [...asset.parts, ...earParts(asset)].map((part) => {
    const mesh = meshOf(part, inSoftware);
    if (part.stays) {
      scene.add(mesh);
    } else {
      mesh.position.copy(pivot).negate();
      head.add(mesh);
    }
    return mesh;
  });
  const inMouth = meshes.filter((mesh) => IN_MOUTH.includes(mesh.name));
  const eyes = asset.eyes.map((eye) => {
    const ball = eyeball(eye, inSoftware);
    ball.position.set(...eye.centre_mm).sub(pivot);
    head.add(ball);
    return ball;
  });

  const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 50, 4000);
  camera.position.set(LOOK_AT_MM[0], LOOK_AT_MM[1] + 10, LOOK_AT_MM[2] + DISTANCE_MM);
  const controls = new OrbitControls(camera, renderer.domElement);
  controls.target.set(...LOOK_AT_MM);
  controls.enablePan = false;
  controls.minDistance = 120;
  controls.maxDistance = 1500;
  controls.update();

  let waiting = null;
  const draw = () => {
    waiting = null;
    if (!container.clientWidth) return; // it has no place yet: `fit` draws it once it has
    renderer.render(scene, camera);
    onDrawn();
  };
  const drawSoon = () => {
    waiting ??= requestAnimationFrame(draw);
  };
  controls.addEventListener("change", drawSoon);
  const size = new THREE.Vector2();
  const fit = () => {
    const { clientWidth, clientHeight } = container;
    renderer.getSize(size);
    const isAsBefore = size.x === clientWidth && size.y === clientHeight;
    if (!clientWidth || !clientHeight || isAsBefore) return;
    renderer.setSize(clientWidth, clientHeight);
    camera.aspect = clientWidth / clientHeight;
    camera.updateProjectionMatrix();
    drawSoon();
  };
  renderer.compile(scene, camera);
  const sizes = new ResizeObserver(fit);
  sizes.observe(container);
  fit();

  return {
    closeUp(isNear) {
      const [x, y, z] = isNear ? MOUTH_AT_MM : LOOK_AT_MM;
      controls.target.set(x, y, z);
      camera.position.set(x, isNear ? y : y + 10, z + (isNear ? NEAR_MM : DISTANCE_MM));
      controls.update();
      drawSoon();
    },
    triangles: meshes[0].geometry.index.count / 3,
    element: renderer.domElement,
    show(pose) {
      turn(head, pose.neckDeg);
      for (const eye of eyes) turn(eye, pose.eyesDeg);
      for (const mesh of meshes) mesh.userData.move(pose.targets);
      const light = mouthLight(lipGapMm(asset, pose.targets));
      for (const mesh of inMouth) mesh.material.color.setScalar(light);
      drawSoon();
    },
    stop() {
      cancelAnimationFrame(waiting);
      sizes.disconnect();
      controls.dispose();
      scene.traverse((each) => {
        each.geometry?.dispose();
        each.material?.map?.dispose();
        each.material?.dispose();
      });
      renderer.dispose();
      renderer.domElement.remove();
    },
  };
}

function mouthLight(gapMm) {
  const { least, fromMm, toMm } = MOUTH_LIGHT;
  return least + (1 - least) * THREE.MathUtils.smoothstep(gapMm, fromMm, toMm);
}

/** Pitch up, yaw to the face's own left, roll to its left shoulder; the face looks along +z. */
function turn(object, { pitch, yaw, roll }) {
  const angles = [-pitch, yaw, -roll].map((each) => THREE.MathUtils.degToRad(each));
  object.rotation.set(...angles, "YXZ");
}

/** The mesh of a part of the asset; its `userData.move(targets)` applies the morph targets. */
function meshOf(part, inSoftware) {
  const colours = linear(part.colours);
  const { mesh, move } = inSoftware
    ? plainMesh(part, colours, { vertexColors: true, side: MATERIALS[part.name].side ?? THREE.FrontSide })
    : morphedMesh(part, colours);
  mesh.name = part.name;
  mesh.frustumCulled = false;
  mesh.userData.move = move;
  return mesh;
}

/** {mesh, move(targets)}: a part of the asset whose morph targets the shader applies. */
function morphedMesh(part, colours) {
  const geometry = new THREE.BufferGeometry();
  const floats = (values) => new THREE.BufferAttribute(values, 3);
  geometry.setAttribute("position", floats(part.places));
  geometry.setAttribute("normal", floats(part.normals));
  geometry.setAttribute("color", floats(colours));
  geometry.setIndex(new THREE.BufferAttribute(part.triangles, 1));
  geometry.morphTargetsRelative = true;
  if (part.morphs.length) {
    geometry.morphAttributes.position = part.morphs.map((morph) => floats(morph.moves));
    geometry.morphAttributes.normal = part.morphs.map((morph) => floats(morph.turns));
  }
  const material = new THREE.MeshStandardMaterial({ vertexColors: true, ...MATERIALS[part.name] });
  const mesh = new THREE.Mesh(geometry, material);
  const move = (targets) => {
    part.morphs.forEach(({ name }, k) => (mesh.morphTargetInfluences[k] = targets[name]));
  };
  return { mesh, move };
}

/** The mesh of an eyeball; in software a matt one, of fewer triangles. */
function eyeball(eye, inSoftware) {
  const [around, down] = inSoftware ? [20, 16] : [48, 40];
  const geometry = new THREE.SphereGeometry(eye.radius_mm, around, down).rotateX(Math.PI / 2);
  const map = new THREE.CanvasTexture(eyeTexture(eye.iris_radius_mm, eye.radius_mm));
  map.colorSpace = THREE.SRGBColorSpace;
  const material = inSoftware
    ? new THREE.MeshBasicMaterial({ map })
    : new THREE.MeshStandardMaterial({ map, roughness: 0.18 });
  return new THREE.Mesh(geometry, material);
}

/** sRGB bytes to linear shares. */
function linear(bytes) {
  const shares = Float32Array.from({ length: 256 }, (_, byte) => ((byte / 255 + 0.055) / 1.055) ** 2.4);
  const found = new Float32Array(bytes.length);
  for (let i = 0; i < bytes.length; i += 1) found[i] = shares[bytes[i]];
  return found;
}

/** Add the sky's light and three lamps to a scene; plain_mesh.js computes the same. */
function light(scene) {
  scene.add(new THREE.HemisphereLight(0xffffff, 0xb59a8c, 1.5));
  const from = (x, y, z, strength, colour) => {
    const lamp = new THREE.DirectionalLight(colour, strength);
    lamp.position.set(x, y, z);
    scene.add(lamp);
  };
  from(-350, 420, 600, 1.7, 0xfff4e8);
  from(500, 120, 400, 0.6, 0xe8f0ff);
  from(200, 300, -500, 0.9, 0xffffff);
}
