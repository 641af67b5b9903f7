// Points, their 95 % ellipsoids and the simulated truth.
const canvas = document.getElementById("map"), statusLine = document.getElementById("status");
const sizes = document.getElementById("times"), data = JSON.parse(document.getElementById("data").textContent);
let shown = -1;

const view = orbit(canvas, data, paint, (x, y) => {
  let best = 12, found = -1;
  for (const [[px, py], , i] of view.draw()) {
    const far = Math.hypot(px - x, py - y);
    if (far < best) { best = far; found = i; }
  }
  if (found !== shown) { shown = found; view.draw(); }
  statusLine.textContent = found < 0 ? data.hint : data.points[found].text;
});
function paint({pen, scale, right, up, ink, at, line}) {
  const times = Number(new FormData(sizes).get("times")), size = data.radius_95 * times * scale;
  pen.strokeStyle = data.truth_colour; pen.fillStyle = "rgba(201,185,138,0.10)";
  for (const polygon of data.truth) {
    line(polygon, true); pen.fill(); pen.lineWidth = 0.6; pen.stroke();
    line(polygon.slice(0, 2)); pen.lineWidth = 2; pen.stroke();
  }
  pen.strokeStyle = data.shape_colour; pen.fillStyle = data.shape_colour + "30";
  for (const shape of data.shapes) {
    pen.lineWidth = 2;
    for (const points of shape.lines) { line(points); pen.stroke(); }
    pen.lineWidth = 0.8;
    shape.ends.forEach((end, i) => { view.ellipsoid(end, shape.covs[i], size); pen.fill(); pen.stroke(); });
  }
  if (data.ghost) {
    pen.strokeStyle = data.ghost_colour + "90"; pen.lineWidth = 4; line(data.ghost); pen.stroke();
    view.dot(data.ghost[data.ghost.length - 1], 3, data.ghost_colour);
  }
  const placed = data.points.map((point, i) => [at(point.p), point, i]).sort((a, b) => a[0][2] - b[0][2]);
  for (const [[x, y], point, i] of placed) {
    const lit = i === shown;
    if (point.normal) {
      pen.beginPath(); pen.moveTo(x, y);
      pen.lineTo(x + data.normal * dot(point.normal, right), y - data.normal * dot(point.normal, up));
      pen.strokeStyle = data.stroke_colour; pen.lineWidth = 1; pen.stroke();
    }
    view.ellipsoid(point.p, point.cov, size);
    pen.fillStyle = point.colour + (lit ? "88" : "40"); pen.fill();
    pen.strokeStyle = point.colour; pen.lineWidth = lit ? 2 : 1; pen.stroke();
    view.dot(point.p, 2, point.colour);
    pen.fillStyle = ink; pen.fillText(i + 1, x + 5, y - 5);
  }
  const note = times > 1 ? `ellipsoids drawn ${times} times as large` : "ellipsoids in scale";
  view.frame({x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1]}, note);
  return placed;
}
sizes.addEventListener("change", view.draw);
view.draw();
