// The parts in perspective by WebGL 2: rotated by dragging or the arrow keys, zoomed by the wheel or + and -.
// Loads nothing from a network.
const scene = JSON.parse(document.getElementById("scene-data").textContent), canvas = document.getElementById("scene");
const gl = canvas.getContext("webgl2", {antialias: true, alpha: true, stencil: true});
let azimuth = scene.azimuth, elevation = scene.elevation, zoom = 1, dragged = null;

const decode = (text, type) => new type(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]], dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };

function corners(part) {  // point, normal and colour of each corner; faces that meet at an edge share no vertices
  const raw = decode(part.points, Uint16Array), index = decode(part.faces, Uint32Array), data = new Float32Array(9 * index.length);
  const p = Array.from({length: raw.length / 3}, (_, i) => [0, 1, 2].map(k => scene.low[k] + scene.step * raw[3 * i + k]));
  const normals = p.map(() => [0, 0, 0]), colours = part.colours && decode(part.colours, Uint8Array);
  for (let f = 0; f < index.length; f += 3) {
    const [a, b, c] = [0, 1, 2].map(k => p[index[f + k]]), normal = cross(minus(b, a), minus(c, a));
    for (let k = 0; k < 3; k++) for (let j = 0; j < 3; j++) normals[index[f + k]][j] += normal[j];
  }
  index.forEach((v, i) => {
    data.set(p[v], 9 * i); data.set(unit(normals[v]), 9 * i + 3);
    data.set(colours ? [0, 1, 2].map(j => colours[3 * v + j] / 255) : part.colour.map(c => c / 255), 9 * i + 6);
  });
  return data;
}

