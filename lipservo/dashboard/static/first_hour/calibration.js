// A speaker's mouth becomes this robot's angles: by eye with sliders, or measured; and the grade.
import { escaped, shown, spoken } from "../words.js";
import { about, draw, markers, mouth, write } from "./dom.js";

const KEYS = { keep: "\r", back: "b", skip: "x", finish: "q" }; // as `calibrate guided` takes them
const STICKS_MS = 4000; // a slider keeps the angle sent for so long, until the robot's goal is the same
const SEND_MS = 120; // of a slider that is dragged

export class Calibration {
  static title = "Calibration";

  constructor(hour, body) {
    Object.assign(this, { hour, body, moves: {}, sent: {}, timer: null });
    body.addEventListener("click", (event) => this.click(event.target.closest("button")));
    body.addEventListener("input", (event) => this.slide(event.target));
    body.addEventListener("change", (event) => event.target.name === "tracker" && this.choose());
    body.addEventListener("submit", (event) => {
      event.preventDefault();
      this.measure(event.target, false);
    });
  }

  can(state) {
    return state.face !== null;
  }

  summary(state) {
    return state.face?.calibration ?? "";
  }

  update(state) {
    if (!state.face) return;
    if (this.hour.runs("by_eye")) this.byEye(state);
    else if (this.hour.runs("measure")) this.measuring(state);
    else if (this.hour.runs("drawn")) draw(this.body, '<p class="busy"><i></i>A map for a face of usual shape is made …</p>');
    else this.before(state);
  }

  /** Draw the section while no step runs: the last grade, and the ways to calibrate. */
  before(state) {
    const made = state.graded ? grade(state.graded) : "";
    const failed = state.step?.error?.includes("is not written") && state.step.name === "measure";
    const accept = failed
      ? '<p><button type="button" class="act" data-do="accept">Go on with what was captured, and take it as it is</button></p>'
      : "";
    const places = state.face.has_place;
    const drawn = places
      ? ""
      : '<div><h3>Drawn</h3><p>A map for a face of usual shape, with your limits: the robot speaks at once, coarsely.</p><button type="button" class="act" data-do="drawn">Begin with a drawn face</button></div>';
    const computed = state.simulated ? '<option value="computed">computed from the simulated servos</option>' : "";
    draw(
      this.body,
      `${made}${accept}<div class="ways"><div><h3>By eye</h3><p>You see the mouth that is wanted, and bring the robot's there with sliders: 14 shapes, some ten minutes. Usable, and coarse.</p>` +
        `${places ? lags(false) : ""}<button type="button" class="act first" data-do="by-eye">${state.keeps ? "Go on by eye" : "Begin by eye"}</button></div>` +
        '<form><h3>Measured</h3><p>A tracker sees points on the face while the robot goes through some 150 poses, slowly: it knows millimetres, and whether the lips meet.</p>' +
        `<label>Who sees the markers<select class="field" name="tracker">${computed}<option value="camera">a camera, human enough faces</option><option value="file">a file or folder that another program fills</option></select></label>` +
        '<label class="of-camera">Camera<input class="field" name="camera" placeholder="0"></label>' +
        '<label class="of-camera">Between the outer corners of the eyes, mm<input class="field" name="eye_distance_mm" inputmode="decimal" placeholder="92"></label>' +
        '<label class="of-file">File or folder<input class="field" name="path" placeholder="/home/me/markers.csv" autocapitalize="off"></label>' +
        `${places ? lags(true) : ""}<button class="act first">Measure</button></form>${drawn}</div>` +
        '<p class="hint">The robot moves by itself in both. Keep hands away; STOP and Esc stop it at any moment, and what was made is kept.</p>',
    );
    this.choose();
  }

  /** Only what the chosen tracker needs is asked. */
  choose() {
    const chosen = this.body.querySelector("[name=tracker]")?.value;
    for (const kind of ["camera", "file"]) {
      for (const each of this.body.querySelectorAll(`.of-${kind}`)) each.hidden = chosen !== kind;
    }
  }

