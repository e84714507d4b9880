// The head of the page: state in words, and a banner when something that matters is gone.
import { face, frameAgeMs, onDraw, onStatus } from "./link.js";
import { stateWords, statusWords } from "./words.js";

const PERIOD_MS = 100;
const OLD_MS = 700; // frames come every 33 ms; the banner is up within a second
const PATIENT_MS = 4000; // a page that has just been opened has no frame yet

const banner = document.getElementById("face-banner");
const state = document.getElementById("face-state");
const beganMs = performance.now();
let drivenFrames = 0;
let lastState = null; // that the servo side told: what a face ended as, once it is gone

/** What is wrong, worst first; null: nothing. state: told last by the servo side. Pure. */
export function complaint(frame, ageMs, openMs, state) {
  if (!frame) {
    return openMs < PATIENT_MS ? null : "The dashboard sends nothing. Is it still running?";
  }
  if (ageMs > OLD_MS) {
    return (
      "The dashboard does not answer: what you see is old. The face may still move. " +
      "It connects again by itself; `lipservo stop` at a terminal stops the face."
    );
  }
  if (state === "ended" && (frame.servosGone || frame.speechGone)) return ENDED;
  if (frame.servosGone && frame.speechGone) {
    return (
      "The face does not answer: neither its servo side nor its speech side says anything. " +
      "Positions on this page are old."
    );
  }
  if (frame.servosGone) {
    return "The servo side (bridge) does not answer. Its servos stop by themselves; positions on this page are old.";
  }
  if (frame.speechGone) return "The speech side does not answer: the mouth rests until it is back.";
  return null;
}

const ENDED =
  "The face has ended. Start it again at its computer, with `lipservo run` or `lipservo daemon`.";

function look() {
  const text = complaint(face.frame, frameAgeMs(), performance.now() - beganMs, lastState);
  banner.hidden = text === null;
  if (text !== null && banner.textContent !== text) banner.textContent = text;
  document.body.classList.toggle("face-old", text !== null);
  if (frameAgeMs() > OLD_MS) show(["no connection", "bad"]);
}

/** `driven` is not said of a face of which some servos are not. Pure. */
export function withServos([words, tone], status) {
  if (tone !== "good") return [words, tone];
  const states = Object.values(status?.servos ?? {});
  const nOut = states.filter((each) => each !== "driven").length;
  return nOut ? [`${words}, ${nOut} of ${states.length} servos not`, "warn"] : [words, tone];
}

function show([words, tone]) {
  if (state.textContent !== words) state.textContent = words;
  state.dataset.tone = tone;
}

onDraw((frame) => {
  if (frameAgeMs() > OLD_MS) return;
  if (!frame.servosGone) lastState = frame.state;
  if (frame.servosGone) show(lastState === "ended" ? stateWords("ended") : ["servo side gone", "bad"]);
  else {
    const told = frame.state;
    show(withServos(told ? stateWords(told) : statusWords(face.status), face.status));
    // Some frames of a stop still say "driven"; a new start says it for longer.
    drivenFrames = told === "driven" ? drivenFrames + 1 : 0;
    if (drivenFrames === 60) window.faceDriven?.();
  }
});
onStatus(() => look());
setInterval(look, PERIOD_MS);
