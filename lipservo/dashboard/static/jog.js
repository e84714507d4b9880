// Moving single servos by hand: behind a switch that turns itself off 3 s after the last touch.
import { postJson } from "./calls.js";
import { drawnDeg, face, facts, onDraw, onHello, onStatus, troubleOf } from "./link.js";
import { place } from "./live/servo_bars.js";
import { PulseRow } from "./pulse_row.js";
import { shown, spoken, unread, whyStill } from "./words.js";

const ARMED_MS = 3000; // as long as the face itself waits for the next jog command
const EVERY_MS = 60;

class FaceJog extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<div class="arm"><button type="button" class="switch" role="switch" aria-checked="false">' +
      'Arm the sliders</button><div class="left"><i></i></div><span class="hint"></span></div>' +
      '<div class="beyond" role="alert" hidden><p></p>' +
      '<button type="button" class="act first go">Go beyond</button>' +
      '<button type="button" class="act stay">Stay within</button></div>' +
      '<div class="sliders" inert></div><p class="said" role="status"></p>';
    this.beyond = this.querySelector(".beyond");
    this.beyond.querySelector(".go").addEventListener("click", () => this.agree(true));
    this.beyond.querySelector(".stay").addEventListener("click", () => this.agree(false));
    this.agreed = new Set(); // servos that a person wants to go beyond their limits
    this.arm = this.querySelector(".switch");
    this.left = this.querySelector(".left i");
    this.hint = this.querySelector(".hint");
    this.sliders = this.querySelector(".sliders");
    this.said = this.querySelector(".said");
    this.armedUntilMs = 0;
    this.wanted = new Map(); // servo -> its place, {deg} or {pulse_us}, that has not been sent yet
    this.touched = new Set(); // servos that were moved since arming
    this.arm.addEventListener("click", () => (this.isArmed ? this.end() : this.begin()));
    this.leave = () => this.isArmed && this.end(true);
    window.addEventListener("pagehide", this.leave);
    this.hidden_ = () => document.hidden && this.leave();
    document.addEventListener("visibilitychange", this.hidden_);
    this.still = null; // why nothing can be moved now
    this.undo = [
      onHello((hello) => this.build(hello.servos)),
      onDraw((frame) => this.draw(frame)),
      onStatus((status) => this.rest(whyStill(status))),
    ];
    this.clock = setInterval(() => this.count(), 50);
    this.count();
  }

  disconnectedCallback() {
    this.leave();
    clearInterval(this.clock);
    window.removeEventListener("pagehide", this.leave);
    document.removeEventListener("visibilitychange", this.hidden_);
    this.undo.forEach((each) => each());
  }

  /** Disarm while nothing can be moved. why: a sentence, since the face is stopped; null: it can. */
  rest(why) {
    this.still = why;
    if (why !== null && this.isArmed) this.end();
    this.count();
  }

  get isArmed() {
    return performance.now() < this.armedUntilMs;
  }

  /** Make a row for each servo: in degrees, or in microseconds for a hobby servo. */
  build(names) {
    this.rows = names.map((name) => new (facts.servos?.[name]?.pulse ? PulseRow : DegreeRow)(name, this));
    this.sliders.replaceChildren(...this.rows.map((row) => row.line));
    for (const { input } of this.rows) input.addEventListener("pointerdown", () => this.touch());
  }

  /** Whether a person has agreed to take this servo beyond its limits; if not, show the question. */
  mayGoBeyond(name) {
    if (this.agreed.has(name)) return true;
    this.asked = name;
    this.beyond.querySelector("p").textContent = `${spoken(name)}: ${this.dataset.warning}`;
    this.beyond.hidden = false;
    this.beyond.scrollIntoView({ block: "center" }); // on a telephone the slider is far below
    return false;
  }

  async agree(isAgreed) {
    this.beyond.hidden = true;
    if (!isAgreed) return;
    this.agreed.add(this.asked);
    this.say("", "");
    await (this.isArmed ? this.touch() : this.begin()); // reading takes longer than the switch waits
    if (this.isArmed && this.said.dataset.tone !== "bad") this.say("", `${spoken(this.asked)} may go beyond its limits now, 10 µs at a time.`);
  }

  /** Arm the sliders, each at its servo's present position; those of servos in trouble stay disabled. */
  async begin() {
    const beganMs = performance.now();
    try {
      await postJson("/api/jog", { action: "arm" });
    } catch (error) {
      return this.say("bad", error.message);
    }
    // Sliders begin where the servos stand, so that the first touch moves nothing far.
    this.rows.forEach((row, i) => {
      const encoder = face.frame?.encodersDeg[i] ?? null;
      row.rest(encoder, face.frame?.goalsDeg[i] ?? null);
      row.input.disabled = troubleOf(row.name, encoder) !== null;
    });
    this.say("", "");
    this.touched.clear();
    this.armedUntilMs = beganMs + ARMED_MS;
    this.wasArmed = true;
    if (!this.isArmed) this.say("bad", "The face answered too late: arm again.");
    return this.count();
  }

  /** Renew the arming, here and at the face. */
  async touch() {
    if (!this.isArmed) return;
    try {
      await this.renew({ action: "arm" });
    } catch (error) {
      this.say("bad", error.message);
    }
  }

  /** Send an order to the face that is armed; the switch then waits no longer than the face does. */
  async renew(order) {
    const beganMs = performance.now();
    await postJson("/api/jog", order);
    if (this.isArmed) this.armedUntilMs = beganMs + ARMED_MS;
  }

  /** Ask for a servo's new place, {deg} or {pulse_us}; the newest of each servo is sent. */
  want(name, place) {
    if (!this.isArmed) return;
    this.touched.add(name);
    this.wanted.set(name, place);
    this.send();
  }

  /** One call at a time, each with the newest angle. */
  async send() {
    if (this.sending) return;
    this.sending = true;
    while (this.wanted.size && this.isArmed) {
      const [[name, place]] = this.wanted;
      this.wanted.delete(name);
      try {
        await this.renew({ action: "move", servo: name, ...place });
        this.say("", "");
      } catch (error) {
        this.say("bad", `${spoken(name)}: ${error.message}`);
      }
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
    this.sending = false;
  }

  /** Disarm, and end jogging at the face. leaving: the page closes, and the call must outlive it. */
  async end(leaving = false) {
    this.armedUntilMs = 0;
    this.wanted.clear();
    this.count();
    if (leaving) {
      postJson("/api/jog", { action: "end" }, { keepalive: true }).catch(() => {});
      return;
    }
    try {
      await postJson("/api/jog", { action: "end" });
    } catch (error) {
      this.say("bad", error.message);
    }
  }

  /** Show for how long the sliders are armed yet, or why they cannot be; 20 times a second. */
  count() {
    const leftMs = Math.max(0, this.armedUntilMs - performance.now());
    const isArmed = leftMs > 0;
    this.left.style.width = `${(100 * leftMs) / ARMED_MS}%`;
    this.arm.setAttribute("aria-checked", String(isArmed));
    const label = isArmed ? `Armed: ${(leftMs / 1000).toFixed(1)} s` : "Arm the sliders";
    if (this.arm.textContent !== label) this.arm.textContent = label;
    this.arm.disabled = this.still !== null && !isArmed;
    let hint = isArmed
      ? "Each touch renews it. Press to disarm; the face then goes on by itself."
      : "While armed, sliders move single servos within their limits; the others go on. It disarms 3 s after the last touch.";
    if (this.arm.disabled) hint = this.still;
    if (this.hint.textContent !== hint) this.hint.textContent = hint;
    this.sliders.inert = !isArmed;
    if (this.wasArmed && !isArmed) {
      this.wasArmed = false;
      this.wanted.clear();
    }
  }

  draw(frame) {
    const encodersDeg = drawnDeg(frame);
    this.rows?.forEach((row, i) => {
      // A slider that nobody has touched since arming stays where its servo is.
      row.draw(encodersDeg[i], frame.goalsDeg[i], this.isArmed && this.touched.has(row.name));
    });
  }

  say(tone, text) {
    this.said.dataset.tone = tone;
    this.said.textContent = text;
  }
}

