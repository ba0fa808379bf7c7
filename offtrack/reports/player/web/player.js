// One show(t) moves everything: picture, plan, 3-D view, playheads, numbers and the address.

class Player {
  constructor(root, playback) {
    Object.assign(this, { root, playback, t: 0, playing: false, view: "plan", byStation: false, picturesOf: 0 });
    this.part = (name) => root.querySelector(`[data-part="${name}"]`);
    this.slider = this.part("time");
    this.pictures = new Pictures(this.part("picture"), this.part("caption"));
    this.plan = new Plan(this.part("plan"), playback, () => this.redraw());
    this.scene = new Scene(this.part("scene"), playback, () => this.redraw());
    this.charts = new Charts(this.part("charts"), playback, (x) => this.show(x));
    this.layOut();
    this.listen();
    this.charts.build();
    this.plan.begin();
    this.show(timeOfAddress() ?? this.playback.peak);
  }

  get end() {
    const runs = this.playback.runs;
    return this.byStation ? Math.max(0, ...runs.map((run) => (run.rows ? run.stations[run.rows - 1] : 0))) : this.playback.end;
  }

  // Smallest step of the keys: from picture to picture, else a tenth of a second.
  get step() {
    const times = this.playback.runs[this.picturesOf].pictureTimes;
    if (this.byStation) return 0.5;
    return times.length > 1 ? (times[times.length - 1] - times[0]) / (times.length - 1) : 0.1;
  }

  layOut() {
    const { runs, note } = this.playback;
    this.slider.max = this.end;
    this.slider.step = "any";
    this.part("camera").hidden = !runs.some((run) => run.pictures.length);
    this.part("plan").closest("figure").hidden = !runs[0].bodies.length;
    this.root.classList.toggle("planless", !runs[0].bodies.length);
    this.root.classList.toggle("blind", !runs.some((run) => run.pictures.length));
    this.part("note").textContent = note;
    this.part("run").parentElement.hidden = this.playback.together;
    if (!this.part("run").options.length) this.part("run").replaceChildren(...this.playback.all.map((run, k) => new Option(run.name, k)));
    this.part("stations").hidden = runs.length < 2;
    const chooser = this.part("which");
    chooser.hidden = runs.length < 2;
    chooser.replaceChildren(...runs.map((run, k) => new Option(run.name, k)));
    this.picturesOf = Math.max(0, runs.findIndex((run) => run.pictures.length));
    chooser.value = this.picturesOf;
    this.layOutReadings();
    this.drawKeys();
    this.drawSpans();
  }

  layOutReadings() {
    const list = this.part("readings");
    list.replaceChildren();
    this.cells = [];
    this.playback.runs.forEach((run, r) => {
      if (this.playback.runs.length > 1) {
        const name = document.createElement("dt");
        name.className = "run";
        const title = run.link ? document.createElement("a") : name;
        title.textContent = run.name;
        if (run.link) { title.href = run.link; name.append(title); }
        name.style.borderColor = palette()[SERIES[r % SERIES.length]];
        list.append(name);
      }
      for (const reading of this.playback.readings) {
        if (!run.has(reading.signal)) continue;
        const box = document.createElement("div"), label = document.createElement("dt"), value = document.createElement("dd");
        label.textContent = reading.label;
        label.title = run.meanings.get(reading.signal);
        value.style.color = `var(--${reading.colour}, inherit)`;
        value.dataset.signal = reading.signal;
        box.append(label, value);
        list.append(box);
        this.cells.push({ run, r, reading, value });
      }
    });
  }

  drawKeys() {
    const keys = this.part("keys"), { runs, lines, things, friction } = this.playback, entry = (...of) => this.entry(...of);
    if (!runs[0].bodies.length) return;
    const colours = palette(), entries = [];
    if (runs.length > 1) entries.push(...runs.map((run, r) => entry(run.name, colours[SERIES[r % SERIES.length]])));
    else {
      entries.push(...runs.flatMap((run) => run.trails.map((trail) => entry(trail.label, colours[trail.colour]))));
      if (runs[0].estimated) entries.push(entry(`dots: ${runs[0].estimated.label}`, colours.estimated));
    }
    entries.push(...lines.map((line) => entry(line.label, colours[line.colour])));
    if (things.length) entries.push(entry("kerbs, islands, signals of the map", colours.ink));
    if (friction) entries.push(entry(`friction ${friction.worst.toFixed(2)} to ${friction.best.toFixed(2)} (white)`, `rgba(${colours.ice.join()},.5)`, true));
    keys.replaceChildren(...entries);
  }

