//! Ways to a board's log: a debug probe, the board on USB, a link without a configuration.

use anyhow::Result;
use ihd_flash::log::follow::Way;
use ihd_link::usb;

/// The only board on USB by its address; none where there is none.
pub(super) fn only_board() -> Result<Option<String>> {
    // A machine without USB has no boards there.
    let boards = usb::boards().unwrap_or_default();
    let addresses: Vec<String> = boards.iter().map(|b| format!("usb:{}", b.serial)).collect();
    ensure_usage!(
        addresses.len() < 2,
        "there are {} boards: name one of {}",
        addresses.len(),
        addresses.join(", ")
    );
    Ok(addresses.into_iter().next())
}

/// Through the debug probe with this name, or the only one.
#[cfg(not(feature = "probe"))]
pub(super) fn by_probe(_: Option<&str>) -> Result<Box<dyn Way>> {
    Err(super::super::usage::Usage(
        "this program was built without debug probes, and no board is on USB: name a device (ihd log serial:PATH), or \
         take the program of the release archive, or `cargo run --release --features probe -- log --probe`"
            .into(),
    )
    .into())
}

/// Through the debug probe with this name, or the only one.
#[cfg(feature = "probe")]
pub(super) fn by_probe(selector: Option<&str>) -> Result<Box<dyn Way>> {
    use ihd_flash::log::over_probe::ProbeWay;
    use ihd_flash::probe::Probes;
    Ok(Box::new(ProbeWay::new(Probes::default(), selector)))
}

/// Opens an address, each time anew.
#[cfg(not(feature = "daemon"))]
pub(super) fn opener(
    device: &str,
) -> Result<impl FnMut() -> Result<Box<dyn ihd_link::Transport>, ihd_link::LinkError> + use<>> {
    let spec: ihd_link::DeviceSpec = device.parse().map_err(super::super::usage::Usage::of)?;
    ensure_usage!(
        spec != ihd_link::DeviceSpec::Sim,
        "a simulated hob lives in `ihd hob`: name it as tcp:HOST:PORT"
    );
    Ok(move || spec.open(|| unreachable!("refused above")))
}
