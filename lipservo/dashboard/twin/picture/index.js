// Loads the head and draws it, in three dimensions where the browser can.

import { loadAsset } from "./asset.js";
import { makeDrawing } from "./drawing.js";
import { makeHead } from "./head.js";
import { alike, lipGapMm, poseOf, restingPose } from "./pose.js";

export { readPacked } from "./asset.js";

/**
 * What a page sees of a twin, also as window.twin:
 * apply(frame): show a frame of static/frame.js at the next redraw, the newest only;
 * frames: how many were applied; last: the newest; drawn: how often it was redrawn since;
 * ready: the head is loaded and was drawn; kind: "webgl", "canvas" or null before that;
 * triangles: of the skin; pose: what is shown, as pose.js says it; gapMm: between its inner lips.
 */
export class TwinPicture {
  /** url: of the head. `loaded` is a promise that fails where the head cannot be loaded. */
  constructor(url) {
    this.frames = 0;
    this.drawn = 0;
    this.last = null;
    this.kind = null;
    this.triangles = 0;
    this.pose = null;
    this.gapMm = null;
    this.isNear = false;
    this._container = document.createElement("div");
    this._container.style.cssText = "position:absolute;inset:0";
    this._stopped = false;
    this.loaded = this._load(url);
    this.loaded.catch(() => {}); // whoever waits for it is told
  }

  /** Put the picture into an element of the page. */
  placeIn(element) {
    element.append(this._container);
  }

  get ready() {
    return this.drawn > 0;
  }

  /** Load the head, and begin to draw it: by WebGL, or simply where there is none. */
  async _load(url) {
    const loading = loadAsset(url);
    // A browser takes its time to begin with WebGL: it does so while the head is on its way.
    const graphics = graphicsOf(document.createElement("canvas"));
    const asset = await loading;
    if (this._stopped) return;
    this._asset = asset;
    if (!graphics) {
      this._drawSimply();
      return;
    }
    this._begin("webgl", (...given) => makeHead(...given, graphics));
    this._view.element.addEventListener("webglcontextlost", () => this._drawSimply());
  }

  apply(frame) {
    this.frames += 1;
    this.last = frame;
    if (!this._view) return;
    const pose = poseOf(frame, this._asset);
    if (!alike(pose, this.pose)) this._show(pose);
  }

  /** How far the inner lips are apart with these coefficients, mm; null before the head is there. */
  gapOf(coefficients) {
    return this._asset ? lipGapMm(this._asset, poseOf({ coefficients }, this._asset).targets) : null;
  }

  /** Look at the mouth from near, or at the whole head. The simple drawing stays as it is. */
  closeUp(isNear) {
    this.isNear = isNear;
    this._view?.closeUp?.(isNear);
  }

  stop() {
    this._stopped = true;
    this._view?.stop();
    this._container.remove();
  }

  _drawSimply() {
    if (this._stopped) return;
    this._view?.stop();
    this._begin("canvas", makeDrawing);
  }

  /** Make the view, and show the newest frame, or the face at rest. */
  _begin(kind, make) {
    this._view = make(this._container, this._asset, () => {
      this.drawn += 1;
    });
    this._view.closeUp?.(this.isNear);
    this.kind = kind;
    this.triangles = this._view.triangles;
    this._show(this.last ? poseOf(this.last, this._asset) : restingPose(this._asset));
  }

  _show(pose) {
    this.pose = pose;
    this.gapMm = lipGapMm(this._asset, pose.targets);
    this._view.show(pose);
  }
}

let early = null;

/** Begin to load a page's picture before the framework has made an element for it. */
export function beginPicture(url) {
  early = { url, picture: new TwinPicture(url) };
}

/** The picture that was begun, or a new one. */
export function pictureOf(url) {
  const begun = early?.url === url ? early.picture : null;
  early = null;
  return begun ?? new TwinPicture(url);
}

/**
 * Whether WebGL is there and drawn by a processor alone, {inSoftware}, or null. Asked of a canvas
 * of its own, as three.js writes errors to the console where it finds none.
 */
export function graphicsOf(canvas) {
  const context = canvas.getContext("webgl2");
  if (!context) return null;
  const names = context.getExtension("WEBGL_debug_renderer_info");
  const name = names ? context.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return { inSoftware: /swiftshader|llvmpipe|software/i.test(name) };
}
