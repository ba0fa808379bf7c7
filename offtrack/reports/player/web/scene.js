// The 3-D view, by WebGL: ground with a grid, road, bodies and wheels as boxes, paths, the estimated path with a ribbon
// of its sigma, and the cameras' frusta. The ground is drawn level. Drag turns the view, Shift and drag moves it, the
// wheel goes nearer.

const VERTEX = `
attribute vec3 place; attribute vec3 normal; uniform mat4 view; uniform mat4 model; varying vec3 facing; varying vec3 at;
void main() { vec4 world = model * vec4(place, 1.0); at = world.xyz; facing = mat3(model) * normal; gl_Position = view * world; }`;
const FRAGMENT = `
precision highp float; uniform vec4 colour; uniform float lit; uniform vec4 grid; uniform float far; uniform vec3 eye;
varying vec3 facing; varying vec3 at;
void main() {
  float light = lit > 0.5 ? 0.62 + 0.38 * max(0.0, dot(normalize(facing), normalize(vec3(0.35, -0.5, 0.8)))) : 1.0;
  vec4 shown = vec4(colour.rgb * light, colour.a);
  if (grid.a > 0.0) {
    vec2 cell = abs(fract(at.xy / grid.a - 0.5) - 0.5) * grid.a;
    float fade = 1.0 - smoothstep(0.1 * far, 0.5 * far, distance(at.xy, eye.xy));
    float thin = 0.0016 * distance(at, eye);
    shown.rgb = mix(shown.rgb, grid.rgb, fade * (1.0 - smoothstep(0.0, thin + 0.02, min(cell.x, cell.y))));
  }
  gl_FragColor = vec4(shown.rgb * shown.a, shown.a);
}`;

