// A recorded run: its trace as plots over time, scrubbed back and forth. While it is shown, twin,
// photograph and own robot show it in place of the live face. The file stays in the browser.

import { face } from "../link.js";
import { spoken } from "../words.js";
import { colour, fitted } from "../live/canvas.js";

const MOST_BYTES = 300e6;
const VERSION = 1;
const TEXT_FROM_PX = 12; // a phoneme that is drawn narrower than this has no letters

/**
 * {servos, timesS, phonemes, coefficients, sentDeg} of a trace's text: names, and a value for each tick.
 * Throws an Error with one line.
 */
export function readTrace(text) {
  const lines = text.split("\n").filter(Boolean);
  const head = parsed(lines[0]);
  if (head?.lipservo_trace !== VERSION) throw new Error(`it is no lipservo trace of version ${VERSION}`);
  const ticks = lines.slice(1).map(parsed).filter((each) => Array.isArray(each?.coefficients));
  if (ticks.length < 2) throw new Error("it holds no motion");
  const column = (name) => ticks.map((each) => each[name]);
  return {
    servos: head.servos, timesS: column("sound_s"), phonemes: column("phoneme"),
    coefficients: column("coefficients"), sentDeg: column("sent_deg"),
  };
}

function parsed(line) {
  try {
    return JSON.parse(line);
  } catch {
    return null; // a line that was cut
  }
}

