// Small tools of the sections: markup that is made anew only where it changed, and mouths as SVG.

/**
 * Set an element's markup, and return whether it has changed since the last call: where it has not,
 * nothing is touched, so that what is typed and focused stays.
 */
export function draw(element, markup) {
  if (element.drawnAs === markup) return false;
  element.drawnAs = markup;
  element.innerHTML = markup;
  return true;
}

export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

const WIDTH_MM = 84;
const HEIGHT_MM = 64;

/** Both lips from the front, as an SVG. loops: outer and inner, [[x, y], ...] in mm, y upwards. Pure. */
export function mouth(loops, label, kind = "") {
  const [outer, inner] = loops.map((loop) => `M${loop.map(([x, y]) => `${x.toFixed(1)} ${(-y).toFixed(1)}`).join("L")}Z`);
  return (
    `<svg class="mouth ${kind}" viewBox="${-WIDTH_MM / 2} ${-HEIGHT_MM / 2 + 6} ${WIDTH_MM} ${HEIGHT_MM}" role="img" aria-label="${label}">` +
    (inner ? `<path class="inside" d="${inner}"/>` : "") +
    `<path class="lips" fill-rule="evenodd" d="${outer}${inner ?? ""}"/></svg>`
  );
}

/**
 * SVG of markers as a tracker sees them from the front. Pure.
 * seen: {names, points, loops} of the server; a point is null while its marker is not seen, and
 * loops are lists of points that are joined.
 */
export function markers(seen) {
  const points = seen.points.map((point) => (point === null ? null : [point[0], -point[1]]));
  const known = points.filter((point) => point !== null);
  if (!known.length) return '<p class="hint">No marker is seen.</p>';
  const [xs, ys] = [0, 1].map((axis) => known.map((point) => point[axis]));
  const [left, top] = [Math.min(...xs), Math.min(...ys)];
  const [width, height] = [Math.max(...xs) - left, Math.max(...ys) - top];
  const size = Math.max(width, height, 40);
  const margin = size * 0.08;
  const dot = size * 0.012;
  const lines = seen.loops
    .map((loop) => loop.map((n) => points[n]).filter((point) => point !== null))
    .filter((loop) => loop.length > 2)
    .map((loop) => `<path d="M${loop.map((point) => point.join(" ")).join("L")}Z"/>`)
    .join("");
  const dots = points
    .map((point, n) => (point === null ? "" : `<circle cx="${point[0]}" cy="${point[1]}" r="${dot}"><title>${seen.names[n]}</title></circle>`))
    .join("");
  return (
    `<svg class="markers" viewBox="${left - margin} ${top - margin} ${width + 2 * margin} ${height + 2 * margin}" role="img" ` +
    `aria-label="${known.length} of ${points.length} markers seen" style="stroke-width:${dot * 0.8}">${lines}${dots}</svg>`
  );
}

/** `about 4 minutes`, of minutes that are left. Pure. */
export function about(minutesLeft) {
  if (minutesLeft === null || minutesLeft === undefined) return "";
  if (minutesLeft < 1) return "less than a minute";
  const whole = Math.round(minutesLeft);
  return `about ${whole} ${whole === 1 ? "minute" : "minutes"}`;
}
