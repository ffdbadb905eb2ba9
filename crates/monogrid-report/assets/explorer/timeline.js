// What became of each frame over time: state as colour, share of good pixels and rate as curves. A click chooses a moment.
import { isDark } from 'explorer/colours';
import { quantiles } from 'explorer/data';

const HEIGHT = 96;
const BAND = 16;

export class Timeline {
  constructor(canvas, frames, choose) {
    this.canvas = canvas;
    this.frames = frames;
    this.chosen = null;
    const row = (event) => {
      const box = canvas.getBoundingClientRect();
      const share = Math.min(Math.max((event.clientX - box.left) / box.width, 0), 0.999999);
      return Math.floor(share * frames.index.length);
    };
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      choose(row(event));
    });
    canvas.addEventListener('pointermove', (event) => event.buttons && choose(row(event)));
    canvas.addEventListener('keydown', (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -25, PageDown: 25 }[event.key];
      if (!step) return;
      event.preventDefault();
      choose(Math.min(Math.max((this.chosen ?? 0) + step, 0), frames.index.length - 1));
    });
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
  }

  show(row) {
    this.chosen = row;
    this.draw();
  }

  draw() {
    const { frames, canvas } = this;
    const ratio = Math.min(devicePixelRatio, 2);
    const width = canvas.parentElement.clientWidth;
    if (!width) return;
    canvas.width = width * ratio;
    canvas.height = HEIGHT * ratio;
    canvas.style.height = `${HEIGHT}px`;
    const context = canvas.getContext('2d');
    context.scale(ratio, ratio);
    context.fillStyle = isDark() ? '#1d2024' : '#ffffff';
    context.fillRect(0, 0, width, HEIGHT);
    const count = frames.index.length;
    const x = (row) => (row / count) * width;
    for (let row = 0; row < count; row++) {
      context.fillStyle = frames.legend[frames.state[row]][1];
      context.fillRect(x(row), HEIGHT - BAND, width / count + 0.6, BAND);
    }
    this.curve(frames.good, 100, '#2a7fc8', x);
    // a few frames that take very long do not flatten the others
    this.curve(frames.milliseconds, Math.max(1, quantiles(frames.milliseconds, 0, 0.98)[1]), '#c07a28', x);
    if (frames.error.length) this.curve(frames.error, Math.max(1e-9, quantiles(frames.error, 0, 1)[1]), '#b03a8c', x);
    if (this.chosen !== null) {
      context.fillStyle = '#ff00aa';
      context.fillRect(x(this.chosen + 0.5) - 1, 0, 2, HEIGHT);
    }
  }

  // Unknown values, below zero, are gaps.
  curve(values, most, colour, x) {
    const context = this.canvas.getContext('2d');
    context.strokeStyle = colour;
    context.lineWidth = 1.3;
    context.beginPath();
    let isOpen = false;
    values.forEach((value, row) => {
      if (value < 0) {
        isOpen = false;
        return;
      }
      const place = [x(row + 0.5), (HEIGHT - BAND - 4) * (1 - Math.min(value / most, 1)) + 2];
      if (isOpen) context.lineTo(...place);
      else context.moveTo(...place);
      isOpen = true;
    });
    context.stroke();
  }

  // What is known about a frame, as text.
  describe(row, unit) {
    const { frames } = this;
    const parts = [`frame ${frames.index[row]}, ${frames.time[row].toFixed(2)} s: ${frames.legend[frames.state[row]][0]}`];
    const reason = reasonAt(frames, row);
    if (reason) parts.push(reason);
    if (frames.good[row] >= 0) parts.push(`${frames.good[row]} % of the pixels agree`);
    if (frames.milliseconds[row] >= 0) parts.push(`${frames.milliseconds[row].toFixed(0)} ms`);
    if (frames.error.length && frames.error[row] >= 0) parts.push(`${frames.error[row].toFixed(3)} ${unit === 'm' ? 'm' : 'map units'} from the true path`);
    return parts.join(' · ');
  }
}

// Reasons are noted where they change.
function reasonAt(frames, row) {
  let found = '';
  for (const [from, text] of frames.reasons) {
    if (from > row) break;
    found = text;
  }
  return found;
}
