// A face that was stopped, on every page: what its servos confirmed, and the way back: Start, behind
// a question. The newest status decides, so that all pages show the same.
import { postJson } from "./calls.js";
import { face, facts, frameAgeMs, OLD_MS, onFrame, onHello, onStatus } from "./link.js";
import { confirmed, confirmedWords, driven, forget, isLimp, isTrying, keep, kept, show, stop } from "./stop.js";
import { isStopped } from "./words.js";

// A status may be so old: one from before a `start` does not say what became of it.
const STALE_MS = 3000;
const START_MS = 60_000; // longer than any start that succeeds
const SLOW_MS = 12_000;
const DONE_MS = 4000; // how long "started" stands there
// The second click of a double click on Start, or a key that is held, is no answer to the question.
const SURE_MS = 500;
// The last record of a servo side that is gone is repeated for 0.8 s (`GONE_S` of live_frames.py), and
// statuses come twice a second: so long after a confirmation both may still say "driven".
const LATE_MS = 1500;
// A single missing status does not mean the end: a face that switches torque off again may be late.
const SILENT_MS = 2500;
const AT_END = ["stopped", "ended"]; // states in which the report of a stop is the last word
const LIVELY = ["driven", "silent", "easing", "frozen", "letting go"];

const bar = document.getElementById("face-start");
const why = bar.querySelector(".why");
const button = bar.querySelector(".begin");
const question = bar.querySelector(".question");
const sure = bar.querySelector(".confirm");

let own = ""; // the sentence that this file has written under the head
let failure = ""; // why the last start of this page came to nothing
let askedMs = null; // since when the question is there
let starting = null; // {sinceMs, isOwn, acceptedMs, hasBegun, stops}: a start under way
let nStops = 0; // presses of STOP on this page
let pressedMs = -Infinity;
let wasStopped = false; // by the status before
let sawMoving = false; // since this page was opened, or the last start
let keptMs = -Infinity;

/**
 * What the page is to show: `moving` (the ordinary pages), `stopped`, `starting`, or `gone`: the
 * face has ended, or it or its dashboard is away, after the servos confirmed. wordMs: how long ago
 * the word was kept. Pure.
 */
export function phaseOf({ status, frame, ageMs, word, wordMs, isStarting }) {
  const isOld = frame === null || ageMs > OLD_MS;
  if (isStarting) return "starting";
  if (word === null || wordMs > LATE_MS) {
    if (!isOld && hasTorque(frame)) return "moving"; // frames are newer than a status
    if (isStopped(status)) return "stopped";
    return word !== null && (isOld || status === null || status.state === "ended") ? "gone" : "moving";
  }
  return status?.state === "ended" ? "gone" : "stopped";
}

function hasTorque(frame) {
  return frame !== null && !frame.servosGone && !AT_END.includes(frame.state) && (frame.torqueOn || frame.state === "driven");
}

/** [tone, sentence] of a face that a person stopped. word: may be null. Pure. */
export function stoppedWords(status, word) {
  let [tone, text] = ["warn", "Stopped. Its servos have not confirmed yet that they are limp: keep your hands away."];
  if (word !== null) [tone, text] = confirmed(word);
  if (status?.plugged === false) {
    text += " Their port is gone: look at the plug.";
    if (tone === "good") tone = "warn";
  }
  return [tone, isStopped(status) && tone === "good" ? `${text} Start it again with Start.` : text];
}

/** [tone, sentence] of a face that is away after a stop. lastState: of its servo side. Pure. */
export function goneWords({ word, lastState, isOld, config, port, isFirstHour = false }) {
  const again = `\`lipservo daemon --config ${config ?? "FACE"}${port ? ` --port ${port}` : ""} --dashboard\``;
  if (!isLimp(word)) {
    const [tone, text] = confirmed(word);
    return [tone, `${text} ${isOld ? "The dashboard" : "The face"} does not answer any more.`];
  }
  const words = confirmedWords(word);
  if (isFirstHour && !isOld) return ["good", `Stopped: ${words}. Go on with the step below when you are ready.`];
  if (lastState === "ended") {
    return ["good", `The face has ended: ${words}. Start it again at its computer, with ${again}.`];
  }
  const who = isOld ? "The dashboard does not answer any more" : "The face does not answer any more";
  return [
    "quiet",
    `${who}. The servos' last word: ${words}. At its computer, \`lipservo start\` starts it again, ` +
      `or ${again} if it has ended.`,
  ];
}

