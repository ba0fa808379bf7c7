// Charts over time, drawn by uPlot, that share their range, their cursor and the playhead.

const SERIES = ["true", "estimated", "third", "fourth", "fifth", "sixth"];
const DASHES = [6, 4];

class Charts {
  constructor(root, playback, onSeek) {
    Object.assign(this, { root, playback, onSeek, plots: [], byStation: false });
    this.sync = uPlot.sync("playback");
  }

  build() {
    this.plots.forEach((plot) => plot.destroy());
    this.root.replaceChildren();
    this.plots = this.playback.charts.map((chart) => this.plot(chart)).filter(Boolean);
    this.resize(); // once all are there the columns have their widths
    this.seek(this.now || 0);
  }

  // Draws the charts with new data; a chart that is zoomed stays so.
  renew() {
    const whole = this.plots.map((plot) => plot.scales.x.min <= plot.data[0][0] && plot.scales.x.max >= plot.data[0][plot.data[0].length - 1]);
    const fresh = this.playback.charts.map((chart) => this.content(chart)).filter(Boolean);
    if (fresh.length !== this.plots.length || fresh.some((one, k) => one.series.length !== this.plots[k].series.length)) { this.build(); return; }
    fresh.forEach((one, k) => this.plots[k].setData(one.data, whole[k]));
  }

  // x values of a run: time, or distance driven.
  axis(run) { return Array.from(this.byStation ? run.stations : run.time); }

  // Series, bands, colours of the legend and data of a chart; null if no run has its signals.
  content(chart) {
    const colours = palette(), several = this.playback.runs.length > 1, tables = [], series = [{}], bands = [], marks = [""];
    const named = { value: (plot, value, s, k) => this.shown(plot, s, k, chart), spanGaps: true };
    const add = (x, values, options) => {
      tables.push([x, values]);
      marks.push(options.colour || "");
      series.push({ ...named, ...options });
    };
    this.playback.runs.forEach((run, r) => {
      const x = this.axis(run);
      const curves = several ? chart.curves.filter((curve) => curve.style !== "band" && curve.style !== "dashed") : chart.curves;
      curves.forEach((curve, c) => {
        const colour = several ? colours[SERIES[r % SERIES.length]] : colours[curve.colour];
        const label = several ? `${run.name}${curves.length > 1 ? ": " + curve.label : ""}` : curve.label;
        if (curve.style === "band") {
          const edges = run.band(curve);
          if (!edges) return;
          const plain = { stroke: "transparent", width: 0, points: { show: false }, };
          edges.forEach((edge) => add(x, edge, { ...plain, label: "" }));
          bands.push({ series: [series.length - 1, series.length - 2], fill: colour + "33" });
          return;
        }
        const values = run.curve(curve);
        if (!values || !values.some((value) => value !== null)) return;
        const dots = curve.style === "dots";
        add(x, values, {
          label, colour, dots, stroke: colour, width: dots ? 0 : several && c ? 1 : 1.6, dash: curve.style === "dashed" || (several && c) ? DASHES : undefined,
          points: { show: dots, size: 3, fill: colour, stroke: colour, width: 0 }, paths: dots ? () => null : undefined,
        });
      });
    });
    if (!tables.length) return null;
    const shared = tables.every(([x]) => x === tables[0][0]);
    return { series, bands, marks, data: shared ? [tables[0][0], ...tables.map(([, values]) => values)] : uPlot.join(tables) };
  }

  plot(chart) {
    const content = this.content(chart), colours = palette();
    if (!content) return null;
    const { series, bands, marks, data } = content;
    const box = document.createElement("div");
    box.className = "chart";
    const heading = document.createElement("h3");
    heading.textContent = `${chart.title} [${chart.unit}]`;
    box.append(heading);
    this.root.append(box);
    const grid = { stroke: colours.line, width: 1 }, stroke = colours.soft, font = "12px system-ui, sans-serif";
    const plot = new uPlot({
      width: box.clientWidth || 600, height: 170, series, bands,
      cursor: { sync: { key: this.sync.key, setSeries: false }, drag: { x: true, y: false, setScale: true }, points: { size: 6 } },
      scales: { x: { time: false } },
      axes: [{ stroke, grid, font, ticks: grid, size: 34 }, { stroke, grid, font, ticks: grid, size: 58 }],
      legend: { live: true, markers: { width: 2, stroke: (u, k) => marks[k], fill: (u, k) => (series[k].dots ? marks[k] : "transparent") } },
      hooks: { draw: [(u) => this.drawLimits(u, chart.limit)], ready: [(u) => { this.listen(u); setTimeout(() => this.seek(this.now || 0)); }], setSize: [(u) => this.move(u)], setScale: [(u) => this.move(u)] },
    }, data, box);
    plot.root.setAttribute("role", "img");
    plot.root.setAttribute("aria-label", `Chart: ${chart.title} in ${chart.unit}`);
    plot.root.querySelectorAll(".u-series").forEach((row, k) => { row.hidden = k > 0 && !marks[k]; });
    plot.root.querySelector(".u-series .u-label").textContent = this.byStation ? "distance [m]" : "time [s]";
    return plot;
  }

  // Lines to both sides of zero.
  drawLimits(plot, limit) {
    const { left, top, width, height } = plot.bbox;
    for (const y of (limit ? [-limit, limit] : []).map((value) => plot.valToPos(value, "y", true))) {
      plot.ctx.strokeStyle = palette().fifth;
      if (y > top && y < top + height) plot.ctx.stroke(new Path2D(`M${left} ${y}H${left + width}`));
    }
  }

  // Value of a series at a row of the chart; of sparse values the latest one.
  shown(plot, s, k, chart) {
    if (k === null || k === undefined) return "–";
    const values = plot.data[s], x = plot.data[0];
    for (let j = k; j >= 0 && x[k] - x[j] < 10; j--) if (values[j] !== null && values[j] !== undefined) return fixed(values[j], chart.digits) + (chart.unit === "-" ? "" : " " + chart.unit);
    return "–";
  }

  listen(plot) {
    const head = document.createElement("div");
    head.className = "playhead";
    plot.over.append(head);
    plot.playhead = head;
    let pressed = 0;
    plot.over.addEventListener("mousedown", (e) => { pressed = e.offsetX; });
    plot.over.addEventListener("mouseup", (e) => { if (Math.abs(e.offsetX - pressed) < 3) this.onSeek(plot.posToVal(e.offsetX, "x")); });
    plot.over.addEventListener("mouseenter", () => { this.hovered = true; });
    plot.over.addEventListener("mouseleave", () => {
      this.hovered = false;
      setTimeout(() => this.seek(this.now)); // once uPlot has taken its own cursor away
    });
    this.move(plot);
  }

  move(plot) {
    if (!plot.playhead) return;
    const left = plot.valToPos(this.now || 0, "x"), width = plot.over.clientWidth;
    plot.playhead.hidden = left < 0 || left > width;
    plot.playhead.style.transform = `translateX(${left}px)`;
  }

  // Moves every playhead to x, and the legends to its values unless the mouse reads others.
  seek(x) {
    this.now = x;
    for (const plot of this.plots) {
      this.move(plot);
      if (!this.hovered) plot.setLegend({ idx: lastAtMost(plot.data[0], x + 1e-4) }, false);
    }
  }

  // Positions of the playheads in units of the axis, for checks.
  get heads() { return this.plots.map((plot) => plot.posToVal(new DOMMatrix(getComputedStyle(plot.playhead).transform).m41, "x")); }

  resize() { for (const plot of this.plots) plot.setSize({ width: plot.root.parentElement.clientWidth, height: 170 }); }
}
