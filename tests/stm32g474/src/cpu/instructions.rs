//! Cost of Thumb code in cycles on a Cortex-M4 (Technical Reference Manual r0p1, table 3-1 and 3.3.2, and the floating-point
//! unit's table 7-1), with memory without wait states.

/// Properties of a block of code that follow from its instructions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Block {
    /// Address of the first instruction.
    pub start: u32,
    /// Address after the last one.
    pub end: u32,
    /// Number of instructions.
    pub instructions: u32,
    /// Cycles without wait states and without the refill of a taken branch at the end.
    pub cycles: u32,
    /// Addresses of the words that it loads relative to the program counter.
    pub literals: Vec<u32>,
    /// Set if the block sends an event (SEV).
    pub sends_event: bool,
}

/// Cycles to refill the pipeline after a taken branch: 1 to 3 (TRM 3.3.1, P), modelled as 2.
pub const REFILL: u32 = 2;

/// Cycles of a division: the worst of 2 to 12 (TRM).
const DIVIDE: u32 = 12;

/// Decodes the code of a block.
pub fn decode(start: u32, code: &[u8]) -> Block {
    let mut block = Block {
        start,
        end: start + code.len() as u32,
        ..Block::default()
    };
    let half = |at: usize| {
        code.get(at..at + 2)
            .map(|b| u16::from_le_bytes([b[0], b[1]]))
    };
    let (mut at, mut after_transfer) = (0, false);
    while let Some(first) = half(at) {
        let address = start + at as u32;
        let wide = first >> 11 >= 0b11101;
        let (cycles, transfer) = if wide {
            let second = half(at + 2).unwrap_or(0);
            literal_wide(&mut block, address, first, second);
            wide_cycles(first, second)
        } else {
            literal_narrow(&mut block, address, first);
            block.sends_event |= first == 0xBF40;
            narrow_cycles(first)
        };
        // Neighbouring single loads and stores overlap (TRM 3.3.2).
        block.cycles += if transfer && after_transfer {
            cycles - 1
        } else {
            cycles
        };
        after_transfer = transfer;
        block.instructions += 1;
        at += if wide { 4 } else { 2 };
    }
    block
}

fn literal_narrow(block: &mut Block, address: u32, op: u16) {
    if op >> 11 == 0b01001 {
        block
            .literals
            .push(((address + 4) & !3) + u32::from(op & 0xFF) * 4);
    }
}

fn literal_wide(block: &mut Block, address: u32, first: u16, second: u16) {
    let base = (address + 4) & !3;
    // LDR.W Rt, [PC, #±imm12]; VLDR Sd/Dd, [PC, #±imm8·4].
    let (offset, up) = match (first & 0xFF7F, first & 0xFF3F) {
        (0xF85F, _) => (u32::from(second & 0xFFF), first & 0x80 != 0),
        (_, 0xED1F) => (u32::from(second & 0xFF) * 4, first & 0x80 != 0),
        _ => return,
    };
    block
        .literals
        .push(if up { base + offset } else { base - offset });
}

/// Cycles of a 16-bit instruction; `true` if it is a single load or store.
fn narrow_cycles(op: u16) -> (u32, bool) {
    match op >> 12 {
        // LDR literal is 0x48-0x4F; BX and BLX are branches, counted when taken.
        0x4 if op >> 11 == 0b01001 => (2, true),
        0x5..=0x9 => (2, true),
        0xB if matches!(op >> 9, 0b1011010 | 0b1011110) => (1 + (op & 0x1FF).count_ones(), false),
        // CPS
        0xB if op & 0xFFE8 == 0xB660 => (1, false),
        0xC => (1 + (op & 0xFF).count_ones(), false),
        _ => (1, false),
    }
}

