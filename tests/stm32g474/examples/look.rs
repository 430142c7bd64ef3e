use ihd_stm32g474::bench::Bench;
use ihd_link::Transport;
use ihd_stm32g474::registers as reg;
use ihd_sim::{plant::Plant, mains::Mains, adc::{Adc, Noise}, behavioural::PotKind};
fn main() {
    let image = std::path::PathBuf::from(std::env::args().nth(1).unwrap());
    let b = Bench::power_up(&image, || Plant::new(Mains::new(50.0), PotKind::Ferromagnetic, Adc::new(Noise::default(), 1).with_filter(500e3))).unwrap();
    b.run_s(0.02);
    let mut s = b.serial();
    let mut s2 = b.serial(); let t = std::thread::spawn(move || { let r = ihd_link::Client::connect(Box::new(s2)); println!("client {:?}", r.map(|c| c.hello().clone())); }); t.join().unwrap(); let _ = &mut s;
    let mut histogram = std::collections::BTreeMap::new();
    for _ in 0..3 { let pc = b.with(|m| { m.run_for(3001).unwrap(); (m.pc(), m.chip().nvic.is_handler()) }); *histogram.entry(pc).or_insert(0) += 1; }
    let mut h: Vec<_> = histogram.into_iter().collect(); h.sort_by_key(|x| -x.1); for ((pc, handler), n) in h.iter().take(25) { println!("{pc:x} {handler} {n}"); }
    b.with(|m| for v in m.violations() { println!("{v}"); });
    for _ in 0..1 {
    b.run_s(0.002);
    b.with(|m| {
        let c = m.chip();
        println!("cr1 {:x} cr3 {:x} brr {:x} inbound {} entries91 {} dma {} usb {} now {}", c.file.word(reg::lpuart1::cr1::ADDRESS), c.file.word(reg::lpuart1::cr3::ADDRESS), c.file.word(reg::lpuart1::brr::ADDRESS), c.serial.inbound.len(), c.nvic.entries[16+91], c.nvic.entries[27], c.nvic.entries[36], c.log.now);
        println!("iser {:x?} pend {:x?}", (0..4).map(|k| c.nvic.read(0x100+4*k).unwrap()).collect::<Vec<_>>(), (0..4).map(|k| c.nvic.read(0x200+4*k).unwrap()).collect::<Vec<_>>());
        println!("serial {:?}", c.serial);
        let t = m.timing().total; println!("pc {:x} {t:?} {:?}", m.pc(), m.resets);
    });}
}
