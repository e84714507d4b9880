// The same frames without WebGL: outline, eyes, lids, brows and lips on a 2-D canvas.

import { placeOf } from "./pose.js";

export const WITHOUT_WEBGL = "WebGL is not available: simple drawing";
const HEIGHT_MM = 250;
const MIDDLE_MM = [0, -38];

/** Draw the face in `container`. Returns {show(pose), stop(), triangles: 0, element}, as head.js does. */
export function makeDrawing(container, asset, onDrawn) {
  const canvas = document.createElement("canvas");
  const note = document.createElement("div");
  note.textContent = WITHOUT_WEBGL;
  note.className = "twin-note";
  note.style.cssText = "position:absolute;bottom:6px;left:10px;font:13px sans-serif;color:var(--soft, #555)";
  container.append(canvas, note);
  const paint = canvas.getContext("2d");
  const skin = asset.parts[0];
  let shown = null;
  let waiting = null;

  const draw = () => {
    waiting = null;
    const { clientWidth: width, clientHeight: height } = container;
    if (!shown || !width || !height) return;
    canvas.width = width;
    canvas.height = height;
    const scale = height / HEIGHT_MM;
    paint.clearRect(0, 0, width, height);
    paint.setTransform(
      scale, 0, 0, -scale, width / 2 - MIDDLE_MM[0] * scale, height / 2 + MIDDLE_MM[1] * scale,
    );
    paint.lineWidth = 0.8;
    const turned = rotation(shown.neckDeg);
    const flat = (place) => atPivot(place, asset.pivot_mm, turned);
    const path = (name, closed = true) => {
      const corners = asset.lines[name].map((vertex) => flat(placeOf(skin, vertex, shown.targets)));
      trace(paint, corners, closed);
    };
    const fill = (name, colour) => {
      path(name);
      paint.fillStyle = colour;
      paint.fill();
    };
    fill("rim", "#e6bba4");
    paint.strokeStyle = "#c59079";
    path("nose", false);
    paint.stroke();
    for (const eye of asset.eyes) {
      paint.save();
      fill(`eye_${eye.side}`, "#f5f2ee");
      path(`eye_${eye.side}`);
      paint.clip();
      const gaze = rotation(shown.eyesDeg);
      const front = times(gaze, [0, 0, eye.radius_mm]).map((each, i) => each + eye.centre_mm[i]);
      const [x, y] = flat(front);
      for (const [share, colour] of [[1, "#56737a"], [0.45, "#101012"]]) {
        paint.beginPath();
        paint.arc(x, y, share * eye.iris_radius_mm, 0, 2 * Math.PI);
        paint.fillStyle = colour;
        paint.fill();
      }
      paint.restore();
      path(`eye_${eye.side}`);
      paint.strokeStyle = "#40302a";
      paint.stroke();
      fill(`brow_${eye.side}`, "#6b4d3d");
    }
    fill("outer_lip", "#c0706c");
    fill("inner_lip", "#3a1214");
    paint.strokeStyle = "#7a3b3b";
    paint.stroke();
    paint.setTransform(1, 0, 0, 1, 0, 0);
    onDrawn();
  };
  const drawSoon = () => {
    waiting ??= requestAnimationFrame(draw);
  };
  const sizes = new ResizeObserver(drawSoon);
  sizes.observe(container);

  return {
    triangles: 0,
    element: canvas,
    show(pose) {
      shown = pose;
      drawSoon();
    },
    stop() {
      cancelAnimationFrame(waiting);
      sizes.disconnect();
      canvas.remove();
      note.remove();
    },
  };
}

/** A smooth line through the middles of a polygon's edges, or straight from corner to corner. */
function trace(paint, corners, closed) {
  paint.beginPath();
  if (!closed) {
    for (const [x, y] of corners) paint.lineTo(x, y);
    return;
  }
  corners.forEach(([x, y], i) => {
    const [nextX, nextY] = corners[(i + 1) % corners.length];
    const [lastX, lastY] = corners.at(i - 1);
    if (i === 0) paint.moveTo((lastX + x) / 2, (lastY + y) / 2);
    paint.quadraticCurveTo(x, y, (x + nextX) / 2, (y + nextY) / 2);
  });
  paint.closePath();
}

/** Rows of the matrix that turns by yaw, then pitch, then roll, as head.js does. */
function rotation({ pitch, yaw, roll }) {
  const [x, y, z] = [-pitch, yaw, -roll].map((each) => (each * Math.PI) / 180);
  const [cx, cy, cz] = [x, y, z].map(Math.cos);
  const [sx, sy, sz] = [x, y, z].map(Math.sin);
  return [
    [cy * cz + sy * sx * sz, -cy * sz + sy * sx * cz, sy * cx],
    [cx * sz, cx * cz, -sx],
    [-sy * cz + cy * sx * sz, sy * sz + cy * sx * cz, cy * cx],
  ];
}

function times(matrix, vector) {
  return matrix.map((row) => row.reduce((sum, each, i) => sum + each * vector[i], 0));
}

function atPivot(place, pivot, turned) {
  const moved = times(turned, place.map((each, i) => each - pivot[i]));
  return moved.map((each, i) => each + pivot[i]);
}
