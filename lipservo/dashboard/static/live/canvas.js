// A canvas that is as sharp as the screen and as large as its place.

/** The drawing context, scaled so that one unit is one CSS pixel, and the size in those. */
export function fitted(canvas) {
  const sharpness = window.devicePixelRatio || 1;
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  const columns = Math.round(width * sharpness);
  const rows = Math.round(height * sharpness);
  if (canvas.width !== columns || canvas.height !== rows) {
    canvas.width = columns;
    canvas.height = rows;
  }
  const context = canvas.getContext("2d");
  context.setTransform(sharpness, 0, 0, sharpness, 0, 0);
  return { context, width, height };
}

/** A colour of the stylesheet, by its name: dark where the page is. */
export function colour(canvas, name) {
  return getComputedStyle(canvas).getPropertyValue(`--${name}`);
}

/** The time at the right edge: it goes on smoothly between two frames, and stops with them. */
export function shownTimeS(frame, ageMs) {
  return frame.timeS + Math.min(ageMs, 100) / 1000;
}

/** Seconds from edge to edge: on a telephone fewer, so that letters fit. */
export function spanS(width) {
  return width < 600 ? 2 : LONGEST_SPAN_S;
}

export const LONGEST_SPAN_S = 4;
