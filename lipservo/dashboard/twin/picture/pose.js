// What a frame asks of the head: how much of each morph target, and angles in degrees.

/** Beyond these a target no longer looks like what it stands for. */
const LID = [-0.35, 1];
const BROW = [-0.5, 1.3];
const SMILE = [-0.7, 1.1];

const within = (value, [least, most]) => Math.min(most, Math.max(least, value));

/** The pose of a face of which nothing is known: its mouth is at rest. */
export function restingPose(asset) {
  return poseOf({ coefficients: asset.rest, expression: {} }, asset);
}

/**
 * The head's pose in a frame of static/frame.js. Returns {targets: {name: amount}, neckDeg, eyesDeg}, the angles as
 * {pitch, yaw, roll}. What the frame leaves open is 0; components that it lacks are those of rest.
 */
export function poseOf(frame, asset) {
  const expressionOf = (name) => frame.expression?.[name] ?? 0;
  const targets = {};
  asset.components.forEach((name, k) => {
    const amount = frame.coefficients?.[k];
    targets[name] = Number.isFinite(amount) ? amount : asset.rest[k];
  });
  for (const side of ["left", "right"]) {
    const lid = within(expressionOf(`lid_${side}`), LID);
    targets[`lid_${side}`] = lid;
    // The second target leads the lid over the eyeball and not through it: packed.py.
    targets[`lid_${side}_over`] = Math.max(0, lid * (1 - lid));
  }
  targets.brow = within(expressionOf("brow"), BROW);
  targets.smile = within(expressionOf("smile"), SMILE);
  for (const name of ["lip_tuck", "tongue_dental", "tongue_alveolar"]) {
    targets[name] = within(expressionOf(name), [0, 1]);
  }
  return {
    targets,
    neckDeg: {
      pitch: expressionOf("neck_pitch_deg"),
      yaw: expressionOf("neck_yaw_deg"),
      roll: expressionOf("neck_roll_deg"),
    },
    eyesDeg: { pitch: expressionOf("eye_pitch_deg"), yaw: expressionOf("eye_yaw_deg"), roll: 0 },
  };
}

/** Whether two poses look the same: to a thousandth of a millimetre and of a degree or so. */
export function alike(one, other) {
  if (!one || !other) return false;
  const near = (a, b) => Object.keys(a).every((name) => Math.abs(a[name] - b[name]) < 0.001);
  return (
    near(one.targets, other.targets) &&
    near(one.neckDeg, other.neckDeg) &&
    near(one.eyesDeg, other.eyesDeg)
  );
}

/** Where a vertex of a part is in a pose, in mm, before the head turns. */
export function placeOf(part, vertex, targets) {
  return [0, 1, 2].map((axis) =>
    part.morphs.reduce(
      (sum, morph) => sum + targets[morph.name] * morph.moves[3 * vertex + axis],
      part.places[3 * vertex + axis],
    ),
  );
}

/** How far the middles of the inner lips are apart in a pose, upper above lower, in mm. */
export function lipGapMm(asset, targets) {
  const [upper, lower] = asset.lip_gap.map((vertex) => placeOf(asset.parts[0], vertex, targets)[1]);
  return upper - lower;
}
