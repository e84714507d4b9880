// Where the face in a photograph is, set by hand: twenty dots that are dragged. Pure, but for the element.

/**
 * All points of a face, {name: [x, y]}: those set by hand, and the others placed by them, by the shift,
 * rotation and scale that fit them best to another face. known: the points of that face; set: those
 * set by hand. Least squares of similarity transforms of the plane.
 */
export function placed(known, set) {
  const names = Object.keys(set);
  if (!names.length) return { ...known };
  const mean = (points) => [0, 1].map((axis) => names.reduce((sum, name) => sum + points[name][axis], 0) / names.length);
  const [from, to] = [mean(known), mean(set)];
  let [along, across, square] = [0, 0, 0];
  for (const name of names) {
    const [px, py] = [known[name][0] - from[0], known[name][1] - from[1]];
    const [qx, qy] = [set[name][0] - to[0], set[name][1] - to[1]];
    along += px * qx + py * qy;
    across += px * qy - py * qx;
    square += px * px + py * py;
  }
  const [a, b] = square > 1e-9 ? [along / square, across / square] : [1, 0];
  return Object.fromEntries(
    Object.entries(known).map(([name, [x, y]]) => {
      const [px, py] = [x - from[0], y - from[1]];
      return [name, set[name] ?? [to[0] + a * px - b * py, to[1] + b * px + a * py]];
    }),
  );
}

/** Points of another face, moved to the middle of a picture and scaled to the size of a portrait's. */
export function centred(known, [width, height]) {
  const ear = known.left_ear[0] - known.right_ear[0];
  const scale = (0.42 * Math.min(width, height)) / ear;
  const [x, y] = known.nose_tip;
  return Object.fromEntries(
    Object.entries(known).map(([name, at]) => [
      name, [width / 2 + scale * (at[0] - x), 0.52 * height + scale * (at[1] - y)],
    ]),
  );
}

const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const words = (name) => name.replaceAll("_", " ");

/** A picture with dots on the points of a face; `points`: all of them, {name: [x, y]} in its pixels. */
class FacePoints extends HTMLElement {
  /** Begin with a picture, a canvas. known: the points of another face; set: points set already. */
  edit(picture, known, set = {}) {
    this.known = centred(known, [picture.width, picture.height]);
    this.set = { ...set };
    const dots = Object.keys(known)
      .map((name) => `<g data-point="${name}" tabindex="0" role="button" aria-label="${words(name)}">` +
        `<title>${words(name)}</title><circle class="touch"/><circle class="dot"/></g>`)
      .join("");
    this.innerHTML =
      '<p class="hint">Drag the outer corners of the eyes and the chin first: the others follow. ' +
      'Then the corners and edges of the lips. Left and right are the face\'s own.</p>' +
      `<div class="points-stage"><svg viewBox="-0.5 -0.5 ${picture.width} ${picture.height}">${dots}</svg></div>` +
      '<p class="hint point-name" aria-live="polite">&nbsp;</p>';
    this.querySelector(".points-stage").prepend(picture);
    this.svg = this.querySelector("svg");
    this.radius = Math.max(picture.width, picture.height) / 130;
    for (const dot of this.svg.querySelectorAll("g")) this.moves(dot);
    this.place();
  }

  /** Let a dot be moved: by dragging, or by arrow keys, with Shift ten pixels at a time. */
  moves(dot) {
    const name = dot.dataset.point;
    const put = (at) => {
      const { width, height } = this.svg.viewBox.baseVal;
      this.set[name] = [Math.min(width - 1, Math.max(0, at[0])), Math.min(height - 1, Math.max(0, at[1]))];
      this.place();
    };
    const tell = () => (this.querySelector(".point-name").textContent = words(name));
    dot.addEventListener("focus", tell);
    dot.addEventListener("pointerenter", tell);
    dot.addEventListener("pointerdown", (event) => {
      dot.setPointerCapture(event.pointerId);
      dot.focus();
      event.preventDefault();
    });
    dot.addEventListener("pointermove", (event) => {
      if (!dot.hasPointerCapture(event.pointerId)) return;
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
      put([at.x, at.y]);
    });
    dot.addEventListener("keydown", (event) => {
      const step = STEPS[event.key];
      if (!step) return;
      event.preventDefault();
      const by = event.shiftKey ? 10 : 1;
      put([0, 1].map((axis) => this.points[name][axis] + by * step[axis]));
    });
  }

  /** Compute all points from those set by hand, and draw the dots there. */
  place() {
    this.points = placed(this.known, this.set);
    for (const dot of this.svg.querySelectorAll("g")) {
      const name = dot.dataset.point;
      dot.toggleAttribute("data-set", name in this.set);
      for (const [at, circle] of dot.querySelectorAll("circle").entries()) {
        circle.setAttribute("cx", this.points[name][0]);
        circle.setAttribute("cy", this.points[name][1]);
        circle.setAttribute("r", at === 0 ? 3 * this.radius : this.radius);
      }
    }
  }
}

customElements.define("face-points", FacePoints);
