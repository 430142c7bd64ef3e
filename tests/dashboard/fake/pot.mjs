// A pot on the coil of a half-bridge series-resonant inverter, by closed formulas: those of shared/src/lookup/prior.rs,
// scaled to a pot that the prior does not know.

/** Series resonance capacitor, in farad (shared/src/hob.rs). */
export const C_F = 1080e-9;
export const F_MIN_HZ = 34000;
export const F_MAX_HZ = 80000;
export const RATED_W = 2500;
/** Peak of the rectified mains, in volt. */
export const BUS_PEAK_V = 230 * Math.SQRT2;
/** Reactance above resonance that control keeps, of the coil's (firmware/src/limits.rs). */
export const RESONANCE_MARGIN = 0.12;
export const I_LIMIT_A = 70;

/** R and L of the prior at a frequency in hertz and a current amplitude in ampere. */
export function prior(fHz, iA) {
  const x = fHz / 45e3;
  return {
    r: (3 + 4 / (1 + iA / 9)) * Math.sqrt(x),
    l: (20.5 + 18 / (1 + iA / 10)) * 1e-6 * x ** -0.3,
  };
}

/** A pot: how much more R and L it has than the prior, and how they bend. */
export class Pot {
  constructor(name, rFactor, lFactor, bendA) {
    this.name = name;
    this.rFactor = rFactor;
    this.lFactor = lFactor;
    this.bendA = bendA;
    this.curves = new Map();
  }

  /** R in ohm and L in henry; `warm` is a factor on R for a pot that warms up. */
  at(fHz, iA, warm = 1) {
    const { r, l } = prior(fHz, iA * (9 / this.bendA));
    return { r: r * this.rFactor * warm, l: l * this.lFactor };
  }

  /** Amplitude of the current's fundamental at a bus voltage, with the R and L that it then has. */
  current(fHz, busV, warm = 1) {
    const omega = 2 * Math.PI * fHz;
    const v1 = (2 / Math.PI) * busV;
    let i = v1 / 8;
    let z = null;
    for (let step = 0; step < 60; step++) {
      const { r, l } = this.at(fHz, i, warm);
      z = { r, l, x: omega * l - 1 / (omega * C_F) };
      const next = v1 / Math.hypot(z.r, z.x);
      if (Math.abs(next - i) < 1e-6 * (1 + i)) return { i: next, ...z };
      i += 0.6 * (next - i);
    }
    return { i, ...z };
  }

  /** Mean power over a mains half-cycle, in watt, the current's crest and R and L there. */
  halfCycle(fHz, warm = 1) {
    const steps = 24;
    let power = 0;
    for (let k = 0; k < steps; k++) {
      const at = this.current(fHz, BUS_PEAK_V * Math.sin((Math.PI * (k + 0.5)) / steps), warm);
      power += (at.r * at.i * at.i) / 2 / steps;
    }
    return { power, ...this.current(fHz, BUS_PEAK_V, warm) };
  }

  /** The switching frequency for a power, and what then flows; no lower than resonance allows. */
  heat(powerW, warm = 1) {
    const key = `${powerW} ${warm.toFixed(3)}`;
    let found = this.curves.get(key);
    if (!found) {
      let [low, high] = [F_MIN_HZ, F_MAX_HZ];
      for (let step = 0; step < 30; step++) {
        const f = (low + high) / 2;
        const now = this.halfCycle(f, warm);
        const tooNear = now.x < RESONANCE_MARGIN * 2 * Math.PI * f * now.l || now.i > I_LIMIT_A;
        if (now.power > powerW || tooNear) low = f;
        else high = f;
      }
      const fSw = Math.round(high);
      found = { fSw, ...this.halfCycle(fSw, warm) };
      if (this.curves.size > 2000) this.curves.clear();
      this.curves.set(key, found);
    }
    return found;
  }
}

export const POTS = {
  'ferritic-21': new Pot('ferritic-21', 1.06, 1.03, 9.5),
  'cast-iron-21': new Pot('cast-iron-21', 1.22, 1.1, 11),
  'ferritic-18': new Pot('ferritic-18', 0.88, 1.12, 8),
  'stainless-24': new Pot('stainless-24', 0.94, 0.95, 10),
};

/** Frequencies of the lookup's rows, in hertz, and currents of its columns, in ampere (shared/src/lookup/grid.rs). */
export const ROWS_HZ = Array.from({ length: 8 }, (_, k) => 30e3 * (8 / 3) ** (k / 7));
export const COLUMNS_A = Array.from({ length: 17 }, (_, k) => 5 * (17 ** (k / 16) - 1));
