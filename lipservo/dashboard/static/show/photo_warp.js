// Where the points of a photograph go when its face moves: lipservo/display/photo_warp.py and
// lip_contact.py, in a browser. Pure; a test compares the two. Pixels, x right, y down, z to the viewer.

const MOST_ROUNDS = 200; // of unfolding
const LEAST_SHARE = 0.02; // of its area that a triangle keeps

/**
 * A photograph's warp: the header of a packed buffer, with its arrays and the areas of its triangles.
 * readPacked: of the twin's module; buffer: what lipservo/display/photo_packed.py wrote.
 */
export function readWarp(readPacked, buffer) {
  const { header, array } = readPacked(buffer);
  const read = (where) => array(where);
  for (const name of ["places", "own_px", "rest_px", "triangles"]) header[name] = read(header[name]);
  for (const [name, where] of Object.entries(header.targets)) header.targets[name] = read(where);
  for (const part of header.layers) {
    for (const name of ["places", "colours", "triangles"]) part[name] = read(part[name]);
  }
  header.areas = areasOf(header, header.rest_px);
  return header;
}

/** The amount of each morph target, by name, in a frame of static/frame.js; what it lacks is at rest. */
export function amountsOf(warp, frame) {
  const amounts = {};
  warp.components.forEach((name, k) => {
    const amount = frame.coefficients?.[k];
    amounts[name] = Number.isFinite(amount) ? amount : warp.rest[k];
  });
  for (const [name, [least, most]] of Object.entries(warp.most)) {
    amounts[name] = Math.min(most, Math.max(least, frame.expression?.[name] ?? 0));
  }
  for (const side of ["left", "right"]) {
    const lid = amounts[`lid_${side}`];
    amounts[`lid_${side}_over`] = lid * (1 - lid);
  }
  return amounts;
}

/**
 * {px, depth, amounts, pose}: the mesh's vertices in pixels, x and y in turn, and the depth of those of
 * the skin; the amounts of its targets; how the head is turned (`poseOf`).
 */
export function moved(warp, frame) {
  const amounts = amountsOf(warp, frame);
  const skin = new Float64Array(warp.places);
  for (const [name, moves] of Object.entries(warp.targets)) {
    const amount = amounts[name];
    if (amount) for (let i = 0; i < skin.length; i += 1) skin[i] += amount * moves[i];
  }
  meet(warp.contact, warp.components.map((name) => amounts[name]), skin);
  const pose = poseOf(warp, frame);
  turn(skin, pose);
  const still = new Float64Array(warp.own_px);
  turn(still, pose);
  const nSkin = skin.length / 3;
  const px = new Float64Array(warp.rest_px.length);
  const depth = new Float64Array(nSkin);
  for (let i = 0; i < nSkin; i += 1) {
    px[2 * i] = skin[3 * i];
    px[2 * i + 1] = skin[3 * i + 1];
    depth[i] = skin[3 * i + 2];
  }
  placeRings(warp, px, placeEyes(warp, still, px, nSkin));
  unfold(warp, px);
  return { px, depth, amounts, pose };
}

/** Lips brought together where the model's touch, in place. As `LipContact.bring_together`. */
function meet(contact, coefficients, skin) {
  const [dx, dy] = contact.down;
  const widestMm = Math.max(
    ...contact.gap_at_zero_mm.map((zero, i) =>
      contact.gap_each_mm[i].reduce((sum, each, k) => sum + each * coefficients[k], zero),
    ),
  );
  const nearer = Math.min(1, Math.max(0, 1 - widestMm / contact.own_gap_mm));
  const closing = contact.upper.map((upper, i) => {
    const lower = contact.lower[i];
    const gap = (skin[3 * lower] - skin[3 * upper]) * dx + (skin[3 * lower + 1] - skin[3 * upper + 1]) * dy;
    return Math.min(contact.excess_px[i] * nearer, gap - contact.least_px[i]) / 2;
  });
  contact.felt.forEach(([rows, columns, shares], side) => {
    const way = side === 0 ? 1 : -1;
    rows.forEach((row, n) => {
      const by = way * shares[n] * closing[columns[n]];
      skin[3 * row] += by * dx;
      skin[3 * row + 1] += by * dy;
    });
  });
}

