// The head of the page: state in words, and a banner when something that matters is gone.
import { face, facts, frameAgeMs, OLD_MS, onStatus } from "./link.js";
import { isLimp, isReleased, kept } from "./stop.js";
import { isStopped, stateWords, statusWords } from "./words.js";

const PERIOD_MS = 100;
const PATIENT_MS = 4000; // a page that has just been opened has no frame yet
// After a servo side has ended well, a status that says so arrives within this.
const ENDING_MS = 2500;
const AT_END = ["letting go", "ended", "stopped"];

const banner = document.getElementById("face-banner");
const state = document.getElementById("face-state");
const beganMs = performance.now();

/**
 * [tone, sentence] of the worst that is wrong; null: nothing. The argument is what is known, as `look`
 * gathers it; phase: as of `phaseOf` in stopped.js. While a face is stopped or starts, or the page
 * shows its confirmed end, servos and dashboard that are gone are no alarm. Pure.
 */
export function complaint({ frame, ageMs, openMs, phase, status, lastState, servosMs, refusal, idle, isFirstHour, trouble }) {
  if (refusal !== null) return ["bad", refusal];
  if (phase === "gone") return null;
  const isOld = frame !== null && ageMs > OLD_MS;
  if (idle && !isOld && frame !== null) return null; // of a first hour, between two steps
  if (phase !== "moving" && (isOld || frame === null) && status !== null) return null;
  if (frame === null) {
    return openMs < PATIENT_MS ? null : ["bad", "The dashboard sends nothing. Is it still running?"];
  }
  if (isOld && lastState === "ended") return ["warn", ENDED];
  if (isOld) {
    return [
      "bad",
      "The dashboard does not answer: what you see is old. The face may still move. " +
        "It connects again by itself; `lipservo stop` at a terminal stops the face.",
    ];
  }
  if (phase !== "moving") return null;
  if (isFirstHour && status === null && frame.servosGone && [null, ...AT_END].includes(lastState)) {
    return ["warn", `${trouble ?? "No step drives servos now"}; go on at First hour.`];
  }
  if (frame.servosGone && AT_END.includes(lastState)) {
    if (status !== null && servosMs < ENDING_MS) return null;
    if (lastState === "ended") return ["warn", ENDED];
  }
  if (frame.servosGone && frame.speechGone) {
    return [
      "bad",
      "The face does not answer: neither its servo side nor its speech side says anything. " +
        "Positions on this page are old.",
    ];
  }
  if (frame.servosGone) {
    return [
      "bad",
      "The servo side (bridge) does not answer. Its servos stop by themselves; positions on this page are old.",
    ];
  }
  if (frame.speechGone && lastState !== "ended") {
    return ["bad", "The speech side does not answer: the mouth rests until it is back."];
  }
  return null;
}

const ENDED =
  "The face has ended; what its servos confirmed did not reach this page. " +
  "Start it again at its computer, with `lipservo run` or `lipservo daemon`.";

/** [words, tone] of the page's head: the state of the face in a few words. The argument: as above. Pure. */
export function headWords({ frame, ageMs, phase, status, word, lastState, refusal, idle }) {
  if (refusal !== null) return ["not let in", "bad"];
  const isOld = frame === null || ageMs > OLD_MS;
  if (idle && !isOld && phase === "moving" && (frame.servosGone || status === null)) {
    return status === null ? ["no servo is running", "quiet"] : statusWords(status);
  }
  if (phase === "starting") return ["starting", "warn"];
  if (phase === "stopped") return stopWords("stopped", word);
  if (phase === "gone") {
    if (lastState === "ended") return stopWords("ended", word);
    return [isOld ? "no connection" : "no answer", isLimp(word) ? "quiet" : "bad"];
  }
  if (frame === null) return status === null ? ["…", ""] : withServos(statusWords(status), status);
  if (isOld) return ["no connection", "bad"];
  if (!frame.servosGone) {
    return withServos(frame.state ? stateWords(frame.state, status?.capabilities) : statusWords(status), status);
  }
  return AT_END.includes(lastState) ? ["ended", "quiet"] : ["servo side gone", "bad"];
}

/** [words, tone] of a face that has stopped or ended. word: what its servos confirmed, may be null. */
function stopWords(state, word) {
  if (word === null) return [`${state}, not confirmed`, "warn"];
  if (isReleased(word)) return [`${state}: ${word.report.released_words}`, "warn"];
  return isLimp(word) ? [`${state}: limp`, "quiet"] : [`${state}: NOT confirmed limp`, "bad"];
}

/** [words, tone] of a running face, corrected where its port is gone or some servos are not driven. Pure. */
export function withServos([words, tone], status) {
  if (tone !== "good" || isStopped(status)) return [words, tone]; // a status of before the start
  if (status?.plugged === false) return ["port gone: look at the plug", "bad"];
  const states = Object.values(status?.servos ?? {});
  const nOut = states.filter((each) => each !== "driven").length;
  if (!nOut) return [words, tone];
  if (states.every((each) => each === "waiting")) return ["no servo answers: look at their supply", "bad"];
  return [`${words}, ${nOut} of ${states.length} servos not driven`, "warn"];
}

/** Gather what is known of the face, and write banner and head; ten times a second. */
function look() {
  const nowMs = performance.now();
  const seen = {
    ...face, ageMs: frameAgeMs(), openMs: nowMs - beganMs, servosMs: nowMs - face.lastServosMs, word: kept(),
    isFirstHour: facts.firstHour,
  };
  const alarm = complaint(seen);
  banner.hidden = alarm === null;
  if (alarm !== null) {
    banner.dataset.level = alarm[0];
    if (banner.textContent !== alarm[1]) banner.textContent = alarm[1];
  }
  document.body.classList.toggle("face-old", alarm !== null || face.phase === "gone");
  const [words, tone] = headWords(seen);
  if (state.textContent !== words) state.textContent = words;
  state.dataset.tone = tone;
}

onStatus(look);
setInterval(look, PERIOD_MS);
