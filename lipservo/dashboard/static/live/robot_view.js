// The robot from the front, moved by its servos' encoders: what it does, not what it was told.
// Robot's left is the viewer's right. A servo that does not answer is hatched, never drawn as well.
import { drawnDeg, face, facts, onDraw, onHello, troubleOf } from "../link.js";
import { drawFigure, figure, HATCH } from "./robot_figure.js";
import { shown, spoken, unread } from "../words.js";

const SIDES = ["left", "right"];

/**
 * Angles in the drawing's directions, {channel: {left: {deg, well}, right: {deg, well}}}; well: whether
 * the servo works. Pure. rig: {servo: {channel, side, sign}}; encodersDeg: in the order of `names`, null
 * where a servo never answered; troubleOf(name, deg): what is wrong with a servo, or null.
 */
export function pose(names, rig, encodersDeg, troubleOf) {
  const moved = {};
  names.forEach((name, i) => {
    const { channel, side, sign } = rig[name] ?? {};
    if (!channel) return;
    const encoder = encodersDeg[i];
    const one = { deg: sign * (encoder ?? 0), well: troubleOf(name, encoder) === null };
    moved[channel] ??= {};
    for (const each of side === "both" ? SIDES : [side]) moved[channel][each] = one;
  });
  return moved;
}

class FaceRobot extends HTMLElement {
  connectedCallback() {
    this.undo = [onHello((hello) => this.build(hello)), onDraw((frame) => this.draw(frame))];
    window.robotView = this;
  }

  disconnectedCallback() {
    this.undo.forEach((each) => each());
  }

  /** Make the drawing of this face's robot, with a dial for each servo that moves none of its parts. */
  build(hello) {
    const rig = facts.rig ?? {};
    const channels = new Set(Object.values(rig).map((each) => each.channel));
    const dials = hello.servos.filter((name) => !rig[name]?.channel);
    this.innerHTML =
      `<svg role="img" aria-label="the robot, as its encoders say">${HATCH}${figure(channels)}</svg>` +
      `<div class="dials">${dials.map(dial).join("")}</div><p class="lost" hidden></p>`;
    this.svg = this.querySelector("svg");
    this.lost = this.querySelector(".lost");
    this.dials = new Map([...this.querySelectorAll(".dial")].map((one) => [one.dataset.servo, one]));
    this.channels = channels;
    // The mouth fills the picture where there is nothing else.
    this.svg.setAttribute("viewBox", hasHead(channels) ? "60 16 280 414" : "84 186 232 210");
  }

  /** Move the drawing to the measured angles of a frame, and name the servos that do not work. */
  draw(frame) {
    if (!this.svg) return;
    const names = face.hello.servos;
    const encodersDeg = drawnDeg(frame);
    const isLast = encodersDeg !== frame.encodersDeg;
    this.pose = pose(names, facts.rig ?? {}, encodersDeg, troubleOf);
    this.drawn = drawFigure(this.svg, this.pose); // numbers of the drawing, for tests
    this.svg.classList.toggle("gone", frame.servosGone && !isLast);
    this.svg.classList.toggle("limp", face.phase === "stopped");
    const lost = [];
    names.forEach((name, i) => {
      const why = troubleOf(name, encodersDeg[i]);
      if (why) lost.push(spoken(name));
      if (this.dials.has(name)) turn(this.dials.get(name), name, encodersDeg[i], why);
    });
    const isSeen = encodersDeg.some((deg) => deg !== null);
    let text = lostWords(lost);
    if (isLast) text = `${text} ${isSeen ? LAST : UNREAD}`.trim();
    else if (frame.servosGone) text = "Where the servos are is not known.";
    this.lost.dataset.calm = String(isLast && !lost.length);
    this.lost.hidden = text === "";
    if (this.lost.textContent !== text) this.lost.textContent = text;
  }
}

const LAST = "Not running: drawn where its joints were read last.";
const UNREAD = "Not running: its joints are not read, and drawn at 0°.";

/** A sentence that names the parts that are hatched, four at most. Pure. */
export function lostWords(names) {
  if (!names.length) return "";
  const listed = names.slice(0, 4).join(", ") + (names.length > 4 ? ` and ${names.length - 4} more` : "");
  return `Hatched: not working or not answering: ${listed}.`;
}

function hasHead(channels) {
  return [...channels].some((each) => /^(neck|eye|lid|brow)/.test(each ?? ""));
}

function dial(name) {
  return (
    `<div class="dial" data-servo="${name}"><svg viewBox="-32 -32 64 40">` +
    '<path d="M-26 0A26 26 0 0 1 26 0" fill="none"/><line x1="0" y1="0" x2="0" y2="-24"/></svg>' +
    `<span>${spoken(name)}</span><b></b></div>`
  );
}

/** Turn a servo's dial to its measured angle. why: what is wrong with the servo; null: nothing. */
function turn(dialElement, name, encoder, why) {
  const { least_deg: least = -90, most_deg: most = 90 } = facts.servos?.[name] ?? {};
  const share = encoder === null ? 0.5 : (encoder - least) / (most - least || 1);
  const turned = -90 + 180 * Math.min(1, Math.max(0, share));
  dialElement.querySelector("line").setAttribute("transform", `rotate(${turned.toFixed(1)})`);
  dialElement.querySelector("b").textContent = encoder === null ? unread(face.status, name, why === null) : shown(encoder, 1, "°");
  dialElement.classList.toggle("unwell", why !== null);
}

customElements.define("face-robot", FaceRobot);