/** A slider in degrees of the joint. */
class DegreeRow {
  constructor(name, jog) {
    const { least_deg: least, most_deg: most, positive } = facts.servos?.[name] ?? { least_deg: -90, most_deg: 90 };
    Object.assign(this, { name, least, most });
    this.line = document.createElement("label");
    this.line.className = "slider";
    this.line.dataset.servo = name;
    this.line.innerHTML =
      '<span class="name"></span><span class="rail">' +
      `<input type="range" min="${least}" max="${most}" step="0.1"><u></u></span><output></output>` +
      `<span class="ends"><span>${least}°</span><em></em><span>${most}°</span></span>`;
    this.line.querySelector(".name").textContent = spoken(name);
    this.line.querySelector(".ends em").textContent = positive ? `+ ${positive}` : "";
    this.input = this.line.querySelector("input");
    this.mark = this.line.querySelector("u");
    this.output = this.line.querySelector("output");
    this.input.addEventListener("input", () => jog.want(name, { deg: Number(this.input.value) }));
  }

  /** Set the slider to the servo's position, or its goal, so that the first touch moves nothing far. */
  rest(encoderDeg, goalDeg) {
    this.input.value = encoderDeg ?? goalDeg ?? 0;
  }

  /** Show the servo's position. isHeld: a person moves the slider, which then stays where it is. */
  draw(encoderDeg, goalDeg, isHeld) {
    const at = encoderDeg === null ? null : place(encoderDeg, this.least, this.most);
    this.mark.hidden = at === null;
    // The thumb's middle runs from half its width to half its width before the end.
    if (at !== null) this.mark.style.left = `calc(8px + ${at} * (100% - 16px))`;
    const text = encoderDeg === null ? unread(face.status, this.name, face.phase === "stopped") : shown(encoderDeg, 1, "°");
    if (this.output.textContent !== text) this.output.textContent = text;
    if (!isHeld && encoderDeg !== null) this.rest(encoderDeg, goalDeg);
  }
}

customElements.define("face-jog", FaceJog);
