// The camera's picture of the present time with strokes over it. Decoded pictures are kept for a while.

const KEPT = 40;

class Pictures {
  constructor(canvas, caption) {
    Object.assign(this, { canvas, caption, decoded: new Map(), shown: null, strokes: true });
  }

  // Shows the newest picture of a run at a time; returns its number, or -1.
  show(run, t) {
    const number = run.pictures.length && run.pictureTimes[0] <= t + 1e-4 ? lastAtMost(run.pictureTimes, t + 1e-4) : run.pictures.length ? 0 : -1;
    if (number < 0) return number;
    const picture = run.pictures[number];
    this.wanted = picture;
    this.caption.textContent = [`picture ${number + 1} of ${run.pictures.length}`, `${picture.time.toFixed(2)} s`, picture.caption].filter(Boolean).join(" · ");
    this.load(picture).then((image) => { if (this.wanted === picture) this.draw(image, picture); }).catch(() => {});
    if (number + 1 < run.pictures.length) this.load(run.pictures[number + 1]).catch(() => {});
    return number;
  }

  load(picture) {
    if (!this.decoded.has(picture)) {
      const image = new Image();
      image.src = "data:image/jpeg;base64," + picture.base64;
      this.decoded.set(picture, image.decode().then(() => image));
      if (this.decoded.size > KEPT) this.decoded.delete(this.decoded.keys().next().value);
    }
    return this.decoded.get(picture);
  }

  draw(image, picture) {
    const canvas = this.canvas;
    if (canvas.width !== image.width || canvas.height !== image.height) [canvas.width, canvas.height] = [image.width, image.height];
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    this.drawn = picture;
    if (!this.strokes) return;
    if (picture.lines.length) this.drawLines(context, picture); else this.drawFlow(context, picture.strokes);
  }

  // Motions of features: blue where they are short, orange where they are long.
  drawFlow(context, strokes) {
    const count = strokes.length / 4, lengths = new Float32Array(count);
    for (let k = 0; k < count; k++) lengths[k] = Math.hypot(strokes[4 * k + 2] - strokes[4 * k], strokes[4 * k + 3] - strokes[4 * k + 1]);
    const long = lengths.slice().sort()[Math.floor(0.95 * (count - 1))] || 1;
    context.lineWidth = 1.2;
    for (let k = 0; k < count; k++) {
      const [u0, v0, u1, v1] = strokes.subarray(4 * k, 4 * k + 4), hue = 200 - 165 * Math.min(1, lengths[k] / long);
      context.strokeStyle = context.fillStyle = `hsl(${hue.toFixed(0)} 95% 58%)`;
      context.beginPath();
      context.moveTo(u0 / 8, v0 / 8);
      context.lineTo(u1 / 8, v1 / 8);
      context.stroke();
      context.fillRect(u1 / 8 - 1.2, v1 / 8 - 1.2, 2.4, 2.4);
    }
  }

  drawLines(context, picture) {
    let at = 0;
    picture.lines.forEach((count, k) => {
      context.strokeStyle = PALETTES.light[SERIES[k]];
      context.lineWidth = 2.5;
      context.beginPath();
      for (const end = at + count; at < end; at++) {
        context.moveTo(picture.strokes[4 * at] / 8, picture.strokes[4 * at + 1] / 8);
        context.lineTo(picture.strokes[4 * at + 2] / 8, picture.strokes[4 * at + 3] / 8);
      }
      context.stroke();
    });
  }
}
