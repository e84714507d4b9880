// Moving single servos by hand: behind a switch that turns itself off 3 s after the last touch.
import { postJson } from "./calls.js";
import { drawnDeg, face, facts, onDraw, onHello, onStatus, troubleOf } from "./link.js";
import { place } from "./live/servo_bars.js";
import { shown, spoken, unread, whyStill } from "./words.js";

const ARMED_MS = 3000; // as long as the face itself waits for the next word
const EVERY_MS = 60;

class FaceJog extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<div class="arm"><button type="button" class="switch" role="switch" aria-checked="false">' +
      'Arm the sliders</button><div class="left"><i></i></div><span class="hint"></span></div>' +
      '<div class="sliders" inert></div><p class="said" role="status"></p>';
    this.arm = this.querySelector(".switch");
    this.left = this.querySelector(".left i");
    this.hint = this.querySelector(".hint");
    this.sliders = this.querySelector(".sliders");
    this.said = this.querySelector(".said");
    this.armedUntilMs = 0;
    this.wanted = new Map(); // servo -> degrees that have not been sent yet
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

  /** why: the face is stopped, a sentence; null: it is not. */
  rest(why) {
    this.still = why;
    if (why !== null && this.isArmed) this.end();
    this.count();
  }

  get isArmed() {
    return performance.now() < this.armedUntilMs;
  }

  build(names) {
    this.rows = names.map((name) => slider(name));
    this.sliders.replaceChildren(...this.rows.map((row) => row.line));
    for (const { name, input } of this.rows) {
      input.addEventListener("input", () => this.want(name, Number(input.value)));
      input.addEventListener("pointerdown", () => this.touch());
    }
  }

  async begin() {
    try {
      await postJson("/api/jog", { action: "arm" });
    } catch (error) {
      return this.say("bad", error.message);
    }
    // Sliders begin where the servos stand, so that the first touch moves nothing far.
    this.rows.forEach(({ input, name }, i) => {
      const encoder = face.frame?.encodersDeg[i] ?? null;
      input.value = encoder ?? 0;
      input.disabled = troubleOf(name, encoder) !== null;
    });
    this.say("", "");
    this.touched.clear();
    this.armedUntilMs = performance.now() + ARMED_MS;
    this.wasArmed = true;
    return this.count();
  }

  touch() {
    if (this.isArmed) this.armedUntilMs = performance.now() + ARMED_MS;
  }

  want(name, deg) {
    if (!this.isArmed) return;
    this.touch();
    this.touched.add(name);
    this.wanted.set(name, deg);
    this.send();
  }

  /** One call at a time, each with the newest angle. */
  async send() {
    if (this.sending) return;
    this.sending = true;
    while (this.wanted.size && this.isArmed) {
      const [[name, deg]] = this.wanted;
      this.wanted.delete(name);
      try {
        await postJson("/api/jog", { action: "move", servo: name, deg });
        this.say("", "");
      } catch (error) {
        this.say("bad", `${spoken(name)}: ${error.message}`);
      }
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
    this.sending = false;
  }

  /** leaving: the page goes away, so that the call must outlive it. */
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
    this.rows?.forEach(({ name, mark, output, input }, i) => {
      const { least_deg: least, most_deg: most } = facts.servos?.[name] ?? { least_deg: -90, most_deg: 90 };
      const encoder = drawnDeg(frame)[i];
      const at = encoder === null ? null : place(encoder, least, most);
      mark.hidden = at === null;
      // The thumb's middle runs from half its width to half its width before the end.
      if (at !== null) mark.style.left = `calc(8px + ${at} * (100% - 16px))`;
      const text = encoder === null ? unread(face.status, name, face.phase === "stopped") : shown(encoder, 1, "°");
      if (output.textContent !== text) output.textContent = text;
      // A slider that nobody has touched since arming stays where its servo is.
      const isHeld = this.isArmed && this.touched.has(name);
      if (!isHeld && encoder !== null) input.value = encoder;
    });
  }

  say(tone, text) {
    this.said.dataset.tone = tone;
    this.said.textContent = text;
  }
}

function slider(name) {
  const { least_deg: least, most_deg: most, positive } = facts.servos?.[name] ?? { least_deg: -90, most_deg: 90 };
  const line = document.createElement("label");
  line.className = "slider";
  line.dataset.servo = name;
  line.innerHTML =
    '<span class="name"></span><span class="rail">' +
    `<input type="range" min="${least}" max="${most}" step="0.1"><u></u></span><output></output>` +
    `<span class="ends"><span>${least}°</span><em></em><span>${most}°</span></span>`;
  line.querySelector(".name").textContent = spoken(name);
  line.querySelector(".ends em").textContent = positive ? `+ ${positive}` : "";
  const input = line.querySelector("input");
  return { name, line, input, mark: line.querySelector("u"), output: line.querySelector("output") };
}

customElements.define("face-jog", FaceJog);
