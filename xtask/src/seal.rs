//! CRC of the board's image, which the firmware checks at start and while it runs. It is written into the linked file, so that
//! every way of flashing this file flashes the same bytes.

use std::fs;
use std::path::Path;

use anyhow::{Context, ensure};
use object::{Object, ObjectSection, ObjectSegment};

/// First address of the STM32G474's flash.
const FLASH: u64 = 0x0800_0000;

/// Section of the CRC, after everything that it covers (firmware/ccm.x).
const SECTION: &str = ".image_crc";

/// CRC-32 as in zlib and on the wire.
const CRC32: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// Bytes of the file that are flashed, with their address.
#[derive(Debug)]
struct Piece<'a> {
    address: u64,
    bytes: &'a [u8],
}

/// Writes the CRC into an image. A file without a place for it is not changed.
pub fn seal(image: &Path) -> anyhow::Result<()> {
    let mut file = fs::read(image).with_context(|| image.display().to_string())?;
    let Some((at, crc)) = checksum(&file).with_context(|| image.display().to_string())? else {
        return Ok(());
    };
    let place = file.get_mut(at..at + 4).context("no room for the CRC")?;
    place.copy_from_slice(&crc.to_le_bytes());
    fs::write(image, file).with_context(|| image.display().to_string())
}

/// Offset of the CRC in the file, and its value.
fn checksum(file: &[u8]) -> anyhow::Result<Option<(usize, u32)>> {
    let elf = object::read::elf::ElfFile32::<object::Endianness>::parse(file)?;
    let Some(section) = elf.section_by_name(SECTION) else {
        return Ok(None);
    };
    let (at, _) = section.file_range().context("the CRC is not in the file")?;
    let mut pieces = Vec::new();
    for segment in elf.segments() {
        let address = segment.elf_program_header().p_paddr.get(elf.endian());
        let bytes = segment.data()?;
        if !bytes.is_empty() {
            pieces.push(Piece {
                address: address.into(),
                bytes,
            });
        }
    }
    Ok(Some((at as usize, cover(pieces, section.address())?)))
}

/// CRC of all pieces from the beginning of the flash to `end`. Gaps between them are an error: their contents in flash are unknown.
fn cover(mut pieces: Vec<Piece>, end: u64) -> anyhow::Result<u32> {
    pieces.sort_by_key(|piece| piece.address);
    let (mut digest, mut next) = (CRC32.digest(), FLASH);
    for piece in pieces.iter().filter(|piece| piece.address < end) {
        ensure!(
            piece.address == next,
            "the image has {:#x} bytes between {next:#x} and {:#x} that nothing fills",
            piece.address.wrapping_sub(next),
            piece.address
        );
        let length = piece.bytes.len().min((end - piece.address) as usize);
        digest.update(piece.bytes.get(..length).unwrap_or_default());
        next += length as u64;
    }
    ensure!(next == end, "the image ends at {next:#x}, not at {end:#x}");
    Ok(digest.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(offset: u64, bytes: &[u8]) -> Piece<'_> {
        let address = FLASH + offset;
        Piece { address, bytes }
    }

    /// The check value of CRC-32/ISO-HDLC, in pieces out of order, with the place of the CRC behind it.
    #[test]
    fn what_is_flashed_is_covered_and_a_gap_is_refused() {
        let whole = vec![piece(4, b"56789\xFF\xFF\xFF\xFF"), piece(0, b"1234")];
        assert_eq!(cover(whole, FLASH + 9).unwrap(), 0xCBF4_3926);
        let gap = vec![piece(0, b"1234"), piece(8, b"56789")];
        assert!(cover(gap, FLASH + 13).is_err());
        let short = vec![piece(0, b"1234")];
        assert!(cover(short, FLASH + 8).is_err());
    }
}
