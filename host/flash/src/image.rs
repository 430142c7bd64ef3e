//! The firmware's image: an ELF file as left by `cargo xtask firmware`, checked before use.

use std::fmt;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

use ihd_shared::image::{
    FLASH_ADDRESS, HEADER_ADDRESS, HEADER_BYTES, Header, LOOKUP_ADDRESS, NOTE_ADDRESS, NOTE_BYTES,
    build_id,
};
use ihd_shared::wire::frame::CRC32;
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Architecture, Endianness, Object, ObjectSegment};
use serde::{Serialize, Serializer};

/// Path of the image below a checkout's root.
pub const OF_CHECKOUT: &str = "target/firmware/images/stm32g474.elf";

/// Limit of a file's size in bytes: the image is 1 MB with all debug information.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// RAM in which a stack may begin: SRAM1 and SRAM2.
const RAM: std::ops::RangeInclusive<u32> = 0x2000_0000..=0x2001_8000;

/// Error of an image file.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file cannot be read.
    #[error("image {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// It is no ELF file of a 32-bit Arm, or is cut.
    #[error(
        "image {path} is no ELF file for a 32-bit Arm ({why}); give the file that `cargo xtask firmware` writes"
    )]
    NotElf {
        /// The file.
        path: String,
        /// Reason.
        why: String,
    },
    /// It places bytes outside the image's part of the flash.
    #[error(
        "image {path} places {bytes} bytes at {address:#010x}, outside of {FLASH_ADDRESS:#010x} to {LOOKUP_ADDRESS:#010x}, \
         which is the STM32G474's flash without the pages of the lookup; this image is for another chip or too large"
    )]
    Outside {
        /// The file.
        path: String,
        /// Address.
        address: u64,
        /// Number of bytes.
        bytes: usize,
    },
    /// Bytes between the beginning of the flash and the CRC are missing or overlap.
    #[error(
        "image {path} has a gap or an overlap at {address:#010x}; build it anew with `cargo xtask firmware`"
    )]
    Gap {
        /// The file.
        path: String,
        /// Address.
        address: u32,
    },
    /// Header or build id are not at their places.
    #[error(
        "image {path} has no header of an ihd firmware; it is another program, or older than protocol 2.2: build it with `cargo xtask firmware`"
    )]
    NoHeader {
        /// The file.
        path: String,
    },
    /// Stack or entry are outside the ranges of a program.
    #[error(
        "image {path} begins with {stack:#010x} and {entry:#010x}, which are no stack and no entry of an STM32G474's program"
    )]
    Vectors {
        /// The file.
        path: String,
        /// First word.
        stack: u32,
        /// Second word.
        entry: u32,
    },
    /// The last word is not the CRC of the bytes before it.
    #[error(
        "image {path} is not sealed: its CRC is {stored:#010x}, but {computed:#010x} would be right. What cargo leaves in \
         its own folder has none; flash {OF_CHECKOUT}, which `cargo xtask firmware` writes"
    )]
    Unsealed {
        /// The file.
        path: String,
        /// CRC in the file.
        stored: u32,
        /// Computed CRC.
        computed: u32,
    },
    /// No image was given, none is built in, and there is none in a checkout.
    #[error(
        "there is no image to flash: this program carries none, and there is no {OF_CHECKOUT} here; build one with `cargo \
         xtask firmware` in a checkout, or give one with --image (a release archive has it)"
    )]
    None,
}

/// Hash that the linker computed over its input: images with the same id are the same.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct BuildId(pub [u8; 20]);

impl BuildId {
    /// Converts a device's bytes; `None` unless there are 20.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().map(Self)
    }

    /// First eight hexadecimal digits.
    pub fn short(&self) -> String {
        self.to_string().chars().take(8).collect()
    }
}

impl fmt::Display for BuildId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for BuildId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "BuildId({self})")
    }
}

