// STOP. A plain button that posts to the API: it needs neither the page's framework nor its socket,
// and this file imports nothing, so that nothing else that breaks can break it.

const PATIENCE_MS = 2000;
const RETRY_MS = 300;
const TRIES = 40;
const WAIT_S = 15; // easing to rest takes a few seconds, before the servos confirm
// The second press counts as "go limp now" from the first press until the face is started again.
let level = "soft";
let presses = 0;
let trying = false;
// What the servos confirmed last, until the face is started again: {report: `StopReport`, atMs:
// `Date.now()` of the confirmation, null where this page did not see it}; null: nothing.
let word = null;

const button = document.getElementById("face-stop");
const line = document.getElementById("face-stop-report");

/** Send one stop of level `how`; its answer, after up to `waitS` s for the confirmation. Throws if none comes. */
async function post(how, waitS) {
  const response = await fetch("/api/stop", {
    method: "POST",
    cache: "no-store",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ level: how, wait_s: waitS }),
    signal: AbortSignal.timeout(PATIENCE_MS + 1000 * waitS),
  });
  const answer = await response.json().catch(() => null);
  return { isTaken: response.ok, status: response.status, answer };
}

/**
 * Stop the face. Two requests at once: one that is answered when the face has taken the stop,
 * repeated until it has; and one that is answered when its servos have confirmed.
 *
 * @param {string} how level of the stop; by itself soft, and limp from the second press on.
 */
export async function stop(how = level) {
  presses += 1;
  const mine = presses;
  const isOld = () => mine !== presses;
  level = "limp";
  trying = true;
  label("LET GO");
  show("wait", how === "soft" ? "Stopping …" : "Letting go at once …");
  window.dispatchEvent(new Event("face-stop"));
  await insist(how, isOld);
  if (!isOld()) finish();
}

/**
 * Send a stop again and again until the face has taken it, and write each step under the head; besides,
 * wait for the confirmation of the servos. isOld: whether a later press has taken over.
 */
async function insist(how, isOld) {
  let isConfirmed = false;
  let isWaiting = false;
  const awaitEnd = async () => {
    isWaiting = true;
    const { isTaken, answer } = await post(how, WAIT_S).catch(() => ({ isTaken: false }));
    isWaiting = false;
    if (isOld() || isIdle(answer)) return;
    isConfirmed = Boolean(isTaken && answer?.report);
    if (!isConfirmed || isOld()) return;
    keep(answer.report, Date.now());
    show(...confirmed(word));
    finish();
  };
  for (let n = 1; n <= TRIES && !isConfirmed && !isOld(); n += 1) {
    if (!isWaiting) awaitEnd();
    const { isTaken, status, answer } = await post(how, 0).catch(() => ({ isTaken: false }));
    if (isConfirmed || isOld()) return;
    if (isIdle(answer)) {
      level = "soft"; // the next press is a first one
      label("STOP");
      return show(answer.is_limp ? "good" : "warn", answer.nothing_driven);
    }
    if (isTaken) return show("warn", how === "soft" ? EASES : LETS_GO);
    const tone = isLimp(word) ? "warn" : "bad";
    if (status === 401) return show(tone, `Refused: ${LOCKED} ${advice()}`);
    if (status >= 400 && status < 500) {
      return show(tone, `Refused: ${reason(answer) ?? status}. ${advice()}`);
    }
    const why = status === 503 ? "No face answers" : (reason(answer) ?? "The dashboard does not answer");
    show(tone, `${why}. Trying again (${n}) … ${advice()}`);
    await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
  }
  if (!isConfirmed && !isOld()) {
    show(isLimp(word) ? "warn" : "bad", `No answer to ${TRIES} requests. ${advice()}`);
  }
}

/** Whether there was no face to stop: between the steps of a first hour. Pure. */
function isIdle(answer) {
  return Boolean(answer?.nothing_driven);
}

const EASES = "The face stops: it eases to rest, unless it is frozen. Press again to let go at once.";
const LETS_GO = "The face lets go; its servos have not confirmed yet.";
const SUPPLY = "Switch the servos' supply off, or run";
const BY_HAND = `${SUPPLY} \`lipservo stop\`.`;
export const LOCKED =
  "This page needs the face's token: open the address that was printed, or run `lipservo dashboard --open`.";

/** A sentence on what to do by hand; if servos have confirmed that they are limp, on that. */
function advice() {
  return isLimp(word) ? `The servos' last word: ${confirmedWords(word)}.` : BY_HAND;
}