  // Bands of health and faults below the slider.
  drawSpans() {
    const bar = this.part("spans"), end = this.end || 1, colours = palette();
    const names = new Map();
    bar.replaceChildren();
    if (this.byStation) return;
    for (const run of this.playback.runs) {
      const lanes = new Map();
      for (const span of run.spans) {
        const kind = span.label.startsWith("fault") ? "fault" : "estimate";
        if (!lanes.has(kind)) { const lane = document.createElement("div"); lane.className = "lane"; lanes.set(kind, lane); bar.append(lane); }
        const piece = document.createElement("i"), text = `${span.label}, ${span.start.toFixed(1)} to ${span.end.toFixed(1)} s`;
        piece.style.left = `${(100 * span.start) / end}%`;
        piece.style.width = `${(100 * (span.end - span.start)) / end}%`;
        piece.style.background = colours[span.colour];
        piece.title = this.playback.runs.length > 1 ? `${run.name}: ${text}` : text;
        piece.setAttribute("role", "img");
        piece.setAttribute("aria-label", piece.title);
        lanes.get(kind).append(piece);
        names.set(span.label, colours[span.colour]);
      }
    }
    if (!names.size) return;
    const key = document.createElement("div");
    key.className = "keys";
    key.append(...[...names].map(([label, colour]) => this.entry(label, colour, true)));
    bar.append(key);
  }

  // A colour with its meaning.
  entry(label, colour, shade) {
    const item = document.createElement("span"), swatch = document.createElement("i");
    swatch.style.background = colour;
    if (shade) swatch.className = "shade";
    item.append(swatch, label);
    return item;
  }

  listen() {
    this.slider.addEventListener("input", () => this.show(Number(this.slider.value)));
    const click = (name, action) => this.part(name).addEventListener("click", action);
    click("play", () => this.play(!this.playing));
    click("back", () => this.move(-this.step));
    click("on", () => this.move(this.step));
    click("first", () => this.show(0));
    click("last", () => this.show(this.end));
    click("fit", () => this.plan.fit());
    click("follow", () => this.plan.follow());
    click("theme", () => { document.documentElement.dataset.theme = isDark() ? "light" : "dark"; this.recolour(); });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
    this.part("run").addEventListener("change", (e) => this.chooseRun(Number(e.target.value)));
    this.part("strokes").addEventListener("change", (e) => { this.pictures.strokes = e.target.checked; this.redraw(); });
    this.part("stations-on").addEventListener("change", (e) => this.align(e.target.checked));
    this.part("which").addEventListener("change", (e) => { this.picturesOf = Number(e.target.value); this.redraw(); });
    for (const tab of this.root.querySelectorAll("[role=tab]")) tab.addEventListener("click", () => this.choose(tab.dataset.view));
    document.addEventListener("keydown", (e) => this.key(e));
    addEventListener("hashchange", (e) => { const t = timeOfAddress(e.newURL); if (t !== null && Math.abs(t - this.t) > 0.006) this.show(t); });
    new ResizeObserver(() => { this.charts.resize(); this.redraw(); }).observe(this.root);
  }

  key(e) {
    if (/^(SELECT|TEXTAREA)$/.test(e.target.tagName) || (e.target.tagName === "INPUT" && e.target.type !== "range") || e.ctrlKey || e.metaKey || e.altKey) return;
    const far = e.shiftKey ? 10 : 1;
    const action = { " ": () => this.play(!this.playing), ArrowRight: () => this.move(far * this.step), ArrowLeft: () => this.move(-far * this.step),
                     Home: () => this.show(0), End: () => this.show(this.end), p: () => this.choose("plan"), 3: () => this.choose("scene"),
                     f: () => this.plan.follow(), g: () => this.plan.fit() }[e.key];
    if (!action || (e.key === " " && e.target.tagName === "BUTTON")) return;
    action();
    e.preventDefault();
  }

  choose(view) {
    this.view = view;
    for (const tab of this.root.querySelectorAll("[role=tab]")) tab.setAttribute("aria-selected", String(tab.dataset.view === view));
    this.part("plan").hidden = view !== "plan";
    this.part("scene").hidden = view !== "scene";
    if (view === "scene" && !this.scene.open()) { this.part("note").textContent = "This browser shows no 3-D view: WebGL is off."; this.choose("plan"); return; }
    this.redraw();
  }

