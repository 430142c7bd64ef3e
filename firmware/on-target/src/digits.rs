//! The sampling path on samples that are made of integers alone: the same bits wherever it runs.

use ihd_firmware::sampling::path::{AdcBlock, SamplingPath};
use ihd_firmware::sense::bus::BusReading;
use ihd_firmware::sense::product_sums::PairArithmetic;
use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::TrajectoryEntry;
use ihd_shared::wire::frame::CRC32;

/// Blocks that are taken: three half-cycles of 50 Hz at 70 kHz, and some.
pub const BLOCKS: u32 = 800;

/// CRC-32 of the trajectory that [`run`] must leave, on any machine: worked out on x86-64, where firmware/tests/digits.rs holds it.
pub const EXPECTED: u32 = 0x16DD_F9D0;

/// Load that the estimator begins with.
const START: (MicroOhm, PicoHenry) = (MicroOhm(4_000_000), PicoHenry(25_000_000));

/// A triangle of 1024 steps a turn, −256 to 256.
fn triangle(at: i32) -> i32 {
    let at = at.rem_euclid(1_024);
    if at < 512 { at - 256 } else { 768 - at }
}

/// Block number `n`: a voltage with the mains' envelope, a current that lags it by an angle that moves slowly, and noise.
pub fn block(n: u32, noise: &mut u32) -> [Pair; ADC_LOCK_P] {
    // 233 blocks are 10 ms at 70 kHz; never below a tenth.
    let envelope = 26 + (triangle((n * 1_024 / 233) as i32).abs() * 230) / 256;
    core::array::from_fn(|k| {
        let turn = (k as i32 * 3 * 1_024) / ADC_LOCK_P as i32;
        *noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let hiss = |shift: u32| ((*noise >> shift) & 3) as i32 - 1;
        let v = 3 * triangle(turn) * envelope / 256 + hiss(28);
        let i = 2 * triangle(turn - 200 - (n / 8) as i32 % 32) * envelope / 256 + hiss(20);
        Pair {
            v: v as i16,
            i: i as i16,
        }
    })
}

/// Estimates of the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digits {
    /// CRC-32 of what it gave for each block.
    pub crc: u32,
    /// Blocks for which it gave R and L.
    pub estimates: u32,
    /// The last of them.
    pub last: TrajectoryEntry,
}

/// Replays [`BLOCKS`] blocks.
pub fn run(path: &mut SamplingPath<impl PairArithmetic>) -> Digits {
    let (r, l) = START;
    path.set_replay(true, 70_000, r, l);
    let (mut digest, mut noise) = (CRC32.digest(), 1);
    let (mut estimates, mut last) = (0, TrajectoryEntry::default());
    for n in 0..BLOCKS {
        let pairs = block(n, &mut noise);
        let estimate = path.replay_block(&AdcBlock {
            pairs: &pairs,
            zero_crossing: (n % 233 == 0).then_some((n % 61) as u8),
            bus: BusReading::steady(3_000),
            dc_link_ma: None,
            lost: 0,
        });
        match estimate {
            Some(entry) => {
                digest.update(&entry.to_le_bytes());
                (estimates, last) = (estimates + 1, entry);
            }
            None => digest.update(&[0xA5]),
        }
    }
    Digits {
        crc: digest.finalize(),
        estimates,
        last,
    }
}