/** [tone, sentence] of what the servos confirmed. word: {report, atMs}. Pure. */
export function confirmed({ report, atMs }) {
  if (isLimp({ report })) return ["good", `Stopped. ${capital(confirmedWords({ report, atMs }))}.`];
  const loose = looseWords(report);
  if (isReleased({ report })) {
    const n = report.confirmed?.length ?? 0;
    const who = n ? `only ${n} of ${n + report.released.length} servos can` : "no servo can";
    return ["warn", `Stopped. ${capital(report.released_words)}; ${who} confirm it. Keep your hands away.`];
  }
  if (!loose) return ["warn", "Stopped. No servo has confirmed that it is limp: keep your hands away."];
  return ["bad", `Stopped, but NOT confirmed to be limp: ${loose}. Keep your hands away. ${SUPPLY} \`lipservo limp\`.`];
}

/** `at rest and limp, confirmed by 16 servos at 14:02`, of a report that is complete. Pure. */
export function confirmedWords({ report, atMs }) {
  if (report.dry_run) return "dry run, no torque was switched on";
  const n = report.confirmed.length;
  const where = report.at_rest ? "at rest and limp" : "limp";
  const when = atMs === null || atMs === undefined ? "" : ` at ${clock(atMs)}`;
  return `${where}, confirmed by ${n} ${n === 1 ? "servo" : "servos"}${when}`;
}

/** Whether every servo has confirmed that it is limp. word: {report}, or null. Pure. */
export function isLimp(word) {
  if (word === null || Object.keys(word.report.unconfirmed ?? {}).length) return false;
  if (word.report.released?.length) return false;
  return Boolean(word.report.dry_run || word.report.confirmed?.length);
}

/** Whether all were let go, and some of them cannot confirm it. word: {report}, or null. Pure. */
export function isReleased(word) {
  return Boolean(word?.report.released?.length) && !Object.keys(word.report.unconfirmed ?? {}).length;
}

/** `jaw, neck yaw (does not answer)`: servos that did not confirm, each reason once. Pure. */
function looseWords(report) {
  const named = new Map();
  for (const [name, why] of Object.entries(report.unconfirmed ?? {})) {
    named.set(why, [...(named.get(why) ?? []), name.replaceAll("_", " ")]);
  }
  return [...named].map(([why, names]) => names.join(", ") + (why ? ` (${why})` : "")).join("; ");
}

function clock(ms) {
  const date = new Date(ms);
  return [date.getHours(), date.getMinutes()].map((each) => String(each).padStart(2, "0")).join(":");
}

function capital(text) {
  return text[0].toUpperCase() + text.slice(1);
}

function reason(answer) {
  const text = answer?.error ?? answer?.detail;
  return typeof text === "string" ? text.replace(/\.$/, "") : null;
}

/** Write the line under the head. tone: good, wait, warn or bad. */
export function show(tone, text) {
  line.dataset.tone = tone;
  line.hidden = false;
  if (line.textContent !== text) line.textContent = text;
}

function label(text) {
  if (text === "STOP") delete button.dataset.pressed;
  else button.dataset.pressed = "";
  button.querySelector("b").textContent = text;
}

function finish() {
  trying = false;
  window.dispatchEvent(new Event("face-word"));
}

/** Whether a press has not been answered yet: the line is about that. */
export function isTrying() {
  return trying;
}

/** The last confirmed word, {report, atMs}; null: none since the face was started. */
export function kept() {
  return word;
}

/** Keep what the servos confirmed. atMs: when, null where this page did not see it. */
export function keep(report, atMs) {
  word = { report, atMs };
  if (isLimp(word)) label("STOP"); // limp already; the next press says so to the servos once more
}

/** Servos have torque again: what was confirmed holds no more. */
export function forget() {
  word = null;
}

/** The face is driven again: the next press is a first one, and nothing is confirmed any more. */
export function driven() {
  word = null;
  level = "soft";
  label("STOP");
  if (!trying) line.hidden = true;
}

button.addEventListener("click", () => stop());
// Capturing, on the window: whatever has the focus, also a text field or a question.
window.addEventListener(
  "keydown",
  (event) => {
    if (event.key === "Escape" && !event.repeat) stop();
  },
  true,
);
window.faceStop = stop;
button.dataset.ready = "";
// Pressed before this file had come: the button has posted by itself.
if (button.dataset.early !== undefined) stop();
