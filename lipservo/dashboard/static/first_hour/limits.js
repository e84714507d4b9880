// Limits set by hand: torque is off, every joint's angle is shown live, and a button sets a limit where
// a hand holds the joint.
import { escaped, shown, spoken } from "../words.js";
import { draw, write } from "./dom.js";

const HAND_DEG = [-10, -2, 2, 10]; // of a simulated hand
const AROUND_DEG = 10;
const ENDS = { min: "Set as min", neutral: "Neutral", max: "Set as max" };

/** Whether a servo's limits differ from the first ones of `new-face`, 10 degrees (hobby servos 9). Pure. */
export function hasOwnLimits({ min_deg, max_deg }) {
  return !(min_deg === -max_deg && (max_deg === 10 || max_deg === 9));
}

/** Whether both ends of a joint are set, so that they can be written. Pure. */
export function isWhole(ends) {
  return "min" in ends && "max" in ends;
}

export class Limits {
  static title = "Limits";

  constructor(hour, body, warning) {
    Object.assign(this, { hour, body, warning, ranges: {} });
    body.addEventListener("click", (event) => this.click(event.target.closest("button")));
  }

  can(state) {
    return state.face !== null;
  }

  summary(state) {
    if (state.face === null) return "";
    const found = Object.values(state.face.servos).filter(hasOwnLimits).length;
    return `${found} of ${Object.keys(state.face.servos).length} joints have limits of their own`;
  }

  update(state) {
    if (!state.face) return;
    if (!state.face.has_place) this.byPulse(state);
    else if (this.hour.runs("limits")) this.turning(state);
    else if (this.hour.runs("set_up")) {
      draw(this.body, '<p class="busy"><i></i>The limits are in the YAML. Now they are written into the servos, torque off.</p>');
    } else this.before(state);
  }

  /** Draw the section while no step runs: limits that are set and not yet written, and what to do. */
  before(state) {
    const set = Object.entries(state.ends).map(([name, ends]) => `<li>${escaped(spoken(name))}: ${told(ends)}</li>`);
    const isWritable = Object.values(state.ends).some(isWhole);
    const button = isWritable ? '<button type="button" class="act first" data-do="write">Write the limits</button> ' : "";
    const kept = set.length ? `<p>Set, and not written yet:</p><ul>${set.join("")}</ul>${button}` : "";
    const skip = state.ended_well.set_up ? "" : `<button type="button" class="act" data-do="set-up">Keep the limits as they are</button>`;
    draw(
      this.body,
      '<p>The servos are let go, and you turn each joint by hand to where it may go at most. <b>What they hold falls: hold the jaw.</b></p>' +
        `${kept}<div class="buttons"><button type="button" class="act${isWritable ? "" : " first"}" data-do="let-go">Let the servos go</button>${skip}</div>` +
        result(this.hour),
    );
  }

  /** Draw the section while servos are limp: a row for each joint, and a button that writes the limits. */
  turning(state) {
    const turned = this.hour.event("limits", "turned");
    if (!turned) {
      draw(this.body, '<p class="busy"><i></i>Letting go …</p>');
      return;
    }
    const names = Object.keys(state.face.servos);
    draw(
      this.body,
      "<p>Torque is off, confirmed by every servo. Hold a joint at its end and press <b>Set as min</b> or <b>max</b>; where the mouth rests closed, <b>Neutral</b>. The limits lie 2° inside, but never beyond neutral.</p>" +
        `<div class="turned">${names.map((name) => row(name, state.face.servos[name], state.simulated)).join("")}</div>` +
        '<div class="buttons end"><button type="button" class="act first" data-do="write">Write the limits</button><button type="button" class="act" data-do="end">Leave them</button></div>',
    );
    for (const name of names) this.live(name, turned, state);
    const whole = Object.values(state.ends).filter(isWhole).length;
    const button = this.body.querySelector("[data-do=write]");
    button.disabled = whole === 0;
    write(button, whole ? `Write the limits of ${whole === names.length ? "all" : whole} ${whole === 1 ? "joint" : "joints"}` : "Write the limits");
  }

