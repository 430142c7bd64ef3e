use ihd_stm32g474::bench::Bench;
use ihd_sim::{plant::Plant, mains::Mains, adc::{Adc, Noise}, behavioural::PotKind};
fn main() {
    let image = std::path::PathBuf::from(std::env::args().nth(1).unwrap());
    let b = Bench::power_up(&image, || Plant::new(Mains::new(50.0), PotKind::Ferromagnetic, Adc::new(Noise::default(), 1).with_filter(500e3))).unwrap();
    for _ in 0..25 { b.run_s(0.001);
    b.with(|m| {
        let t = m.timing().total;
        println!("pc {:x} {t:?} {:?} locked {} sleeping {} e27 {} {:?}", m.pc(), m.resets, m.is_locked_up(), m.sleeping(), m.entries(27), m.now());
    });}
    b.with(|m| for v in m.violations() { println!("{v}"); });
}