  chooseRun(k) {
    this.play(false);
    this.playback.choose(k);
    this.part("run").value = k;
    this.rows = null;
    this.layOut();
    this.plan.bounds = this.plan.extent();
    this.plan.stillKey = "";
    this.scene.shapes.clear();
    this.charts.build();
    this.plan.begin();
    this.show(this.playback.peak);
  }

  // Takes a run as far as it has come; shows its end if `follow`.
  async renew(table, buffer, pictures, follow) {
    const before = this.playback.all[0], run = new Run(table.runs[0], buffer, []);
    run.addPictures([...before.pictures.map((picture) => ({ ...picture })), ...pictures]);
    const fresh = this.playback.charts.length !== table.charts.length;
    Object.assign(this.playback, { all: [run], runs: [run], charts: table.charts, readings: table.readings });
    this.plan.bounds = this.plan.extent();
    this.layOut();
    if (fresh) this.charts.build(); else this.charts.renew();
    if (!this.plan.following && follow) this.plan.fit();
    this.show(follow ? this.end : this.t);
  }

  align(byStation) {
    const share = this.end ? this.t / this.end : 0;
    this.byStation = this.charts.byStation = byStation;
    this.slider.max = this.end;
    this.charts.build();
    this.drawSpans();
    this.show(share * this.end);
  }

  recolour() {
    this.charts.build();
    this.drawKeys();
    this.drawSpans();
    if (this.playback.friction) this.plan.loadFriction(this.playback.friction);
    this.redraw();
  }

  play(playing) {
    this.playing = playing;
    const button = this.part("play");
    button.textContent = playing ? "❚❚" : "▶";
    button.setAttribute("aria-label", playing ? "Pause" : "Play");
    if (!playing) { this.writeAddress(); return; }
    if (this.t >= this.end - 1e-6) this.show(0);
    let before = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      const speed = Number(this.part("speed").value) * (this.byStation ? 3 : 1);
      this.show(Math.min(this.end, this.t + 0.001 * speed * (now - before)));
      before = now;
      if (this.t >= this.end) this.play(false); else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  move(by) { this.play(false); this.show(this.t + by); }

  rowsAt(x) { return this.playback.runs.map((run) => (this.byStation ? lastAtMost(run.stations, x + 1e-4) : run.row(x))); }

  show(x) {
    this.t = Math.min(Math.max(x, 0), this.end);
    this.rows = this.rowsAt(this.t);
    this.slider.value = this.t;
    const shown = this.byStation ? `${this.t.toFixed(1)} m` : `${this.t.toFixed(2)} s`;
    this.part("now").textContent = shown;
    this.slider.setAttribute("aria-valuetext", shown);
    this.charts.seek(this.t);
    for (const { run, r, reading, value } of this.cells) {
      const number = run.rows ? reading.scale * run.latest(reading.signal, this.rows[r]) : NaN, none = Number.isNaN(number);
      const early = none && run.rows && run.isYetToCome(reading.signal, this.rows[r]);
      value.classList.toggle("none", none);
      value.textContent = early ? (reading.colour === "estimated" ? "no estimate yet" : "not known yet") : none ? "–" : `${fixed(number, reading.digits)} ${reading.unit === "-" ? "" : reading.unit}`;
    }
    this.redraw();
    if (!this.playing) this.writeAddress();
  }

  redraw() {
    if (!this.rows) return;
    const run = this.playback.runs[this.picturesOf];
    this.picture = this.pictures.show(run, this.byStation && run.rows ? run.time[this.rows[this.picturesOf]] : this.t);
    if (!run.bodies.length) return;
    if (this.view === "plan") this.plan.draw(this.rows); else this.scene.draw(this.rows);
  }

  writeAddress() {
    clearTimeout(this.writing); // browsers refuse many changes of the address at once
    this.writing = setTimeout(() => { if (!this.byStation) history.replaceState(null, "", `#t=${this.t.toFixed(2)}`); }, 250);
  }
}

// Time that an address asks for; null if it names none.
function timeOfAddress(address = location.href) {
  const match = /[#&]t=([\d.]+)/.exec(address);
  return match ? Number(match[1]) : null;
}

(async () => {
  const root = document.getElementById("player");
  try {
    const begin = performance.now();
    window.player = new Player(root, await Playback.read());
    if (root.dataset.live) window.live = new Live(window.player, root.dataset.live);
    root.dataset.ready = (performance.now() - begin).toFixed(0);
  } catch (error) {
    root.querySelector('[data-part="note"]').textContent = `The playback could not be shown: ${error.message}`;
    throw error;
  }
})();
