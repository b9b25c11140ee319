/** Colours of the heat map of texels a pixel: the sequential scale of the theme that is on. */

const CLASSES = 7;

/** sRGB, 0 to 1, of the classes below 1/2, 1, 2, 4, 8, 16 and from 16 texels a pixel. */
export function readHeat(): number[][] {
  const style = getComputedStyle(document.documentElement);
  return Array.from({ length: CLASSES }, (_, k) => channels(style.getPropertyValue(`--q${k}`)));
}

/** "#a8701f" -> its channels, 0 to 1. */
export function channels(hex: string): number[] {
  const digits = /^\s*#([0-9a-f]{6})\s*$/i.exec(hex)?.[1] ?? "808080";
  return [0, 2, 4].map((at) => parseInt(digits.slice(at, at + 2), 16) / 255);
}
