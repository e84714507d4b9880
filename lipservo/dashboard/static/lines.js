// The lines that a face can speak, sounds and performances: played, stopped, brought in, thrown away.
import { getJson, postJson, refusal, remove } from "./calls.js";
import { onStatus } from "./link.js";
import { escaped, whyStill } from "./words.js";

const SURE_MS = 4000;
const AGAIN_MS = 5000;

class FaceLines extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<ul class="files"></ul><div class="upload"><p>Drop WAV, FLAC, OGG, MP3 or .perf files here, or</p>' +
      '<label class="act">choose files<input type="file" multiple hidden ' +
      'accept=".wav,.flac,.ogg,.mp3,.perf,audio/*"></label><progress max="1" hidden></progress></div>' +
      '<p class="said" role="status"></p>';
    this.list = this.querySelector(".files");
    this.bar = this.querySelector("progress");
    this.said = this.querySelector(".said");
    const drop = this.querySelector(".upload");
    const input = this.querySelector("input");
    input.addEventListener("change", () => this.bring([...input.files]).then(() => (input.value = "")));
    drop.addEventListener("dragover", (event) => {
      event.preventDefault();
      drop.classList.add("over");
    });
    drop.addEventListener("dragleave", () => drop.classList.remove("over"));
    drop.addEventListener("drop", (event) => {
      event.preventDefault();
      drop.classList.remove("over");
      this.bring([...event.dataTransfer.files]);
    });
    this.undo = onStatus((status) => this.tell(status));
    this.clock = setInterval(() => this.load(), AGAIN_MS);
    this.load();
  }

  disconnectedCallback() {
    this.undo();
    clearInterval(this.clock);
  }

  /** Request the list of files, and draw it where it has changed. */
  async load() {
    let files;
    try {
      files = filesOf(await getJson("/api/lines"));
    } catch (error) {
      this.away = error.message;
      return this.say("bad", error.message);
    }
    if (this.away && this.said.textContent === this.away) this.say("", "");
    this.away = "";
    const told = JSON.stringify(files);
    if (told === this.told) return undefined;
    this.told = told;
    this.list.replaceChildren(...files.map((file) => this.line(file)));
    if (!files.length) this.list.innerHTML = "<li>No sound files in the folder yet.</li>";
    return undefined;
  }

  /** The list item of a file: name, size, and buttons to play, silence and delete. */
  line(file) {
    const item = document.createElement("li");
    item.dataset.file = file.name;
    item.innerHTML =
      `<span class="name">${escaped(file.name)}</span><span class="size">${sizeWords(file)}</span>` +
      '<span class="buttons"><button type="button" class="act first play">Play</button>' +
      '<button type="button" class="act hush">Stop</button>' +
      '<button type="button" class="act danger delete">Delete</button></span>';
    const on = (name, act) => item.querySelector(name).addEventListener("click", act);
    on(".play", () => this.call(`It plays ${file.name}.`, () => postJson("/api/play", { file: file.name }, { patienceMs: 20000 })));
    on(".hush", () => this.call("What it says by itself is dropped; an agent that speaks goes on, until STOP.", () => postJson("/api/interrupt")));
    on(".delete", (event) => this.confirm(event.target, file.name));
    return item;
  }

  /** At the first press ask, by the button's text; at a second within SURE_MS delete the file. */
  confirm(button, name) {
    if (button.classList.contains("sure")) {
      return this.call(`${name} is deleted.`, () => remove(`/api/lines/${encodeURIComponent(name)}`));
    }
    button.classList.add("sure");
    button.textContent = "Delete it?";
    setTimeout(() => {
      button.classList.remove("sure");
      button.textContent = "Delete";
    }, SURE_MS);
    return undefined;
  }

  /** Call `ask`, say `done` or what went wrong, and load the list again. */
  async call(done, ask) {
    try {
      await ask();
      this.say("good", done);
    } catch (error) {
      this.say("bad", error.message);
    }
    await this.load();
  }

  /** Upload files one after another, with a progress bar; then say which were refused. */
  async bring(files) {
    this.bar.hidden = false;
    const refused = [];
    for (const file of files) {
      try {
        await sent(file, (share) => (this.bar.value = share));
      } catch (error) {
        refused.push(`${file.name}: ${error.message}`);
      }
    }
    this.bar.hidden = true;
    if (refused.length) this.say("bad", refused.join(" · "));
    else if (files.length) this.say("good", files.length === 1 ? `${files[0].name} is there.` : `${files.length} files are there.`);
    await this.load();
  }

  /** Mark the lines that are played now, and disable Play while the face is stopped. */
  tell(status) {
    const why = whyStill(status);
    for (const button of this.list.querySelectorAll(".play")) {
      button.disabled = why !== null;
      button.title = why ?? "";
    }
    for (const item of this.list.querySelectorAll("li[data-file]")) {
      item.classList.toggle("playing", status?.speaking?.replace(/ #\d+$/, "") === item.dataset.file);
    }
  }

  say(tone, text) {
    this.said.dataset.tone = tone;
    this.said.textContent = text;
  }
}

function filesOf(answer) {
  const files = answer.lines ?? answer.files ?? answer;
  return files.map((file) => (typeof file === "string" ? { name: file } : file));
}

function sizeWords(file) {
  const parts = [];
  if (file.duration_s !== undefined && file.duration_s !== null) parts.push(`${file.duration_s.toFixed(1)} s`);
  const bytes = file.n_bytes ?? file.size_bytes;
  if (bytes !== undefined) parts.push(bytes > 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.ceil(bytes / 1e3)} kB`);
  return parts.join(" · ");
}

/** Upload one file by XMLHttpRequest, since `fetch` reports no progress. progress: gets the share sent. */
function sent(file, progress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", `/api/lines?name=${encodeURIComponent(file.name)}`);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.upload.addEventListener("progress", (event) => progress(event.loaded / event.total));
    request.addEventListener("error", () => reject(new Error("The upload broke off.")));
    request.addEventListener("load", () => {
      if (request.status < 300) return resolve();
      let answer = null;
      try {
        answer = JSON.parse(request.responseText);
      } catch {
        // the answer has no words: only its status is shown
      }
      return reject(refusal(request.status, answer));
    });
    request.send(file);
  });
}

customElements.define("face-lines", FaceLines);
