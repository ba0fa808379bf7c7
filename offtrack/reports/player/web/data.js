// The playback's table and numbers, unpacked; a run answers which row, picture or value belongs to a time.

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

const KINDS = { f4: Float32Array, i2: Int16Array };
const numbers = (buffer, place) => new KINDS[place.kind](buffer, place.at, place.count);

// A number with this many digits; zero has no sign.
function fixed(value, digits) {
  const text = value.toFixed(digits);
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text;
}

// Index of the last of the rising values that is at most x; 0 if none is.
function lastAtMost(values, x) {
  let low = 0, high = values.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (values[middle] <= x) low = middle; else high = middle - 1;
  }
  return low;
}

class Run {
  constructor(table, buffer, pictures) {
    Object.assign(this, { name: table.name, link: table.link, peak: table.peak, bodies: table.bodies, trails: table.trails,
                          estimated: table.estimated, spans: table.spans, cameras: table.cameras });
    this.columns = new Map();
    this.units = new Map();
    this.meanings = new Map();
    for (const signal of table.signals) {
      this.columns.set(signal.name, numbers(buffer, signal.values));
      this.units.set(signal.name, signal.unit);
      this.meanings.set(signal.name, signal.meaning);
    }
    this.time = this.columns.get("time") || new Float32Array(0);
    this.lines = table.lines.map((line) => ({ ...line, points: numbers(buffer, line.points) }));
    this.setPictures(table.pictures, buffer, pictures);
  }

  setPictures(table, buffer, pictures) {
    const strokes = numbers(buffer, table.strokes);
    let at = 0;
    this.pictures = table.times.map((time, k) => {
      const count = table.counts[k];
      const picture = { time, base64: pictures[table.first + k], caption: table.captions ? table.captions[k] : "",
                        strokes: strokes.subarray(4 * at, 4 * (at + count)), lines: table.lines ? table.lines[k] : [] };
      at += count;
      return picture;
    });
    this.pictureTimes = table.times;
  }

  // Pictures of a run that goes on.
  addPictures(pictures) {
    for (const { strokes, ...picture } of pictures) this.pictures.push({ ...picture, strokes: Int16Array.from(strokes) });
    this.pictureTimes = this.pictures.map((picture) => picture.time);
  }

  get rows() { return this.time.length; }
  get end() { return this.rows ? this.time[this.rows - 1] : 0; }

  row(t) { return lastAtMost(this.time, t + 1e-4); }

  has(signal) { return this.columns.has(signal); }

  value(signal, row) { const c = this.columns.get(signal); return c ? c[row] : NaN; }

  // The newest value up to a row, at most ten seconds old.
  latest(signal, row) {
    const column = this.columns.get(signal);
    if (!column) return NaN;
    for (let k = row; k >= 0 && this.time[row] - this.time[k] < 10; k--) if (!Number.isNaN(column[k])) return column[k];
    return NaN;
  }

  // True if a signal has no value up to a row, but one later.
  isYetToCome(signal, row) {
    const first = this.columns.get(signal).findIndex((value) => !Number.isNaN(value));
    return first > row;
  }

  // x, y and heading of a body.
  pose(body, row) { return this.bodies[body].pose.map((signal) => this.columns.get(signal)[row]); }

  // A point of a body on the ground.
  place(body, point, row) {
    const [x, y, psi] = this.pose(body, row), c = Math.cos(psi), s = Math.sin(psi);
    return [x + c * point[0] - s * point[1], y + s * point[0] + c * point[1]];
  }

  trailPoint(trail, row) {
    return trail.body >= 0 ? this.place(trail.body, trail.point, row) : trail.signals.map((name) => this.columns.get(name)[row]);
  }

  // Distance that the first body has driven, over the rows.
  get stations() {
    if (!this.driven || this.driven.length !== this.rows) {
      this.driven = new Float32Array(this.rows);
      for (let k = 1; k < this.rows; k++) {
        const [x0, y0] = this.pose(0, k - 1), [x1, y1] = this.pose(0, k);
        this.driven[k] = this.driven[k - 1] + Math.max(Math.hypot(x1 - x0, y1 - y0), 1e-6);
      }
    }
    return this.driven;
  }

  // Rows about `spacing` metres of travel apart, up to a row, which is the last.
  rowsEvery(spacing, last) {
    const stations = this.stations, rows = [];
    for (let k = 0, next = 0; k <= last; k++) if (stations[k] >= next) { rows.push(k); next = stations[k] + spacing; }
    if (rows.length && rows[rows.length - 1] !== last) rows.push(last);
    return rows;
  }

  // Points that the estimator states beside its body: [x, y, one sigma, heading] per estimate.
  estimatedPoints(last) {
    const path = this.estimated;
    if (!path || !this.has(path.offset)) return [];
    const points = [];
    for (let k = 0; k <= last; k++) {
      const offset = this.value(path.offset, k), health = this.value(path.health, k);
      if (Number.isNaN(offset) || health >= 2) continue;
      const psi = this.pose(path.body, k)[2];
      const [x, y] = this.place(path.body, [path.point[0], path.point[1] + offset], k);
      points.push([x, y, this.value(path.std, k) || 0, psi, k]);
    }
    return points;
  }

  // Values of a chart's curve over all rows, null where there is none.
  curve(curve) {
    const column = this.columns.get(curve.signal);
    if (!column) return null;
    const less = curve.less ? this.columns.get(curve.less) : null;
    const values = new Array(column.length);
    for (let k = 0; k < column.length; k++) {
      const value = curve.scale * (less ? column[k] - less[k] : column[k]);
      values[k] = Number.isNaN(value) ? null : value;
    }
    return values;
  }

  // Lower and upper edge of a band: two standard deviations to both sides of its base.
  band(curve) {
    const std = this.columns.get(curve.signal), base = curve.base ? this.columns.get(curve.base) : null;
    if (!std) return null;
    const low = new Array(std.length), high = new Array(std.length);
    for (let k = 0; k < std.length; k++) {
      const middle = base ? base[k] : 0, known = !Number.isNaN(middle) && !Number.isNaN(std[k]);
      low[k] = known ? curve.scale * (middle - 2 * std[k]) : null;
      high[k] = known ? curve.scale * (middle + 2 * std[k]) : null;
    }
    return [low, high];
  }
}

class Playback {
  static async read() {
    const text = (id) => document.getElementById(id).textContent;
    const table = JSON.parse(text("playback-table"));
    const buffer = await unpacked(text("playback-numbers"));
    const pictures = text("playback-pictures").split("\n");
    return new Playback(table, buffer, pictures);
  }

  constructor(table, buffer, pictures) {
    this.title = table.title;
    this.charts = table.charts;
    this.readings = table.readings;
    this.note = table.note;
    this.nearest = table.nearest;
    this.friction = table.friction;
    this.things = table.things.map((outline) => numbers(buffer, outline));
    this.road = table.road && { left: numbers(buffer, table.road.left), right: numbers(buffer, table.road.right) };
    this.all = table.runs.map((run) => new Run(run, buffer, pictures));
    this.together = table.together;
    this.runs = table.together ? this.all : [this.all[0]];
  }

  // Shows one of several runs that are not laid over each other.
  choose(k) { this.runs = [this.all[k]]; }

  get lines() { return this.runs.flatMap((run) => run.lines); }

  get end() { return Math.max(0, ...this.runs.map((run) => run.end)); }

  // Moment of the largest deviation of all runs that are shown.
  get peak() { return this.runs.reduce((worst, run) => (run.peak[1] > worst[1] ? run.peak : worst), [0, 0])[0]; }
}