const SIDES = [ // of a box: normal, four corners
  [[0, 0, 1], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], [[0, 0, -1], [0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
  [[1, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]], [[-1, 0, 0], [0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]],
  [[0, 1, 0], [0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]], [[0, -1, 0], [0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
];
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

// Product of two 4 x 4 matrices by columns.
function product(a, b) {
  const c = new Array(16);
  for (let j = 0; j < 4; j++) for (let i = 0; i < 4; i++) c[4 * j + i] = a[i] * b[4 * j] + a[4 + i] * b[4 * j + 1] + a[8 + i] * b[4 * j + 2] + a[12 + i] * b[4 * j + 3];
  return c;
}

const channels = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

class Scene {
  constructor(canvas, playback, onChange) {
    Object.assign(this, { canvas, playback, onChange, azimuth: -2.3, height: 0.5, moved: [0, 0] });
    const length = playback.runs[0] ? playback.runs[0].bodies.reduce((sum, body) => sum + body.outline[0][0] - body.outline[2][0], 0) : 10;
    this.size = Math.max(length, 0.5);
    this.distance = 1.5 * this.size;
    this.shapes = new Map();
  }

  // True once WebGL works here.
  open() {
    if (this.gl) return true;
    const gl = this.canvas.getContext("webgl", { antialias: true });
    if (!gl) return false;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return false;
    gl.useProgram(program);
    this.at = Object.fromEntries(["view", "model", "colour", "lit", "grid", "far", "eye"].map((name) => [name, gl.getUniformLocation(program, name)]));
    this.place = gl.getAttribLocation(program, "place");
    this.normal = gl.getAttribLocation(program, "normal");
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.gl = gl;
    this.listen();
    return true;
  }

  listen() {
    let last = null;
    this.canvas.addEventListener("pointerdown", (e) => { last = [e.clientX, e.clientY]; this.canvas.setPointerCapture(e.pointerId); });
    this.canvas.addEventListener("pointerup", () => { last = null; });
    this.canvas.addEventListener("pointermove", (e) => {
      if (!last) return;
      const [du, dv] = [e.clientX - last[0], e.clientY - last[1]];
      last = [e.clientX, e.clientY];
      if (e.shiftKey || e.buttons === 2) {
        const k = this.distance / this.canvas.clientHeight, s = Math.sin(this.azimuth), c = Math.cos(this.azimuth);
        this.moved = [this.moved[0] + k * (du * s + dv * c), this.moved[1] + k * (-du * c + dv * s)];
      } else this.turn(-0.006 * du, 0.006 * dv);
      this.onChange();
    });
    this.canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    this.canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.nearer(Math.exp(0.0012 * e.deltaY)); this.onChange(); }, { passive: false });
    this.canvas.addEventListener("dblclick", () => { this.moved = [0, 0]; this.onChange(); });
    this.canvas.addEventListener("keydown", (e) => {
      const action = { a: () => this.turn(0.1, 0), d: () => this.turn(-0.1, 0), w: () => this.turn(0, 0.1), s: () => this.turn(0, -0.1),
                       "+": () => this.nearer(0.85), "-": () => this.nearer(1.18) }[e.key];
      if (action) { action(); this.onChange(); e.preventDefault(); e.stopPropagation(); }
    });
  }

  turn(about, up) { this.azimuth += about; this.height = Math.min(1.55, Math.max(0.03, this.height + up)); }
  nearer(factor) { this.distance = Math.min(60 * this.size, Math.max(0.15 * this.size, this.distance * factor)); }

  // The view from a point that looks at the middle of the first run's vehicle.
  look(rows) {
    const run = this.playback.runs[0], b = Math.floor(run.bodies.length / 2), psi = run.rows ? run.pose(b, rows[0])[2] : 0;
    const [x, y] = run.rows ? run.place(b, [0, 0], rows[0]) : [0, 0], turned = this.azimuth, tall = 0.4 * run.bodies[0].heights[1];
    const target = [x + this.moved[0], y + this.moved[1], tall];
    const away = [Math.cos(turned) * Math.cos(this.height), Math.sin(turned) * Math.cos(this.height), Math.sin(this.height)];
    const eye = target.map((value, k) => value + this.distance * away[k]);
    const right = [-Math.sin(turned), Math.cos(turned), 0];
    const up = [away[1] * right[2] - away[2] * right[1], away[2] * right[0] - away[0] * right[2], away[0] * right[1] - away[1] * right[0]];
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const place = [right[0], up[0], away[0], 0, right[1], up[1], away[1], 0, right[2], up[2], away[2], 0, -dot(right, eye), -dot(up, eye), -dot(away, eye), 1];
    const near = 0.02 * this.distance, far = 60 * this.size + 4 * this.distance, f = 1.9, aspect = this.canvas.width / this.canvas.height;
    const lens = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
    return { view: product(lens, place), eye, far, target, psi };
  }

  draw(rows) {
    if (!this.open()) return;
    const gl = this.gl, ratio = Math.min(devicePixelRatio || 1, 2), colours = palette();
    const [width, height] = [Math.round(this.canvas.clientWidth * ratio), Math.round(this.canvas.clientHeight * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(...channels(colours.sky), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { view, eye, far, target } = this.look(rows);
    gl.uniformMatrix4fv(this.at.view, false, view);
    gl.uniform1f(this.at.far, far);
    gl.uniform3f(this.at.eye, ...eye);
    this.drawGround(target, far, colours);
    this.playback.runs.forEach((run, r) => {
      if (!run.rows) return;
      const several = this.playback.runs.length > 1, own = colours[SERIES[r % SERIES.length]];
      this.drawPaths(run, rows[r], several ? own : null, colours);
      run.bodies.forEach((body, b) => this.drawBody(run, body, b, rows[r], several ? own : b % 2 ? "#c9d3dd" : colours.true, colours));
      for (const camera of run.cameras) this.drawFrustum(run, camera, rows[r], colours);
    });
  }

  // One shape: triangles or lines, with normals; kept by its name until its content changes.
  shape(name, version, make, mode) {
    const gl = this.gl, kept = this.shapes.get(name);
    if (kept && kept.version === version) return kept;
    const { places, normals } = make();
    const shape = kept || { places: gl.createBuffer(), normals: gl.createBuffer() };
    for (const [buffer, values] of [[shape.places, places], [shape.normals, normals || new Array(places.length).fill(0)]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.DYNAMIC_DRAW);
    }
    Object.assign(shape, { version, mode, count: places.length / 3 });
    this.shapes.set(name, shape);
    return shape;
  }

  paint(shape, { colour, opacity = 1, model = IDENTITY, lit = false, grid = [0, 0, 0, 0] }) {
    const gl = this.gl;
    for (const [buffer, attribute] of [[shape.places, this.place], [shape.normals, this.normal]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(attribute);
      gl.vertexAttribPointer(attribute, 3, gl.FLOAT, false, 0, 0);
    }
    gl.uniformMatrix4fv(this.at.model, false, model);
    gl.uniform4f(this.at.colour, ...channels(colour), opacity);
    gl.uniform1f(this.at.lit, lit ? 1 : 0);
    gl.uniform4f(this.at.grid, ...grid);
    gl.drawArrays(shape.mode, 0, shape.count);
  }

  drawGround(target, far, colours) {
    const gl = this.gl, cell = 10 ** Math.round(Math.log10(0.5 * this.size)), reach = 0.5 * far, [x, y] = target.map((v) => cell * Math.round(v / cell));
    const ground = this.shape("ground", [x, y, reach].join(), () => ({ places: [x - reach, y - reach, 0, x + reach, y - reach, 0, x + reach, y + reach, 0, x - reach, y - reach, 0, x + reach, y + reach, 0, x - reach, y + reach, 0] }), gl.TRIANGLES);
    gl.depthMask(false); // what lies on the ground does not flicker with it
    this.paint(ground, { colour: colours.ground, grid: [...channels(colours.line), cell] });
    const { road, lines } = this.playback;
    if (road) this.paint(this.shape("road", "", () => ({ places: strip(road.left, road.right) }), gl.TRIANGLES), { colour: colours.road });
    lines.forEach((line, k) => this.paint(this.shape(`line ${k}`, "", () => ({ places: flat(line.points) }), gl.LINE_STRIP), { colour: colours[line.colour] }));
    gl.depthMask(true);
  }

  drawPaths(run, row, own, colours) {
    const gl = this.gl, rows = run.rowsEvery(0.02 * this.size, row), lift = 0.002 * this.size, wide = 0.006 * this.size;
    gl.depthMask(false);
    const points = run.estimatedPoints(row);
    if (!own && points.length > 1) {
      const edge = (side) => points.flatMap(([x, y, std, psi]) => { const half = Math.max(wide, 2 * std); return [x - side * half * Math.sin(psi), y + side * half * Math.cos(psi)]; });
      this.paint(this.shape(`ribbon ${run.name}`, points.length, () => ({ places: strip(edge(1), edge(-1), lift) }), gl.TRIANGLES), { colour: colours.estimated, opacity: 0.35 });
    }
    run.trails.forEach((trail, k) => {
      if (own && k) return;
      const line = rows.map((r) => run.trailPoint(trail, r)).filter(([x]) => !Number.isNaN(x));
      if (line.length < 2) return;
      const normal = (j) => { const a = line[Math.max(0, j - 1)], b = line[Math.min(line.length - 1, j + 1)], d = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1; return [-(b[1] - a[1]) / d, (b[0] - a[0]) / d]; };
      const edge = (side) => line.flatMap(([x, y], j) => { const [u, v] = normal(j); return [x + side * wide * u, y + side * wide * v]; });
      this.paint(this.shape(`trail ${run.name} ${k}`, row, () => ({ places: strip(edge(1), edge(-1), lift) }), gl.TRIANGLES), { colour: own || colours[trail.colour] });
    });
    gl.depthMask(true);
  }

  // Matrix of a body's frame in the world, tilted by its roll and pitch.
  model(run, b, row) {
    const [x, y, psi] = run.pose(b, row), tilt = run.bodies[b].tilt;
    const [roll, pitch] = tilt ? tilt.map((name) => run.value(name, row) || 0) : [0, 0];
    const [cr, sr, cp, sp, c, s] = [Math.cos(roll), Math.sin(roll), Math.cos(pitch), Math.sin(pitch), Math.cos(psi), Math.sin(psi)];
    return [c * cp, s * cp, -sp, 0, c * sp * sr - s * cr, s * sp * sr + c * cr, cp * sr, 0, c * sp * cr + s * sr, s * sp * cr - c * sr, cp * cr, 0, x, y, 0, 1];
  }

  drawBody(run, body, b, row, colour, colours) {
    const gl = this.gl, model = this.model(run, b, row), xs = body.outline.map((p) => p[0]), ys = body.outline.map((p) => p[1]);
    const [low, high] = [[Math.min(...xs), Math.min(...ys), body.heights[0]], [Math.max(...xs), Math.max(...ys), body.heights[1]]];
    const truck = run.bodies.length > 1 && b === 0;
    const boxes = truck ? [[[Math.max(low[0], high[0] - 2.3), low[1], low[2]], high], [low, [high[0], high[1], low[2] + 0.45]]] : [[low, high]];
    const shape = this.shape(`body ${run.name} ${b}`, "", () => boxed(boxes), gl.TRIANGLES);
    this.paint(shape, { colour, model, lit: true });
    body.wheels.forEach((wheel, k) => {
      const steer = wheel.steer ? run.latest(wheel.steer, row) || 0 : 0, c = Math.cos(steer), s = Math.sin(steer), radius = wheel.length / 2;
      const turned = [c, s, 0, 0, -s, c, 0, 0, 0, 0, 1, 0, wheel.x, wheel.y, radius, 1];
      const [x, y, psi] = run.pose(b, row), flatModel = [Math.cos(psi), Math.sin(psi), 0, 0, -Math.sin(psi), Math.cos(psi), 0, 0, 0, 0, 1, 0, x, y, 0, 1];
      this.paint(this.shape(`wheel ${run.name} ${b} ${k}`, "", () => rolled(radius, wheel.width), gl.TRIANGLES), { colour: colours.ink, model: product(flatModel, turned), lit: true });
    });
  }

  drawFrustum(run, camera, row, colours) {
    const gl = this.gl, X = camera.X_BC, reach = 0.25 * this.size;
    const place = (u, v, w) => [0, 1, 2].map((i) => X[i][0] * u + X[i][1] * v + X[i][2] * w + X[i][3]);
    const corners = [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => place(a * camera.half_width * reach, b * camera.half_height * reach, reach));
    const lines = [], faces = [], top = place(0, 0, 0);
    corners.forEach((corner, k) => { const next = corners[(k + 1) % 4]; lines.push(...top, ...corner, ...corner, ...next); faces.push(...top, ...corner, ...next); });
    const model = this.model(run, camera.body, row), name = `${run.name} ${camera.body}`;
    this.paint(this.shape(`frustum ${name}`, "", () => ({ places: lines }), gl.LINES), { colour: colours.fourth, model });
    gl.depthMask(false);
    this.paint(this.shape(`view ${name}`, "", () => ({ places: faces }), gl.TRIANGLES), { colour: colours.fourth, opacity: 0.1, model });
    gl.depthMask(true);
  }
}

// Triangles between two edges given as x, y, x, y, ….
function strip(left, right, z = 0) {
  const places = [];
  for (let k = 0; k + 3 < left.length; k += 2)
    places.push(left[k], left[k + 1], z, right[k], right[k + 1], z, left[k + 2], left[k + 3], z,
                right[k], right[k + 1], z, right[k + 2], right[k + 3], z, left[k + 2], left[k + 3], z);
  return places;
}

function flat(points) {
  const places = [];
  for (let k = 0; k < points.length; k += 2) places.push(points[k], points[k + 1], 0);
  return places;
}

// Triangles and normals of boxes from their low to their high corners.
function boxed(boxes) {
  const places = [], normals = [];
  for (const [low, high] of boxes)
    for (const [normal, ...corners] of SIDES)
      for (const k of [0, 1, 2, 0, 2, 3]) {
        places.push(...corners[k].map((end, i) => (end ? high[i] : low[i])));
        normals.push(...normal);
      }
  return { places, normals };
}

// A wheel about its own middle, its axis along y.
function rolled(radius, width) {
  const places = [], normals = [], count = 20;
  for (let k = 0; k < count; k++) {
    const [a, b] = [k, k + 1].map((j) => (2 * Math.PI * j) / count), h = width / 2;
    const [p, q] = [a, b].map((angle) => [radius * Math.cos(angle), radius * Math.sin(angle)]);
    const rim = [[p[0], -h, p[1]], [q[0], -h, q[1]], [q[0], h, q[1]], [p[0], -h, p[1]], [q[0], h, q[1]], [p[0], h, p[1]]];
    for (const corner of rim) { places.push(...corner); normals.push(corner[0] / radius, 0, corner[2] / radius); }
    for (const side of [-1, 1]) for (const corner of [[0, side * h, 0], [p[0], side * h, p[1]], [q[0], side * h, q[1]]]) { places.push(...corner); normals.push(0, side, 0); }
  }
  return { places, normals };
}
