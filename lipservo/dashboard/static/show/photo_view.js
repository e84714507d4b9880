// A photograph that speaks, in WebGL: flat layers from the back to the front, as
// lipservo/display/photo_display.py and mouth_inside.py draw them into films.

import { THREE } from "nicegui-scene";
import { moved, turn } from "./photo_warp.js";

/** How much darker it is right under the upper lip than deeper in the mouth. */
const SHADOW = 0.55;
/** Width of the picture in a close-up, in widths of the mouth. */
const NEAR_WIDTHS = 2.2;
/** Bright skin round the mouth; darker light makes darker teeth, within these. */
const BRIGHT = 0.85, FULL_LIGHT = 185, LEAST_TONE = 0.45, MOST_TONE = 1.1, HUE = 0.15;

/**
 * Draw a photograph in `container`. picture: a canvas of the warp's size; warp: as of `readWarp`.
 * Returns {show(frame), closeUp(isNear), stop(), gapPx, drawn, element}; gapPx: how far the lips are
 * open; drawn: how often it was drawn.
 */
export function makePhoto(container, picture, warp, { inSoftware }) {
  const [width, height] = warp.size;
  const renderer = new THREE.WebGLRenderer({ antialias: !inSoftware, alpha: true });
  renderer.setPixelRatio(inSoftware ? 1 : Math.min(window.devicePixelRatio, 2));
  renderer.setClearColor(0, 0);
  // Pixels are shown as the photograph has them, and blended as a film blends them.
  renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
  container.append(renderer.domElement);
  const map = new THREE.CanvasTexture(picture);
  map.colorSpace = THREE.NoColorSpace;
  if (inSoftware) {
    map.generateMipmaps = false;
    map.minFilter = THREE.LinearFilter;
  }
  const scene = new THREE.Scene();
  const camera = new THREE.OrthographicCamera();
  camera.position.z = 10;
  const uvOf = (rest, nUv) => {
    const uv = new Float32Array(2 * nUv);
    for (let i = 0; i < nUv; i += 1) {
      uv[2 * i] = (rest[2 * i] + 0.5) / width;
      uv[2 * i + 1] = 1 - (rest[2 * i + 1] + 0.5) / height;
    }
    return new THREE.BufferAttribute(uv, 2);
  };
  let order = 0;
  const layer = (geometry, look, isSolid = true) => {
    const material = new THREE.MeshBasicMaterial({
      side: THREE.DoubleSide, transparent: true, depthTest: false, depthWrite: false,
      blending: isSolid ? THREE.NoBlending : THREE.NormalBlending, ...look,
    });
    const mesh = new THREE.Mesh(geometry, material);
    mesh.frustumCulled = false;
    mesh.renderOrder = order;
    order += 1;
    scene.add(mesh);
    return mesh;
  };
  const places = (n) => new THREE.BufferAttribute(new Float32Array(3 * n), 3).setUsage(THREE.DynamicDrawUsage);
  const flat = (position, uv, triangles) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", position);
    if (uv) geometry.setAttribute("uv", uv);
    geometry.setIndex(new THREE.BufferAttribute(triangles, 1));
    return geometry;
  };

  const corners = [-0.5, -0.5, width - 0.5, -0.5, -0.5, height - 0.5, width - 0.5, height - 0.5];
  const whole = places(4);
  fill(whole, corners);
  layer(flat(whole, uvOf(corners, 4), new Uint16Array([0, 1, 2, 1, 3, 2])), { map });
  const n = warp.rest_px.length / 2;
  const meshAt = places(n);
  const uv = uvOf(warp.rest_px, n);
  const [eyes, skin] = [3 * warp.first_eye, 3 * warp.first_skin];
  layer(flat(meshAt, uv, warp.triangles.slice(0, eyes)), { map });

  const inside = mouth(warp, flat, places, layer, uvOf, map);
  const toned = tone(picture, warp);
  layer(flat(meshAt, uv, warp.triangles.slice(eyes, skin)), { map });
  layer(flat(meshAt, uv, warp.triangles.slice(skin)), { map });

  let waiting = null;
  const view = { gapPx: null, drawn: 0, isNear: false, element: renderer.domElement };
  const draw = () => {
    waiting = null;
    if (!container.clientWidth) return;
    renderer.render(scene, camera);
    view.drawn += 1;
  };
  const drawSoon = () => {
    waiting ??= requestAnimationFrame(draw);
  };
  const size = new THREE.Vector2();
  const fit = () => {
    const { clientWidth, clientHeight } = container;
    if (!clientWidth || !clientHeight) return;
    renderer.getSize(size);
    if (size.x !== clientWidth || size.y !== clientHeight) renderer.setSize(clientWidth, clientHeight);
    const across = view.isNear ? NEAR_WIDTHS * inside.widthPx : width;
    const [x, y] = view.isNear ? inside.middle : [(width - 1) / 2, (height - 1) / 2];
    const perPx = Math.max(across / clientWidth, (view.isNear ? across * 0.6 : height) / clientHeight);
    const [right, down] = [(clientWidth * perPx) / 2, (clientHeight * perPx) / 2];
    Object.assign(camera, { left: x - right, right: x + right, top: y - down, bottom: y + down });
    camera.updateProjectionMatrix();
    // What gives way round the face may not leave the picture.
    const [left, bottom] = [(right - x - 0.5) / perPx, (down - height + 0.5 + y) / perPx];
    renderer.setScissor(Math.ceil(left), Math.ceil(bottom), Math.floor(width / perPx), Math.floor(height / perPx));
    drawSoon();
  };
  renderer.setScissorTest(true);
  const sizes = new ResizeObserver(fit);
  sizes.observe(container);
  return Object.assign(view, {
    show(frame) {
      const now = moved(warp, frame);
      fill(meshAt, now.px);
      view.gapPx = inside.place(now, toned);
      drawSoon();
    },
    closeUp(isNear) {
      view.isNear = isNear;
      fit();
    },
    stop() {
      cancelAnimationFrame(waiting);
      sizes.disconnect();
      scene.traverse((each) => {
        each.geometry?.dispose();
        each.material?.dispose();
      });
      map.dispose();
      renderer.dispose();
      renderer.domElement.remove();
    },
  });
}

