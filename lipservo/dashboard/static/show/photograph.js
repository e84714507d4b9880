// A photograph in place of the twin: the shipped one, or the user's own, which stays in the browser.

import { graphicsOf, readPacked } from "lipservo-twin";
import { refusal } from "../calls.js";
import { onDraw } from "../link.js";
import "./face_points.js";
import { makePhoto } from "./photo_view.js";
import { readWarp } from "./photo_warp.js";

const URL_OF = "/twin/photo";
const LONGEST_PX = 1280, LEAST_PX = 64, MOST_BYTES = 60e6, MOST_POINTS_BYTES = 1e6;
const BACKING = "rgb(226, 231, 236)"; // behind what is transparent, as in films
const KEPT = "lipservo-photograph", KEPT_POINTS = "lipservo-points ";

class FacePhoto extends HTMLElement {
  connectedCallback() {
    this.innerHTML =
      '<div class="row"><button type="button" class="act" data-show="twin">Twin</button>' +
      '<button type="button" class="act" data-show="photo">Photograph</button>' +
      '<label class="act own">Open your own <input type="file" accept="image/*,.json" multiple hidden></label>' +
      '<button type="button" class="act points" hidden>Move its points</button>' +
      '<button type="button" class="act keep" hidden>Save its points</button></div>' +
      '<p class="told hint" role="status"></p><div class="photo-editor" hidden><face-points></face-points>' +
      '<button type="button" class="act first done">Show this face</button></div>' +
      '<div class="photo-stage drawn" hidden></div>';
    const find = (selector) => this.querySelector(selector);
    [this.told, this.stage, this.editor] = [".told", ".photo-stage", ".photo-editor"].map(find);
    for (const button of this.querySelectorAll("[data-show]")) {
      button.addEventListener("click", () => this.choose(button.dataset.show));
    }
    find("input").addEventListener("change", (event) => {
      this.open([...event.target.files]);
      event.target.value = "";
    });
    this.addEventListener("dragover", (event) => event.preventDefault());
    this.addEventListener("drop", (event) => {
      event.preventDefault();
      this.open([...event.dataTransfer.files]);
    });
    find(".done").addEventListener("click", () => this.showOwn(find("face-points").points));
    find(".points").addEventListener("click", () => this.edit());
    find(".keep").addEventListener("click", () => this.save());
    this.undo = onDraw((frame) => this.apply(frame));
    window.photograph = this;
    this.choose(localStorage.getItem(KEPT) ?? "twin");
  }

  disconnectedCallback() {
    this.undo();
    this.view?.stop();
  }

  /** Show "twin" or "photo"; the shipped photograph where no other was opened. */
  async choose(what) {
    this.what = what;
    localStorage.setItem(KEPT, what);
    this.closest(".card").classList.toggle("shows-photo", what === "photo");
    this.stage.hidden = what !== "photo";
    if (what !== "photo") this.editor.hidden = true;
    for (const button of this.querySelectorAll("[data-show]")) {
      button.setAttribute("aria-pressed", button.dataset.show === what);
    }
    if (what !== "photo" || this.view || this.picture) return;
    try {
      this.say("Loading the photograph ...");
      const picture = await pictureOf(await (await answered(`${URL_OF}.jpg`)).blob());
      const warp = await answered(`${URL_OF}.bin`);
      if (this.picture) return; // one of the user's own was opened meanwhile
      await this.show(picture, warp);
      this.say("The twin's own picture, a photograph of nobody. Yours stays in this browser.");
    } catch (error) {
      if (!this.picture) this.say(`The photograph cannot be shown: ${error.message}`, "bad");
    }
  }

  /** A picture, and a file of its points where there is one. Says in one line what is wrong. */
  async open(files) {
    try {
      const told = files.find((each) => /\.json$/i.test(each.name));
      const file = files.find((each) => each !== told);
      if (!file) throw new Error("none of these files is a picture; open its points together with it");
      if (file.size > MOST_BYTES) throw new Error(`more than ${MOST_BYTES / 1e6} MB; give a smaller picture`);
      const picture = await pictureOf(file);
      this.shipped ??= await (await answered(`${URL_OF}.json`)).json();
      Object.assign(this, { picture, points: null, name: file.name, key: `${KEPT_POINTS}${file.name} ${file.size}` });
      for (const name of [".points", ".keep"]) this.querySelector(name).hidden = true;
      this.choose("photo");
      const points = told ? await pointsOf(told, picture.share) : keptPoints(this.key);
      if (points) await this.showOwn(points);
      else this.edit();
    } catch (error) {
      this.say(`${error.message}`, "bad");
    }
  }

