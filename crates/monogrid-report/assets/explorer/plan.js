// The map from above in two dimensions: one layer of cells, or the cells between two heights, with the path.
import { isDark } from 'explorer/colours';
import { extent } from 'explorer/data';

const MARGIN = 0.06;

export class Plan {
  constructor(canvas, data) {
    this.canvas = canvas;
    this.data = data;
    this.heights = [-Infinity, Infinity];
    this.moment = null;
    const [low, high] = extent(data);
    const room = MARGIN * Math.max(high[0] - low[0], high[1] - low[1], 1e-6);
    this.low = [low[0] - room, low[1] - room];
    this.size = [high[0] - low[0] + 2 * room, high[1] - low[1] + 2 * room];
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
  }

  // One layer of cells at a height, or everything between two.
  showBetween(low, high) {
    this.heights = [low, high];
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
    const colours = isDark() ? ['#3a3d42', '#1b1d20', '#e8e8e4'] : ['#d9d9d4', '#ffffff', '#1c1c1c'];
    context.fillStyle = colours[0];
    context.fillRect(0, 0, width, height);
    this.cells(context, this.data.free, colours[1], scale);
    this.cells(context, this.data.occupied, colours[2], scale);
    this.line(context, this.data.reference, '#999999');
    this.line(context, this.data.path.map((p) => p.slice(1)), '#2a7fc8');
    if (this.moment) this.dot(context, this.moment, '#ff00aa');
    this.ruler(context, width, height, scale, colours[2]);
  }

  cells(context, cubes, colour, scale) {
    if (!cubes) return;
    context.fillStyle = colour;
    const [low, high] = this.heights;
    for (let i = 0; i < cubes.count; i++) {
      const [x, y, z] = cubes.centre(i);
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
  ruler(context, width, height, scale, colour) {
    const wanted = (0.25 * width) / scale;
    const power = 10 ** Math.floor(Math.log10(wanted));
    const size = [5, 2, 1].map((n) => n * power).find((n) => n <= wanted) ?? power;
    context.fillStyle = '#2a7fc8';
    context.fillRect(12, height - 14, size * scale, 3);
    context.font = '12px system-ui,sans-serif';
    context.fillText(`${Number(size.toPrecision(1))} ${this.data.unit === 'm' ? 'm' : 'map units'}`, 12, height - 20);
  }
}
