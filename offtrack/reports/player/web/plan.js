// The plan view: ground, road, swept path, paths as far as they are driven, bodies and wheels. Zoom and pan by mouse,
// touch and keys; what does not move is drawn once for each view.

// A line through points given as x, y, x, y, ….
function traced(points) {
  const line = new Path2D();
  for (let k = 0; k < points.length; k += 2) line.lineTo(points[k], points[k + 1]);
  return line;
}

class Plan {
  constructor(canvas, playback, onChange) {
    Object.assign(this, { canvas, playback, onChange });
    this.still = document.createElement("canvas");
    this.stillKey = "";
    this.scale = 1;
    this.centre = [0, 0];
    this.following = false;
    this.bounds = this.extent();
    this.friction = null;
    if (playback.friction) this.loadFriction(playback.friction);
    this.listen();
  }

  loadFriction(friction) {
    const image = new Image();
    image.onload = () => {
      const shades = document.createElement("canvas");
      [shades.width, shades.height] = [image.width, image.height];
      const context = shades.getContext("2d");
      context.drawImage(image, 0, 0);
      const pixels = context.getImageData(0, 0, image.width, image.height), [r, g, b] = palette().ice;
      for (let k = 0; k < pixels.data.length; k += 4) {
        const shade = pixels.data[k];
        pixels.data.set([r, g, b, 0.5 * shade], k);
      }
      context.putImageData(pixels, 0, 0);
      this.friction = shades;
      this.stillKey = "";
      this.onChange();
    };
    image.src = "data:image/png;base64," + friction.png;
  }

