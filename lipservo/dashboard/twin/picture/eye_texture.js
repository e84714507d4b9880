// An eyeball unrolled: from the pupil at the top to the back at the bottom.

const WIDTH = 512;
const HEIGHT = 512;

/** A canvas whose row is the angle from the pupil (0 to 180 degrees), and column the way round. */
export function eyeTexture(irisRadiusMm, radiusMm) {
  const canvas = document.createElement("canvas");
  canvas.width = WIDTH;
  canvas.height = HEIGHT;
  const paint = canvas.getContext("2d");
  const irisRow = (Math.asin(irisRadiusMm / radiusMm) / Math.PI) * HEIGHT;
  const rows = paint.createLinearGradient(0, 0, 0, HEIGHT);
  const at = (share, colour) => rows.addColorStop((share * irisRow) / HEIGHT, colour);
  at(0, "#0b0b0d");
  at(0.4, "#0b0b0d");
  at(0.44, "#4a5a4c");
  at(0.6, "#6f8b84");
  at(0.82, "#56737a");
  at(0.94, "#2c3c46");
  at(1.0, "#39454d");
  at(1.1, "#dcd6cf");
  at(1.5, "#ece7e1");
  at(2.6, "#e2d6cd");
  at(3.6, "#c9a79c");
  paint.fillStyle = rows;
  paint.fillRect(0, 0, WIDTH, HEIGHT);
  // Streaks of the iris: no two alike, and the same at every visit.
  for (let streak = 0; streak < 140; streak += 1) {
    const shade = Math.abs(Math.sin(streak * 12.9898) * 43758.5453) % 1;
    paint.strokeStyle = shade > 0.5 ? `rgba(190,205,190,${0.2 * shade})` : `rgba(20,30,35,${0.3 * shade})`;
    paint.lineWidth = 1 + 2 * shade;
    const column = (streak * WIDTH) / 140;
    paint.beginPath();
    paint.moveTo(column, irisRow * 0.45);
    paint.lineTo(column + 6 * (shade - 0.5), irisRow * (0.75 + 0.2 * shade));
    paint.stroke();
  }
  return canvas;
}