function shader(kind, text) { const s = gl.createShader(kind); gl.shaderSource(s, "#version 300 es\nprecision highp float;\n" + text); gl.compileShader(s); return s; }
function start() {
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `in vec3 p, n, c; uniform mat4 view; uniform float ground; uniform vec2 shade;
    out vec3 normal, colour; void main() { normal = n; colour = c;
    vec3 q = ground < 0.5 ? p : vec3(p.xy + shade * (p.z - ${scene.floor.toFixed(6)}), ${scene.floor.toFixed(6)});
    gl_Position = view * vec4(q, 1.0); }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `in vec3 normal, colour; uniform vec3 eye, light; uniform float ground; uniform vec4 flat_; out vec4 pixel;
    void main() { if (ground > 0.5) { pixel = flat_; return; }
      vec3 n = normalize(normal); if (dot(n, eye) < 0.0) n = -n;
      float sky = 0.5 + 0.5 * n.z, lit = max(dot(n, light), 0.0), shine = pow(max(dot(n, normalize(light + eye)), 0.0), 40.0);
      pixel = vec4(colour * (0.45 + 0.4 * sky + 0.45 * lit) + 0.15 * shine, 1.0); }`));
  gl.linkProgram(program); gl.useProgram(program);
  const at = name => gl.getUniformLocation(program, name);
  const arrays = [...scene.parts.map(corners), grid()].map(data => {
    const array = gl.createVertexArray();
    gl.bindVertexArray(array); gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    ["p", "n", "c"].forEach((name, i) => {
      const where = gl.getAttribLocation(program, name);
      if (where >= 0) { gl.enableVertexAttribArray(where); gl.vertexAttribPointer(where, 3, gl.FLOAT, false, 36, 12 * i); }
    });
    return [array, data.length / 9];
  });
  gl.enable(gl.DEPTH_TEST); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);

  function draw() {
    const dense = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * dense; canvas.height = canvas.clientHeight * dense;
    gl.viewport(0, 0, canvas.width, canvas.height); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    const ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
    const right = [ca, sa, 0], up = [-sa * se, ca * se, ce], eye = [sa * ce, -ca * ce, se], wide = canvas.width / canvas.height;
    const far = 2.75 * scene.radius / zoom / Math.min(1, wide), lens = 1 / Math.tan(0.33), near = 0.05 * scene.radius, back = far + 4 * scene.radius;
    const c = scene.centre, rows = [right, up, eye].map(a => [...a, -dot(a, c)]);
    const k = (near + back) / (near - back), l = 2 * near * back / (near - back);
    const m = [rows[0].map(v => v * lens / wide), rows[1].map(v => v * lens),
      rows[2].map((v, i) => k * (v - (i === 3 ? far : 0)) + (i === 3 ? l : 0)), rows[2].map((v, i) => -v + (i === 3 ? far : 0))];
    gl.uniformMatrix4fv(at("view"), true, m.flat());
    gl.uniform3fv(at("eye"), eye); gl.uniform3fv(at("light"), unit([0.5 * ca - 0.4 * sa, 0.5 * sa + 0.4 * ca, 0.9].map((v, i) => v + 0.4 * eye[i])));
    gl.uniform2f(at("shade"), -0.25, 0.2);
    const ink = getComputedStyle(canvas).color.match(/[\d.]+/g).slice(0, 3).map(v => v / 255);
    gl.enable(gl.BLEND); gl.depthMask(false); gl.uniform1f(at("ground"), 1);
    const last = arrays.length - 1;
    gl.uniform4f(at("flat_"), ...ink, 0.22); gl.bindVertexArray(arrays[last][0]); gl.drawArrays(gl.LINES, 0, arrays[last][1]);
    gl.enable(gl.STENCIL_TEST); gl.stencilFunc(gl.EQUAL, 0, 255); gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);  // each pixel once
    gl.uniform4f(at("flat_"), 0, 0, 0, 0.16);
    for (const [array, count] of arrays.slice(0, last)) { gl.bindVertexArray(array); gl.drawArrays(gl.TRIANGLES, 0, count); }
    gl.disable(gl.STENCIL_TEST);
    gl.depthMask(true); gl.disable(gl.BLEND); gl.uniform1f(at("ground"), 0);
    for (const [array, count] of arrays.slice(0, last)) { gl.bindVertexArray(array); gl.drawArrays(gl.TRIANGLES, 0, count); }
  }
  function turn(x, y) { azimuth -= x; elevation = Math.max(-1.5, Math.min(1.5, elevation + y)); draw(); }
  function magnify(times) { zoom = Math.max(0.3, Math.min(12, zoom * times)); draw(); }
  canvas.addEventListener("pointerdown", e => { dragged = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { dragged = null; });
  canvas.addEventListener("pointermove", e => {
    if (!dragged) return;
    const [x, y] = dragged; dragged = [e.clientX, e.clientY];
    turn(0.01 * (e.clientX - x), 0.01 * (e.clientY - y));
  });
  canvas.addEventListener("wheel", e => { e.preventDefault(); magnify(Math.exp(-0.001 * e.deltaY)); }, {passive: false});
  canvas.addEventListener("dblclick", () => { azimuth = scene.azimuth; elevation = scene.elevation; zoom = 1; draw(); });
  canvas.addEventListener("keydown", e => {
    const keys = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1]}, sizes = {"+": 1.2, "-": 1 / 1.2};
    if (e.key in keys) turn(...keys[e.key]); else if (e.key in sizes) magnify(sizes[e.key]); else return;
    e.preventDefault();
  });
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
}
function grid() {  // lines 10 mm apart on the floor
  const reach = 0.01 * Math.ceil(130 * scene.radius), data = [];
  for (let i = -reach; i <= reach + 1e-6; i += 0.01) for (const line of [[i, -reach, i, reach], [-reach, i, reach, i]])
    for (const k of [0, 2]) data.push(line[k] + scene.grid[0], line[k + 1] + scene.grid[1], scene.floor, 0, 0, 1, 0, 0, 0);
  return new Float32Array(data);
}
if (gl) start(); else document.getElementById("scene-note").textContent = "This browser draws no WebGL 2; the parts are in the files below.";
