//! Parser of an alternate setting's string, which describes a memory: `@Internal Flash   /0x08000000/256*02Kg`.

use std::num::ParseIntError;

/// Memory with its regions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MappedMemory {
    /// Name: `Internal Flash`.
    pub name: String,
    /// Regions.
    pub regions: Vec<Region>,
}

/// Sectors from an address on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// First address.
    pub address: u32,
    /// Sectors, in order of address.
    pub sectors: Vec<Sectors>,
}

/// Sectors of the same kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sectors {
    /// Number of sectors.
    pub count: u32,
    /// Size of each in bytes.
    pub bytes: u32,
    /// `true` if they can be read.
    pub readable: bool,
    /// `true` if they can be erased.
    pub erasable: bool,
    /// `true` if they can be written.
    pub writable: bool,
}

/// Error for a text that is no layout.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// A part is missing.
    #[error("no name, address and sectors in {0:?}")]
    Shape(String),
    /// A number is invalid or too large.
    #[error("no number: {0:?}")]
    Number(String),
}

impl MappedMemory {
    /// Parses a layout.
    ///
    /// # Errors
    /// [`LayoutError`] if it is none.
    pub fn parse(text: &str) -> Result<Self, LayoutError> {
        let shape = || LayoutError::Shape(text.to_owned());
        let mut parts = text.strip_prefix('@').ok_or_else(shape)?.split('/');
        let name = parts.next().ok_or_else(shape)?.trim().to_owned();
        let mut regions = Vec::new();
        while let Some(address) = parts.next() {
            let address = hexadecimal(address)?;
            let sectors = parts.next().ok_or_else(shape)?;
            let sectors = sectors.split(',').map(sectors_of);
            let region = Region {
                address,
                sectors: sectors.collect::<Result<_, _>>()?,
            };
            // It must end within 32 bits.
            if u64::from(address) + region.bytes() > 1 << 32 {
                return Err(LayoutError::Number(text.to_owned()));
            }
            regions.push(region);
        }
        if regions.is_empty() {
            return Err(shape());
        }
        Ok(Self { name, regions })
    }

    /// Returns `true` if one of its regions begins at this address.
    pub fn begins_at(&self, address: u32) -> bool {
        self.regions.iter().any(|region| region.address == address)
    }

    /// Returns `true` if it contains all of these bytes.
    pub fn holds(&self, address: u32, bytes: usize) -> bool {
        self.regions.iter().any(|region| {
            let offset = u64::from(address).checked_sub(region.address.into());
            offset.is_some_and(|offset| offset + bytes as u64 <= region.bytes())
        })
    }
}

impl Region {
    /// Total size in bytes.
    pub fn bytes(&self) -> u64 {
        let bytes = |s: &Sectors| u64::from(s.count) * u64::from(s.bytes);
        self.sectors.iter().map(bytes).fold(0, u64::saturating_add)
    }
}

fn hexadecimal(text: &str) -> Result<u32, LayoutError> {
    let wrong = || LayoutError::Number(text.to_owned());
    let digits = text.trim().strip_prefix("0x").ok_or_else(wrong)?;
    u32::from_str_radix(digits, 16).map_err(|_| wrong())
}

/// Parses `256*02Kg`: count, size, unit, and access rights: bit 0 read, bit 1 erase, bit 2 write.
fn sectors_of(text: &str) -> Result<Sectors, LayoutError> {
    let wrong = || LayoutError::Number(text.to_owned());
    let number = |digits: &str| -> Result<u32, LayoutError> {
        digits.trim().parse().map_err(|_: ParseIntError| wrong())
    };
    let (count, size) = text.split_once('*').ok_or_else(wrong)?;
    let access = size.chars().last().filter(char::is_ascii_lowercase);
    let access = access.ok_or_else(wrong)? as u32;
    let size = &size[..size.len() - 1];
    let (digits, unit) = match size.chars().last() {
        Some('K') => (&size[..size.len() - 1], 1024),
        Some('M') => (&size[..size.len() - 1], 1024 * 1024),
        Some('B' | ' ') => (&size[..size.len() - 1], 1),
        _ => (size, 1),
    };
    let bytes = number(digits)?.checked_mul(unit).ok_or_else(wrong)?;
    Ok(Sectors {
        count: number(count)?,
        bytes,
        readable: access & 1 != 0,
        erasable: access & 2 != 0,
        writable: access & 4 != 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_stm32g474_says() {
        let flash = MappedMemory::parse("@Internal Flash   /0x08000000/256*02Kg").unwrap();
        assert_eq!(flash.name, "Internal Flash");
        assert!(flash.begins_at(0x0800_0000));
        let sectors = flash.regions[0].sectors[0];
        assert_eq!((sectors.count, sectors.bytes), (256, 2048));
        assert!(sectors.readable && sectors.erasable && sectors.writable);
        assert!(flash.holds(0x0807_F800, 2048));
        assert!(!flash.holds(0x0807_F801, 2048));
        assert!(!flash.holds(0x07FF_FFFF, 1));
        let text = "@Option Bytes   /0x1FFF7800/01*048 e/0x1FFFF800/01*048 e";
        let options = MappedMemory::parse(text).unwrap();
        assert!(options.begins_at(0x1FFF_7800) && options.begins_at(0x1FFF_F800));
        let sectors = options.regions[1].sectors[0];
        assert_eq!((sectors.count, sectors.bytes), (1, 48));
        assert!(sectors.readable && !sectors.erasable && sectors.writable);
    }

    #[test]
    fn what_other_chips_say() {
        let f4 =
            MappedMemory::parse("@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg").unwrap();
        assert_eq!(f4.regions[0].bytes(), 1024 * 1024);
        let l4 = MappedMemory::parse("@OTP Memory /0x1FFF7000/01*0001Ke").unwrap();
        assert_eq!(l4.regions[0].bytes(), 1024);
        let u5 = MappedMemory::parse("@Option Bytes   /0x40022040/01*64 e").unwrap();
        assert_eq!(u5.regions[0].bytes(), 64);
    }

    #[test]
    fn what_is_none_is_refused() {
        for text in [
            "",
            "@",
            "Internal Flash/0x08000000/256*02Kg",
            "@Internal Flash",
            "@Internal Flash/0x08000000",
            "@Internal Flash/08000000/256*02Kg",
            "@Internal Flash/0x108000000/256*02Kg",
            "@Internal Flash/0x08000000/",
            "@Internal Flash/0x08000000/256",
            "@Internal Flash/0x08000000/256*",
            "@Internal Flash/0x08000000/256*g",
            "@Internal Flash/0x08000000/256*02K",
            "@Internal Flash/0x08000000/-1*02Kg",
            "@Internal Flash/0x08000000/4294967295*02Kg",
            "@Internal Flash/0x08000000/1*4294967295Kg",
            "@Internal Flash/0x08000000/256*02K\u{e9}",
            "@Internal Flash/0x08000000/256*\u{e9}g",
        ] {
            assert!(MappedMemory::parse(text).is_err(), "{text}");
        }
    }

    proptest::proptest! {
        #[test]
        fn no_string_makes_it_panic(text in "@?[ -~]{0,8}(/0x[0-9A-F]{0,9}/[0-9*KMBeg ,]{0,12}){0,3}\\PC{0,3}") {
            if let Ok(memory) = MappedMemory::parse(&text) {
                proptest::prop_assert!(!memory.holds(u32::MAX, 2));
            }
        }
    }
}
