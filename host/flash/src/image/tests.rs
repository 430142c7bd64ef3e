use super::*;
use ihd_fakes::SampleImage;
use proptest::prelude::*;

fn parse(elf: &[u8]) -> Result<Image, ImageError> {
    Image::parse(elf, Some(Path::new("sample.elf")))
}

#[test]
fn a_sealed_image_says_what_it_is() {
    let sample = SampleImage::default();
    let image = parse(&sample.elf()).unwrap();
    assert_eq!(image.build, "ihd-firmware 9.8.7");
    assert_eq!(image.protocol, (2, 2));
    assert_eq!(image.build_id, BuildId([0xB1; 20]));
    assert_eq!(
        image.describe(),
        "ihd-firmware 9.8.7 (build b1b1b1b1, protocol 2.2)"
    );
    let flat = image.flat();
    assert_eq!(image.bytes as usize, flat.len());
    let (covered, crc) = flat.split_at(flat.len() - 4);
    assert_eq!(
        crc,
        crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC)
            .checksum(covered)
            .to_le_bytes()
    );
    assert_eq!(image.crc.to_le_bytes(), crc);
}

#[test]
fn an_unsealed_image_is_refused() {
    let mut elf = SampleImage::default().elf();
    let at = elf
        .windows(8)
        .position(|bytes| bytes == SampleImage::CODE)
        .unwrap();
    elf[at] ^= 1;
    let why = parse(&elf).unwrap_err();
    assert!(matches!(why, ImageError::Unsealed { .. }), "{why}");
    assert!(why.to_string().contains("cargo xtask firmware"), "{why}");
}

#[test]
fn what_belongs_elsewhere_is_refused() {
    let place = 0;
    let sample = SampleImage {
        place,
        ..Default::default()
    };
    assert!(matches!(
        parse(&sample.elf()),
        Err(ImageError::Outside { address: 0, .. })
    ));
    // One double word into the first page of the lookup, and up to it.
    let room = (LOOKUP_ADDRESS - FLASH_ADDRESS) as usize;
    let of = |bytes| SampleImage {
        bytes,
        ..Default::default()
    };
    assert!(matches!(
        parse(&of(room + 8).elf()),
        Err(ImageError::Outside { .. })
    ));
    assert_eq!(parse(&of(room).elf()).unwrap().bytes, 508 * 1024);
}

#[test]
fn what_is_no_firmware_of_ours_is_refused() {
    let magic = *b"NOPE";
    let sample = SampleImage {
        magic,
        ..Default::default()
    };
    assert!(matches!(
        parse(&sample.elf()),
        Err(ImageError::NoHeader { .. })
    ));
    assert!(matches!(parse(b"\x7fELF"), Err(ImageError::NotElf { .. })));
    assert!(matches!(parse(b""), Err(ImageError::NotElf { .. })));
    let entry = 0x0800_0300;
    let sample = SampleImage {
        entry,
        ..Default::default()
    };
    let even = parse(&sample.elf()).unwrap_err();
    assert!(matches!(even, ImageError::Vectors { .. }), "{even}");
    let machine = 62;
    let sample = SampleImage {
        machine,
        ..Default::default()
    };
    assert!(matches!(
        parse(&sample.elf()),
        Err(ImageError::NotElf { .. })
    ));
}

#[test]
fn a_gap_is_refused() {
    let gap = 8;
    let sample = SampleImage {
        gap,
        ..Default::default()
    };
    assert!(matches!(parse(&sample.elf()), Err(ImageError::Gap { .. })));
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let why = Image::choose(Some(Path::new("/no/such.elf"))).unwrap_err();
    assert!(why.to_string().contains("/no/such.elf"), "{why}");
    assert!(matches!(
        Image::read(Path::new("/")),
        Err(ImageError::NotElf { .. })
    ));
}

proptest! {
    /// An image that is damaged or cut off is an error or harmless, never a panic; one that is accepted has a right CRC.
    #[test]
    fn damage_is_no_panic(at in 0_usize..2_048, to: u8, cut in 0_usize..4_096) {
        let mut elf = SampleImage::default().elf();
        elf.truncate(cut.max(1));
        if let Some(byte) = elf.get_mut(at) {
            *byte = to;
        }
        if let Ok(image) = parse(&elf) {
            let flat = image.flat();
            let covered = image.bytes as usize - 4;
            prop_assert_eq!(CRC32.checksum(&flat[..covered]), image.crc);
        }
    }
}