  /**
   * Update a joint's row: its angle, its range so far, and the limits that are set.
   * turned: the newest event of the step, {deg, obstacles} by joint.
   */
  live(name, turned, state) {
    const line = this.body.querySelector(`[data-servo="${name}"]`);
    const deg = turned.deg[name];
    const ends = state.ends[name] ?? {};
    const extremesDeg = (this.ranges[name] ??= [0, 0]);
    if (deg !== null) this.ranges[name] = [Math.min(extremesDeg[0], deg), Math.max(extremesDeg[1], deg)];
    // The track shows all angles so far, and AROUND_DEG beyond them to either side.
    const anglesDeg = [...this.ranges[name], ...Object.values(ends)];
    const [low, high] = [Math.min(...anglesDeg) - AROUND_DEG, Math.max(...anglesDeg) + AROUND_DEG];
    const positionOf = (each) => `${((100 * (each - low)) / (high - low)).toFixed(2)}%`;
    write(line.querySelector("output"), deg === null ? "–" : `${shown(deg, 1)}°`);
    const mark = line.querySelector(".here");
    mark.hidden = deg === null;
    if (deg !== null) mark.style.left = positionOf(deg);
    const range = line.querySelector(".range");
    const [from, to] = [ends.min, ends.max].every((each) => each !== undefined) ? [ends.min, ends.max].sort((a, b) => a - b) : [null, null];
    range.hidden = from === null;
    if (from !== null) {
      range.style.left = positionOf(from);
      range.style.right = `${100 - Number.parseFloat(positionOf(to))}%`;
    }
    for (const end of Object.keys(ENDS)) {
      const button = line.querySelector(`[data-end=${end}]`);
      button.classList.toggle("set", end in ends);
      write(button.querySelector("small"), end in ends ? `${shown(ends[end], 1)}°` : "");
      const flag = line.querySelector(`.flag.${end}`);
      flag.hidden = !(end in ends);
      if (end in ends) flag.style.left = positionOf(ends[end]);
    }
    write(line.querySelector(".why"), turned.obstacles[name] ?? "");
  }

  /** Draw the section for hobby servos, which report no angle: sliders in microseconds lead them. */
  byPulse(state) {
    if (this.hour.runs("jog")) {
      const made = draw(this.body, `<face-jog data-warning="${escaped(this.warning)}"></face-jog><div class="buttons end"><button type="button" class="act first" data-do="jogged">The limits are found</button></div>`);
      if (made) import("../jog.js");
      return;
    }
    draw(
      this.body,
      "<p>Hobby servos do not say where they stand: each joint is led by a slider to where it should stop, slowly. Set as min, neutral and max are written at once.</p>" +
        '<p class="note warn">The first start may throw a servo to its neutral. Hands off, and the supply\'s switch in reach.</p>' +
        '<button type="button" class="act first" data-do="jog">Drive the servos</button>',
    );
    void state;
  }

  /** Do what the pressed button says; its `data-` attributes name a limit, a simulated hand or an action. */
  click(button) {
    if (button === null) return;
    const servo = button.closest("[data-servo]")?.dataset.servo;
    const { end, hand, do: what } = button.dataset;
    if (end) this.hour.post("limit", { servo, end });
    else if (hand) this.hour.post("turn", { servo, by_deg: Number(hand) });
    else if (what === "let-go") this.begin();
    else if (what === "write") this.hour.post("limits");
    else if (what === "end" || what === "jogged") this.hour.post("end");
    else if (what === "jog") this.hour.post("start", { step: "jog", may_jump: true });
    else if (what === "set-up") this.hour.post("start", { step: "set_up" });
  }

  begin() {
    this.ranges = {};
    this.hour.post("start", { step: "limits" });
  }
}

/** HTML of a joint's row: name, angle, track, buttons that set its limits; a hand if it is simulated. */
function row(name, servo, isSimulated) {
  const buttons = Object.entries(ENDS)
    .map(([end, text]) => `<button type="button" class="act" data-end="${end}">${text} <small></small></button>`)
    .join("");
  const hand = isSimulated
    ? `<span class="hand">a hand turns it ${HAND_DEG.map((deg) => `<button type="button" class="act small" data-hand="${deg}">${deg > 0 ? "+" : "−"}${Math.abs(deg)}°</button>`).join("")}</span>`
    : "";
  return (
    `<div class="turn" data-servo="${escaped(name)}"><span class="name">${escaped(spoken(name))} <small>${escaped(servo.positive)} →</small></span><output></output>` +
    '<span class="track"><i class="range"></i><b class="flag min"></b><b class="flag neutral"></b><b class="flag max"></b><u class="here"></u></span>' +
    `<span class="buttons">${buttons}</span>${hand}<small class="why"></small></div>`
  );
}

/** HTML of what was written into the servos last; empty where nothing was. */
function result(hour) {
  const step = hour.state.step;
  if (step?.name !== "set_up" || step.runs || step.error) return "";
  const lines = step.notes.filter((line) => line.includes("limit") || line.includes("nothing"));
  return `<details><summary>The servos hold their limits.</summary><ul>${lines.map((line) => `<li>${escaped(line)}</li>`).join("")}</ul></details>`;
}

function told(ends) {
  return Object.entries(ends)
    .map(([end, deg]) => `${end} ${shown(deg, 1)}°`)
    .join(", ");
}
