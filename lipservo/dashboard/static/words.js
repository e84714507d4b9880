// What states are called in plain words, and how numbers and texts are shown.

const STATES = {
  stopped: ["not running", "quiet"],
  driven: ["running", "good"],
  silent: ["resting: limp until somebody speaks", "quiet"],
  easing: ["stopping: easing to rest", "warn"],
  frozen: ["stopped: frozen where it is", "warn"],
  "letting go": ["letting go: torque goes off", "warn"],
  ended: ["ended", "quiet"],
};

/**
 * [words, tone] of a face's state; tone: good, quiet, warn or bad. Pure.
 * can: of its status; null: what its servos can report is not known yet.
 */
export function stateWords(state, can = null) {
  if (!state) return ["state unknown", "bad"];
  if (state === "silent" && can?.confirmed_limp === false) return [`resting: ${can.released_words}`, "quiet"];
  return STATES[state] ?? [state, "warn"];
}

/** The same of a status, with the stop that a supervisor holds to. Pure. */
export function statusWords(status) {
  if (status === null) return ["no answer", "bad"];
  if (status.stopped === "freeze") return STATES.frozen;
  return stateWords(status.state, status.capabilities);
}

/** Whether a person has stopped the face, and it waits for a start. status: may be null. Pure. */
export function isStopped(status) {
  if (status?.state !== "stopped") return false;
  return Boolean(status.stopped) || status.can_start === true;
}

export const STILL = "The face is stopped. Start it first, at the top of the page.";

/** Why nothing of a face can be moved now, a sentence; null: it can. Pure. */
export function whyStill(status) {
  return isStopped(status) ? STILL : null;
}

/** What one servo can report, by its name; of a face with several buses what its bus can. Pure. */
function capabilitiesOf(status, name) {
  const can = status?.capabilities;
  const index = can?.bus_of ? Object.keys(status.servos ?? {}).indexOf(name) : -1;
  return index < 0 ? can : can.buses[can.bus_of[index]];
}

/** In place of a place that was not read; a dash where the servo cannot say where it stands. Pure. */
export function unread(status, name, isLimp) {
  if (capabilitiesOf(status, name)?.place === false) return "–";
  return isLimp ? "limp" : "no answer";
}

/**
 * What keeps a servo from being drawn as working; null: nothing. Pure.
 * status: may be null; encoderDeg: null: never read.
 */
export function servoTrouble(status, name, encoderDeg) {
  if (isStopped(status)) {
    const why = status.stop_report?.unconfirmed?.[name];
    return why === undefined ? null : `not confirmed to be limp: ${why}`;
  }
  const state = status?.servos?.[name];
  const canSay = capabilitiesOf(status, name)?.place !== false;
  if (canSay && (encoderDeg === null || encoderDeg === undefined)) return "does not answer";
  if (!state || state === "driven") return null;
  const line = (status.troubles ?? []).find((each) => each.startsWith(`${name}:`));
  return line ? line.slice(name.length + 1).trim() : state;
}

/** `upper_lip_left` as people say it. */
export function spoken(name) {
  return name.replaceAll("_", " ");
}

/** A number with so many places, or a dash where it is not known. */
export function shown(value, places = 0, unit = "") {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  return `${value.toFixed(places)}${unit ? `\u202f${unit}` : ""}`;
}

/** Text as text: nothing in it is markup. */
export function escaped(text) {
  return String(text).replace(/[&<>"']/g, (sign) => `&#${sign.charCodeAt(0)};`);
}

/** A count in its grammatical number. */
export function counted(n, one, many = `${one}s`) {
  return `${n} ${n === 1 ? one : many}`;
}
