// The reconstructed probe and its contact, played in the time of the recording.
const replay = JSON.parse(document.getElementById("replay-data").textContent), frames = replay.frames;
const play = document.getElementById("replay-play"), place = document.getElementById("replay-time"), text = document.getElementById("replay-text");
const start = frames[0].t, span = Math.max(frames[frames.length - 1].t - start, 1e-6);
let playing = !matchMedia("(prefers-reduced-motion: reduce)").matches, shift = 0;

const scene = orbit(document.getElementById("replay"), replay, paint);
function now() { return start + (((Date.now() / 1000 + shift) % span) + span) % span; }  // reloading does not restart it
function index(time) {  // of the last frame that is not later
  let low = 0, high = frames.length - 1;
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    frames[middle].t <= time ? low = middle : high = middle - 1;
  }
  return low;
}
function tube(line) {  // outline of the probe seen from the viewer
  const points = line.map(scene.at), left = [], right = [];
  points.forEach(([x, y], k) => {
    const [a, b] = [points[Math.max(k - 1, 0)], points[Math.min(k + 1, points.length - 1)]];
    const [u, v] = [b[0] - a[0], b[1] - a[1]], r = scene.scale * replay.radius_mm[k] / (Math.hypot(u, v) || 1);
    left.push([x - v * r, y + u * r]); right.unshift([x + v * r, y - u * r]);
  });
  return [...left, ...right];
}
function paint({pen, at, scale, ink, near}) {
  const time = playing ? now() : Number(place.value), i = index(time), frame = frames[i], line = frame.p;
  for (let k = 0; k <= i; k++) if (frames[k].contact) scene.dot(frames[k].contact.p, 1.6, frames[k].contact.colour + "88");
  const contact = frame.contact, behind = contact && dot(contact.force, near) < 0;
  if (contact && behind) touch(contact);
  if (line) {
    const corners = tube(line);
    pen.beginPath(); corners.forEach(([x, y], k) => k ? pen.lineTo(x, y) : pen.moveTo(x, y)); pen.closePath();
    pen.fillStyle = frame.free ? "rgba(128,128,128,0.5)" : "rgba(86,160,211,0.75)"; pen.fill();
    pen.strokeStyle = "#2a6fa0"; pen.lineWidth = 1; pen.stroke();
  }
  if (contact && !behind) touch(contact);
  if (frame.true) {
    const [x, y] = at(frame.true);
    pen.beginPath(); pen.moveTo(x - 5, y - 5); pen.lineTo(x + 5, y + 5); pen.moveTo(x - 5, y + 5); pen.lineTo(x + 5, y - 5);
    pen.strokeStyle = ink; pen.lineWidth = 1.5; pen.stroke();
  }
  scene.frame(replay.axes, replay.note);
  if (playing) place.value = time;
  text.textContent = frame.text;

  function touch({p, cov, force, colour}) {
    scene.ellipsoid(p, cov, replay.radius_95 * scale);
    pen.fillStyle = colour + "40"; pen.fill(); pen.strokeStyle = colour; pen.lineWidth = 1; pen.stroke();
    const tail = p.map((value, j) => value - force[j]), [x, y] = at(p), [u, v] = at(tail);
    const far = Math.hypot(x - u, y - v) || 1, [a, b] = [(x - u) / far, (y - v) / far];
    pen.beginPath(); pen.moveTo(u, v); pen.lineTo(x, y);
    pen.moveTo(x - 8 * a - 4 * b, y - 8 * b + 4 * a); pen.lineTo(x, y); pen.lineTo(x - 8 * a + 4 * b, y - 8 * b - 4 * a);
    pen.strokeStyle = "#d55e00"; pen.lineWidth = 2; pen.stroke();
    scene.dot(p, 3, colour);
  }
}
function run() { if (playing) { scene.draw(); requestAnimationFrame(run); } }
function set(value) {
  playing = value; play.textContent = playing ? "Pause" : "Play";
  if (playing) { shift = Number(place.value) - start - Date.now() / 1000; requestAnimationFrame(run); }
}
play.addEventListener("click", () => set(!playing));
place.addEventListener("input", () => { set(false); scene.draw(); });
play.textContent = playing ? "Pause" : "Play";
scene.draw(); run();
