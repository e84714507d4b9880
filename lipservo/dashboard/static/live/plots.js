// The last minute in plots: lips, one joint, its servo, delay. ECharts, which NiceGUI ships, is loaded
// when they are opened; samples are kept from the page's beginning on.
import { face, onFrame, onHello, onStatus } from "../link.js";
import { getJson } from "../calls.js";
import { shown, spoken } from "../words.js";
import { colour } from "./canvas.js";

const SPAN_S = 60;
const SAMPLE_S = 0.1;
const DRAW_MS = 500;
/** Heading, unit, and curves: name, colour, value of a sample for the joint that is chosen. */
const PLOTS = [
  ["Lip gap", "mm", [["wanted", "orange", wantedMm], ["reached", "blue", reachedMm]]],
  ["Joint", "°", [["goal", "orange", (sample, i) => sample.goalsDeg?.[i]], ["position", "blue", (sample, i) => sample.encodersDeg?.[i]]]],
  ["Temperature", "°C", [["temperature", "blue", (sample, i, name) => ofServo(sample, name)?.temperature_degc]]],
  ["Load", "%", [["load", "blue", (sample, i, name) => percent(ofServo(sample, name)?.load)]]],
  ["Mouth behind the sound", "ms", [["delay", "blue", (sample) => sample.status?.delay_ms]]],
];

class FacePlots extends HTMLElement {
  connectedCallback() {
    this.samples = [];
    this.lips = null;
    this.charts = [];
    this.innerHTML =
      '<details><summary>Lip gap, joints, temperature, load and delay</summary><p class="told" role="status"></p>' +
      '<label>Joint <select class="field"></select></label><div class="plots"></div></details>';
    const find = (selector) => this.querySelector(selector);
    [this.details, this.told, this.joint] = ["details", ".told", "select"].map(find);
    this.details.addEventListener("toggle", () => this.open());
    this.undo = [
      onHello((hello) => this.joint.replaceChildren(...hello.servos.map((name) => new Option(spoken(name), name)))),
      onFrame((frame) => this.take(frame)),
      onStatus(() => this.draw()),
    ];
    window.plots = this; // for tests
  }

  disconnectedCallback() {
    this.undo.forEach((each) => each());
    this.sizes?.disconnect();
    this.charts.forEach((each) => each.dispose());
  }

  take({ timeS, coefficients, goalsDeg, encodersDeg }) {
    keep(this.samples, { timeS, coefficients, goalsDeg, encodersDeg, status: face.status });
  }

  /** Load the library and what the calibration says of the lips, once, and draw. */
  async open() {
    if (!this.details.open || this.charts.length) return;
    this.told.textContent = "Loading the plots ...";
    // A face without a calibration has no gap that is reached.
    this.lips = await getJson("/api/calibration").then((told) => withSpread(told.lip_gap), () => null);
    try {
      const { echarts } = await import("nicegui-echart");
      const figures = PLOTS.map(([heading, unit, curves]) => figure(heading, unit, curves));
      this.querySelector(".plots").replaceChildren(...figures);
      this.charts = figures.map((each) => echarts.init(each.lastChild));
      this.sizes = new ResizeObserver(() => this.charts.forEach((each) => each.resize()));
      this.sizes.observe(this);
      this.told.textContent = "";
      this.draw();
    } catch (error) {
      this.told.textContent = `The plots could not be loaded (${error.message}). Reload the page.`;
    }
  }

  /** Draw all curves: seconds before now, to the right edge. */
  draw() {
    if (!this.details.open || !this.charts.length || !this.samples.length) return;
    const nowS = this.samples.at(-1).timeS;
    const name = this.joint.value;
    const names = face.hello?.servos ?? [];
    const known = { lips: this.lips, names };
    const [soft, line] = ["soft", "line"].map((each) => colour(this, each));
    this.charts.forEach((chart, n) => {
      const [, unit, curves] = PLOTS[n];
      chart.setOption({
        animation: false,
        grid: { left: 48, right: 14, top: 10, bottom: 24 },
        tooltip: { trigger: "axis", valueFormatter: (value) => shown(value ?? null, 1, unit) },
        xAxis: { type: "value", min: -SPAN_S, max: 0, axisLabel: { formatter: "{value} s", color: soft }, splitLine: { show: false } },
        yAxis: { type: "value", scale: true, axisLabel: { color: soft }, splitLine: { lineStyle: { color: line } } },
        series: curves.map(([curve, ink, value]) => ({
          name: curve, type: "line", showSymbol: false, color: colour(this, ink), lineStyle: { width: 1.5 },
          data: this.samples.map((sample) => [sample.timeS - nowS, value(sample, names.indexOf(name), name, known) ?? null]),
        })),
      });
    });
  }
}

/** With `spread_deg`, how far each joint turns in its poses; null stays null. */
function withSpread(lips) {
  const columns = lips?.servos.map((_, i) => lips.poses_deg.map((pose) => pose[i]));
  return lips && { ...lips, spread_deg: columns.map((all) => Math.max(...all) - Math.min(...all) || 1) };
}

/** Add a sample, a tenth of a second after the last at least, and drop those older than a minute. Changes `samples`. */
export function keep(samples, sample) {
  const last = samples.at(-1);
  if (last && sample.timeS < last.timeS) samples.length = 0; // the dashboard was started again
  else if (last && sample.timeS < last.timeS + SAMPLE_S - 1e-3) return samples;
  samples.push(sample);
  while (samples[0].timeS < sample.timeS - SPAN_S) samples.shift();
  return samples;
}

/**
 * The lip gap that joint angles show, in mm, estimated from the poses that the calibration gives to
 * likely faces: the mean of their gaps, weighted by nearness (Shepard, "A two-dimensional interpolation
 * function for irregularly-spaced data", 1968); null where an angle is not known. Pure.
 */
export function gapMm(lips, names, anglesDeg) {
  const known = lips.servos.map((name) => anglesDeg[names.indexOf(name)] ?? NaN);
  let [sum, weights] = [0, 0];
  lips.poses_deg.forEach((pose, n) => {
    const far = pose.reduce((total, deg, i) => total + ((deg - known[i]) / lips.spread_deg[i]) ** 2, 0);
    const weight = (far + 0.0006) ** -3;
    sum += weight * lips.gaps_mm[n];
    weights += weight;
  });
  return Number.isNaN(sum) ? null : sum / weights;
}

function wantedMm(sample) {
  return (sample.wantedMm ??= window.twin?.gapOf(sample.coefficients));
}

function reachedMm(sample, i, name, { lips, names }) {
  return lips && (sample.reachedMm ??= gapMm(lips, names, sample.encodersDeg));
}

function ofServo(sample, name) {
  return sample.status?.health?.find((each) => each.name === name);
}

function percent(share) {
  return share == null ? null : 100 * share;
}

/** A plot's place, with its heading and the names of its curves in their colours. */
function figure(heading, unit, curves) {
  const made = document.createElement("figure");
  const names = curves.map(([name, ink]) => `<i style="color: var(--${ink})">${name}</i>`).join(", ");
  made.innerHTML = `<figcaption><b>${heading}</b>, ${unit}: ${names}</figcaption><div role="img" aria-label="${heading} over the last minute"></div>`;
  return made;
}

customElements.define("face-plots", FacePlots);
