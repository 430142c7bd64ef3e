//! Linux drives boards over USB: a guest under QEMU, with the host program in it. `cargo xtask usb` runs this.

#[path = "usb_linux/boards.rs"]
mod boards;
#[path = "usb_linux/guest.rs"]
mod guest;
#[path = "usb_linux/initramfs.rs"]
mod initramfs;

use std::time::{Duration, Instant};

use boards::Board;
use guest::Guest;
use ihd_stm32g474::usb::usbip::Server;

#[test]
#[ignore = "needs QEMU and a kernel: cargo xtask usb"]
fn scratch() {
    let began = Instant::now();
    let mut guest = Guest::boot().unwrap();
    println!("booted {:?}", began.elapsed());
    let image = std::path::PathBuf::from(std::env::var_os("IHD_STM32G474_IMAGE").unwrap());
    let board = Board::emulated(&image, 0x12).unwrap();
    let server = Server::start([board.cable.clone()]).unwrap();
    let port = server.address().port();
    let mut run = |line: &str| {
        let began = Instant::now();
        let answer = guest.run(line, Duration::from_secs(120)).unwrap();
        println!(
            "$ {line}\n{}[{} in {:?}]",
            answer.text,
            answer.status,
            began.elapsed()
        );
    };
    run("ihd --version");
    run(&format!("vhci-attach 10.0.2.2:{port} 1-1 0"));
    run("sleep 2; dmesg | tail -12; ls -R /dev/bus/usb; cat /sys/bus/usb/devices/1-1/serial");
    run("usb-descriptors 123456789ABCDEF011223344; ihd trainer --device usb:1");
    run("ihd record --device usb --out a.mcap --duration 20 --power 1000");
    run("time ihd trainer --device usb --power 1000 --no-store");
    run("free; cat /proc/uptime");
}
