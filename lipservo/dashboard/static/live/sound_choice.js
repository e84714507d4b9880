// Loudspeaker, microphone, voice, language and volume, written into the face's own YAML; and a copy
// of a shipped face, which has none.
import { getJson, patchJson, postJson } from "../calls.js";
import { escaped } from "../words.js";

/** name in the YAML: [label, where its choices are in /api/sound, what an empty choice is called]. */
const CHOICES = {
  output: ["Loudspeaker", "outputs", "the computer's own"],
  input: ["Microphone", "inputs", "the computer's own"],
  synthesizer: ["Speech engine", "synthesizers", null],
  voice: ["Voice", "voices", "its own choice"],
  language: ["Language", "languages", "en-us"],
};

class FaceSound extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<details><summary>Voice, loudspeaker, microphone</summary><form class="choices"></form>' +
      '<p class="row"><button type="button" class="act copy" hidden>Save a copy of this face</button>' +
      '<span class="hint">Changes count when the face is started again.</span></p>' +
      '<p class="said" role="status"></p></details>';
    this.form = this.querySelector("form");
    this.copy = this.querySelector(".copy");
    this.said = this.querySelector(".said");
    this.querySelector("details").addEventListener("toggle", () => this.load(), { once: true });
    this.form.addEventListener("change", (event) => this.choose(event.target));
    this.form.addEventListener("submit", (event) => event.preventDefault());
    this.copy.addEventListener("click", () => this.save());
  }

  /** Request the choices, only when the list is opened, since that may start a speech engine; draw them. */
  async load() {
    try {
      const answer = await getJson("/api/sound", 20000);
      this.form.innerHTML = fields(answer);
      this.copy.hidden = !answer.is_shipped;
      if (answer.is_shipped) this.show("", "This face is shipped with lipservo: save a copy to change it.");
      for (const each of this.form.elements) each.disabled = answer.is_shipped;
    } catch (error) {
      this.show("bad", error.message);
    }
  }

  /** Write a changed choice into the face's YAML, and say so. */
  async choose(field) {
    const value = field.type === "range" ? Number(field.value) : field.value;
    try {
      const told = await patchJson("/api/sound", { [field.name]: value });
      this.show("good", `Saved in ${told.in}.`);
      if (field.name === "synthesizer") await this.load();
    } catch (error) {
      this.show("bad", error.message);
    }
  }

  async save() {
    try {
      const told = await postJson("/api/copy");
      this.show("good", `Saved as ${told.file}. Start it: ${told.command}`);
      this.copy.hidden = true;
    } catch (error) {
      this.show("bad", error.message);
    }
  }

  show(tone, text) {
    this.said.dataset.tone = tone;
    this.said.textContent = text;
  }
}

/** The form's fields, as HTML. told: the answer of /api/sound. Pure. */
export function fields(told) {
  const selects = Object.entries(CHOICES).map(([name, [label, from, none]]) => {
    const chosen = told.chosen[name] ?? "";
    const there = told[from];
    const names = [...(none === null ? [] : [""]), ...there, ...(chosen && !there.includes(chosen) ? [chosen] : [])];
    const options = names.map(
      (each) => `<option value="${escaped(each)}"${each === chosen ? " selected" : ""}>${escaped(each || none)}</option>`,
    );
    return `<label>${label}<select class="field" name="${name}">${options.join("")}</select></label>`;
  });
  const volume =
    `<label>Volume<input type="range" name="volume" min="0" max="1" step="0.05" value="${Number(told.chosen.volume)}"></label>`;
  return selects.join("") + volume;
}

customElements.define("face-sound", FaceSound);