/** {matrix, shift}: a point p turns to matrix p + shift, about the pivot; null: the head is straight. */
function poseOf(warp, frame) {
  const rad = (name) => {
    const most = warp.most_pose_deg[name];
    const deg = frame.expression?.[`neck_${name}_deg`] ?? 0;
    return (Math.min(most, Math.max(-most, deg)) * Math.PI) / 180;
  };
  const [pitch, yaw, roll] = ["pitch", "yaw", "roll"].map(rad);
  if (!pitch && !yaw && !roll) return null;
  const [cx, sx, cy, sy, cz, sz] = [-pitch, yaw, -roll].flatMap((a) => [Math.cos(a), Math.sin(a)]);
  const aboutX = [[1, 0, 0], [0, cx, -sx], [0, sx, cx]];
  const aboutY = [[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]];
  const aboutZ = [[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]];
  const back = warp.axes[0].map((_, i) => warp.axes.map((row) => row[i]));
  const matrix = [times(aboutY, times(aboutX, aboutZ)), back].reduce(times, warp.axes);
  const pivot = warp.pivot_px;
  const shift = matrix.map((row, i) => pivot[i] - row.reduce((sum, each, k) => sum + each * pivot[k], 0));
  return { matrix, shift };
}

function times(one, other) {
  return one.map((row) => other[0].map((_, j) => row.reduce((sum, each, k) => sum + each * other[k][j], 0)));
}

/** Points (n * 3) turned with the head, in place. */
export function turn(points, pose) {
  if (!pose) return;
  const [a, b, c] = pose.matrix;
  for (let i = 0; i < points.length; i += 3) {
    const [x, y, z] = [points[i], points[i + 1], points[i + 2]];
    points[i] = a[0] * x + a[1] * y + a[2] * z + pose.shift[0];
    points[i + 1] = b[0] * x + b[1] * y + b[2] * z + pose.shift[1];
    points[i + 2] = c[0] * x + c[1] * y + c[2] * z + pose.shift[2];
  }
}

/** Place the eyes' vertices, which only turn with the head, and their centres; return the row after them. */
function placeEyes(warp, still, px, first) {
  let at = first;
  for (const eye of warp.eyes) {
    let x = 0, y = 0;
    for (const row of eye) {
      px[2 * at] = still[3 * row];
      px[2 * at + 1] = still[3 * row + 1];
      x += px[2 * at] / eye.length;
      y += px[2 * at + 1] / eye.length;
      at += 1;
    }
    px[2 * at] = x;
    px[2 * at + 1] = y;
    at += 1;
  }
  return at;
}

/**
 * Move the background's rings of vertices with the rim of the face, less with each ring outwards; the
 * motion of the rim is smoothed along it. first: the row of the first ring.
 */
function placeRings(warp, px, first) {
  const { rim, rest_px: rest, rim_neighbours: reach } = warp;
  const n = rim.length;
  for (let i = 0; i < n; i += 1) {
    for (const axis of [0, 1]) {
      let move = 0;
      for (let k = -reach; k <= reach; k += 1) {
        const at = 2 * rim[(i + k + n) % n] + axis;
        move += (px[at] - rest[at]) / (2 * reach + 1);
      }
      warp.rings.forEach((share, ring) => {
        const at = 2 * (first + ring * n + i) + axis;
        px[at] = rest[at] + share * move;
      });
    }
  }
}

/**
 * Move triangles of the skin that would turn over, or nearly, as a whole, by the mean motion of their
 * corners; again until none is left. As `Unfolding`.
 */
function unfold(warp, px) {
  const { triangles, rest_px: rest, first_skin: first, areas: own } = warp;
  for (let round = 0; round < MOST_ROUNDS; round += 1) {
    const areas = areasOf(warp, px);
    const sums = new Map();
    for (let n = 0; n < areas.length; n += 1) {
      if (areas[n] * Math.sign(own[n]) >= LEAST_SHARE * Math.abs(own[n])) continue;
      const corners = [0, 1, 2].map((k) => triangles[3 * (first + n) + k]);
      const middle = [0, 1].map((axis) =>
        corners.reduce((sum, row) => sum + (px[2 * row + axis] - rest[2 * row + axis]) / 3, 0),
      );
      for (const row of corners) {
        const sum = sums.get(row) ?? [0, 0, 0];
        sums.set(row, [sum[0] + middle[0], sum[1] + middle[1], sum[2] + 1]);
      }
    }
    if (!sums.size) return;
    for (const [row, [x, y, count]] of sums) {
      px[2 * row] = rest[2 * row] + x / count;
      px[2 * row + 1] = rest[2 * row + 1] + y / count;
    }
  }
}

/** Twice the area of each triangle of the skin, with the sign of the way round. */
function areasOf({ triangles, first_skin: first }, px) {
  const n = triangles.length / 3 - first;
  const areas = new Float64Array(n);
  for (let i = 0; i < n; i += 1) {
    const at = 3 * (first + i);
    const [a, b, c] = [2 * triangles[at], 2 * triangles[at + 1], 2 * triangles[at + 2]];
    areas[i] = (px[b] - px[a]) * (px[c + 1] - px[a + 1]) - (px[b + 1] - px[a + 1]) * (px[c] - px[a]);
  }
  return areas;
}
