// One connection for the whole page: frames as they come, the status twice a second.
import { connect, history } from "./frame.js";
import { getJson } from "./calls.js";
import { isStopped, servoTrouble } from "./words.js";

const STATUS_PERIOD_MS = 500;
const SHOWN_BEFORE = 130; // frames of the seconds before the page was opened
const PAINT_MS = 30;
/** Frames come every 33 ms; what the last one says is out of date after so long. */
export const OLD_MS = 700;
/** A browser that takes so long for a picture draws in software: then the twin comes first, and everything
 * is drawn less often. */
const SLOW_PICTURE_MS = 60;
const SLOW_SHARE = 4;
const TWIN_FIRST_MS = 8000;
const RELOAD_MS = 20000;

/** What the page knows of the face. Times are `performance.now()`; -Infinity: never. */
export const face = {
  hello: null,
  frame: null,
  status: null,
  held: null, // a frame of a recorded run: drawn in place of the newest
  frameAtMs: -Infinity,
  trouble: null, // why there is no status
  refusal: null, // why this page may not see the face: a sentence about the token
  last: null, // the last status, however long ago
  fresh: null, // the last that was the face's own answer just then, and when
  freshMs: -Infinity,
  lastState: null, // the last state that servo side or status reported
  lastServosMs: -Infinity, // when the servo side wrote last
  seenDeg: [], // encoders, each as it was read last
  phase: "moving", // what the page shows, as `phaseOf` of stopped.js says
  idle: false, // of a first hour: no step drives servos, or the one that does answers
  nFrames: 0,
  nLost: 0, // frames that the server sent or skipped and this page never saw
};

/** What the server wrote into the page: limits, models, words. It never changes. */
export const facts = JSON.parse(document.getElementById("face-facts")?.textContent ?? "{}");

let reloads = false;
let drawn = null;
let paintedMs = -Infinity;
let lookedMs = performance.now();
let pictureMs = 2 * SLOW_PICTURE_MS; // a running mean; slow until it has shown that it is not
const listeners = { hello: new Set(), frame: new Set(), status: new Set(), draw: new Set(), paint: new Set() };

/** Call `listener(hello)` at each connection, and now if there is one. Returns a function that removes it. */
export function onHello(listener) {
  listeners.hello.add(listener);
  if (face.hello) listener(face.hello);
  return () => listeners.hello.delete(listener);
}

/** Call `listener(frame)` with every frame, also those of before the page was opened. Returns as above. */
export function onFrame(listener) {
  listeners.frame.add(listener);
  return () => listeners.frame.delete(listener);
}

/** Call `listener(frame)` with each frame to be drawn, before the browser paints. Returns as above. */
export function onDraw(listener) {
  listeners.draw.add(listener);
  return () => listeners.draw.delete(listener);
}

/** Call `listener(frame)` before the browser paints, also without a new frame. Returns as above. */
export function onPaint(listener) {
  listeners.paint.add(listener);
  return () => listeners.paint.delete(listener);
}

/** Call `listener(status)` with every status; null: no answer came. Returns as above. */
export function onStatus(listener) {
  listeners.status.add(listener);
  if (face.status) listener(face.status);
  return () => listeners.status.delete(listener);
}

/** How long ago the last frame came. */
export function frameAgeMs() {
  return performance.now() - face.frameAtMs;
}

/** Angles at which to draw the servos: while the face is stopped or starts, those that were read last. */
export function drawnDeg(frame) {
  const isLast = frame.servosGone && (face.phase === "stopped" || face.phase === "starting");
  return isLast ? frame.encodersDeg.map((_, i) => face.seenDeg[i] ?? null) : frame.encodersDeg;
}

/** What keeps a servo from being drawn as working; null: nothing. */
export function troubleOf(name, encoderDeg) {
  return face.phase === "starting" ? null : servoTrouble(face.status, name, encoderDeg);
}

function noteServos(frame) {
  if (frame.servosGone) return;
  frame.encodersDeg.forEach((deg, i) => (face.seenDeg[i] = deg ?? face.seenDeg[i] ?? null));
}