/** [tone, sentence] of a start under way. status: may be null; forMs: since it was requested. Pure. */
export function startingWords(status, forMs) {
  const state = status === null || status.state === "stopped" ? "" : `: ${status.state}`;
  const slow = forMs > SLOW_MS ? " It takes longer than usual." : "";
  return ["warn", `Starting${state} … Keep your hands away.${slow}${troubles(status)}`];
}

/** The first troubles of a status as sentences; "" where there are none. */
function troubles(status) {
  const lines = [...(status?.troubles ?? [])];
  if (status?.plugged === false) lines.unshift("the servos' port is gone: look at the plug");
  return lines.slice(0, 2).map((each) => ` ${sentence(each)}`).join("");
}

function sentence(text) {
  return `${text[0].toUpperCase()}${text.slice(1).replace(/\.$/, "")}.`;
}

/** Write the phase, the sentence under the head, and Start with its question, from what is known now. */
function render() {
  const nowMs = performance.now();
  const isOld = face.frame === null || frameAgeMs() > OLD_MS;
  const word = kept();
  const status = face.status ?? (nowMs - face.freshMs < SILENT_MS ? face.fresh : null);
  face.phase = phaseOf({
    status, frame: face.frame, ageMs: frameAgeMs(), word, wordMs: nowMs - keptMs,
    isStarting: starting !== null,
  });
  // Also while torque is switched off once more, when `can_start` is false for a moment.
  const mayStart = face.phase === "stopped" && isStopped(status);
  if (!mayStart) askedMs = null;
  if (face.phase !== "stopped" && face.phase !== "starting") failure = "";
  if (!isTrying()) {
    if (face.phase === "stopped") say(...stoppedWords(status, word));
    else if (face.phase === "starting") say(...startingWords(face.status, nowMs - starting.sinceMs));
    else if (face.phase === "gone") {
      const { config } = facts;
      const port = face.last?.port ?? null;
      say(...goneWords({ word, lastState: face.lastState, isOld, config, port, isFirstHour: facts.firstHour }));
    } else if (own && word === null && !doneTimer) hush();
  }
  const isAsking = askedMs !== null;
  bar.hidden = !(mayStart || failure);
  bar.dataset.tone = failure ? "bad" : document.getElementById("face-stop-report").dataset.tone;
  button.hidden = !mayStart || isAsking;
  question.hidden = !isAsking;
  if (why.textContent !== failure) why.textContent = failure;
  why.hidden = failure === "" || isAsking;
}

let doneTimer = null;

function say(tone, text) {
  clearTimeout(doneTimer);
  doneTimer = null;
  own = text;
  show(tone, text);
}

/** Take away what this file has written, and nothing else. */
function hush() {
  const line = document.getElementById("face-stop-report");
  if (line.textContent === own) line.hidden = true;
  own = "";
}

function ask() {
  failure = "";
  askedMs = performance.now();
  render();
  sure.focus();
}

function decline() {
  askedMs = null;
  render();
  button.focus();
}

/** Start the face: the question has been answered with yes. A STOP pressed meanwhile is sent again. */
async function begin() {
  if (askedMs === null || performance.now() - askedMs < SURE_MS) return;
  askedMs = null;
  const mine = { sinceMs: performance.now(), isOwn: true, acceptedMs: Infinity, hasBegun: false, stops: nStops };
  starting = mine;
  render();
  let error = null;
  try {
    await postJson("/api/start", {}, { patienceMs: 10_000 });
    mine.acceptedMs = performance.now();
  } catch (thrown) {
    error = thrown;
  }
  if (nStops !== mine.stops) {
    // STOP was pressed meanwhile: whichever of the two came first, the stop is to be the last.
    if (!error || error.status === undefined) stop();
  } else if (error) {
    failure = `Not started: ${error.message}`;
    if (starting === mine) starting = null;
  } else if (starting === mine) {
    driven();
    sawMoving = false;
  }
  render();
}

