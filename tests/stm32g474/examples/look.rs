use ihd_sim::{
    adc::{Adc, Noise},
    behavioural::PotKind,
    mains::Mains,
    plant::Plant,
};
use ihd_stm32g474::bench::Bench;
fn main() {
    let image = std::path::PathBuf::from(std::env::args().nth(1).unwrap());
    let b = Bench::power_up(&image, || {
        Plant::new(
            Mains::new(50.0),
            PotKind::Ferromagnetic,
            Adc::new(Noise::default(), 1).with_filter(500e3),
        )
    })
    .unwrap();
    if std::env::args().nth(2).is_some() {
        b.with(|m| {
            m.chip()
                .set_option(ihd_stm32g474::registers::flash::flash_optr::DBANK, 0);
            m.power_cycle().unwrap();
        });
    } else {
        b.run_s(0.05);
        {
            let mut c = ihd_link::Client::connect(Box::new(b.serial())).unwrap();
            use ihd_shared::lookup::*;
            b.with(|m| m.chip().flash.cut_at_operation = Some(1));
            let _ = c.push_lookup(&RlLookup {
                version: 1,
                ..prior::prior()
            });
        }
    }
    for k in 0..60 {
        b.with(move |m| {
            m.run_for(1_360_000).unwrap();
            let t = m.timing().total;
            println!(
                "pc {:x} {} {:?} locked {} sleeping {} e27 {} hard {} nmi {} {:?}",
                m.pc(),
                t.instructions,
                m.resets,
                m.is_locked_up(),
                m.sleeping(),
                m.entries(27),
                m.entries(3),
                m.entries(2),
                m.now() / 1360
            );
        });
    }
    b.with(|m| {
        for v in m.violations() {
            println!("{v}");
        }
    });
}