  // Smallest and largest x and y of all that moves.
  extent() {
    let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
    const add = (x, y) => { x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y); };
    for (const run of this.playback.runs)
      for (let k = 0; k < run.rows; k += Math.max(1, run.rows >> 9))
        run.bodies.forEach((body, b) => body.outline.forEach((corner) => add(...run.place(b, corner, k))));
    for (const line of this.playback.lines)
      for (let k = 0; k < line.points.length; k += 2) add(line.points[k], line.points[k + 1]);
    return x0 <= x1 ? [x0, y0, x1, y1] : [-10, -10, 10, 10];
  }

  fit() {
    const [x0, y0, x1, y1] = this.bounds, { width, height } = this.size();
    this.scale = Math.min(0.92 * width / Math.max(x1 - x0, 1e-3), 0.92 * height / Math.max(y1 - y0, 1e-3), this.playback.nearest);
    this.centre = [0.5 * (x0 + x1), 0.5 * (y0 + y1)];
    this.following = false;
    this.onChange();
  }

  follow() {
    const reach = 2 + 1.5 * this.playback.runs[0].bodies.reduce((sum, body) => sum + body.outline[0][0] - body.outline[2][0], 0);
    this.scale = Math.min(this.playback.nearest, Math.min(this.size().width, this.size().height) / reach);
    this.following = true;
    this.onChange();
  }

  // The whole course if the bodies are large enough to see in it, else the bodies' surroundings.
  begin() {
    this.fit();
    const length = this.playback.runs[0]?.bodies.reduce((sum, body) => sum + body.outline[0][0] - body.outline[2][0], 0) || 1;
    if (this.scale * length < 45) this.follow();
  }

  size() { return { width: this.canvas.clientWidth || 600, height: this.canvas.clientHeight || 400 }; }

  listen() {
    const canvas = this.canvas, pointers = new Map();
    canvas.addEventListener("pointerdown", (e) => { pointers.set(e.pointerId, [e.offsetX, e.offsetY]); canvas.setPointerCapture(e.pointerId); });
    const gone = (e) => pointers.delete(e.pointerId);
    canvas.addEventListener("pointerup", gone);
    canvas.addEventListener("pointercancel", gone);
    canvas.addEventListener("pointermove", (e) => {
      if (!pointers.has(e.pointerId)) return;
      const others = [...pointers].filter(([id]) => id !== e.pointerId).map(([, place]) => place);
      const [u, v] = pointers.get(e.pointerId);
      if (others.length) {
        const [a, b] = others[0];
        this.zoom(Math.hypot(e.offsetX - a, e.offsetY - b) / Math.max(8, Math.hypot(u - a, v - b)), 0.5 * (a + u), 0.5 * (b + v));
      } else this.pan(e.offsetX - u, e.offsetY - v);
      pointers.set(e.pointerId, [e.offsetX, e.offsetY]);
    });
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom(Math.exp(-0.0015 * e.deltaY), e.offsetX, e.offsetY); }, { passive: false });
    canvas.addEventListener("dblclick", () => this.fit());
    canvas.addEventListener("keydown", (e) => {
      const { width, height } = this.size();
      const action = { "+": () => this.zoom(1.25, width / 2, height / 2), "-": () => this.zoom(0.8, width / 2, height / 2) }[e.key];
      if (action) { action(); e.preventDefault(); e.stopPropagation(); }
    });
  }

  pan(du, dv) {
    this.following = false;
    this.centre = [this.centre[0] - du / this.scale, this.centre[1] + dv / this.scale];
    this.onChange();
  }

  zoom(factor, u, v) {
    const { width, height } = this.size(), at = this.world(u, v, width, height);
    this.scale = Math.min(Math.max(this.scale * factor, 0.02), 2000);
    if (!this.following) {
      const now = this.world(u, v, width, height);
      this.centre = [this.centre[0] + at[0] - now[0], this.centre[1] + at[1] - now[1]];
    }
    this.onChange();
  }

  world(u, v, width, height) { return [this.centre[0] + (u - width / 2) / this.scale, this.centre[1] - (v - height / 2) / this.scale]; }

  // Draws the state in which each run is at its row.
  draw(rows) {
    const { width, height } = this.size(), ratio = devicePixelRatio || 1;
    for (const canvas of [this.canvas, this.still])
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
        this.stillKey = "";
      }
    if (this.following && this.playback.runs[0].rows) {
      const run = this.playback.runs[0], body = run.bodies[0];
      this.centre = run.place(0, [body.outline[2][0], 0], rows[0]);
    }
    const key = [this.scale, ...this.centre, width, height, isDark(), this.playback.runs.map((run) => run.name + run.rows)].join();
    if (key !== this.stillKey) { this.drawStill(width, height, ratio); this.stillKey = key; }
    const context = this.canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.still, 0, 0);
    this.enter(context, width, height, ratio);
    this.outlines = this.playback.runs.map((run, k) => this.drawRun(context, run, rows[k], k));
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.drawScaleBar(context, height);
  }

  enter(context, width, height, ratio) {
    const k = this.scale * ratio;
    context.setTransform(k, 0, 0, -k, ratio * (width / 2 - this.scale * this.centre[0]), ratio * (height / 2 + this.scale * this.centre[1]));
    context.lineJoin = context.lineCap = "round";
  }

  inView(x, y, width, height, margin) {
    return Math.abs(x - this.centre[0]) < margin + 0.5 * width / this.scale && Math.abs(y - this.centre[1]) < margin + 0.5 * height / this.scale;
  }

  drawStill(width, height, ratio) {
    const context = this.still.getContext("2d"), colours = palette(), { road, things, lines, runs } = this.playback;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = colours.ground;
    context.fillRect(0, 0, this.still.width, this.still.height);
    this.enter(context, width, height, ratio);
    if (road) {
      context.fillStyle = context.strokeStyle = colours.road;
      context.lineWidth = 1 / this.scale;
      const { left, right } = road;
      for (let k = 0; k + 3 < left.length; k += 2) {
        if (!this.inView(left[k], left[k + 1], width, height, 30)) continue;
        const piece = traced([...left.subarray(k, k + 4), right[k + 2], right[k + 3], right[k], right[k + 1]]);
        piece.closePath();
        context.fill(piece);
        context.stroke(piece);
      }
    }
    if (this.friction) {
      const { low, high } = this.playback.friction;
      context.save();
      context.translate(low[0], high[1]);
      context.scale(1, -1);
      context.imageSmoothingEnabled = false;
      context.drawImage(this.friction, 0, 0, high[0] - low[0], high[1] - low[1]);
      context.restore();
    }
    context.strokeStyle = colours.ink;
    context.lineWidth = 1.2 / this.scale;
    for (const outline of things) context.stroke(traced(outline));
    for (const line of lines) {
      context.strokeStyle = colours[line.colour];
      context.globalAlpha = 0.55;
      context.lineWidth = line.width || 4 / this.scale;
      context.stroke(traced(line.points));
      context.globalAlpha = 1;
    }
    if (runs.length === 1) for (const run of runs) this.drawSwept(context, run, width, height);
  }

  drawSwept(context, run, width, height) {
    if (!run.rows) return;
    const rows = run.rowsEvery(Math.max(0.3, 2 / this.scale), run.rows - 1);
    context.fillStyle = palette().swept;
    context.beginPath(); // one path: overlapping bodies are not darker
    for (const row of rows) {
      const [x, y] = run.pose(0, row);
      if (!this.inView(x, y, width, height, 40)) continue;
      run.bodies.forEach((body, b) => {
        body.outline.forEach((corner, k) => context[k ? "lineTo" : "moveTo"](...run.place(b, corner, row)));
        context.closePath();
      });
    }
    context.fill("nonzero");
  }

  drawRun(context, run, row, index) {
    if (!run.rows) return [];
    const colours = palette(), several = this.playback.runs.length > 1, rows = run.rowsEvery(Math.max(0.05, 1.5 / this.scale), row);
    run.trails.forEach((trail, k) => {
      if (several && k) return; // one path a run: that of its first point
      context.strokeStyle = several ? colours[SERIES[index % SERIES.length]] : colours[trail.colour];
      context.lineWidth = 2 / this.scale;
      context.beginPath();
      for (const k of rows) { const [x, y] = run.trailPoint(trail, k); if (!Number.isNaN(x)) context.lineTo(x, y); }
      context.stroke();
    });
    if (!several && run.estimated) {
      context.fillStyle = colours.estimated;
      for (const [x, y] of run.estimatedPoints(row)) {
        context.beginPath();
        context.arc(x, y, 1.6 / this.scale, 0, 7);
        context.fill();
      }
    }
    const outlines = run.bodies.map((body, b) => this.drawBody(context, run, body, b, row, several ? colours[SERIES[index % SERIES.length]] : colours.ink));
    if (!several) run.trails.forEach((trail) => {
      if (trail.body < 0) return;
      const [x, y] = run.trailPoint(trail, row);
      context.beginPath();
      context.arc(x, y, 4.5 / this.scale, 0, 7);
      context.fillStyle = colours[trail.colour];
      context.strokeStyle = colours.paper;
      context.lineWidth = 1.5 / this.scale;
      context.fill();
      context.stroke();
    });
    return outlines;
  }

  drawBody(context, run, body, b, row, ink) {
    const colours = palette(), corners = body.outline.map((corner) => run.place(b, corner, row)), outline = traced(corners.flat());
    outline.closePath();
    context.globalAlpha = this.playback.runs.length > 1 ? 0.25 : 0.85; // of several runs none hides another
    context.fillStyle = colours.paper;
    context.fill(outline);
    context.globalAlpha = 1;
    context.fillStyle = ink;
    const [, , psi] = run.pose(b, row);
    for (const wheel of body.wheels) {
      const steer = wheel.steer ? run.latest(wheel.steer, row) || 0 : 0;
      context.save();
      context.translate(...run.place(b, [wheel.x, wheel.y], row));
      context.rotate(psi + steer);
      context.fillRect(-wheel.length / 2, -wheel.width / 2, wheel.length, wheel.width);
      context.restore();
    }
    context.strokeStyle = ink;
    context.lineWidth = 1.4 / this.scale;
    context.stroke(outline);
    return corners;
  }

  drawScaleBar(context, height) {
    const wanted = 110 / this.scale, power = 10 ** Math.floor(Math.log10(wanted));
    const length = [5, 2, 1].map((k) => k * power).find((k) => k <= wanted) || power;
    const colours = palette();
    context.strokeStyle = context.fillStyle = colours.soft;
    context.lineWidth = 1.5;
    context.stroke(new Path2D(`M14 ${height - 20}v6h${length * this.scale}v-6`));
    context.font = "12px system-ui, sans-serif";
    context.fillText(`${Number(length.toPrecision(1))} m`, 18, height - 20);
  }
}
