//! Checks of the firmware against this host, and against the available image.

use ihd_flash::{BuildId, Image};
use ihd_link::{BoardFacts, Client};
use ihd_shared::wire::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

use crate::Check;

/// Checks protocol, version, build id and CRC. `image`: the image that `ihd flash` would install, or the reason why there is none;
/// `board`: the identity reported by the device, or the reason why there is none.
pub fn checks(
    client: &Client,
    board: Result<&BoardFacts, &str>,
    image: Result<&Image, &str>,
) -> Vec<Check> {
    vec![
        protocol(client),
        version(client, image),
        build_id(board, image),
    ]
}

fn protocol(client: &Client) -> Check {
    const NAME: &str = "protocol";
    // A device of another major version cannot be connected.
    let (theirs, ours) = (client.hello().protocol_minor, PROTOCOL_MINOR);
    let versions = format!("{PROTOCOL_MAJOR}.{theirs}, this host {PROTOCOL_MAJOR}.{ours}");
    match theirs.cmp(&ours) {
        std::cmp::Ordering::Equal => Check::pass(NAME, versions),
        std::cmp::Ordering::Less => Check::fail(
            NAME,
            format!("{versions}: the firmware is older, and part of this host finds no answer"),
            "ihd flash",
        ),
        std::cmp::Ordering::Greater => Check::pass(NAME, format!("{versions}: a newer firmware"))
            .with_remedy("A newer host knows more of it"),
    }
}

fn version(client: &Client, image: Result<&Image, &str>) -> Check {
    const NAME: &str = "version";
    let runs = client.hello().build.as_str();
    match image {
        Ok(image) if runs == image.build => Check::pass(NAME, runs),
        Ok(image) => Check::fail(
            NAME,
            format!("{runs} runs, {} is at hand", image.build),
            "ihd flash puts it there",
        ),
        Err(why) => Check::not_tested(NAME, format!("{runs} runs; nothing to compare with: {why}")),
    }
}

fn build_id(board: Result<&BoardFacts, &str>, image: Result<&Image, &str>) -> Check {
    const NAME: &str = "image";
    let board = match board {
        Ok(board) => board,
        Err(why) => return Check::not_tested(NAME, why),
    };
    let Some(runs) = BuildId::from_bytes(&board.build_id) else {
        return Check::not_tested(NAME, "the device has no build id: it is simulated");
    };
    let image = match image {
        Ok(image) => image,
        Err(why) => {
            let why = format!(
                "build {} runs; nothing to compare with: {why}",
                runs.short()
            );
            return Check::not_tested(NAME, why);
        }
    };
    if runs != image.build_id {
        return Check::fail(
            NAME,
            format!(
                "build {} runs, {} is at hand",
                runs.short(),
                image.build_id.short()
            ),
            "ihd flash puts it there",
        );
    }
    match board.sealed_crc == image.crc {
        true => Check::pass(NAME, format!("build {} runs and is at hand", runs.short())),
        false => Check::fail(
            NAME,
            format!(
                "build {} with CRC {:#010x}, the image at hand has {:#010x}",
                runs.short(),
                board.sealed_crc,
                image.crc
            ),
            "ihd flash: what runs was changed after it was built",
        ),
    }
}
