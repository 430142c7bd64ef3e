//! The image's USB, in process: no operating system, the emulated clock.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use ihd_link::Client;
use ihd_sim::adc::{Adc, Noise};
use ihd_sim::behavioural::PotKind;
use ihd_sim::mains::Mains;
use ihd_sim::plant::Plant;
use ihd_stm32g474::bench::Bench;
use ihd_stm32g474::usb::Board;

fn image() -> PathBuf {
    let path = std::env::var_os("IHD_STM32G474_IMAGE");
    path.expect("`cargo xtask board` names the image").into()
}

#[test]
fn scratch() {
    let plant = || Plant::new(Mains::new(50.0), PotKind::Ferromagnetic, Adc::new(Noise::default(), 1).with_filter(500e3));
    let bench = Bench::power_up(&image(), plant).unwrap();
    let cable = bench.with(|machine| machine.cable.clone());
    bench.run_freely(true);
    let began = Instant::now();
    let board = Board::enumerate(&cable, 5);
    println!("{:?} {:?}", began.elapsed(), bench.now_s());
    for v in bench.with(|m| m.violations()) { println!("{v}"); }
    let board = board.unwrap();
    println!("{:02x?}", board.description);
    let mut client = Client::connect(Box::new(board.link())).unwrap();
    println!("{:?} {:?} {:?}", client.hello(), began.elapsed(), bench.now_s());
    client.stream(1, 20).unwrap();
    client.set_power(1000).unwrap();
    let (e0, w0) = (bench.now_s(), Instant::now());
    while bench.now_s() < e0 + 2.0 {
        client.next_event(Duration::from_millis(100)).unwrap();
    }
    println!("{:?} {:?} {:?}", bench.now_s() - e0, w0.elapsed(), client.counters());
    println!("{:?}", client.status());
    for v in bench.with(|m| m.violations()) { println!("{v}"); }
}
