// The figure itself, as SVG: millimetres of horns and hinges, drawn at 2.6 units a millimetre.
//
// Geometry of the simulated face (calibration/simulated/face.py): lip horns are 8 mm, the incisors
// 88 mm from the jaw's hinge. Small angles look larger than on a real head, on purpose: 1 mm of lip
// must be seen from two metres.

const UNIT = 2.6;
const HORN_MM = 8;
const JAW_MM = 88;
const MOUTH = { x: 200, y: 280, halfMm: 27, innerMm: 11 };
const EYES = { y: 165, apart: 52, radius: 27, iris: 12 };
const RAD = Math.PI / 180;

export const HATCH =
  '<defs><pattern id="hatch" width="7" height="7" patternUnits="userSpaceOnUse" ' +
  'patternTransform="rotate(45)"><rect width="7" height="7" fill="#d7dde2"/>' +
  '<rect width="2.5" height="7" fill="#9aa6b0"/></pattern></defs>';

/** SVG of the figure at rest; `drawFigure` moves it. channels: motions that this robot has servos for. */
export function figure(channels) {
  const eyes = channels.has("eye_yaw") || channels.has("eye_pitch") || channels.has("lid");
  return (
    '<g class="neck"><path class="plate" d="M158 330h84v88h-84z"/>' +
    '<path class="plate" d="M128 408h144l14 22h-172z"/></g>' +
    '<g class="head"><path class="jaw" d="M104 214c2 78 20 122 58 142q38 14 76 0c38-20 56-64 58-142z"/>' +
    '<path class="skull" d="M200 32c80 0 116 58 113 134-1 46-8 74-17 96l-24 22q-72 10-144 0l-24-22' +
    'c-9-22-16-50-17-96-3-76 33-134 113-134z"/>' +
    '<circle class="bolt" cx="103" cy="226" r="9"/><circle class="bolt" cx="297" cy="226" r="9"/>' +
    '<g class="features">' +
    '<path class="nose" d="M200 188l-13 46q13 9 26 0z"/>' +
    (eyes ? eye("right", -1) + eye("left", 1) : "") +
    (channels.has("brow") ? brow("right", -1) + brow("left", 1) : "") +
    '<path class="cavity"/><path class="teeth upper"/><path class="teeth lower"/>' +
    '<path class="lip upper" data-part="upper"/><path class="lip lower" data-part="lower"/>' +
    '<g class="horns"></g></g></g>'
  );
}

/** SVG of an eye. side: the robot's; direction: -1 to the viewer's left, 1 to the right. */
function eye(side, direction) {
  const x = MOUTH.x + direction * EYES.apart;
  const { y, radius, iris } = EYES;
  return (
    `<clipPath id="eye-${side}"><circle cx="${x}" cy="${y}" r="${radius}"/></clipPath>` +
    `<g class="eye" data-eye="${side}"><circle class="white" cx="${x}" cy="${y}" r="${radius}"/>` +
    `<g clip-path="url(#eye-${side})"><g class="ball"><circle class="iris" cx="${x}" cy="${y}" r="${iris}"/>` +
    `<circle class="pupil" cx="${x}" cy="${y}" r="5.5"/></g>` +
    `<rect class="lid" x="${x - radius}" y="${y - 3 * radius}" width="${2 * radius}" height="${2 * radius}"/></g>` +
    `<circle class="rim" cx="${x}" cy="${y}" r="${radius}"/></g>`
  );
}

function brow(side, direction) {
  const x = MOUTH.x + direction * EYES.apart;
  return `<path class="brow" data-brow="${side}" d="M${x - 26} 126q26-14 52 0"/>`;
}

/** Millimetres that a horn of 8 mm moves its end at so many degrees. Pure. */
export function hornMm(deg) {
  return HORN_MM * Math.sin(deg * RAD);
}

/**
 * Where the mouth's points are, in millimetres from its middle, y down: {jawMm, pout (-1 to 1), corner,
 * upper, lower}, the last three for both sides. moved: angles, as of `pose` in robot_view.js. Pure.
 */