  /** Draw the calibration by eye: the wanted mouth, the robot's, and a slider for each joint. */
  byEye(state) {
    const eye = this.hour.event("by_eye", "eye");
    const chirps = this.hour.event("by_eye", "progress");
    if (chirps || this.hour.event("by_eye", "fitting")) {
      draw(this.body, progress(chirps, "The map is made of your shapes …"));
      return;
    }
    if (!eye) {
      draw(this.body, '<p class="busy"><i></i>The servos come to neutral. Keep your hands away.</p>');
      return;
    }
    const names = Object.keys(state.face.servos).filter((name) => state.face.servos[name].part === "mouth");
    draw(
      this.body,
      '<div class="eye"><figure><figcaption>Wanted: <b class="name"></b><span class="what"></span></figcaption><div class="wanted"></div></figure>' +
        `<figure><figcaption>${state.simulated ? "The robot's mouth, computed" : state.face.has_place ? "The robot, as its encoders say" : "The robot, as it was sent"}</figcaption><div class="made">${state.simulated ? "" : "<face-robot></face-robot>"}</div></figure></div>` +
        `<div class="sliders">${names.map((name) => slider(name, state.face.servos[name])).join("")}</div>` +
        '<div class="buttons end"><button type="button" class="act first" data-key="keep">It looks like that: next</button><button type="button" class="act" data-key="back">Back</button><button type="button" class="act" data-key="skip">Leave it out</button><button type="button" class="act" data-key="finish">Finish</button></div>' +
        '<ol class="poses"></ol>',
    );
    const find = (selector) => this.body.querySelector(selector);
    write(find(".eye .name"), eye.name);
    write(find(".what"), eye.instruction);
    draw(find(".wanted"), mouth(eye.wanted, `the mouth that is wanted: ${eye.name}`, "wanted"));
    if (eye.robot) draw(find(".made"), mouth(eye.robot, "the robot's mouth", "robot"));
    draw(
      find(".poses"),
      eye.poses.map((name, n) => `<li class="${n === eye.pose ? "now" : ""}${eye.made.includes(name) ? " done" : ""}">${escaped(name)}</li>`).join(""),
    );
    for (const name of names) this.place(name, eye.goals_deg[name]);
  }

  /** Set a joint's slider to its goal, unless a person has just moved it. */
  place(name, deg) {
    const line = this.body.querySelector(`.slider[data-servo="${name}"]`);
    const input = line.querySelector("input");
    const sent = this.sent[name]; // until the robot's side says the same, the slider stays
    if (name in this.moves || (sent && sent.deg !== deg && performance.now() - sent.ms < STICKS_MS)) return;
    delete this.sent[name];
    if (Number(input.value) !== deg) input.value = deg;
    write(line.querySelector("output"), `${shown(deg, 1)}°`);
  }

  /** Show the angle of a slider that is dragged, and send it after SEND_MS with all that changed. */
  slide(input) {
    const name = input.closest(".slider")?.dataset.servo;
    if (!name) return;
    write(input.closest(".slider").querySelector("output"), `${shown(Number(input.value), 1)}°`);
    this.moves[name] = Number(input.value);
    this.timer ??= setTimeout(() => this.send(), SEND_MS);
  }

  async send() {
    const move = { ...this.moves };
    for (const [name, deg] of Object.entries(move)) this.sent[name] = { deg, ms: performance.now() };
    this.moves = {};
    this.timer = null;
    if (Object.keys(move).length) await this.hour.post("order", { move });
  }

  /** Draw the measured calibration: markers seen, poses done, and where each joint is. */
  measuring(state) {
    const done = this.hour.event("measure", "progress");
    const seen = this.hour.event("measure", "seen");
    const places = this.hour.event("measure", "arrived")?.deg ?? {};
    const names = Object.keys(state.face.servos).filter((name) => state.face.servos[name].part === "mouth");
    draw(
      this.body,
      '<div class="measuring"><figure><figcaption>What the tracker sees <small class="n-seen"></small></figcaption><div class="picture"></div></figure>' +
        `<div><div class="how-far"></div><div class="places">${names.map((name) => `<div class="place" data-servo="${escaped(name)}"><span>${escaped(spoken(name))}</span><i><u></u></i><output></output></div>`).join("")}</div>` +
        '<ul class="notes"></ul><button type="button" class="act" data-do="end">Stop measuring</button></div></div>',
    );
    const find = (selector) => this.body.querySelector(selector);
    draw(find(".how-far"), progress(done, "The servos come to neutral. Keep your hands away."));
    if (seen) {
      write(find(".n-seen"), `${seen.points.filter((each) => each !== null).length} of ${seen.points.length} markers`);
      draw(find(".picture"), markers(seen));
    } else draw(find(".picture"), '<p class="hint">Nothing yet.</p>');
    for (const name of names) {
      const { min_deg, max_deg } = state.face.servos[name];
      const line = find(`.place[data-servo="${name}"]`);
      const deg = places[name];
      write(line.querySelector("output"), deg === undefined || deg === null ? "–" : `${shown(deg, 1)}°`);
      if (deg !== undefined) line.querySelector("u").style.left = `${(100 * (deg - min_deg)) / (max_deg - min_deg)}%`;
    }
    draw(find(".notes"), state.step.notes.slice(-3).map((line) => `<li>${escaped(line)}</li>`).join(""));
  }

