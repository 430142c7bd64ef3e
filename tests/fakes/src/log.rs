//! ELF file with log messages only, and frames of a board's log.

/// Messages and their parts: tag and format string, as written by defmt.
#[derive(Clone, Debug)]
pub struct SampleLog {
    strings: Vec<(&'static str, &'static str)>,
    encoding: &'static str,
}

impl SampleLog {
    /// Creates a file with these strings, numbered from 1.
    pub fn new(strings: &[(&'static str, &'static str)]) -> Self {
        Self {
            strings: strings.to_vec(),
            encoding: "rzcobs",
        }
    }

    /// Creates one message of each kind of value, numbered from 1, for the fuzzer.
    pub fn of_everything() -> Self {
        Self::new(&[
            ("defmt_info", "watchdog runs: {=u32} µs"),
            ("defmt_error", "self-test: fault {=u16:#06x}"),
            ("defmt_warn", "{=str} and {=istr}, {=[u8]:a}, {=[u8;3]:x}"),
            (
                "defmt_debug",
                "{=bool} {=char} {=f32} {=i8} {=i64:x} {=u128}",
            ),
            (
                "defmt_trace",
                "{0=0..4} {0=4..12:b} {1=?} {2=[?]} {3=[?;2]:a}",
            ),
            ("defmt_println", "{=__internal_Debug} {=__internal_Display}"),
            (
                "defmt_info",
                "{=u64:us} {=u64:tms} {=u64:ms} {=usize:05} {=isize} {=f64}",
            ),
            (
                "defmt_derived",
                "Idle|Heating {{ power_w: {=u16} }}|Of({=?})",
            ),
            ("defmt_derived", "Pair {{ v: {=i16}, i: {=i16} }}"),
            ("defmt_derived", "{=[?]}"),
            ("defmt_derived", "{=__internal_FormatSequence}"),
            ("defmt_prim", "{=u8}"),
            ("defmt_str", "interned"),
            ("defmt_derived", "nothing"),
            ("defmt_info", "cbor {=[u8]:cbor}, {=u8:?} {=str:?}"),
        ])
    }

    /// Sets another encoding.
    pub fn encoded_as(mut self, encoding: &'static str) -> Self {
        self.encoding = encoding;
        self
    }

    /// Returns the frame of a message with its values, as sent by a board.
    pub fn frame(number: u16, values: &[u8]) -> Vec<u8> {
        let bytes = [&number.to_le_bytes(), values].concat();
        [encode(&bytes), vec![0]].concat()
    }

    /// Returns the file with nothing else in it.
    pub fn elf(&self) -> Vec<u8> {
        let mut elf = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
        // An executable for Arm.
        for half in [2u16, 40] {
            elf.extend(half.to_le_bytes());
        }
        for word in [1u32, 0, 0, 0, 0x0500_0000] {
            elf.extend(word.to_le_bytes());
        }
        for half in [52u16, 32, 0, 0, 0, 0] {
            elf.extend(half.to_le_bytes());
        }
        self.within(elf)
    }

    /// Adds these messages to another ELF file without sections.
    pub fn within(&self, mut elf: Vec<u8>) -> Vec<u8> {
        let mut headers = vec![0; 40];
        // Name, type, link, info, alignment, entry size.
        let kinds: [[u32; 6]; 4] = [
            [1, 1, 0, 0, 1, 0],
            [8, 2, 3, 1, 4, 16],
            [16, 3, 0, 0, 1, 0],
            [24, 3, 0, 0, 1, 0],
        ];
        for (content, [name, kind, link, info, alignment, entry]) in
            self.sections().iter().zip(kinds)
        {
            elf.resize(elf.len().next_multiple_of(4), 0);
            let (at, size) = (elf.len() as u32, content.len() as u32);
            let words = [name, kind, 0, 0, at, size, link, info, alignment, entry];
            headers.extend(words.iter().flat_map(|word| word.to_le_bytes()));
            elf.extend_from_slice(content);
        }
        elf.resize(elf.len().next_multiple_of(4), 0);
        let place = elf.len() as u32;
        // Offset of the section headers; their size, number, and the index of the names.
        elf.splice(32..36, place.to_le_bytes());
        let halves = [40u16, 5, 4].map(u16::to_le_bytes);
        elf.splice(46..52, halves.concat());
        elf.extend(headers);
        elf
    }

    /// Messages, symbols, their names, the sections' names.
    fn sections(&self) -> [Vec<u8>; 4] {
        const ABSOLUTE: u16 = 0xfff1;
        let mut names = vec![0];
        let mut symbols = vec![0; 16];
        let mut symbol = |name: String, value: usize, section: u16| {
            symbols.extend((names.len() as u32).to_le_bytes());
            symbols.extend((value as u32).to_le_bytes());
            symbols.extend(1u32.to_le_bytes());
            // Global data.
            symbols.extend([0x11, 0]);
            symbols.extend(section.to_le_bytes());
            names.extend(name.bytes().chain([0]));
        };
        symbol("_defmt_version_ = 4".into(), 0, ABSOLUTE);
        symbol(format!("_defmt_encoding_ = {}", self.encoding), 0, ABSOLUTE);
        for (k, (tag, data)) in self.strings.iter().enumerate() {
            let name = serde_json::json!({
                "package": "ihd-firmware", "tag": tag, "data": data, "disambiguator": k.to_string(),
                "crate_name": "ihd_firmware",
            });
            symbol(name.to_string(), k + 1, 1);
        }
        let messages = vec![0; self.strings.len() + 1];
        let section_names = b"\0.defmt\0.symtab\0.strtab\0.shstrtab\0".to_vec();
        [messages, symbols, names, section_names]
    }
}

/// Encodes a frame as a device's logger does (reverse zero-compressing COBS), without the zero at the end.
pub fn encode(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let (mut run, mut zeros) = (0u8, 0u8);
    for &byte in bytes {
        if run < 7 {
            if byte == 0 {
                zeros |= 1 << run;
            } else {
                out.push(byte);
            }
            run += 1;
            if run == 7 && zeros != 0 {
                out.push(zeros);
                (run, zeros) = (0, 0);
            }
        } else if byte == 0 {
            out.push(0x80 + (run - 7));
            (run, zeros) = (0, 0);
        } else {
            out.push(byte);
            run += 1;
            if run == 134 {
                out.push(0xff);
                (run, zeros) = (0, 0);
            }
        }
    }
    // defmt's logger pads the last seven bytes with zeros.
    match run {
        0 => {}
        1..=6 => out.push((zeros | (0xff << run)) & 0x7f),
        _ => out.push(0x80 + (run - 7)),
    }
    out
}
