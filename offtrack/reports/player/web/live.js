// A run that goes on: each event fetches the run as far as it has come, and the page follows its end.

class Live {
  constructor(player, address) {
    Object.assign(this, { player, address, busy: false, waiting: false });
    this.follow = true;
    player.slider.addEventListener("input", () => { this.follow = player.t > player.end - 0.3; });
    player.part("last").addEventListener("click", () => { this.follow = true; });
    for (const name of ["first", "back", "play"]) player.part(name).addEventListener("click", () => { this.follow = false; });
    this.events = new EventSource(`${address}/events`);
    this.events.addEventListener("snapshot", () => this.renew());
    this.events.addEventListener("finished", (e) => this.finish(e.data));
    this.events.addEventListener("error", () => {
      this.events.close();
      this.say("The run does not answer any more: it has ended, or its command was stopped.");
    });
  }

  // Shows a note that stays.
  say(note) { this.player.playback.note = this.player.part("note").textContent = note; }

  async renew() {
    if (this.busy) { this.waiting = true; return; }
    this.busy = true;
    try {
      const run = this.player.playback.runs[0], answer = await fetch(`${this.address}/playback?have=${run.pictures.length}`);
      if (!answer.ok) return;
      const { table, numbers, pictures } = await answer.json();
      await this.player.renew(JSON.parse(table), await unpacked(numbers), pictures, this.follow);
    } finally {
      this.busy = false;
      if (this.waiting) { this.waiting = false; this.renew(); }
    }
  }

  async finish(what) {
    this.events.close();
    this.say(`The run is over: ${what}. This page keeps what it shows.`);
  }
}