impl Serialize for BuildId {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

/// Contiguous bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageSegment {
    /// Address of the first byte.
    pub address: u32,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// Image that may be flashed: it lies in the flash, outside the pages of the lookup, without a gap, and its CRC is right.
#[derive(Clone, Debug)]
pub struct Image {
    /// Path of the file; `None` if it is built in.
    pub path: Option<PathBuf>,
    /// Package and version, as in a device's hello: `ihd-firmware 0.1.0`.
    pub build: String,
    /// The build id.
    pub build_id: BuildId,
    /// Major and minor version of its protocol.
    pub protocol: (u16, u16),
    /// Segments from the beginning of the flash to the CRC and its few bytes of padding, in order.
    pub segments: Vec<ImageSegment>,
    /// CRC-32 of all before its last word, which holds it.
    pub crc: u32,
    /// Bytes from the beginning of the flash to the end of the CRC.
    pub bytes: u32,
    elf: Vec<u8>,
}

impl Image {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`ImageError`] for every reason for which the file must not be flashed.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let failed = |source| ImageError::Read {
            path: path.to_owned(),
            source,
        };
        let meta = fs::metadata(path).map_err(failed)?;
        if !meta.is_file() || meta.len() > MAX_FILE_BYTES {
            return Err(ImageError::NotElf {
                path: path.display().to_string(),
                why: "no file, or too large".into(),
            });
        }
        Self::parse(&fs::read(path).map_err(failed)?, Some(path))
    }

    /// Checks a file's bytes; the path is for messages.
    ///
    /// # Errors
    /// Any error of [`Image::read`].
    pub fn parse(elf: &[u8], path: Option<&Path>) -> Result<Self, ImageError> {
        let name = || path.map_or("(built in)".into(), |path| path.display().to_string());
        let not_elf = |why: &dyn fmt::Display| ImageError::NotElf {
            path: name(),
            why: why.to_string(),
        };
        let file = ElfFile32::<Endianness>::parse(elf).map_err(|why| not_elf(&why))?;
        if file.architecture() != Architecture::Arm || !file.is_little_endian() {
            return Err(not_elf(&"another processor"));
        }
        let mut segments = Vec::new();
        for segment in file.segments() {
            let bytes = segment.data().map_err(|why| not_elf(&why))?;
            let address = segment.elf_program_header().p_paddr(file.endian());
            if !bytes.is_empty() {
                segments.push(within_flash(address, bytes, &name)?);
            }
        }
        segments.sort_by_key(|segment| segment.address);
        let flat = flat(&segments).map_err(|address| ImageError::Gap {
            path: name(),
            address,
        })?;
        let no_header = || ImageError::NoHeader { path: name() };
        let header = slice(&flat, HEADER_ADDRESS, HEADER_BYTES).and_then(Header::parse);
        let header = header.ok_or_else(no_header)?;
        let id = slice(&flat, NOTE_ADDRESS, NOTE_BYTES).and_then(build_id);
        let id = BuildId(id.ok_or_else(no_header)?);
        let crc = sealed(&flat, &header, &name)?;
        check_vectors(&flat, &header, &name)?;
        Ok(Self {
            path: path.map(Path::to_owned),
            build: format!("ihd-firmware {}", header.version()),
            build_id: id,
            protocol: (header.protocol_major, header.protocol_minor),
            segments,
            crc,
            bytes: header.crc_address + 4 - FLASH_ADDRESS,
            elf: elf.to_owned(),
        })
    }

    /// Returns the image built into this program; `None` without the feature `image`.
    ///
    /// # Errors
    /// Any error of [`Image::parse`].
    pub fn built_in() -> Option<Result<Self, ImageError>> {
        #[cfg(feature = "image")]
        {
            let elf = include_bytes!(concat!(env!("OUT_DIR"), "/stm32g474.elf"));
            Some(Self::parse(elf, None))
        }
        #[cfg(not(feature = "image"))]
        None
    }

    /// Returns the image of the checkout around the working directory or around this program; `None` if there is none.
    ///
    /// # Errors
    /// Any error of [`Image::read`].
    pub fn of_checkout() -> Option<Result<Self, ImageError>> {
        let program = env::current_exe().ok();
        let beginnings = env::current_dir().ok().into_iter().chain(program);
        let mut roots = beginnings.flat_map(|path| {
            let roots = path.ancestors().map(Path::to_owned).collect::<Vec<_>>();
            roots.into_iter()
        });
        let root = roots.find(|root| {
            root.join("firmware/Cargo.toml").is_file() && root.join(OF_CHECKOUT).is_file()
        })?;
        Some(Self::read(&root.join(OF_CHECKOUT)))
    }

    /// Returns the image of the given file; without one the built-in image, else the checkout's.
    ///
    /// # Errors
    /// Any error of [`Image::read`]; [`ImageError::None`].
    pub fn choose(given: Option<&Path>) -> Result<Self, ImageError> {
        match given {
            Some(path) => Self::read(path),
            None => Self::built_in()
                .or_else(Self::of_checkout)
                .unwrap_or(Err(ImageError::None)),
        }
    }

    /// Bytes of the file, with debug information and the texts of the log.
    pub fn elf(&self) -> &[u8] {
        &self.elf
    }

    /// Bytes to flash, from the beginning of the flash on.
    pub fn flat(&self) -> Vec<u8> {
        self.segments
            .iter()
            .flat_map(|segment| segment.bytes.iter().copied())
            .collect()
    }

    /// Build, build id and protocol in one line.
    pub fn describe(&self) -> String {
        let (major, minor) = self.protocol;
        let id = self.build_id.short();
        format!("{} (build {id}, protocol {major}.{minor})", self.build)
    }
}

