// Noise that can be asked for at any place: the same seed and index give the same number.

/** A 32-bit hash of two integers (the finaliser of MurmurHash3). */
export function hash(seed, index) {
  let x = (Math.imul(seed | 0, 0x9e3779b1) ^ Math.imul(index | 0, 0x85ebca6b)) | 0;
  x = Math.imul(x ^ (x >>> 16), 0x85ebca6b);
  x = Math.imul(x ^ (x >>> 13), 0xc2b2ae35);
  return (x ^ (x >>> 16)) >>> 0;
}

/** Uniform in [0, 1). */
export function uniform(seed, index) {
  return hash(seed, index) / 4294967296;
}

/** Normal with mean 0 and deviation 1, by Box and Muller. */
export function normal(seed, index) {
  const u = 1 - uniform(seed, 2 * index);
  return Math.sqrt(-2 * Math.log(u)) * Math.cos(2 * Math.PI * uniform(seed, 2 * index + 1));
}
