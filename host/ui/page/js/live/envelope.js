// @ts-check
/** The envelope of a carrier whose periods are about as wide as the columns that it is drawn in. */

/** From so many columns a period on, a carrier is drawn as a wave. */
export const COLUMNS_A_PERIOD = 4;

/**
 * Columns that hold less than a period of the carrier meet it at another phase each: their least and largest beat with
 * it, and draw a comb that is not in the signal. Then each is widened to its neighbours, until it holds a period.
 * @param {number[]} least
 * @param {number[]} largest
 * @param {number} periods of the carrier, in all columns together
 * @returns {[number[], number[]]} least and largest of at least a period around each column
 */
export function envelope(least, largest, periods) {
  const n = least.length;
  const perPeriod = n / periods;
  if (!(perPeriod > 1 && perPeriod < COLUMNS_A_PERIOD)) return [least, largest];
  const width = Math.ceil(perPeriod) + 1;
  const over = (/** @type {number[]} */ values, /** @type {(...x: number[]) => number} */ of) =>
    values.map((_, k) => {
      // As many columns at either end as in the middle.
      const first = Math.min(Math.max(0, k - (width >> 1)), Math.max(0, n - width));
      return of(...values.slice(first, first + width));
    });
  return [over(least, Math.min), over(largest, Math.max)];
}