function tell(kind, value) {
  for (const listener of listeners[kind]) {
    try {
      listener(value);
    } catch (error) {
      console.error(error); // one picture that fails takes no other with it
    }
  }
}

/** Keep a new frame, count those that were missed, and call the listeners. */
function takeFrame(frame) {
  if (reloads) return;
  const before = face.frame;
  if (before && frame.n > before.n + 1) face.nLost += frame.n - before.n - 1;
  face.frame = frame;
  face.frameAtMs = performance.now();
  face.nFrames += 1;
  noteServos(frame);
  if (!frame.servosGone) {
    face.lastState = frame.state;
    face.lastServosMs = face.frameAtMs;
  }
  tell("frame", frame);
}

/** Keep a new connection's first message; call the listeners, then with frames of before it. */
async function takeHello(hello) {
  face.hello = hello;
  face.frame = null; // numbers begin anew where the dashboard was started again
  face.seenDeg = [];
  reloads = isAnotherFace(hello);
  if (reloads) return;
  tell("hello", hello);
  for (const frame of (await history(hello).catch(() => [])).slice(-SHOWN_BEFORE)) {
    noteServos(frame);
    if (face.frame === null) tell("frame", frame);
  }
}

/**
 * Whether another face has taken the place of the one that this page was made for; then the page is
 * loaded anew, but not again within RELOAD_MS.
 */
function isAnotherFace(hello) {
  const known = Object.keys(facts.servos ?? {}).join();
  const isNew = hello.servos.length > 0 && known !== hello.servos.join();
  const reloadedMs = Number(sessionStorage.getItem("reloaded") ?? 0);
  if (!isNew || Date.now() - reloadedMs < RELOAD_MS) return false;
  sessionStorage.setItem("reloaded", Date.now());
  location.reload();
  return true;
}

/** Call the listeners that draw, before a picture of the browser; less often where it is slow. */
function drawAll() {
  requestAnimationFrame(drawAll);
  const nowMs = performance.now();
  pictureMs += 0.1 * (Math.min(nowMs - lookedMs, 1000) - pictureMs);
  lookedMs = nowMs;
  const everyMs = pictureMs > SLOW_PICTURE_MS ? SLOW_SHARE * pictureMs : PAINT_MS;
  if (!face.frame || nowMs - paintedMs < everyMs || waitsForTwin(nowMs)) return;
  paintedMs = nowMs;
  const shown = face.held ?? face.frame;
  if (shown !== drawn) tell("draw", shown);
  drawn = shown;
  tell("paint", face.frame);
}

/** Whether drawing waits for the twin: in a slow browser, for the page's first seconds. */
function waitsForTwin(nowMs) {
  const isSlow = pictureMs > SLOW_PICTURE_MS && nowMs < TWIN_FIRST_MS;
  return isSlow && document.querySelector(".twin") !== null && !window.twin?.ready;
}

/** Request the status, keep it, call the listeners, and do so again twice a second. */
async function pollStatus() {
  const beganMs = performance.now();
  try {
    const answer = await getJson("/api/status", 2000);
    // A face that does not answer has no status: the answer then repeats its last one.
    face.status = answer.face_answers === false ? null : answer;
    face.trouble = answer.trouble ?? null;
    face.refusal = null;
    face.last = answer;
    if (face.status !== null) {
      face.fresh = answer;
      face.freshMs = performance.now();
      if (isStopped(answer) || answer.state === "ended") face.lastState = answer.state;
    }
  } catch (error) {
    face.status = null;
    face.refusal = error.status === 401 ? error.message : null;
  }
  tell("status", face.status);
  const tookMs = performance.now() - beganMs;
  setTimeout(pollStatus, Math.max(50, STATUS_PERIOD_MS - tookMs));
}

connect(() => {}, takeHello, () => {}, takeFrame);
requestAnimationFrame(drawAll);
pollStatus();
window.dashboard = face; // for tests, and for whoever looks with the browser's tools
