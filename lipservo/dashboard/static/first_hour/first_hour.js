// The page of the first hour: asks the server for its state, draws it, and posts what is clicked.
// All state is the server's: a page that is reloaded, or a second one, goes on where this one was.
import { getJson, postJson } from "../calls.js";
import { face, facts } from "../link.js";
import { escaped } from "../words.js";
import { write } from "./dom.js";
import { Calibration } from "./calibration.js";
import { FirstWords } from "./first_words.js";
import { hasOwnLimits, isWhole, Limits } from "./limits.js";
import { Servos } from "./servos.js";

const LIVELY_MS = 200; // while something moves, or is turned by hand
const CALM_MS = 700;
const BEGINS_MS = 2500; // a step has a socket before its first answer comes
const HERE = "/api/first-hour";

/** What the sections need: to post, to say what went wrong, and the last state. */
export class Hour {
  constructor(show) {
    this.show = show;
    this.state = null;
    this.failure = "";
    this.idleMs = performance.now();
  }

  /** Post to the server and take its new state; return whether it succeeded, else show why not. */
  async post(path, body = {}) {
    if (path === "start" && this.starts) return false; // the second click of a double click
    this.failure = "";
    this.starts = path === "start";
    try {
      this.take(await postJson(`${HERE}/${path}`, body, { patienceMs: 25_000 }));
      return true;
    } catch (error) {
      return this.refuse(error.message);
    } finally {
      this.starts = false;
    }
  }

  /** Show why something was not done; return false. */
  refuse(text) {
    this.failure = text;
    this.show();
    return false;
  }

  /** Request the state, take it, and do so again for ever: five times a second while a step runs. */
  async poll() {
    try {
      this.take(await getJson(HERE, 4000));
      this.lost = null;
    } catch (error) {
      this.lost = error.message;
      this.show();
    }
    setTimeout(() => this.poll(), this.state?.works ? LIVELY_MS : CALM_MS);
  }

  /** Keep a new state of the server, and show it. */
  take(state) {
    this.state = state;
    // Between steps no face answers, and a step without a live board sends no frames: no alarm then.
    if (!state.drives) this.idleMs = performance.now();
    face.idle = face.status !== null || performance.now() - this.idleMs < BEGINS_MS;
    this.show();
  }

  /** The newest event of a kind of the step that runs, or ran last. */
  event(step, kind) {
    return this.state.step?.name === step ? this.state.step.events[kind] : undefined;
  }

  runs(step) {
    return this.state.works === step;
  }
}

/** Which section a person is in: the first that is not done, or the one whose step runs. Pure. */
export function sectionOf(state) {
  const running = { find: 0, nudge: 0, limits: 1, jog: 1, set_up: 1, by_eye: 2, measure: 2, drawn: 2, speak: 3 };
  if (state.works !== null) return running[state.works];
  if (state.face === null) return 0;
  const { set_up, jog } = state.ended_well;
  if (Object.values(state.ends).some(isWhole) || set_up === false || jog === false) return 1;
  if (state.face.calibration) return 3;
  const found = Object.values(state.face.servos).some(hasOwnLimits);
  return found || set_up || jog ? 2 : 1;
}

/** What a person has done, in robot minutes by step, as a sentence; "" before the first. Pure. */
export function minutes(robotMin) {
  const total = Object.values(robotMin).reduce((sum, each) => sum + each, 0);
  return total < 0.05 ? "" : `Robot minutes so far: ${total.toFixed(1)}.`;
}

class FirstHour extends HTMLElement {
  connectedCallback() {
    face.idle = true;
    this.hour = new Hour(() => this.update());
    this.innerHTML =
      '<ol class="hour-steps" aria-label="steps"></ol>' +
      '<p class="note bad failure" role="alert" hidden></p><p class="note warn told" role="status" hidden></p>';
    this.steps = this.querySelector(".hour-steps");
    this.failure = this.querySelector(".failure");
    this.told = this.querySelector(".told");
    this.sections = [Servos, Limits, Calibration, FirstWords].map((Section, n) => {
      const host = document.createElement("section");
      host.className = "card hour-section";
      host.innerHTML =
        `<div class="card-head"><h2><b class="badge">${n + 1}</b> ${Section.title}</h2><small class="summary"></small>` +
        '<button type="button" class="act small open" hidden></button></div><div class="body"></div>';
      this.append(host);
      const section = new Section(this.hour, host.querySelector(".body"), this.dataset.warning);
      host.querySelector(".open").addEventListener("click", () => {
        this.chosen = this.chosen === n ? null : n;
        this.update();
      });
      return { section, host };
    });
    this.spent = document.createElement("p");
    this.spent.className = "hint spent";
    this.append(this.spent);
    this.chosen = null;
    this.hour.poll();
  }

  /** Draw the state: what is wrong, the steps, and the section that is open. */
  update() {
    const { state, failure, lost } = this.hour;
    const step = state?.step;
    const errorText = lost ?? (failure || state?.trouble || (step && !step.runs ? step.error : "")) ?? "";
    this.failure.hidden = !errorText;
    if (this.failure.textContent !== errorText) this.failure.textContent = errorText;
    if (state === null) return;
    this.told.hidden = !state.note;
    write(this.told, state.note ? `${state.note[0].toUpperCase()}${state.note.slice(1)}.` : "");
    write(this.spent, minutes(state.robot_min));
    const now = sectionOf(state);
    if (this.now !== now) this.chosen = null; // what goes on comes first
    this.now = now;
    const open = state.works === null ? (this.chosen ?? now) : now;
    const titles = this.sections.map(({ section }) => section.constructor.title);
    const steps = titles
      .map((title, n) => `<li class="${n < now ? "done" : n === now ? "now" : ""}"${n === now ? " aria-current=step" : ""}>${escaped(title)}</li>`)
      .join("");
    if (this.steps.innerHTML !== steps) this.steps.innerHTML = steps;
    this.sections.forEach(({ section, host }, n) => {
      host.classList.toggle("done", n < now);
      host.classList.toggle("open", n === open);
      const can = section.can(state);
      const button = host.querySelector(".open");
      button.hidden = n === open || !can || state.works !== null;
      button.textContent = n < now ? "Again" : "Open";
      write(host.querySelector(".summary"), section.summary(state));
      if (n === open) section.update(state);
      host.querySelector(".body").hidden = n !== open;
    });
    this.head(state);
  }

  /** Write the name and port of the new face into the head of the page. */
  head(state) {
    const name = state.face?.name ?? state.file.split("/").at(-1);
    write(document.getElementById("face-name"), name);
    let port = document.querySelector("#face-head .port");
    if (!port) {
      port = document.createElement("span");
      port.className = "port";
      document.getElementById("face-name").after(port);
    }
    port.classList.toggle("sim", state.simulated);
    write(port, state.simulated ? "SIMULATED" : (state.port ?? "no port yet"));
  }
}

window.firstHour = { sectionOf, minutes, facts };
customElements.define("first-hour", FirstHour);
