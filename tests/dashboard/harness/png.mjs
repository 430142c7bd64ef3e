// Pictures made small: a page has few colours, and a PNG with a palette of 256 a third of the bytes.

import { crc32, deflateSync, inflateSync } from 'node:zlib';

/** The same picture with at most 256 colours. From eight bits a channel, as browsers write them. */
export function withPalette(png) {
  const { width, height, channels, rows } = decode(png);
  const bins = new Map();
  const key = (at) => ((rows[at] >> 3) << 10) | ((rows[at + 1] >> 3) << 5) | (rows[at + 2] >> 3);
  for (let at = 0; at < rows.length; at += channels) {
    const bin = bins.get(key(at)) ?? { n: 0, r: 0, g: 0, b: 0 };
    bins.set(key(at), { n: bin.n + 1, r: bin.r + rows[at], g: bin.g + rows[at + 1], b: bin.b + rows[at + 2] });
  }
  const colours = [...bins.values()].map(({ n, r, g, b }) => ({ n, r: Math.round(r / n), g: Math.round(g / n), b: Math.round(b / n) }));
  colours.sort((a, b) => b.n - a.n);
  const palette = colours.slice(0, 256);
  const nearest = new Map();
  const index = (at) => {
    const bin = key(at);
    if (!nearest.has(bin)) {
      const far = palette.map((c) => (c.r - rows[at]) ** 2 + (c.g - rows[at + 1]) ** 2 + (c.b - rows[at + 2]) ** 2);
      nearest.set(bin, far.indexOf(Math.min(...far)));
    }
    return nearest.get(bin);
  };
  const indexed = Buffer.alloc((width + 1) * height);
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) indexed[y * (width + 1) + 1 + x] = index((y * width + x) * channels);
  }
  const head = Buffer.alloc(13);
  head.writeUInt32BE(width, 0);
  head.writeUInt32BE(height, 4);
  head.set([8, 3, 0, 0, 0], 8);
  const table = Buffer.from(palette.flatMap(({ r, g, b }) => [r, g, b]));
  const parts = [['IHDR', head], ['PLTE', table], ['IDAT', deflateSync(indexed, { level: 9 })], ['IEND', Buffer.alloc(0)]];
  return Buffer.concat([png.subarray(0, 8), ...parts.map(([name, data]) => chunk(name, data))]);
}

function chunk(name, data) {
  const body = Buffer.concat([Buffer.from(name, 'latin1'), data]);
  const [length, sum] = [Buffer.alloc(4), Buffer.alloc(4)];
  length.writeUInt32BE(data.length);
  sum.writeUInt32BE(crc32(body));
  return Buffer.concat([length, body, sum]);
}

/** Pixels of a PNG without interlacing, row after row. */
function decode(png) {
  const packed = [];
  for (let at = 8; at < png.length; at += 12 + png.readUInt32BE(at)) {
    if (png.toString('latin1', at + 4, at + 8) === 'IDAT') packed.push(png.subarray(at + 8, at + 8 + png.readUInt32BE(at)));
  }
  const [width, height] = [png.readUInt32BE(16), png.readUInt32BE(20)];
  const channels = png[25] === 6 ? 4 : 3;
  const raw = inflateSync(Buffer.concat(packed));
  const stride = width * channels;
  const rows = Buffer.alloc(stride * height);
  for (let y = 0; y < height; y++) {
    const filter = raw[y * (stride + 1)];
    for (let x = 0; x < stride; x++) {
      const left = x >= channels ? rows[y * stride + x - channels] : 0;
      const up = y ? rows[(y - 1) * stride + x] : 0;
      const corner = x >= channels && y ? rows[(y - 1) * stride + x - channels] : 0;
      const guess = [0, left, up, (left + up) >> 1, paeth(left, up, corner)][filter];
      rows[y * stride + x] = raw[y * (stride + 1) + 1 + x] + guess;
    }
  }
  return { width, height, channels, rows };
}

function paeth(left, up, corner) {
  const guess = left + up - corner;
  const [a, b, c] = [Math.abs(guess - left), Math.abs(guess - up), Math.abs(guess - corner)];
  if (a <= b && a <= c) return left;
  return b <= c ? up : corner;
}
