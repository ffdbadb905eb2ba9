// Colour scales, as in the pictures that the program writes (picture/colour.rs).

export const RAINBOW = [
  [46, 42, 120],
  [36, 110, 180],
  [40, 165, 140],
  [140, 200, 80],
  [250, 205, 70],
  [205, 65, 45],
];

// Red, green, blue from 0 to 255 for a share from 0 to 1.
export function rainbow(share) {
  const position = Math.min(Math.max(share, 0), 1) * (RAINBOW.length - 1);
  const i = Math.min(Math.floor(position), RAINBOW.length - 2);
  return RAINBOW[i].map((value, k) => value + (position - i) * (RAINBOW[i + 1][k] - value));
}

// The same scale for the graphics card.
export const RAINBOW_SHADER = `
vec3 rainbow(float share) {
  float p = clamp(share, 0.0, 1.0) * ${RAINBOW.length - 1}.0;
  ${RAINBOW.map((c, i) => `vec3 c${i} = vec3(${c.map((v) => (v / 255).toFixed(4)).join(', ')});`).join('\n  ')}
  vec3 colour = mix(c0, c1, clamp(p, 0.0, 1.0));
  ${RAINBOW.slice(2)
    .map((_, i) => `colour = mix(colour, c${i + 2}, clamp(p - ${i + 1}.0, 0.0, 1.0));`)
    .join('\n  ')}
  return colour;
}`;

export const isDark = () => matchMedia('(prefers-color-scheme: dark)').matches;
