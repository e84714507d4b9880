// STOP. A plain button that asks the API: it needs neither the page's framework nor its socket,
// and this file imports nothing, so that nothing else that breaks can break it.

const PATIENCE_MS = 2000;
const RETRY_MS = 300;
const TRIES = 40;
const WAIT_S = 15; // easing to rest takes a few seconds, before the servos confirm
// The second press counts as "go limp now" from the first press until the face is started again.
let level = "soft";
let running = 0;

const button = document.getElementById("face-stop");
const report = document.getElementById("face-stop-report");

async function ask(how, waitS) {
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
 * Two requests at once: one that is answered when the face has taken the stop, repeated until it
 * has; and one that is answered when its servos have confirmed. The second press is the furthest.
 */
export async function stop() {
  const how = level;
  level = "limp";
  running += 1;
  const mine = running;
  const isOld = () => mine !== running;
  button.dataset.pressed = "";
  button.querySelector("b").textContent = "LET GO";
  say("wait", how === "soft" ? "Stopping …" : "Letting go at once …");
  let end = null;
  let waiting = false;
  const awaitEnd = async () => {
    waiting = true;
    const { isTaken, answer } = await ask(how, WAIT_S).catch(() => ({ isTaken: false }));
    waiting = false;
    if (isTaken && answer?.report) end = answer.report;
    if (end && !isOld()) say(...confirmed(end));
  };
  for (let n = 1; n <= TRIES && !end && !isOld(); n += 1) {
    if (!waiting) awaitEnd();
    const { isTaken, status, answer } = await ask(how, 0).catch(() => ({ isTaken: false }));
    if (end || isOld()) return;
    if (isTaken) return say("warn", how === "soft" ? EASES : LETS_GO);
    if (status >= 400 && status < 500) return say("bad", `Refused: ${told(answer) ?? status}. ${BY_HAND}`);
    say("bad", `${status === 503 ? "No face answers" : (told(answer) ?? "Nobody answers")}. Trying again (${n}) … ${BY_HAND}`);
    await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
  }
  if (!end && !isOld()) say("bad", `Nobody answered ${TRIES} times. ${BY_HAND}`);
}

const EASES = "The face stops: it eases to rest. Press again to let go at once.";
const LETS_GO = "The face lets go; its servos have not confirmed yet.";
const BY_HAND = "Switch the servos' supply off, or run `lipservo stop`.";

/** What the servos themselves said at the end, in words. report: `StopReport`. Pure. */
export function confirmed(report) {
  const loose = Object.keys(report.unconfirmed ?? {});
  const n = report.confirmed?.length ?? 0;
  if (loose.length) {
    return ["bad", `NOT confirmed to be limp: ${loose.join(", ")}. Keep your hands away. ${BY_HAND}`];
  }
  const where = report.at_rest ? "at rest and limp" : "limp";
  return ["good", `Stopped: the face is ${where}, confirmed by ${n} ${n === 1 ? "servo" : "servos"}.`];
}

function told(answer) {
  const text = answer?.error ?? answer?.detail;
  return typeof text === "string" ? text.replace(/\.$/, "") : null;
}

function say(tone, text) {
  report.dataset.tone = tone;
  report.hidden = false;
  report.textContent = text;
}

/** The face is driven again, so that the next press is a first one. */
export function driven() {
  if (level === "soft") return;
  level = "soft";
  delete button.dataset.pressed;
  button.querySelector("b").textContent = "STOP";
  report.hidden = true;
}

button.addEventListener("click", stop);
// Capturing, on the window: whatever has the focus, also a text field or a dialog.
window.addEventListener(
  "keydown",
  (event) => {
    if (event.key === "Escape" && !event.repeat) stop();
  },
  true,
);
window.faceStop = stop;
window.faceDriven = driven;
button.dataset.ready = "";
// Pressed before this file had come: the button has asked by itself.
if (button.dataset.early !== undefined) stop();
