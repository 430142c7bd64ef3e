use std::path::PathBuf;
use ihd_stm32g474::machine::Machine;
use ihd_stm32g474::time::{us, seconds};
use ihd_sim::{plant::Plant, mains::Mains, adc::{Adc, Noise}, behavioural::PotKind};
fn main() {
    let image = PathBuf::from(std::env::args().nth(1).unwrap());
    let ms: u64 = std::env::args().nth(2).unwrap().parse().unwrap();
    let plant = Plant::new(Mains::new(50.0), PotKind::Ferromagnetic, Adc::new(Noise::default(), 1).with_filter(500e3));
    let mut m = Machine::new(&image, plant).unwrap();
    let t = std::time::Instant::now();
    let step = us(1000);
    for k in 0..ms {
        m.run_for(step).unwrap();
        if k < 3 || k % 10 == 0 {
            let pc = m.pc();
            let total = m.timing().total;
            let (br, dma) = (m.chip().pins.bridge(), m.chip().nvic.entries[16+11]);
            println!("{:.3} ms pc {:#x} sp {:#x} instr {} cycles {} resets {:?} bridge {:?} dma {} locked {}", seconds(m.now())*1e3, pc, m.sp(), total.instructions, total.cycles, m.resets, br, dma, m.is_locked_up());
        }
    }
    println!("wall {:?}", t.elapsed());
    for v in m.violations() { println!("{v}"); }
}
