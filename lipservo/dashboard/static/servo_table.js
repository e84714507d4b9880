// How each servo is, with what to do about it; torque off and on, and a restart after a question.
import { getJson, postJson } from "./calls.js";
import { face, facts } from "./link.js";
import { escaped, shown, spoken, STILL, whyStill } from "./words.js";

const WARM_BELOW_DEGC = 10; // so near to its own limit a servo is marked
const EVERY_MS = 500;
const SURE_MS = 4000;
const HEAVY = 0.8; // of its stall torque
const WORDS = { limp: "limp", unconfirmed: "NOT confirmed limp", released: "let go, not confirmed", off: "switched off", waiting: "does not answer", cooling: "limp, resting", rebooting: "restarting", failed: "given up" };

const numbers = [
  ["heat", "temperature"],
  ["load", "load"],
  ["volts", "voltage"],
  ["amps", "current"],
  ["silent", "unanswered"], // questions, since the face was started
  ["reboots", "restarts"],
];
const HEAD =
  "<tr><th>servo</th><th>state</th>" +
  numbers.map(([, title]) => `<th class="number">${title}</th>`).join("") +
  "<th></th></tr>";

class FaceServoTable extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      `<div class="scroll"><table class="health"><thead>${HEAD}</thead><tbody></tbody></table></div>` +
      '<p class="said" role="status"></p>';
    this.body = this.querySelector("tbody");
    this.said = this.querySelector(".said");
    this.rows = new Map();
    this.isHere = true;
    this.look();
  }

  disconnectedCallback() {
    this.isHere = false;
  }

  /** Request the servos and show them, every EVERY_MS while the table is on the page. */
  async look() {
    try {
      this.tell((await getJson("/api/servos", 2000)).servos);
    } catch (error) {
      for (const row of this.rows.values()) row.set(null);
      this.say("warn", error.message);
    }
    if (this.isHere) setTimeout(() => this.look(), EVERY_MS);
  }

  /** Show servos in the order of the face's YAML, unknown ones at the end; make rows for new ones. */
  tell(servos) {
    const whyStopped = whyStill(face.status);
    if (whyStopped !== null) this.say("", whyStopped);
    else if (this.said.textContent === STILL) this.say("", "");
    if (!servos.length && whyStopped === null) this.say("warn", "No face has reported yet how its servos are.");
    else if (this.said.dataset.tone === "warn") this.say("", "");
    const order = Object.keys(facts.servos ?? {});
    const place = ({ name }) => (order.indexOf(name) + order.length + 1) % (order.length + 1);
    for (const servo of servos.toSorted((a, b) => place(a) - place(b))) {
      if (!this.rows.has(servo.name)) this.rows.set(servo.name, new Row(this, servo.name));
      this.rows.get(servo.name).set(servo);
    }
  }

  say(tone, text) {
    this.said.dataset.tone = tone;
    this.said.textContent = text;
  }
}

/** One servo: its line, and under it what is wrong and what helps. */
class Row {
  constructor(table, name) {
    this.table = table;
    this.name = name;
    this.line = document.createElement("tr");
    this.line.dataset.servo = name;
    const { id, model } = facts.servos?.[name] ?? {};
    this.line.innerHTML =
      `<td class="name">${escaped(spoken(name))}<small>${id ?? ""}</small></td><td class="state"></td>` +
      numbers.map(([name, title]) => `<td class="number ${name}" data-title="${title}"></td>`).join("") +
      '<td><div class="buttons"><button type="button" class="act torque"></button>' +
      '<button type="button" class="act reboot">Reboot</button></div></td>';
    this.line.querySelector(".name").title = model ?? "";
    this.remedy = document.createElement("tr");
    this.remedy.className = "remedy";
    this.remedy.hidden = true;
    this.remedy.innerHTML = '<td colspan="9"></td>';
    table.body.append(this.line, this.remedy);
    this.torque = this.line.querySelector(".torque");
    this.reboot = this.line.querySelector(".reboot");
    this.torque.addEventListener("click", () => this.ask(this.isOn ? "off" : "on"));
    this.reboot.addEventListener("click", () => this.confirm());
  }