export function mouthShape(moved) {
  const deg = (channel, side) => moved[channel]?.[side]?.deg ?? 0;
  const jawMm = JAW_MM * Math.sin(deg("jaw", "left") * RAD);
  const pout = Math.min(1, Math.max(-1, hornMm(deg("protrusion", "left")) / HORN_MM));
  const corner = (side) => ({
    x: MOUTH.halfMm + hornMm(deg("corner_out", side)) - 2 * pout,
    // A corner belongs to both lips: half of the jaw's way goes with it.
    y: jawMm / 2 - hornMm(deg("corner_up", side)),
  });
  const upper = (side) => -hornMm(deg("upper_lip", side));
  const lower = (side) => jawMm + hornMm(deg("lower_lip", side));
  return { jawMm, pout, corner: both(corner), upper: both(upper), lower: both(lower) };
}

function both(make) {
  return { left: make("left"), right: make("right") };
}

/** Move the figure to `moved`, angles as of `pose`; return what was drawn, in millimetres and degrees. */
export function drawFigure(svg, moved) {
  const find = (selector) => svg.querySelector(selector);
  const angle = (channel, side = "left") => moved[channel]?.[side]?.deg ?? 0;
  const [yaw, pitch, roll] = ["neck_yaw", "neck_pitch", "neck_roll"].map((each) => angle(each));
  // Features lie 60 units before the axis of the neck: they move farther than the skull.
  const aside = Math.sin(yaw * RAD);
  const up = Math.sin(pitch * RAD);
  find(".head").setAttribute(
    "transform",
    `rotate(${roll.toFixed(2)} 200 360) translate(${(26 * aside).toFixed(2)} ${(-22 * up).toFixed(2)})`,
  );
  find(".features").setAttribute(
    "transform",
    `translate(${(200 + 44 * aside).toFixed(2)} ${(-38 * up).toFixed(2)}) ` +
      `scale(${Math.cos(yaw * RAD).toFixed(4)} 1) translate(-200 0)`,
  );
  const shape = mouthShape(moved);
  drawMouth(find, shape, moved);
  for (const side of ["left", "right"]) drawEye(find, moved, side, angle);
  const neckWell = ["neck_yaw", "neck_pitch", "neck_roll"].every((each) => isWell(moved, each));
  find(".neck").classList.toggle("unwell", !neckWell);
  find(".skull").classList.toggle("unsure", !neckWell);
  return {
    ...shape,
    neck: { yaw, pitch, roll },
    eyes: { yaw: angle("eye_yaw"), pitch: angle("eye_pitch") },
    lid: both((side) => lidShut(moved, side)),
    unwell: [...svg.querySelectorAll(".unwell")].map((one) => one.getAttribute("class")),
  };
}

function isWell(moved, channel, side) {
  const sides = side ? [side] : ["left", "right"];
  return sides.every((each) => moved[channel]?.[each]?.well ?? true);
}

/** Draw jaw, lips, teeth and the horns of the mouth. shape: as of `mouthShape`; find: finds a part. */
function drawMouth(find, shape, moved) {
  const at = (x, y) => [MOUTH.x + UNIT * x, MOUTH.y + UNIT * y];
  const { corner, upper, lower, jawMm, pout } = shape;
  const inner = MOUTH.innerMm - 2 * pout;
  const right = at(-corner.right.x, corner.right.y);
  const left = at(corner.left.x, corner.left.y);
  const mid = (one) => (one.left + one.right) / 2;
  const above = [right, at(-inner, upper.right), at(0, mid(upper) + 0.4), at(inner, upper.left), left];
  const below = [right, at(-inner, lower.right), at(0, mid(lower)), at(inner, lower.left), left];
  const thick = UNIT * (5 + 2.5 * pout); // a pout turns the lips outwards
  const high = bulged(above, -thick);
  const deep = bulged(below, thick * 1.15);
  find(".jaw").setAttribute("transform", `translate(0 ${(UNIT * jawMm).toFixed(2)})`);
  find(".cavity").setAttribute("d", `${curve(above)}${curve([...below].reverse(), "L")}Z`);
  find(".lip.upper").setAttribute("d", `${curve(above)}${curve([...high].reverse(), "L")}Z`);
  find(".lip.lower").setAttribute("d", `${curve(below)}${curve([...deep].reverse(), "L")}Z`);
  const gap = Math.max(0, mid(lower) - mid(upper));
  find(".teeth.upper").setAttribute("d", tooth(at(-9, Math.min(mid(upper), 0)), 18, Math.min(gap, 5)));
  const low = Math.max(0, Math.min(gap - 5, 3.5));
  find(".teeth.lower").setAttribute("d", tooth(at(-8, jawMm + Math.max(0, mid(lower) - jawMm) - low), 16, low));
  find(".lip.upper").classList.toggle("unwell", !isWell(moved, "upper_lip") || !isWell(moved, "protrusion"));
  find(".lip.lower").classList.toggle("unwell", !isWell(moved, "lower_lip") || !isWell(moved, "protrusion"));
  find(".jaw").classList.toggle("unwell", !isWell(moved, "jaw"));
  find(".lip.upper").style.setProperty("--pout", pout.toFixed(3));
  find(".lip.lower").style.setProperty("--pout", pout.toFixed(3));
  drawHorns(find(".horns"), moved, {
    upper_lip: { left: above[3], right: above[1] },
    lower_lip: { left: below[3], right: below[1] },
    corner_out: { left, right },
    corner_up: { left, right },
  });
}