  edit() {
    this.say(`Set the points of the face in ${this.name}.`);
    this.stage.hidden = true;
    this.editor.hidden = false;
    this.querySelector("face-points").edit(this.picture.canvas, this.shipped.points_px, this.points ?? {});
  }

  /** Show the user's picture as a face. points: {name: [x, y]} in its pixels; kept by the browser. */
  async showOwn(points) {
    const { canvas } = this.picture;
    this.points = points;
    try {
      this.say("Reading the face ...");
      const body = JSON.stringify({ size: [canvas.width, canvas.height], points_px: points });
      const headers = { "Content-Type": "application/json" };
      const warp = await answered(`${URL_OF}.bin`, { method: "POST", headers, body });
      localStorage.setItem(this.key, JSON.stringify(points));
      this.editor.hidden = true;
      this.stage.hidden = false;
      await this.show(this.picture, warp);
      this.say(`${this.name}: it stays in this browser; so do its points, until you save them beside it.`);
      for (const name of [".points", ".keep"]) this.querySelector(name).hidden = false;
    } catch (error) {
      this.edit();
      this.say(`${this.name}: ${error.message}`, "bad");
    }
  }

  /** Draw a picture in place of the one before. answer: the response with its packed warp. */
  async show({ canvas }, answer) {
    const warp = readWarp(readPacked, await answer.arrayBuffer());
    const graphics = graphicsOf(document.createElement("canvas"));
    if (!graphics) throw new Error("this browser has no WebGL");
    this.view?.stop();
    this.warp = warp;
    this.view = makePhoto(this.stage, canvas, warp, graphics);
    this.view.closeUp(window.twin?.isNear ?? false);
    this.view.show(this.last ?? { coefficients: warp.rest });
  }

  apply(frame) {
    this.last = frame;
    if (this.what === "photo") this.view?.show(frame);
  }

  /** Save the points as a file that `lipservo film --landmarks` reads, in pixels of the picture's file. */
  save() {
    const { share } = this.picture;
    const points = Object.entries(this.points).map(([name, at]) => [
      name, at.map((each, axis) => (axis < 2 ? Math.round(10 * ((each + 0.5) / share - 0.5)) / 10 : each / share)),
    ]);
    const text = JSON.stringify({ points_px: Object.fromEntries(points) });
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = this.name.replace(/\.\w+$/, "") + ".json";
    link.click();
    URL.revokeObjectURL(link.href);
  }

  say(text, tone = "") {
    this.told.textContent = text;
    this.told.dataset.tone = tone;
  }
}

/** {canvas, share}: upright, no larger than a page needs it; share: of the file's own pixels. */
async function pictureOf(blob) {
  const bitmap = await createImageBitmap(blob).catch(() => {
    throw new Error("it cannot be read as a picture; save it as JPEG or PNG");
  });
  const { width, height } = bitmap;
  if (Math.min(width, height) < LEAST_PX) {
    throw new Error(`${width} x ${height} pixels; a face needs ${LEAST_PX} at least`);
  }
  const share = Math.min(1, LONGEST_PX / Math.max(width, height));
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(width * share);
  canvas.height = Math.round(height * share);
  const paint = canvas.getContext("2d", { willReadFrequently: true });
  paint.fillStyle = BACKING;
  paint.fillRect(0, 0, canvas.width, canvas.height);
  paint.imageSmoothingQuality = "high";
  paint.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  bitmap.close();
  return { canvas, share: canvas.width / width };
}

/** The points in a JSON file, {name: [x, y, ...]}, in pixels of a picture scaled by `share`. Throws an Error. */
async function pointsOf(file, share) {
  if (file.size > MOST_POINTS_BYTES) throw new Error(`${file.name}: too large for the points of a face`);
  try {
    const { points_px: points } = JSON.parse(await file.text());
    const scaled = ([x, y, ...z]) => [(x + 0.5) * share - 0.5, (y + 0.5) * share - 0.5, ...z.map((each) => each * share)];
    return Object.fromEntries(Object.entries(points).map(([name, at]) => [name, scaled(at)]));
  } catch {
    throw new Error(`${file.name}: no points of a face; write {"points_px": {"nose_tip": [x, y], ...}}`);
  }
}

function keptPoints(key) {
  try {
    return JSON.parse(localStorage.getItem(key));
  } catch {
    return null;
  }
}

async function answered(path, request = {}) {
  const answer = await fetch(path, request);
  if (answer.ok) return answer;
  throw refusal(answer.status, await answer.json().catch(() => null));
}

customElements.define("face-photo", FacePhoto);
