//! The flash image: bytes at addresses, and the names that tests look up.

use std::collections::HashMap;
use std::path::Path;

use object::{Object as _, ObjectSegment as _, ObjectSymbol as _};

/// Why an image is refused.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}; `cargo xtask firmware` builds it")]
    Read {
        /// The file.
        path: String,
        /// What the operating system reports.
        source: std::io::Error,
    },
    /// It is no ELF file, or a damaged one.
    #[error("{path} is no ELF image: {source}")]
    Elf {
        /// The file.
        path: String,
        /// What is wrong with it.
        source: object::Error,
    },
    /// It holds bytes that do not lie in the flash.
    #[error("the image has {bytes} bytes at {address:#010x}, which is not flash")]
    Outside {
        /// Where.
        address: u64,
        /// How many.
        bytes: usize,
    },
}

/// First address of the flash.
pub const FLASH: u64 = 0x0800_0000;

/// Bytes of it that hold the program; the two pages behind are the program's own to write.
pub const PROGRAM_BYTES: usize = 508 * 1024;

/// The bytes that are flashed.
#[derive(Clone, Debug)]
pub struct Image {
    /// The program's part of the flash; 0xFF where nothing was written.
    pub flash: Vec<u8>,
    /// Whether some of them are copied to CCM SRAM: then the RAM's last 32 KiB, which are the same memory, are not
    /// there for the program.
    pub uses_ccm: bool,
    symbols: HashMap<String, u32>,
}

impl Image {
    /// Reads an ELF file: the bytes of its segments, at the addresses at which they are flashed.
    ///
    /// # Errors
    /// The file cannot be read, is no ELF file, or does not fit the flash.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let name = path.display().to_string();
        let bytes = std::fs::read(path).map_err(|source| ImageError::Read {
            path: name.clone(),
            source,
        })?;
        let elf = |source| ImageError::Elf {
            path: name.clone(),
            source,
        };
        let file =
            object::read::elf::ElfFile32::<object::Endianness>::parse(&*bytes).map_err(elf)?;
        let mut flash = vec![0xFF; PROGRAM_BYTES];
        let mut uses_ccm = false;
        for segment in file.segments() {
            let data = segment.data().map_err(elf)?;
            if data.is_empty() {
                continue;
            }
            uses_ccm |= (0x1000_0000..0x1000_8000).contains(&segment.address());
            let address = u64::from(
                segment
                    .elf_program_header()
                    .p_paddr
                    .get(object::Endianness::Little),
            );
            let at = address.checked_sub(FLASH).map(|at| at as usize);
            let place = at.and_then(|at| flash.get_mut(at..at + data.len()));
            let place = place.ok_or(ImageError::Outside {
                address,
                bytes: data.len(),
            })?;
            place.copy_from_slice(data);
        }
        let symbols = file
            .symbols()
            .filter_map(|symbol| Some((symbol.name().ok()?.to_owned(), symbol.address() as u32)));
        Ok(Self {
            flash,
            uses_ccm,
            symbols: symbols.collect(),
        })
    }

    /// The same chip before anything was flashed.
    pub fn erased(&self) -> Self {
        Self {
            flash: vec![0xFF; PROGRAM_BYTES],
            uses_ccm: self.uses_ccm,
            symbols: HashMap::new(),
        }
    }

    /// Address of a symbol by its name in the linker's table.
    pub fn symbol(&self, name: &str) -> Option<u32> {
        self.symbols.get(name).copied()
    }

    /// Address of the first symbol whose name contains a text.
    pub fn symbol_like(&self, part: &str) -> Option<u32> {
        self.symbols
            .iter()
            .find(|(name, _)| name.contains(part))
            .map(|(_, &address)| address)
    }
}
