// Points, their 95 % ellipsoids and the simulated truth in parallel projection, rotated with the mouse. Loads nothing from a network.
const canvas = document.getElementById("map"), pen = canvas.getContext("2d"), statusLine = document.getElementById("status");
const sizes = document.getElementById("times"), data = JSON.parse(document.getElementById("data").textContent);
const bars = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
let azimuth, elevation, zoom, dragged = null, shown = -1;

function reset() { azimuth = data.azimuth; elevation = data.elevation; zoom = 1; }
function axes() {
  const ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
  return [[ca, sa, 0], [-sa * se, ca * se, ce], [sa * ce, -ca * ce, se]];
}
function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
function quadratic(a, C, b) {  // aᵀ C b of xx, xy, xz, yy, yz, zz
  return a[0] * (C[0] * b[0] + C[1] * b[1] + C[2] * b[2]) + a[1] * (C[1] * b[0] + C[3] * b[1] + C[4] * b[2])
    + a[2] * (C[2] * b[0] + C[4] * b[1] + C[5] * b[2]);
}
function outline(C, right, up) {  // of the ellipsoid of a covariance: half-axes and angle
  const a = quadratic(right, C, right), b = quadratic(right, C, up), c = quadratic(up, C, up);
  const mid = (a + c) / 2, off = Math.hypot((a - c) / 2, b);
  return [Math.sqrt(mid + off), Math.sqrt(Math.max(mid - off, 0)), 0.5 * Math.atan2(2 * b, a - c)];
}
function draw() {
  const wide = canvas.clientWidth, high = canvas.clientHeight, dense = window.devicePixelRatio || 1;
  canvas.width = wide * dense; canvas.height = high * dense;
  pen.setTransform(dense, 0, 0, dense, 0, 0);
  const [right, up, near] = axes(), scale = zoom * 0.42 * Math.min(wide, high) / data.radius;
  const at = p => {
    const q = [p[0] - data.centre[0], p[1] - data.centre[1], p[2] - data.centre[2]];
    return [wide / 2 + scale * dot(q, right), high / 2 - scale * dot(q, up), dot(q, near)];
  };
  const times = Number(new FormData(sizes).get("times")), size = data.radius_95 * times * scale;
  const trace = corners => {
    pen.beginPath();
    corners.forEach((p, i) => { const [x, y] = at(p); i ? pen.lineTo(x, y) : pen.moveTo(x, y); });
  };
  pen.strokeStyle = data.truth_colour; pen.fillStyle = "rgba(201,185,138,0.10)";
  for (const polygon of data.truth) {
    trace(polygon); pen.closePath(); pen.fill(); pen.lineWidth = 0.6; pen.stroke();
    trace(polygon.slice(0, 2)); pen.lineWidth = 2; pen.stroke();
  }
  const placed = data.points.map((point, i) => [at(point.p), point, i]).sort((a, b) => a[0][2] - b[0][2]);
  pen.font = "11px Helvetica, Arial, sans-serif";
  for (const [[x, y], point, i] of placed) {
    const [long, short, angle] = outline(point.cov, right, up), lit = i === shown;
    if (point.normal) {
      pen.beginPath(); pen.moveTo(x, y);
      pen.lineTo(x + data.normal * dot(point.normal, right), y - data.normal * dot(point.normal, up));
      pen.strokeStyle = data.stroke_colour; pen.lineWidth = 1; pen.stroke();
    }
    pen.beginPath();
    pen.ellipse(x, y, long * size, Math.max(short * size, 0.4), -angle, 0, 2 * Math.PI);
    pen.fillStyle = point.colour + (lit ? "88" : "40"); pen.fill();
    pen.strokeStyle = point.colour; pen.lineWidth = lit ? 2 : 1; pen.stroke();
    pen.beginPath(); pen.arc(x, y, 2, 0, 2 * Math.PI); pen.fillStyle = point.colour; pen.fill();
    pen.fillStyle = "#333"; pen.fillText(i + 1, x + 5, y - 5);
  }
  ["x", "y", "z"].forEach((name, i) => {
    const [x, y] = [48 + 30 * right[i], high - 48 - 30 * up[i]];
    pen.beginPath(); pen.moveTo(48, high - 48); pen.lineTo(x, y); pen.strokeStyle = "#555"; pen.lineWidth = 1; pen.stroke();
    pen.fillStyle = "#555"; pen.fillText(name, x + 0.25 * (x - 48) - 3, y + 0.25 * (y - high + 48) + 4);
  });
  const bar = bars.filter(b => b * scale <= 0.25 * wide).pop() || bars[0];
  pen.fillStyle = "#111"; pen.fillRect(wide - 24 - bar * scale, high - 24, bar * scale, 2);
  pen.textAlign = "right"; pen.fillText(bar + " mm", wide - 24, high - 30);
  pen.fillText(times > 1 ? `ellipsoids drawn ${times} times as large` : "ellipsoids in scale", wide - 24, high - 8);
  pen.textAlign = "left";
  return placed;
}
function report(event) {
  const box = canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
  let best = 12, found = -1;
  for (const [[px, py], , i] of draw()) {
    const far = Math.hypot(px - x, py - y);
    if (far < best) { best = far; found = i; }
  }
  if (found !== shown) { shown = found; draw(); }
  statusLine.textContent = found < 0 ? data.hint : data.points[found].text;
}
canvas.addEventListener("pointerdown", event => { dragged = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
canvas.addEventListener("pointerup", () => { dragged = null; });
canvas.addEventListener("pointercancel", () => { dragged = null; });
canvas.addEventListener("pointermove", event => {
  if (!dragged) return report(event);
  azimuth -= 0.01 * (event.clientX - dragged[0]);
  elevation = Math.max(-1.5, Math.min(1.5, elevation + 0.01 * (event.clientY - dragged[1])));
  dragged = [event.clientX, event.clientY];
  draw();
});
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  zoom = Math.max(0.2, Math.min(50, zoom * Math.exp(-0.001 * event.deltaY)));
  draw();
}, {passive: false});
canvas.addEventListener("dblclick", () => { reset(); draw(); });
sizes.addEventListener("change", () => draw());
window.addEventListener("resize", () => draw());
reset(); draw();
