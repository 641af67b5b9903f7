// A scene in parallel projection on a canvas: rotated by dragging or the arrow keys, zoomed by the wheel or + and -.
// Loads nothing from a network.
function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
function quadratic(a, C, b) {  // aᵀ C b of xx, xy, xz, yy, yz, zz
  return a[0] * (C[0] * b[0] + C[1] * b[1] + C[2] * b[2]) + a[1] * (C[1] * b[0] + C[3] * b[1] + C[4] * b[2])
    + a[2] * (C[2] * b[0] + C[4] * b[1] + C[5] * b[2]);
}

// Returns the view. `scene` has azimuth and elevation at the start [rad], centre and radius [mm], and how flat it lies; `paint(view)` draws
// into it, `hover(x, y)` reads the point under the pointer.
function orbit(canvas, scene, paint, hover) {
  const view = {pen: canvas.getContext("2d")}, bars = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
  let azimuth, elevation, zoom, dragged = null;

  view.draw = () => {
    const dense = window.devicePixelRatio || 1, pen = view.pen;
    view.wide = canvas.clientWidth; view.high = canvas.clientHeight;
    canvas.width = view.wide * dense; canvas.height = view.high * dense;
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    pen.font = "11px Helvetica, Arial, sans-serif";
    view.ink = getComputedStyle(canvas).color;
    const ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
    view.right = [ca, sa, 0]; view.up = [-sa * se, ca * se, ce]; view.near = [sa * ce, -ca * ce, se];
    view.scale = zoom * 0.42 * Math.min(view.wide, view.high * scene.flat) / scene.radius;
    return paint(view);
  };
  view.at = p => {  // right, down and near of a point [mm], in pixels
    const q = [p[0] - scene.centre[0], p[1] - scene.centre[1], p[2] - scene.centre[2]];
    return [view.wide / 2 + view.scale * dot(q, view.right), view.high / 2 - view.scale * dot(q, view.up), dot(q, view.near)];
  };
  view.line = (points, close) => {  // starts a path through points of the scene
    view.pen.beginPath();
    points.forEach((p, i) => { const [x, y] = view.at(p); i ? view.pen.lineTo(x, y) : view.pen.moveTo(x, y); });
    if (close) view.pen.closePath();
  };
  view.ellipsoid = (p, C, size) => {  // starts the outline of the ellipsoid of a covariance about a point
    const a = quadratic(view.right, C, view.right), b = quadratic(view.right, C, view.up), c = quadratic(view.up, C, view.up);
    const mid = (a + c) / 2, off = Math.hypot((a - c) / 2, b), [x, y] = view.at(p);
    const long = Math.sqrt(mid + off), short = Math.sqrt(Math.max(mid - off, 0));
    view.pen.beginPath();
    view.pen.ellipse(x, y, long * size, Math.max(short * size, 0.4), -0.5 * Math.atan2(2 * b, a - c), 0, 2 * Math.PI);
  };
  view.dot = (p, size, colour) => {
    const [x, y] = view.at(p);
    view.pen.beginPath(); view.pen.arc(x, y, size, 0, 2 * Math.PI); view.pen.fillStyle = colour; view.pen.fill();
  };
  view.frame = (axes, note) => {  // directions of the axes by name at the lower left, a scale bar and a note at the right
    const {pen, wide, high, ink} = view;
    pen.fillStyle = pen.strokeStyle = ink; pen.lineWidth = 1;
    for (const [name, axis] of Object.entries(axes)) {
      const [x, y] = [48 + 30 * dot(axis, view.right), high - 48 - 30 * dot(axis, view.up)];
      pen.beginPath(); pen.moveTo(48, high - 48); pen.lineTo(x, y); pen.stroke();
      pen.fillText(name, x + 0.25 * (x - 48) - 3, y + 0.25 * (y - high + 48) + 4);
    }
    const bar = bars.filter(b => b * view.scale <= 0.25 * wide).pop() || bars[0];
    pen.fillRect(wide - 24 - bar * view.scale, high - 24, bar * view.scale, 2);
    pen.textAlign = "right"; pen.fillText(bar + " mm", wide - 24, high - 30);
    pen.fillText(note, wide - 24, high - 8); pen.textAlign = "left";
  };
  function reset() { azimuth = scene.azimuth; elevation = scene.elevation; zoom = 1; }
  function turn(right, up) { azimuth -= right; elevation = Math.max(-1.5, Math.min(1.5, elevation + up)); view.draw(); }
  function magnify(times) { zoom = Math.max(0.2, Math.min(50, zoom * times)); view.draw(); }

  canvas.addEventListener("pointerdown", event => { dragged = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointerup", () => { dragged = null; });
  canvas.addEventListener("pointercancel", () => { dragged = null; });
  canvas.addEventListener("pointermove", event => {
    if (!dragged) {
      const box = canvas.getBoundingClientRect();
      return hover && hover(event.clientX - box.left, event.clientY - box.top);
    }
    const [x, y] = dragged;
    dragged = [event.clientX, event.clientY];
    turn(0.01 * (event.clientX - x), 0.01 * (event.clientY - y));
  });
  canvas.addEventListener("wheel", event => { event.preventDefault(); magnify(Math.exp(-0.001 * event.deltaY)); }, {passive: false});
  canvas.addEventListener("dblclick", () => { reset(); view.draw(); });
  canvas.addEventListener("keydown", event => {
    const keys = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1]}, sizes = {"+": 1.2, "-": 1 / 1.2};
    if (!(event.key in keys) && !(event.key in sizes)) return;
    event.preventDefault();
    event.key in keys ? turn(...keys[event.key]) : magnify(sizes[event.key]);
  });
  window.addEventListener("resize", () => view.draw());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view.draw());
  reset();
  return view;
}