  click(button) {
    if (button === null || button.type === "submit") return;
    const { key, do: what } = button.dataset;
    if (key) this.press(key);
    else if (what === "by-eye") this.hour.post("start", { step: "by_eye", lags: button.parentElement.querySelector("[name=lags]")?.checked ?? false });
    else if (what === "drawn") this.hour.post("start", { step: "drawn" });
    else if (what === "accept") this.measure(this.body.querySelector("form"), true);
    else if (what === "end") this.hour.post("end");
  }

  /** Send what sliders were moved to last, then the key. */
  async press(key) {
    clearTimeout(this.timer);
    await this.send();
    document.activeElement?.blur();
    this.hour.post("order", { key: KEYS[key] });
  }

  /** Start a measured calibration with a form's values. accept: go on with the poses that were kept. */
  measure(form, accept) {
    const value = (name) => form.elements[name].value.trim();
    const chosen = value("tracker");
    const body = { step: "measure", tracker: chosen === "file" ? value("path") : chosen, lags: form.elements.lags?.checked ?? false, accept };
    if (chosen === "camera") {
      if (value("camera")) body.camera = value("camera");
      const distance = value("eye_distance_mm");
      if (distance) body.eye_distance_mm = Number(distance.replace(",", "."));
      if (Number.isNaN(body.eye_distance_mm)) {
        this.hour.refuse(`Between the outer corners of the eyes, mm: "${distance}" is no number; give one such as 92.5.`);
        return;
      }
    }
    this.hour.post("start", body);
  }
}

function lags(isChecked) {
  return `<label class="check"><input type="checkbox" name="lags"${isChecked ? " checked" : ""}> and how late each servo is (14 s a joint)</label>`;
}

function slider(name, servo) {
  const { min_deg, max_deg, positive } = servo;
  return (
    `<label class="slider" data-servo="${escaped(name)}"><span class="name">${escaped(spoken(name))}</span><output></output>` +
    `<input type="range" min="${min_deg}" max="${max_deg}" step="0.5"><span class="ends"><span>${shown(min_deg, 0)}°</span><em>${escaped(positive)} →</em><span>${shown(max_deg, 0)}°</span></span></label>`
  );
}

/** How far a calibration is: a bar, the pose, the minutes that are left. */
function progress(done, before) {
  if (!done || !done.done) return `<p class="busy"><i></i>${escaped(done?.what === "chirps" ? "Each joint chirps …" : before)}</p>`;
  const what = done.what === "chirps" ? "joint" : "pose";
  const left = done.done >= done.total ? "It works out what it saw." : `${about(done.left_min)} left`;
  return (
    `<p class="lead">${what === "pose" ? "Pose" : "Joint"} ${done.done} of ${what === "pose" ? "about " : ""}${done.total}</p>` +
    `<progress max="${done.total}" value="${done.done}"></progress><p class="left">${left}</p>`
  );
}

/** HTML of a calibration's grade: whether the lips meet, warnings, and the command's whole report. */
function grade({ lines, warnings, closing }) {
  const isOpen = closing && !closing.closes;
  const [first, ...more] = lines;
  const tone = isOpen ? "bad" : "good";
  const meets =
    closing === null
      ? '<p class="note">Nobody saw whether the lips meet: a measured calibration tells.</p>'
      : isOpen
        ? `<p class="note bad">The mouth does not close: ${escaped(spoken(closing.joint ?? "a joint"))} stands at its limit, up to ${shown(closing.missing_deg, 1)}° are missing, and the lips stay up to ${shown(closing.apart_mm, 1)} mm apart. Widen that limit, or close it by its horn.</p>`
        : '<p class="note good">The lips meet.</p>';
  const warningItems = warnings.map((line) => `<li>${escaped(line)}</li>`).join("");
  return (
    `<div class="grade" data-closes="${tone}">${meets}<p class="lead">${escaped(first)}</p>` +
    (warningItems ? `<ul class="warnings">${warningItems}</ul>` : "") +
    `<details><summary>The whole report</summary><ul>${more.map((line) => `<li>${escaped(line)}</li>`).join("")}</ul></details></div>`
  );
}
