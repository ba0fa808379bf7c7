// Runs of a study as lines over parallel axes and as dots over two of them; a click opens the run's page.

class Explorer {
  constructor(root, table) {
    Object.assign(this, { root, axes: table.axes, runs: table.runs });
    this.part = (name) => root.querySelector(`[data-part="${name}"]`);
    this.scales = this.axes.map((axis, k) => this.scale(axis, this.runs.map((run) => run.values[k])));
    const numbers = this.axes.map((axis, k) => k).filter((k) => this.scales[k].many);
    const [x, y] = [this.part("x"), this.part("y")];
    for (const chooser of [x, y]) {
      chooser.replaceChildren(...this.axes.map((axis, k) => new Option(axis.label, k)));
      chooser.addEventListener("change", () => this.draw());
    }
    x.value = numbers.find((k) => this.axes[k].varied) ?? numbers[0] ?? 0;
    y.value = numbers.find((k) => !this.axes[k].varied) ?? numbers[1] ?? 0;
    this.draw();
    new ResizeObserver(() => { if (root.clientWidth !== this.width) this.draw(); }).observe(root);
  }

  // Place of a value on its axis, 0 to 1; words stand in the order in which they come.
  scale(axis, values) {
    if (axis.words) {
      const words = [...new Set(values)], last = Math.max(1, words.length - 1);
      return { ticks: words.map((word, k) => [words.length > 1 ? k / last : 0.5, word]), place: (value) => (words.length > 1 ? words.indexOf(value) / last : 0.5), many: words.length > 1 };
    }
    const known = values.filter((value) => value !== null);
    const low = Math.min(...known), high = Math.max(...known), span = high - low || 1;
    const ticks = known.length ? [0, 0.5, 1].filter((share) => (high > low ? share !== 0.5 || axis.digits > 0 : share === 0.5)).map((share) => [share, this.text(axis, high > low ? low + share * span : low)]) : [];
    return { ticks, place: (value) => (value === null ? null : high > low ? (value - low) / span : 0.5), many: high > low };
  }

  titled(axis) { return axis.label + (axis.unit ? ` [${axis.unit}]` : ""); }

  // Title of an axis in short lines.
  wrapped(axis) {
    const lines = [""];
    for (const word of this.titled(axis).split(" ")) {
      const last = lines[lines.length - 1];
      if (last && last.length + word.length > 13) lines.push(word); else lines[lines.length - 1] = last ? `${last} ${word}` : word;
    }
    return lines;
  }

  text(axis, value) { return value === null ? "–" : axis.words ? value : fixed(value, axis.digits); }

  draw() {
    this.width = this.root.clientWidth;
    this.drawLines();
    this.drawDots();
  }

  // An SVG element.
  element(name, attributes, text) {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    return element;
  }

  // A mark of a run: it names the run, is lit with its other marks, and leads to the run's page if there is one.
  mark(shape, run, k) {
    const title = `${run.name}: ${run.outcome}\n` + this.axes.map((axis, j) => `${axis.label}: ${this.text(axis, run.values[j])}${axis.unit ? " " + axis.unit : ""}`).join("\n");
    shape.append(this.element("title", {}, title));
    shape.dataset.run = k;
    shape.classList.add(run.good ? "good" : "bad");
    shape.addEventListener("mouseenter", () => this.light(k, true));
    shape.addEventListener("mouseleave", () => this.light(k, false));
    if (!run.link) return shape;
    const link = this.element("a", { href: run.link, "aria-label": `Open ${run.name}` });
    link.append(shape);
    return link;
  }

  // Lights a run's marks and puts them in front of the others, which must not happen again before the click is over.
  light(k, on) {
    this.part("named").textContent = on ? `${this.runs[k].name}: ${this.runs[k].outcome}` : "";
    for (const shape of this.root.querySelectorAll(`[data-run="${k}"]`)) {
      shape.classList.toggle("lit", on);
      const mark = shape.closest("a") || shape;
      if (on && this.front !== k) mark.parentNode.append(mark);
    }
    if (on) this.front = k;
  }

  drawLines() {
    const heads = this.axes.map((axis) => this.wrapped(axis)), width = Math.max(this.width, 115 * this.axes.length), svg = this.part("lines");
    const top = 18 + 14 * Math.max(...heads.map((lines) => lines.length)), height = 254 + top, bottom = 14;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.style.minWidth = `${115 * this.axes.length}px`;
    svg.replaceChildren();
    const x = (k) => 60 + (this.axes.length > 1 ? (k * (width - 120)) / (this.axes.length - 1) : 0), y = (share) => height - bottom - share * (height - top - bottom);
    this.runs.forEach((run, k) => {
      const points = this.axes.map((axis, j) => [x(j), this.scales[j].place(run.values[j])]).filter(([, share]) => share !== null);
      svg.append(this.mark(this.element("polyline", { points: points.map(([u, share]) => `${u.toFixed(1)},${y(share).toFixed(1)}`).join(" "), fill: "none" }), run, k));
    });
    this.axes.forEach((axis, j) => {
      svg.append(this.element("line", { x1: x(j), x2: x(j), y1: y(0), y2: y(1), class: "axis" }));
      heads[j].forEach((line, k) => svg.append(this.element("text", { x: x(j), y: 14 * (k + 1), "text-anchor": "middle", class: "name" }, line)));
      for (const [share, text] of this.scales[j].ticks) svg.append(this.element("text", { x: x(j) + 5, y: y(share) + 4, class: "tick" }, text));
    });
  }

  drawDots() {
    const [i, j] = ["x", "y"].map((name) => Number(this.part(name).value)), width = Math.max(320, Math.min(this.width, 900)), svg = this.part("dots");
    const ticks = this.scales[i].ticks, letters = ticks.reduce((sum, [, text]) => sum + text.length + 3, 0);
    const rows = Math.max(1, Math.ceil((8 * letters) / (width - 110))), height = 306 + 13 * rows; // of labels, which would touch in one
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.style.maxWidth = `${width}px`;
    svg.replaceChildren();
    const u = (share) => 76 + share * (width - 110), foot = 278, v = (share) => foot - 10 - share * (foot - 38);
    svg.append(this.element("line", { x1: 66, x2: width - 24, y1: foot, y2: foot, class: "axis" }), this.element("line", { x1: 66, x2: 66, y1: 18, y2: foot, class: "axis" }));
    svg.append(this.element("text", { x: 0.5 * (width + 42), y: height - 6, "text-anchor": "middle", class: "name" }, this.titled(this.axes[i])));
    svg.append(this.element("text", { x: 66, y: 12, class: "name" }, this.titled(this.axes[j])));
    ticks.forEach(([share, text], k) => svg.append(this.element("text", { x: u(share), y: foot + 16 + 13 * (k % rows), "text-anchor": share === 1 ? "end" : share === 0 ? "start" : "middle" }, text)));
    for (const [share, text] of this.scales[j].ticks) svg.append(this.element("text", { x: 60, y: v(share) + 4, "text-anchor": "end" }, text));
    this.runs.forEach((run, k) => {
      const [a, b] = [this.scales[i].place(run.values[i]), this.scales[j].place(run.values[j])];
      if (a !== null && b !== null) svg.append(this.mark(this.element("circle", { cx: u(a), cy: v(b), r: 5 }), run, k));
    });
  }
}

window.explorer = new Explorer(document.getElementById("explorer"), JSON.parse(document.getElementById("explorer-table").textContent));