/** A dot where each horn holds the skin; grey and crossed where its servo is not well. */
function drawHorns(group, moved, places) {
  const dots = {};
  for (const [channel, sides] of Object.entries(places)) {
    for (const side of ["left", "right"]) {
      const servo = moved[channel]?.[side];
      if (!servo) continue;
      const key = sides[side].map((each) => each.toFixed(1)).join(" ");
      dots[key] = (dots[key] ?? true) && servo.well;
    }
  }
  const drawn = Object.entries(dots).map(([place, well]) => {
    const [x, y] = place.split(" ");
    return `<circle class="${well ? "horn" : "horn unwell"}" cx="${x}" cy="${y}" r="4.5"/>`;
  });
  group.innerHTML = drawn.join("");
}

/** Draw one eye, its lid and brow. angle: returns a channel's degrees for a side. */
function drawEye(find, moved, side, angle) {
  const one = find(`[data-eye="${side}"]`);
  if (one) {
    const reach = EYES.radius * 0.95;
    const x = reach * Math.sin(angle("eye_yaw", side) * RAD);
    const y = -reach * Math.sin(angle("eye_pitch", side) * RAD);
    one.querySelector(".ball").setAttribute("transform", `translate(${x.toFixed(2)} ${y.toFixed(2)})`);
    const shut = lidShut(moved, side);
    const way = 2 * EYES.radius * shut + EYES.radius * 0.02;
    one.querySelector(".lid").setAttribute("transform", `translate(0 ${way.toFixed(2)})`);
    const seen = ["eye_yaw", "eye_pitch"].every((each) => isWell(moved, each, side));
    one.classList.toggle("unwell", !seen);
    one.querySelector(".lid").classList.toggle("unwell", !isWell(moved, "lid", side));
  }
  const brow = find(`[data-brow="${side}"]`);
  if (brow) {
    brow.setAttribute("transform", `translate(0 ${(-UNIT * hornMm(angle("brow", side))).toFixed(2)})`);
    brow.classList.toggle("unwell", !isWell(moved, "brow", side));
  }
}

/** How far a lid is shut, 0 to 1; at rest a seventh. Pure. */
export function lidShut(moved, side) {
  const lid = moved.lid?.[side];
  if (!lid) return 0.14;
  const shutDeg = lid.shutDeg ?? -45;
  const share = lid.deg <= 0 ? lid.deg / shutDeg : -lid.deg / 90;
  return Math.min(1, Math.max(0, 0.14 + 0.86 * share));
}

function bulged(points, by) {
  const shares = [0.15, 0.9, 0.82, 0.9, 0.15];
  return points.map(([x, y], i) => [x, y + by * shares[i]]);
}

function tooth([x, y], wideMm, highMm) {
  return `M${x.toFixed(1)} ${y.toFixed(1)}h${UNIT * wideMm}v${(UNIT * highMm).toFixed(1)}h${-UNIT * wideMm}z`;
}

/** A Catmull-Rom curve through points, as Bezier pieces. */
function curve(points, begin = "M") {
  const [first] = points;
  let path = `${begin}${first[0].toFixed(1)} ${first[1].toFixed(1)}`;
  for (let i = 0; i + 1 < points.length; i += 1) {
    const before = points[Math.max(0, i - 1)];
    const [from, to] = [points[i], points[i + 1]];
    const after = points[Math.min(points.length - 1, i + 2)];
    const c1 = [from[0] + (to[0] - before[0]) / 6, from[1] + (to[1] - before[1]) / 6];
    const c2 = [to[0] - (after[0] - from[0]) / 6, to[1] - (after[1] - from[1]) / 6];
    path += `C${[...c1, ...c2, ...to].map((each) => each.toFixed(1)).join(" ")}`;
  }
  return path;
}
