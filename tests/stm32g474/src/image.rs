//! Flash image: bytes at addresses, and the symbols that tests use.

use std::collections::HashMap;
use std::path::Path;

use object::{Object as _, ObjectSegment as _, ObjectSymbol as _};

/// Error in reading an image.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}; `cargo xtask firmware` builds it")]
    Read {
        /// Path of the file.
        path: String,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file is no ELF file, or is damaged.
    #[error("{path} is no ELF image: {source}")]
    Elf {
        /// Path of the file.
        path: String,
        /// Error of the ELF parser.
        source: object::Error,
    },
    /// The file holds bytes outside the flash.
    #[error("the image has {bytes} bytes at {address:#010x}, which is not flash")]
    Outside {
        /// Address of the bytes.
        address: u64,
        /// Number of bytes.
        bytes: usize,
    },
}

/// First address of the flash.
pub const FLASH: u64 = 0x0800_0000;

/// Size of the program's part in bytes; the program may write the two pages after it.
pub const PROGRAM_BYTES: usize = 508 * 1024;

/// Content of the flash, with the symbols of its program.
#[derive(Clone, Debug)]
pub struct Image {
    /// The program's part of the flash; 0xFF where nothing was written.
    pub flash: Vec<u8>,
    /// Set if some bytes are copied to CCM SRAM. The program then has no access to the RAM's last 32 KiB, which are the same
    /// memory.
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

    /// Image of the same chip before it was flashed.
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
