// The slider of a hobby servo in microseconds: within its limits, and beyond them to find them.
import { postJson } from "./calls.js";
import { face, facts } from "./link.js";
import { place } from "./live/servo_bars.js";
import { shown, spoken } from "./words.js";

const STEP_US = 10; // the longest step that the face accepts beyond the limits
const ENDS_US = [500, 2500]; // and nothing outside of these
const REPEAT_MS = 250; // of a button that is held down: as fast as the servo may follow
const LIMITS = ["min", "neutral", "max"]; // may be set to the servo's present pulse
const saved = new Map(); // servo -> limits that were written since the page was loaded

/**
 * The row of a hobby servo. jog: the FaceJog that it belongs to; us: the pulse sent last, null: not known;
 * target: the pulse that a person has asked for, null: none.
 */
export class PulseRow {
  constructor(name, jog) {
    Object.assign(this, { name, jog, us: null, target: null });
    this.line = document.createElement("div");
    this.line.className = "slider pulse";
    this.line.dataset.servo = name;
    this.line.innerHTML =
      '<span class="name"></span><span class="rail"><input type="range" step="1"><b></b><b></b><u></u></span><output></output>' +
      '<span class="ends"><span></span><em></em><span></span></span>' +
      '<div class="tools"><button type="button" class="act less">− 10 µs</button>' +
      '<button type="button" class="act more">+ 10 µs</button><span class="set">set as ' +
      LIMITS.map((limit) => `<button type="button" class="act" data-limit="${limit}">${limit}</button>`).join(" ") +
      '</span></div><small class="saved"></small>';
    const find = (selector) => this.line.querySelector(selector);
    this.input = find("input");
    this.mark = find("u");
    this.limitMarks = this.line.querySelectorAll(".rail b");
    this.output = find("output");
    [this.low, this.high] = this.line.querySelectorAll(".ends span");
    find(".name").textContent = spoken(name);
    find(".ends em").textContent = this.way();
    this.input.setAttribute("aria-label", `pulse of ${spoken(name)}`);
    this.input.addEventListener("input", () => this.want(Number(this.input.value)));
    held(find(".less"), () => this.step(-STEP_US));
    held(find(".more"), () => this.step(STEP_US));
    for (const button of this.line.querySelectorAll("[data-limit]")) {
      button.addEventListener("click", () => this.set(button.dataset.limit));
    }
    const { pulse, least_deg, most_deg } = facts.servos[name];
    this.tellSaved(saved.get(name) ?? { ...pulse, min_deg: least_deg, max_deg: most_deg });
  }

  /** The servo's pulses {neutral_us, us_per_deg, min_us, max_us} as the running face has them. */
  get limits() {
    return face.status?.pulses?.[this.name] ?? facts.servos[this.name].pulse;
  }

  /** The word for a positive angle, with an arrow to the side of the slider where it lies. */
  way() {
    const { positive, pulse } = facts.servos[this.name];
    if (!positive) return "";
    return pulse.us_per_deg > 0 ? `${positive} →` : `← ${positive}`;
  }

  rest(_encoderDeg, goalDeg) {
    this.draw(null, goalDeg, false);
  }

  /** Show the pulse of the goal that was sent, as a hobby servo reports none. isHeld: a person moves it. */
  draw(_encoderDeg, goalDeg, isHeld) {
    if (goalDeg === null) return;
    const { neutral_us, us_per_deg, min_us, max_us } = this.limits;
    this.us = neutral_us + us_per_deg * goalDeg;
    const low = Math.max(ENDS_US[0], Math.floor(Math.min(min_us, this.us)) - STEP_US);
    const high = Math.min(ENDS_US[1], Math.ceil(Math.max(max_us, this.us)) + STEP_US);
    if (Number(this.input.min) !== low) this.input.min = low;
    if (Number(this.input.max) !== high) this.input.max = high;
    const at = (us) => `calc(8px + ${place(us, low, high)} * (100% - 16px))`;
    this.mark.style.left = at(this.us);
    [min_us, max_us].forEach((us, i) => (this.limitMarks[i].style.left = at(us)));
    write(this.output, shown(this.us, 0, "µs"));
    write(this.low, `${low}`);
    write(this.high, `${high}`);
    this.line.classList.toggle("outside", !this.isWithin(this.us));
    if (isHeld) return;
    this.target = null;
    this.input.value = this.us;
  }

  isWithin(us) {
    const { min_us, max_us } = this.limits;
    return us > min_us - 0.5 && us < max_us + 0.5;
  }

  /** Ask for a pulse; beyond the limits only if a person has agreed to that for this servo. */
  want(us) {
    if (!this.isWithin(us) && !this.jog.mayGoBeyond(this.name)) {
      const { min_us, max_us } = this.limits;
      this.input.value = Math.min(Math.max(us, min_us), max_us);
      return;
    }
    this.target = us;
    this.input.value = us;
    this.jog.want(this.name, { pulse_us: us });
  }

  /** Ask for a pulse `us` further than the one asked for last. */
  step(us) {
    if (this.us === null) return;
    const next = Math.round(this.target ?? this.us) + us;
    this.want(Math.min(Math.max(next, Number(this.input.min)), Number(this.input.max)));
  }

  /** Write the present pulse into the YAML as the servo's min, neutral or max. */
  async set(limit) {
    const pulse_us = Math.round(this.us);
    this.jog.touch();
    try {
      const told = await postJson("/api/pulse-limits", { servo: this.name, limit, pulse_us });
      saved.set(this.name, told.set);
      this.tellSaved(told.set);
      this.jog.say("good", `${spoken(this.name)}: ${limit} is ${pulse_us} µs in the YAML; it ${told.note}.`);
    } catch (error) {
      this.jog.say("bad", `${spoken(this.name)}: ${error.message}`);
    }
  }

  tellSaved({ min_us, neutral_us, max_us, min_deg, max_deg }) {
    const degrees = `${shown(min_deg, 1)}° to ${shown(max_deg, 1)}°`;
    write(
      this.line.querySelector(".saved"),
      `In the YAML: min ${min_us}, neutral ${neutral_us}, max ${max_us} µs; ${degrees}`,
    );
  }
}

/** Call `act` once for a click or a key, and every REPEAT_MS while the pointer holds the button down. */
function held(button, act) {
  let timer = null;
  const end = () => {
    clearInterval(timer);
    timer = null;
  };
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    act();
    end();
    // A row that was drawn anew hears no end of the press.
    timer = setInterval(() => (button.isConnected && !button.closest("[inert]") ? act() : end()), REPEAT_MS);
    for (const over of ["pointerup", "pointercancel", "blur", "contextmenu"]) window.addEventListener(over, end, { once: true });
  });
  button.addEventListener("pointerleave", end);
  button.addEventListener("click", (event) => event.detail === 0 && act());
}

function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
