// The map from above in two dimensions, with the path: as plan.png shows it, or one layer of cells; all cells where there is no plan.
import { isDark } from 'explorer/colours';
import { bar, extent } from 'explorer/data';

const MARGIN = 0.06;

export class Plan {
  constructor(canvas, data) {
    this.canvas = canvas;
    this.data = data;
    // the layer of cells that is shown instead
    this.layer = null;
    this.image = new Image();
    this.image.onload = () => this.draw();
    if (data.plan) this.image.src = `data:image/png;base64,${data.plan.image}`;
    this.moment = null;
    const [low, high] = extent(data);
    const room = MARGIN * Math.max(high[0] - low[0], high[1] - low[1], 1e-6);
    this.low = [low[0] - room, low[1] - room];
    this.size = [high[0] - low[0] + 2 * room, high[1] - low[1] + 2 * room];
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
  }

  // One layer of cells at a height; the plan for null.
  showLayer(height) {
    this.layer = height;
    this.draw();
  }
  mark(point) {
    this.moment = point;
    this.draw();
  }

  scaleFor(width) {
    const height = Math.min(width * (this.size[1] / this.size[0]), 1.1 * width);
    return { height, scale: Math.min(width / this.size[0], height / this.size[1]) };
  }

  draw() {
    const ratio = Math.min(devicePixelRatio, 2);
    const width = this.canvas.parentElement.clientWidth;
    if (!width) return;
    const { height, scale } = this.scaleFor(width);
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    this.canvas.style.height = `${height}px`;
    const context = this.canvas.getContext('2d');
    context.scale(ratio, ratio);
    const left = (width - this.size[0] * scale) / 2;
    const top = (height - this.size[1] * scale) / 2;
    this.at = ([x, y]) => [left + (x - this.low[0]) * scale, height - top - (y - this.low[1]) * scale];
    // the tones of plan.png
    const [occupied, free, unknown] = ['#26262c', '#ffffff', '#cdcdc8'];
    context.fillStyle = unknown;
    context.fillRect(0, 0, width, height);
    if (this.data.plan && this.layer === null) this.cellsOfPlan(context, scale);
    else {
      this.cells(context, this.data.free, free, scale);
      this.cells(context, this.data.occupied, occupied, scale);
    }
    this.line(context, this.data.reference, '#999999');
    this.line(context, this.data.path.map((p) => p.slice(1)), '#2a7fc8');
    if (this.moment) this.dot(context, this.moment, '#ff00aa');
    this.ruler(context, width, height, scale);
  }

  cellsOfPlan(context, scale) {
    if (!this.image.complete) return;
    const { low, size } = this.data.plan;
    const [left, top] = this.at([low[0], low[1] + size[1]]);
    context.imageSmoothingEnabled = false;
    context.drawImage(this.image, left, top, size[0] * scale, size[1] * scale);
  }

  cells(context, cubes, colour, scale) {
    if (!cubes) return;
    context.fillStyle = colour;
    const [low, high] = this.layer === null ? [-Infinity, this.data.cut ?? Infinity] : [this.layer, this.layer];
    for (let i = 0; i < cubes.count; i++) {
      const [x, y, z] = cubes.at(i);
      const half = cubes.edge(i) / 2;
      if (z + half <= low || z - half > high) continue;
      const [u, v] = this.at([x - half, y + half]);
      context.fillRect(u, v, 2 * half * scale + 0.5, 2 * half * scale + 0.5);
    }
  }

  line(context, points, colour) {
    if (points.length < 2) return;
    context.strokeStyle = colour;
    context.lineWidth = 1.6;
    context.beginPath();
    for (const point of points) context.lineTo(...this.at(point));
    context.stroke();
  }

  dot(context, point, colour) {
    context.fillStyle = colour;
    context.beginPath();
    context.arc(...this.at(point), 5, 0, 2 * Math.PI);
    context.fill();
  }

  // A bar of a round length.
  ruler(context, width, height, scale) {
    const { size, text } = bar((0.25 * width) / scale, this.data.unit);
    context.font = '12px system-ui,sans-serif';
    context.fillStyle = 'rgba(255,255,255,0.8)';
    context.fillRect(8, height - 34, Math.max(size * scale, context.measureText(text).width) + 8, 28);
    context.fillStyle = '#2a7fc8';
    context.fillRect(12, height - 14, size * scale, 3);
    context.fillText(text, 12, height - 20);
  }
}