/** Write points, [x, y, x, y, ...], into an attribute of three numbers each; z stays. */
function fill(attribute, px) {
  for (let i = 0; 2 * i < px.length; i += 1) attribute.setXY(i, px[2 * i], px[2 * i + 1]);
  attribute.needsUpdate = true;
}

/**
 * What is behind the lips: darkness, teeth and tongue, the upper lip's shadow, and over them the
 * rims of the lips, each as wide as the lips part before anything is seen between them.
 */
function mouth(warp, flat, places, layer, uvOf, map) {
  const half = warp.lips.length / 2;
  const upper = warp.lips.slice(0, half + 1);
  const lower = [...warp.lips.slice(half), warp.lips[0]].reverse();
  const pairs = half + 1;
  const rest = (row) => [warp.rest_px[2 * row], warp.rest_px[2 * row + 1]];
  const strip = (rows, bands) => {
    const triangles = [];
    for (const band of bands) {
      for (let i = 0; i + 1 < pairs; i += 1) {
        const [a, b] = [rows * i + band, rows * (i + 1) + band];
        triangles.push(a, a + 1, b, a + 1, b + 1, b);
      }
    }
    return new Uint16Array(triangles);
  };
  const ring = places(2 * pairs);
  const dark = layer(flat(ring, null, strip(2, [0])), { color: 0xffffff });
  const own = Object.fromEntries(warp.components.map((name, k) => [name, warp.own[k]]));
  const parts = warp.layers.map((part) => {
    const geometry = flat(places(part.places.length / 3), null, part.triangles);
    const colours = Float32Array.from(part.colours, (each) => each / 255);
    geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    return { part, mesh: layer(geometry, { vertexColors: true }, !part.raised_by) };
  });
  const shadow = flat(places(2 * pairs), null, strip(2, [0]));
  shadow.setAttribute("color", new THREE.BufferAttribute(new Float32Array(8 * pairs), 4));
  layer(shadow, { vertexColors: true }, false);
  // Of each pair: rim, end of the rim; between the rims twice their middle; end of the rim, rim.
  const ROWS = 8;
  const uvPx = new Float32Array(2 * ROWS * pairs);
  for (let i = 0; i < pairs; i += 1) {
    for (let row = 0; row < ROWS; row += 1) uvPx.set(rest(row < 4 ? upper[i] : lower[i]), 2 * (ROWS * i + row));
  }
  const rims = flat(places(ROWS * pairs), uvOf(uvPx, ROWS * pairs), strip(ROWS, [0, 2, 4, 6]));
  const tints = new Float32Array(4 * ROWS * pairs).fill(1);
  rims.setAttribute("color", new THREE.BufferAttribute(tints, 4));
  layer(rims, { map, vertexColors: true }, false);

  const [left, right] = [rest(upper[0]), rest(upper[half])];
  return {
    widthPx: Math.hypot(right[0] - left[0], right[1] - left[1]),
    middle: [(left[0] + right[0]) / 2, (left[1] + right[1]) / 2],
    /** Place all of it; returns how far the lips are open at the most, in pixels. */
    place({ px, amounts, pose }, toned) {
      const at = (row) => [px[2 * row], px[2 * row + 1]];
      const [from, to] = [at(upper[0]), at(upper[half])];
      const long = Math.max(Math.hypot(to[0] - from[0], to[1] - from[1]), 1e-9);
      const down = [-(to[1] - from[1]) / long, (to[0] - from[0]) / long];
      let widest = 0;
      for (let i = 0; i < pairs; i += 1) {
        const [top, bottom] = [at(upper[i]), at(lower[i])];
        const gap = (bottom[0] - top[0]) * down[0] + (bottom[1] - top[1]) * down[1];
        const open = Math.max(0, gap - warp.hidden_px[i]);
        const rim = Math.min(warp.hidden_px[i], Math.max(gap, 0)) / 2;
        widest = Math.max(widest, open);
        const below = (point, by) => [point[0] + by * down[0], point[1] + by * down[1]];
        const [ends, begins] = [below(top, rim), below(bottom, -rim)];
        const middle = [(ends[0] + begins[0]) / 2, (ends[1] + begins[1]) / 2];
        ring.setXY(2 * i, ...top);
        ring.setXY(2 * i + 1, ...bottom);
        const deep = Math.min(open, warp.shadow_px);
        shadow.attributes.position.setXY(2 * i, ...ends);
        shadow.attributes.position.setXY(2 * i + 1, ...below(ends, deep));
        shadow.attributes.color.setW(2 * i, SHADOW);
        shadow.attributes.color.setW(2 * i + 1, SHADOW * (1 - deep / warp.shadow_px));
        // Between the lips their own skin hides the dark until they part by parted_px.
        const hides = 1 - Math.min(1, open / warp.parted_px);
        [top, ends, ends, middle, middle, begins, begins, bottom].forEach((point, row) => {
          const vertex = ROWS * i + row;
          rims.attributes.position.setXY(vertex, ...point);
          const isBetween = row > 1 && row < 6;
          const tint = isBetween ? warp.shade : 1;
          rims.attributes.color.setXYZW(vertex, tint, tint, tint, isBetween ? hides : 1);
        });
      }
      for (const geometry of [shadow, rims]) {
        geometry.attributes.position.needsUpdate = geometry.attributes.color.needsUpdate = true;
      }
      ring.needsUpdate = true;
      const [darkPx, lightPx] = warp.light_px;
      const share = THREE.MathUtils.smoothstep(widest, darkPx, lightPx);
      const light = warp.least_light + (1 - warp.least_light) * share;
      dark.material.color.setRGB(...warp.darkness.map((each, k) => (light * toned[k] * each) / 255));
      for (const { part, mesh } of parts) {
        // A tongue comes up from below, and out of the dark.
        const shown = amounts[part.raised_by] ?? 1;
        mesh.visible = widest > 0 && shown > 0;
        if (!mesh.visible) continue;
        mesh.material.opacity = shown;
        const points = new Float64Array(part.places);
        const by = [0, 0, 0];
        for (const [name, way] of Object.entries(part.moves_px)) {
          way.forEach((each, axis) => (by[axis] += (amounts[name] - (own[name] ?? 1)) * each));
        }
        for (let i = 0; i < points.length; i += 1) points[i] += by[i % 3];
        turn(points, pose);
        const { position } = mesh.geometry.attributes;
        for (let i = 0; 3 * i < points.length; i += 1) position.setXY(i, points[3 * i], points[3 * i + 1]);
        position.needsUpdate = true;
        mesh.material.color.setRGB(...toned.map((each) => light * each));
      }
      return widest;
    },
  };
}

/** How bright and how coloured the photograph's light is at the lips, against white. */
function tone(picture, warp) {
  const at = warp.lips.map((row) => [warp.rest_px[2 * row], warp.rest_px[2 * row + 1]]);
  const low = [0, 1].map((axis) => Math.max(0, Math.floor(Math.min(...at.map((each) => each[axis]))) - 10));
  const high = [0, 1].map((axis) =>
    Math.min(warp.size[axis], Math.ceil(Math.max(...at.map((each) => each[axis]))) + 10),
  );
  const [wide, tall] = [Math.max(1, high[0] - low[0]), Math.max(1, high[1] - low[1])];
  const { data } = picture.getContext("2d").getImageData(...low, wide, tall);
  const bright = [0, 1, 2].map((channel) => {
    const values = data.filter((_, i) => i % 4 === channel).sort();
    return values[Math.floor(BRIGHT * (values.length - 1))];
  });
  const grey = Math.max(1, (bright[0] + bright[1] + bright[2]) / 3);
  const level = Math.min(MOST_TONE, Math.max(LEAST_TONE, grey / FULL_LIGHT));
  return bright.map((each) => level * (1 + HUE * (each / grey - 1)));
}