/// Cycles of a 32-bit instruction; `true` if it is a single load or store.
fn wide_cycles(first: u16, second: u16) -> (u32, bool) {
    match first >> 9 & 0x3F {
        // LDM, STM, PUSH.W, POP.W
        0b110100 if first & 0x40 == 0 => (1 + second.count_ones(), false),
        // LDRD, STRD, LDREX, TBB (first: 1110 100x x1xx)
        0b110100 => (3, false),
        // Coprocessor: VLDR, VSTR, VLDM, VSTM, VMOV, arithmetic.
        0b110110 | 0b111110 => vfp_memory(first, second),
        0b110111 | 0b111111 => vfp_arithmetic(first, second),
        // LDR, STR and their variants (1111 100x), multiply and divide (1111 1011).
        0b111100 => (2, true),
        // SDIV and UDIV end in 1111; MLA and MLS take two cycles, long multiplications and MUL one.
        0b111101 if matches!(first & 0xFFF0, 0xFB90 | 0xFBB0) && second & 0xF0 == 0xF0 => {
            (DIVIDE, false)
        }
        0b111101 if first & 0xFFF0 == 0xFB00 && second >> 12 != 0xF => (2, false),
        // MSR, MRS, DSB, DMB, ISB
        0b111001 if second >> 12 == 0b1000 && first & 0xFFF0 == 0xF3B0 => (4, false),
        0b111001 if matches!(first & 0xFFE0, 0xF380 | 0xF3E0) && second & 0xD000 == 0x8000 => {
            (2, false)
        }
        _ => (1, false),
    }
}

fn vfp_memory(first: u16, second: u16) -> (u32, bool) {
    let words = u32::from(second & 0xFF);
    // P = 1, W = 0 is a single transfer; else a block. MOV between cores is 1110 1100 010x.
    match (first >> 8 & 1, first >> 5 & 1) {
        (1, 0) => (1 + if second & 0x100 != 0 { 2 } else { 1 }, false),
        _ if first & 0xFFE0 == 0xEC40 => (2, false),
        _ => (1 + words, false),
    }
}

fn vfp_arithmetic(first: u16, second: u16) -> (u32, bool) {
    let register_transfer = second & 0x10 != 0;
    if register_transfer {
        return (1, false);
    }
    match first >> 4 & 0xB {
        // VDIV; VSQRT is among the 1011 ones; VMLA, VMLS, fused ones.
        0b1000 => (14, false),
        0b1011 if first & 0xF == 1 && second & 0xC0 == 0xC0 => (14, false),
        0b0000 | 0b0001 | 0b1001 | 0b1010 => (3, false),
        _ => (1, false),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycles(halves: &[u16]) -> u32 {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        decode(0x0800_0000, &code).cycles
    }

    #[test]
    fn the_manuals_table() {
        assert_eq!(cycles(&[0x1888]), 1, "adds r0, r1, r2");
        assert_eq!(cycles(&[0x6808]), 2, "ldr r0, [r1]");
        assert_eq!(
            cycles(&[0x6808, 0x6849, 0x600A]),
            4,
            "neighbours overlap: 2 + 1 + 1"
        );
        assert_eq!(cycles(&[0xB5F0]), 6, "push {{r4-r7, lr}}: 1 + 5");
        assert_eq!(
            cycles(&[0xE92D, 0x4FF0]),
            10,
            "push.w {{r4-r11, lr}}: 1 + 9"
        );
        assert_eq!(cycles(&[0xFBC1, 0x0102]), 1, "smlal");
        assert_eq!(cycles(&[0xFB81, 0x0102]), 1, "smull");
        assert_eq!(cycles(&[0xFB91, 0xF0F2]), 12, "sdiv");
        assert_eq!(cycles(&[0xE9D0, 0x1200]), 3, "ldrd");
        assert_eq!(cycles(&[0xEE80, 0x0A20]), 14, "vdiv.f32");
        assert_eq!(cycles(&[0xEE30, 0x0A20]), 1, "vadd.f32");
        assert_eq!(cycles(&[0xED90, 0x0A00]), 2, "vldr s0");
        assert_eq!(cycles(&[0xF3EF, 0x8010]), 2, "mrs r0, primask");
    }

    #[test]
    fn literals_are_where_the_code_loads_them() {
        let code = [0x4801u16, 0xBF00, 0xF8DF, 0x0004]
            .map(u16::to_le_bytes)
            .concat();
        assert_eq!(
            decode(0x0800_0002, &code).literals,
            [0x0800_0008, 0x0800_000C]
        );
    }
}
