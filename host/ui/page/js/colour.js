// @ts-check
/**
 * Colour maps whose lightness runs one way, for any colour vision. Pure functions: a colour is [r, g, b], 0 to 255 each.
 * Colours of series are variables of page.css.
 */

/** @typedef {[number, number, number]} Rgb */

// Matplotlib's maps (CC0) at 33 even places; between them straight lines in sRGB, within 1/255 of the originals' 256 values.
const CIVIDIS = read(
  "00224e00285b002e6a0433711a386f273e6e32436d3b496c434e6c4b546c52596d5a5f6e61656f686a716f7073757676" +
    "7c7b788481798b8778938d789b9376a39a75aba072b3a670bbad6cc3b469ccba64d4c15fddc958e6d051efd748f8df3cfee838",
);
const VIRIDIS = read(
  "440154470d6048186a482374472d7b4536814240863f49893b528b375a8d33638d2f6a8e2c728e297a8e26818e23898e" +
    "21908c1f988b1f9f8821a68528ae8031b57b3ebc744cc26c5dc9636ece5882d34c96d83fabdc32c0df24d5e21aeae51afde725",
);

/** @param {string} hex */
function read(hex) {
  /** @type {Rgb[]} */
  const colours = [];
  for (let at = 0; at < hex.length; at += 6) {
    const part = (/** @type {number} */ k) => parseInt(hex.slice(at + 2 * k, at + 2 * k + 2), 16);
    colours.push([part(0), part(1), part(2)]);
  }
  return colours;
}

/**
 * @param {Rgb[]} table
 * @param {number} t 0 to 1; beyond, the ends; no number gives the lower end
 * @returns {Rgb}
 */
function along(table, t) {
  const at = Math.min(Math.max(t || 0, 0), 1) * (table.length - 1);
  const k = Math.min(Math.floor(at), table.length - 2);
  const w = at - k;
  return /** @type {Rgb} */ ([0, 1, 2].map((c) => Math.round(table[k][c] * (1 - w) + table[k + 1][c] * w)));
}

/** From dark blue to yellow, the same for people who see two colours. @param {number} t 0 to 1 */
export const cividis = (t) => along(CIVIDIS, t);

/** From dark violet over green to yellow. @param {number} t 0 to 1 */
export const viridis = (t) => along(VIRIDIS, t);

/**
 * For differences: blue below zero, orange above, zero neutral and nearest to the paper. Both arms have the same
 * lightness at the same distance from zero.
 * @param {number} t -1 to 1
 * @param {boolean} dark whether the page is dark: zero is dark then
 * @returns {Rgb}
 */
export function diverging(t, dark = false) {
  const size = Math.min(Math.abs(t || 0), 1);
  const [zero, end] = dark ? [30, 82] : [96, 36];
  const chroma = 52 * Math.min(size * 1.25, 1) * (dark ? 0.9 : 1);
  return fromLab(zero + (end - zero) * size, chroma, t < 0 ? 262 : 62);
}

/**
 * CIE L*C*h (D65) to sRGB; what sRGB cannot show loses chroma, not lightness.
 * @param {number} lightness 0 to 100
 * @param {number} chroma
 * @param {number} hue in degree
 * @returns {Rgb}
 */
function fromLab(lightness, chroma, hue) {
  let [shown, most] = [0, chroma];
  if (inside(linearOf(lightness, chroma, hue))) shown = chroma;
  else
    for (let k = 0; k < 12; k++) {
      const middle = (shown + most) / 2;
      if (inside(linearOf(lightness, middle, hue))) shown = middle;
      else most = middle;
    }
  const gamma = (/** @type {number} */ u) => (u <= 0.0031308 ? 12.92 * u : 1.055 * u ** (1 / 2.4) - 0.055);
  const byte = (/** @type {number} */ u) => Math.round(255 * Math.min(Math.max(gamma(Math.max(u, 0)), 0), 1));
  return /** @type {Rgb} */ (linearOf(lightness, shown, hue).map(byte));
}

/** @param {number[]} linear */
const inside = (linear) => linear.every((u) => u > -0.001 && u < 1.001);

/** Linear light of the three channels. @param {number} lightness @param {number} chroma @param {number} hue */
function linearOf(lightness, chroma, hue) {
  const angle = (hue * Math.PI) / 180;
  const y = (lightness + 16) / 116;
  const back = (/** @type {number} */ f) => (f > 6 / 29 ? f ** 3 : 3 * (6 / 29) ** 2 * (f - 4 / 29));
  const X = 0.95047 * back(y + (chroma * Math.cos(angle)) / 500);
  const Y = back(y);
  const Z = 1.08883 * back(y - (chroma * Math.sin(angle)) / 200);
  return [3.2406 * X - 1.5372 * Y - 0.4986 * Z, -0.9689 * X + 1.8758 * Y + 0.0415 * Z, 0.0557 * X - 0.204 * Y + 1.057 * Z];
}

/** @param {Rgb} colour @returns {string} for CSS and canvas */
export const css = (colour) => `rgb(${colour[0]}, ${colour[1]}, ${colour[2]})`;

/** @param {string} hex `#rrggbb` @returns {Rgb} */
export const fromHex = (hex) => read(hex.slice(1))[0];

/** Relative luminance, as WCAG has it. @param {Rgb} colour @returns {number} 0 to 1 */
export function luminance(colour) {
  const [r, g, b] = colour.map((c) => (c <= 10 ? c / 3294.6 : ((c / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

/** CIE L*. @param {Rgb} colour @returns {number} 0 to 100 */
export function lightness(colour) {
  const y = luminance(colour);
  return y > (6 / 29) ** 3 ? 116 * Math.cbrt(y) - 16 : (29 / 3) ** 3 * y;
}

/** Contrast, as WCAG has it. @param {Rgb} a @param {Rgb} b @returns {number} 1 to 21 */
export function contrast(a, b) {
  const [x, y] = [luminance(a), luminance(b)];
  return (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05);
}

/** Ink that can be read on a colour: at least 4.5 to 1 on every one. @param {Rgb} colour @returns {"#000000" | "#ffffff"} */
export const inkOn = (colour) => (luminance(colour) > 0.179 ? "#000000" : "#ffffff");
