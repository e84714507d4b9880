// Sliders of the settings that may change while a face runs, and Save into its YAML.
import { getJson, patchJson } from "./calls.js";
import { facts, onStatus } from "./link.js";
import { isStopped } from "./words.js";

const EVERY_MS = 100;
/** name: [title, least, most, step, unit, what it does]; the order of the page. */
const SETTINGS = {
  strength: ["Strength", 0, 1.5, 0.05, "", "How far the mouth moves; 1 is as the speaker did. Lips still close."],
  stage: ["Stage", 0, 1, 0.05, "", "1 opens and rounds the mouth for viewers 3 m away."],
  smoothness: ["Smoothness", 0, 1, 0.05, "", "0 follows every sound; 1 is calm and blurs quick ones."],
  unit_share: ["AnimPhos", 0, 1, 0.05, "", "Share of recorded units in the motion; 0 is the expectation alone."],
  lookahead_ms: ["Look-ahead", 0, 1000, 10, "ms", "How much sound is heard before the mouth decides: better shapes, but later ones."],
  lip_gap_offset_mm: ["Lip gap", -3, 3, 0.1, "mm", "Below 0 closes lips that do not meet, above 0 eases lips that are pressed."],
  expression: ["Expression", 0, 1.5, 0.05, "", "Head, eyes, lids and brows: 0 keeps them still, 1 is as measured on people."],
};

const ONLY_AT_START = ["lookahead_ms"];

class FaceSettings extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<div class="sliders"></div><div class="row"><button type="button" class="act first save" disabled>' +
      'Save</button><span class="hint where"></span></div><p class="said" role="status"></p>';
    this.save = this.querySelector(".save");
    this.said = this.querySelector(".said");
    this.rows = new Map();
    this.wanted = {};
    this.save.addEventListener("click", () => this.keep());
    this.undo = onStatus((status) => this.tell(status));
  }

  disconnectedCallback() {
    this.undo();
  }

  /** Request whether the settings may be saved, and show into which file, or why not. Until the face
   * has told where its YAML is, that is not known. */
  async load() {
    const where = this.querySelector(".where");
    this.isAsking = true;
    try {
      const answer = await getJson("/api/settings");
      if (answer.config !== null) this.canSave = answer.can_save;
      where.textContent = answer.can_save
        ? `writes them into ${answer.config}, whole or not at all`
        : `Cannot be saved: ${answer.why_not}.`;
    } catch (error) {
      where.textContent = error.message;
    }
    this.isAsking = false;
  }

  /** Show the settings that a status has, making a slider for each new one. */
  tell(status) {
    if (status && this.canSave === undefined && !this.isAsking) this.load();
    const now = { ...status?.settings, ...status?.expression };
    const names = Object.keys(SETTINGS).filter((name) => name in now);
    if (isStopped(status) && !names.length && !this.rows.size) {
      this.say("", "The face is stopped: its settings are here once it is started.");
    } else if (status && !names.length && !this.rows.size) {
      this.say("warn", "The way in which this face moves has no settings (strategy " + `${status.strategy ?? "unknown"}).`);
    } else if (names.length && !this.rows.size) this.say("", "");
    const isAway = status === null || (isStopped(status) && !names.length);
    for (const name of names) {
      if (!this.rows.has(name)) this.rows.set(name, this.row(name, ONLY_AT_START.includes(name)));
      const row = this.rows.get(name);
      // A slider that was moved within the last second keeps its value; one whose setting only a
      // restart changes keeps it until it is saved.
      const isHeld = performance.now() - row.touchedMs < (row.atStart ? Infinity : 1000);
      if (!isHeld) row.show(now[name]);
    }
    for (const { input } of this.rows.values()) input.disabled = isAway;
    this.save.disabled = isAway || !this.canSave || this.isSaving || !this.rows.size;
  }

  /**
   * Make the slider of a setting, at its place in the order of SETTINGS; returns {line, input, show, ...}.
   * atStart: only a restart changes the setting.
   */
  row(name, atStart = false) {
    const [title, least, most, step, unit, what] = SETTINGS[name];
    const line = document.createElement("label");
    line.className = "setting";
    line.innerHTML =
      `<b>${title}</b><input type="range" name="${name}" min="${least}" max="${most}" step="${step}">` +
      `<output></output><small>${what}${atStart ? " Changes when the face is started again." : ""}</small>`;
    const places = Object.keys(SETTINGS).indexOf(name);
    const after = [...this.rows.keys()].filter((each) => Object.keys(SETTINGS).indexOf(each) < places);
    const before = after.length ? this.rows.get(after.at(-1)).line : null;
    if (before) before.after(line);
    else this.querySelector(".sliders").prepend(line);
    const input = line.querySelector("input");
    const output = line.querySelector("output");
    const row = { line, input, atStart, touchedMs: -Infinity };
    row.show = (value) => {
      row.value = Number(value); // the slider rounds it to its steps
      input.value = value;
      output.textContent = `${Number(value).toFixed(step < 1 ? 2 : 0)}${unit ? `\u202f${unit}` : ""}`;
    };
    input.addEventListener("input", () => {
      row.touchedMs = performance.now();
      row.show(Number(input.value));
      if (atStart) return;
      this.wanted[name] = Number(input.value);
      this.send();
    });
    return row;
  }

  /** Send the values that were set, the newest of each, until none is left; one call at a time. */
  async send() {
    if (this.sending) return;
    this.sending = true;
    while (Object.keys(this.wanted).length) {
      const values = this.wanted;
      this.wanted = {};
      try {
        await patchJson("/api/settings", { values });
        this.say("", "");
      } catch (error) {
        this.say("bad", error.message);
        for (const name of Object.keys(values)) this.rows.get(name).touchedMs = -Infinity;
      }
      await new Promise((resolve) => setTimeout(resolve, EVERY_MS));
    }
    this.sending = false;
  }

  /** Set all values and write them into the face's YAML. */
  async keep() {
    const values = Object.fromEntries([...this.rows].map(([name, row]) => [name, row.value]));
    this.isSaving = this.save.disabled = true;
    try {
      await patchJson("/api/settings", { values, save: true });
      this.say("good", `Saved in ${facts.config}.`);
    } catch (error) {
      this.say("bad", error.message);
    }
    this.isSaving = this.save.disabled = false;
  }

  say(tone, text) {
    this.said.dataset.tone = tone;
    this.said.textContent = text;
  }
}

customElements.define("face-settings", FaceSettings);
