//! Header of the image in flash (shared/src/image.rs, firmware/ccm.x).

use ihd_shared::image::{FORMAT, HEADER_BYTES, Header, MAGIC, NOTE_BYTES, VERSION_BYTES, build_id};
use ihd_shared::wire::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

unsafe extern "C" {
    static __image_crc: u32;
    static __build_id_note: [u8; NOTE_BYTES];
}

/// [`Header`] as it lies in flash; only the linker knows the address.
#[repr(C)]
struct InFlash {
    magic: [u8; 4],
    format: u16,
    protocol_major: u16,
    protocol_minor: u16,
    zero: u16,
    crc: *const u32,
    version: [u8; VERSION_BYTES],
}

// SAFETY: the pointer is never dereferenced.
unsafe impl Sync for InFlash {}

const _: () = assert!(size_of::<InFlash>() == HEADER_BYTES && size_of::<Header>() <= HEADER_BYTES);

#[used]
#[unsafe(link_section = ".image_header")]
static HEADER: InFlash = InFlash {
    magic: MAGIC,
    format: FORMAT,
    protocol_major: PROTOCOL_MAJOR,
    protocol_minor: PROTOCOL_MINOR,
    zero: 0,
    crc: &raw const __image_crc,
    version: version(),
};

const fn version() -> [u8; VERSION_BYTES] {
    let (text, mut version) = (env!("CARGO_PKG_VERSION").as_bytes(), [0; VERSION_BYTES]);
    let mut k = 0;
    while k < text.len() {
        version[k] = text[k];
        k += 1;
    }
    version
}

/// The build id that the linker has written; none where it was not asked to.
pub fn own_build_id() -> Option<[u8; 20]> {
    // SAFETY: the linker's note, in flash.
    build_id(unsafe { &__build_id_note })
}