  /** Show a servo's readings, buttons and remedies. one: of `/api/servos`; null: nothing is known now. */
  set(one) {
    const cell = (name) => this.line.querySelector(`.${name}`);
    const limits = facts.servos?.[this.name] ?? {};
    const known = one?.temperature_degc !== null && one !== null;
    const [word, tone] = stateWords(one);
    write(cell("state"), `<span class="pill" data-tone="${tone}">${escaped(word)}</span>`);
    const degc = one?.temperature_degc;
    const room = (limits.hottest_degc ?? 70) - (degc ?? 0);
    mark(cell("heat"), shown(degc, 0, "°C"), known && (room <= 0 ? "hot" : room < WARM_BELOW_DEGC ? "warm" : ""));
    const load = one?.load ?? null;
    mark(cell("load"), load === null ? "–" : shown(100 * load, 0, "%"), load > HEAVY ? "warm" : "");
    const volts = one?.voltage_v ?? null;
    // Simulated servos in memory have one supply for all models.
    const isOff = face.status?.port && volts !== null && (volts < limits.least_v || volts > limits.most_v);
    mark(cell("volts"), shown(volts, 1, "V"), isOff ? "off" : "");
    mark(cell("amps"), shown(one?.current_ma, 0, "mA"), "");
    mark(cell("silent"), shown(one?.n_unanswered, 0), "");
    mark(cell("reboots"), shown(one?.n_reboots, 0), "");
    this.isOn = Boolean(one?.torque_on);
    const label = this.isOn ? "Torque off" : "Torque on";
    if (this.torque.textContent !== label) this.torque.textContent = label;
    this.torque.disabled = this.reboot.disabled = one === null || whyStill(face.status) !== null;
    const lines = remedies(one);
    this.remedy.hidden = lines.length === 0;
    write(this.remedy.firstChild, lines.map((line) => `<div>${escaped(line)}</div>`).join(""));
  }

  /** At the first press ask, by the button's text; at a second within SURE_MS restart the servo. */
  confirm() {
    if (this.sure) return this.ask("reboot");
    this.sure = setTimeout(() => this.calm(), SURE_MS);
    this.reboot.textContent = "Reboot now?";
    this.reboot.classList.add("sure");
    this.table.say("", `While it restarts, ${spoken(this.name)} is limp for a moment. Press again to do it.`);
    return undefined;
  }

  calm() {
    clearTimeout(this.sure);
    this.sure = null;
    this.reboot.textContent = "Reboot";
    this.reboot.classList.remove("sure");
    this.table.say("", "");
  }

  /** Switch the servo off or on, or restart it, and say what came of it. what: off, on or reboot. */
  async ask(what) {
    this.calm();
    const words = { off: "goes limp", on: "holds again", reboot: "restarts" };
    try {
      await postJson(`/api/servos/${encodeURIComponent(this.name)}`, { action: what });
      this.table.say("good", `${spoken(this.name)} ${words[what]}.`);
    } catch (error) {
      this.table.say("bad", `${spoken(this.name)}: ${error.message}`);
    }
  }
}

/** [words, tone] of a servo's state. Pure. */
export function stateWords(one) {
  if (one === null || one.state === "unknown") return ["not known", "bad"];
  if (one.state === "limp") return [WORDS.limp, ""];
  if (one.state === "unconfirmed") return [WORDS.unconfirmed, "bad"];
  const isTold = one.n_unanswered !== null; // else the face has not spoken of its health yet
  if (isTold && one.heard === false) return ["never answered", "bad"];
  if (one.state === "driven") return one.torque_on === false ? ["limp", ""] : ["working", "good"];
  return [WORDS[one.state] ?? one.state, one.state === "failed" ? "bad" : "warn"];
}

/** What is wrong with a servo and what helps, a line each. Pure. */
export function remedies(one) {
  if (one === null) return [];
  const ails = [...(one.errors ?? []), ...(one.trouble ? [one.trouble] : [])];
  return ails.map(({ meaning, remedy }) => `${capital(meaning)}. What helps: ${remedy}.`);
}

function capital(text) {
  return text[0].toUpperCase() + text.slice(1);
}

function write(cell, markup) {
  if (cell.innerHTML !== markup) cell.innerHTML = markup;
}

function mark(cell, text, tone) {
  if (cell.textContent !== text) cell.textContent = text;
  for (const each of ["hot", "warm", "off"]) cell.classList.toggle(each, tone === each);
}

customElements.define("face-servo-table", FaceServoTable);
