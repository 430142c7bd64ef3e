//! Access to a board's log: a debug probe, the board on USB, or a link without a configuration.

use anyhow::Result;
use ihd_flash::log::follow::LogOpener;
use ihd_link::usb;

/// Address of the only board on USB; `None` if there is none.
pub(super) fn only_board() -> Result<Option<String>> {
    // A machine without USB has no boards on it.
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

/// Access through the debug probe with this selector, or the only one.
#[cfg(not(feature = "probe"))]
pub(super) fn by_probe(_: Option<&str>) -> Result<Box<dyn LogOpener>> {
    Err(super::super::usage::Usage(
        "this program was built without debug probes, and no board is on USB: name a device (ihd log serial:PATH), or \
         take the program of the release archive, or `cargo run --release --features probe -- log --probe`"
            .into(),
    )
    .into())
}

/// Access through the debug probe with this selector, or the only one.
#[cfg(feature = "probe")]
pub(super) fn by_probe(selector: Option<&str>) -> Result<Box<dyn LogOpener>> {
    use ihd_flash::log::over_probe::ProbeLogOpener;
    use ihd_flash::probe::Probes;
    Ok(Box::new(ProbeLogOpener::new(Probes::default(), selector)))
}

/// Returns a function that opens an address, each time it is called.
#[cfg(not(feature = "daemon"))]
pub(super) fn opener(
    device: &str,
) -> Result<impl FnMut() -> Result<Box<dyn ihd_link::Transport>, ihd_link::LinkError> + use<>> {
    let spec: ihd_link::DeviceSpec = device
        .parse()
        .map_err(super::super::usage::Usage::from_error)?;
    ensure_usage!(
        spec != ihd_link::DeviceSpec::Sim,
        "a simulated hob lives in `ihd hob`: name it as tcp:HOST:PORT"
    );
    Ok(move || spec.open(|| unreachable!("refused above")))
}