fn within_flash(
    address: u32,
    bytes: &[u8],
    name: &dyn Fn() -> String,
) -> Result<ImageSegment, ImageError> {
    let end = u64::from(address) + bytes.len() as u64;
    if address < FLASH_ADDRESS || end > u64::from(LOOKUP_ADDRESS) {
        return Err(ImageError::Outside {
            path: name(),
            address: address.into(),
            bytes: bytes.len(),
        });
    }
    Ok(ImageSegment {
        address,
        bytes: bytes.to_owned(),
    })
}

/// Joins all segments from the beginning of the flash; `Err` with the address of a gap or overlap.
fn flat(segments: &[ImageSegment]) -> Result<Vec<u8>, u32> {
    let mut flat = Vec::new();
    for segment in segments {
        let next = FLASH_ADDRESS + flat.len() as u32;
        if segment.address != next {
            return Err(next.min(segment.address));
        }
        flat.extend_from_slice(&segment.bytes);
    }
    Ok(flat)
}

fn slice(flat: &[u8], address: u32, bytes: usize) -> Option<&[u8]> {
    let at = address.checked_sub(FLASH_ADDRESS)? as usize;
    flat.get(at..at.checked_add(bytes)?)
}

fn read_word(flat: &[u8], address: u32) -> Option<u32> {
    let bytes = slice(flat, address, 4)?;
    Some(u32::from_le_bytes(bytes.try_into().ok()?))
}

/// Returns the CRC if it is right.
fn sealed(flat: &[u8], header: &Header, name: &dyn Fn() -> String) -> Result<u32, ImageError> {
    let stored =
        read_word(flat, header.crc_address).ok_or_else(|| ImageError::NoHeader { path: name() })?;
    let covered = (header.crc_address - FLASH_ADDRESS) as usize;
    let computed = CRC32.checksum(flat.get(..covered).unwrap_or_default());
    if stored == computed {
        Ok(stored)
    } else {
        Err(ImageError::Unsealed {
            path: name(),
            stored,
            computed,
        })
    }
}

fn check_vectors(
    flat: &[u8],
    header: &Header,
    name: &dyn Fn() -> String,
) -> Result<(), ImageError> {
    let stack = read_word(flat, FLASH_ADDRESS).unwrap_or_default();
    let entry = read_word(flat, FLASH_ADDRESS + 4).unwrap_or_default();
    let code = FLASH_ADDRESS..header.crc_address;
    if RAM.contains(&stack) && stack.is_multiple_of(4) && entry & 1 == 1 && code.contains(&entry) {
        Ok(())
    } else {
        Err(ImageError::Vectors {
            path: name(),
            stack,
            entry,
        })
    }
}

#[cfg(test)]
mod tests;