/** End the start under way where a new status says that the face runs, stops, or did not start. */
function follow(status) {
  const nowMs = performance.now();
  if (nowMs - starting.sinceMs > START_MS) {
    failure = `It has not started within ${START_MS / 1000} s.${troubles(status)}`;
    starting = null;
  } else if (status === null) {
    return;
  } else if (!isStopped(status)) {
    starting.hasBegun = true;
    const isUp = status.state === "driven" || status.state === "silent";
    const isStopping = status.stopped !== null && status.stopped !== undefined;
    if (!isUp && !isStopping) return;
    starting = null;
    if (!isUp) return;
    say("good", "Started: the face is running.");
    doneTimer = setTimeout(() => {
      doneTimer = null;
      hush();
    }, DONE_MS);
  } else if (starting.hasBegun || nowMs - starting.acceptedMs > STALE_MS) {
    const found = starting.isOwn ? troubles(status) : "";
    if (found) failure = `Not started.${found}`;
    starting = null;
  }
}

/** Take a new status: starts by others, the report of a stop; then draw. status: null, no answer came. */
function take(status) {
  if (starting !== null) follow(status);
  else if (status !== null && wasStopped && !status.stopped && !AT_END.includes(status.state)) {
    // Another page, a terminal or an agent has started it.
    if (!isJustPressed()) driven();
    failure = "";
    sawMoving = false;
    starting = { sinceMs: performance.now(), isOwn: false, acceptedMs: 0, hasBegun: true, stops: nStops };
    follow(status);
  }
  if (status !== null) {
    wasStopped = isStopped(status);
    if (LIVELY.includes(status.state)) sawMoving = true;
    const isOver = starting === null && (frameAgeMs() > OLD_MS || !hasTorque(face.frame));
    if (isOver && AT_END.includes(status.state) && status.stop_report) learn(status.stop_report);
  }
  render();
}

/** Whether a status that comes now may be from before the last press of STOP. */
function isJustPressed() {
  return performance.now() - pressedMs < STALE_MS;
}

/** Keep a status's stop report, with its own time, else with the present one if this page saw it move. */
function learn(report) {
  if (isSame(kept()?.report, report)) return;
  const seenMs = sawMoving ? Date.now() : null;
  keep(report, report.at_s ? 1000 * report.at_s : seenMs);
  keptMs = performance.now();
}

/** Whether a report says nothing that the other does not; what came with it in an answer aside. */
function isSame(one, other) {
  const key = (report) =>
    JSON.stringify([report?.confirmed ?? [], report?.unconfirmed ?? {}, report?.at_rest ?? null]);
  return Boolean(one) && key(one) === key(other);
}

button.addEventListener("click", ask);
sure.addEventListener("click", begin);
bar.querySelector(".decline").addEventListener("click", decline);
// A key that is held on Start would answer the question that opens under it.
bar.addEventListener("keydown", (event) => {
  if (event.repeat && (event.key === "Enter" || event.key === " ")) event.preventDefault();
});
window.addEventListener("face-stop", () => {
  nStops += 1;
  pressedMs = performance.now();
  askedMs = starting = null;
  wasStopped = false; // until a status of after the press says so
  failure = "";
  render();
});
window.addEventListener("face-word", () => {
  if (kept() !== null) keptMs = performance.now();
  render();
});
let nDriven = 0;
onFrame((frame) => {
  if (hasTorque(frame)) sawMoving = true;
  nDriven = !frame.servosGone && frame.state === "driven" ? nDriven + 1 : 0;
  const nowMs = performance.now();
  // Driven again, by the servo side itself; right after a press of STOP that stays a second one.
  const isOver = kept() !== null && hasTorque(frame) && nowMs - keptMs > LATE_MS;
  if (isOver) forget();
  if ((isOver || nDriven === 60) && !isJustPressed()) driven();
  if (isOver) render();
  const isUp = frame.servosGone || frame.state === "driven" || frame.state === "silent";
  if (doneTimer !== null && !isUp) {
    clearTimeout(doneTimer);
    doneTimer = null;
    hush();
  }
});
onHello(() => (nDriven = 0));
onStatus(take);
setInterval(render, 250);
