// Points, their 95 % ellipsoids and the simulated truth.
const canvas = document.getElementById("map"), statusLine = document.getElementById("status");
const sizes = document.getElementById("times"), data = JSON.parse(document.getElementById("data").textContent);
const [play, step] = document.getElementById("film")?.elements ?? [null, {value: 1, max: 1}];
let shown = -1, timer = 0;

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
  const all = step.value === step.max, seen = thing => all || thing.step < step.value;
  for (const shape of data.shapes.filter(seen)) {
    pen.lineWidth = 2;
    for (const points of shape.lines) { line(points); pen.stroke(); }
    pen.lineWidth = 0.8;
    shape.ends.forEach((end, i) => { view.ellipsoid(end, shape.covs[i], size); pen.fill(); pen.stroke(); });
  }
  const ghost = (all && data.ghost || []).map(p => [...at(p), Math.max(p[3] * scale, 0.7)]), sides = [1, -1].map(side =>
    ghost.map(([x, y, , r], i) => {  // beside the axis, as far as the probe is thick there
      const [[a, b], [c, d]] = [ghost[Math.max(i - 1, 0)], ghost[Math.min(i + 1, ghost.length - 1)]];
      const far = side * r / Math.max(Math.hypot(c - a, d - b), 1e-9);
      return [x - far * (d - b), y + far * (c - a)];
    }));
  pen.fillStyle = data.ghost_colour + "a0"; pen.beginPath();
  [...sides[0], ...sides[1].reverse()].forEach(p => pen.lineTo(...p)); pen.fill();
  const placed = data.points.map((point, i) => [at(point.p), point, i]).filter(([, point]) => seen(point)).sort((a, b) => a[0][2] - b[0][2]);
  for (const [[x, y], point, i] of placed) {
    const lit = i === shown || !all && data.film[step.value - 1][1] === i;
    if (point.normal) {
      pen.beginPath(); pen.moveTo(x, y);
      pen.lineTo(x + data.normal * dot(point.normal, right), y - data.normal * dot(point.normal, up));
      pen.strokeStyle = point.stroke; pen.lineWidth = 1; pen.stroke();
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
function show() { statusLine.textContent = data.film[step.value - 1][0]; view.draw(); }
function pause() { clearInterval(timer); timer = 0; play.textContent = "Play"; }
if (play) {
  step.addEventListener("input", () => { pause(); show(); });
  play.addEventListener("click", () => {
    if (timer) return pause();
    if (step.value === step.max) { step.value = 1; show(); }
    play.textContent = "Pause";
    timer = setInterval(() => { step.stepUp(); show(); if (step.value === step.max) pause(); }, 500);
  });
}
sizes.addEventListener("change", view.draw);
view.draw();