class FaceTrace extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<div class="row"><label class="act">Open a trace <input type="file" accept=".jsonl,.gz" hidden></label>' +
      '<button type="button" class="act play" hidden>Play</button>' +
      '<button type="button" class="act live" hidden>Back to the live face</button>' +
      '<select class="field servo" aria-label="servo" hidden></select></div><p class="told hint" role="status">' +
      'A file of <code>lipservo replay talk.wav --trace talk.jsonl</code>.</p>' +
      '<div class="plots" hidden><canvas></canvas><input type="range" min="0" step="1" aria-label="time"></div>';
    const find = (selector) => this.querySelector(selector);
    [this.told, this.canvas, this.slider, this.servo] = [".told", "canvas", "[type=range]", ".servo"].map(find);
    find("[type=file]").addEventListener("change", (event) => this.open(event.target.files[0]));
    this.slider.addEventListener("input", () => this.at(Number(this.slider.value)));
    this.servo.addEventListener("change", () => this.draw());
    find(".play").addEventListener("click", () => this.play());
    find(".live").addEventListener("click", () => this.end());
    this.sizes = new ResizeObserver(() => this.draw());
    this.sizes.observe(this.canvas);
    window.tracePlayer = this;
  }

  disconnectedCallback() {
    this.sizes.disconnect();
    this.end();
  }

  /** Read a trace, .jsonl or .gz, and show its first tick. */
  async open(file) {
    cancelAnimationFrame(this.playing);
    try {
      if (file.size > MOST_BYTES) throw new Error(`more than ${MOST_BYTES / 1e6} MB`);
      const stream = /\.gz$/i.test(file.name) ? file.stream().pipeThrough(new DecompressionStream("gzip")) : file.stream();
      this.trace = readTrace(await new Response(stream).text());
      this.name = file.name;
      this.servo.replaceChildren(...this.trace.servos.map((name) => new Option(spoken(name), name)));
      for (const each of this.querySelectorAll("[hidden]:not([type=file])")) each.hidden = false;
      this.slider.max = this.trace.timesS.length - 1;
      this.at(0);
    } catch (error) {
      this.end();
      this.told.textContent = `${file.name} cannot be shown: ${error.message}`;
    }
  }

  /** Show tick n of the trace. */
  at(n) {
    this.n = n;
    this.slider.value = n;
    const { servos, timesS, coefficients, sentDeg, phonemes } = this.trace;
    const anglesDeg = (face.hello?.servos ?? []).map((name) => sentDeg[n][servos.indexOf(name)] ?? null);
    face.held = {
      coefficients: coefficients[n], expression: {}, goalsDeg: anglesDeg, encodersDeg: anglesDeg,
      phoneme: phonemes[n], servosGone: false, torqueOn: false,
    };
    this.told.textContent = `${this.name} at ${timesS[n].toFixed(2)} s, ${phonemes[n] ?? "silence"}: recorded, not the live face.`;
    this.draw();
  }

  /** Play from the present tick to the end, at the speed of the recording. */
  play() {
    cancelAnimationFrame(this.playing);
    const { timesS } = this.trace;
    const last = timesS.length - 1;
    if (this.n === last) this.at(0);
    const [fromS, beganMs] = [timesS[this.n], performance.now()];
    const step = () => {
      const nowS = fromS + (performance.now() - beganMs) / 1000;
      let n = this.n;
      while (n < last && timesS[n + 1] <= nowS) n += 1;
      if (n !== this.n) this.at(n);
      if (n < last) this.playing = requestAnimationFrame(step);
    };
    step();
  }

  end() {
    cancelAnimationFrame(this.playing);
    face.held = null;
    this.told.textContent = "The live face is shown.";
  }

  /** Draw the plots: gap between the lips, one servo's angle, phonemes, and the present tick. */
  draw() {
    if (!this.trace || !this.canvas.clientWidth) return;
    const { context, width, height } = fitted(this.canvas);
    context.clearRect(0, 0, width, height);
    const { timesS, phonemes, coefficients, sentDeg, servos } = this.trace;
    const x = (n) => ((timesS[n] - timesS[0]) / (timesS.at(-1) - timesS[0])) * width;
    const servo = servos.indexOf(this.servo.value);
    const gaps = coefficients.map((each) => window.twin?.gapOf?.(each) ?? 0);
    line(context, gaps, x, [18, height / 2 - 10], "mm between the lips", colour(this.canvas, "blue"), colour(this.canvas, "soft"));
    line(context, sentDeg.map((each) => each[servo]), x, [height / 2 + 12, height - 24], `° ${spoken(this.servo.value)}, as sent`, colour(this.canvas, "orange"), colour(this.canvas, "soft"));
    context.fillStyle = colour(this.canvas, "soft");
    context.textAlign = "center";
    for (let n = 0, from = 0; n <= phonemes.length; n += 1) {
      if (n < phonemes.length && phonemes[n] === phonemes[from]) continue;
      const wide = x(Math.min(n, phonemes.length - 1)) - x(from);
      if (phonemes[from] && phonemes[from] !== "SIL" && wide > TEXT_FROM_PX) {
        context.fillText(phonemes[from], x(from) + wide / 2, height - 6);
      }
      from = n;
    }
    context.fillStyle = colour(this.canvas, "ink");
    context.fillRect(x(this.n) - 0.75, 0, 1.5, height);
  }
}

/** Draw a curve of values between two heights, and above it their range and `name`. x: of tick n, px. */
function line(context, values, x, [top, bottom], name, stroke, ink) {
  const ends = (some) => [Math.min, Math.max].map((end) => some.reduce((a, b) => end(a, b))); // may be too many to spread
  const [least, most] = ends(values);
  const y = (value) => bottom - ((value - least) / (most - least || 1)) * (bottom - top);
  context.beginPath();
  const each = Math.ceil(values.length / (2 * context.canvas.clientWidth)); // of a long trace, the ends of every half pixel
  for (let n = 0; n < values.length; n += each) {
    for (const value of ends(values.slice(n, n + each))) context.lineTo(x(n), y(value));
  }
  context.strokeStyle = stroke;
  context.lineWidth = 1.5;
  context.stroke();
  context.font = "13px Roboto, sans-serif";
  context.fillStyle = ink;
  context.textAlign = "left";
  context.fillText(`${least.toFixed(1)} to ${most.toFixed(1)} ${name}`, 4, top - 4);
}

customElements.define("face-trace", FaceTrace);
