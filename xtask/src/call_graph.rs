//! Who calls whom in a linked image, read from its Thumb code: enough to show that a function never
//! reaches another one.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::iter::successors;

use anyhow::Context;
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

struct Function {
    name: String,
    end: u64,
}

/// Functions and the calls between them.
pub struct CallGraph {
    functions: BTreeMap<u64, Function>,
    calls: BTreeMap<u64, BTreeSet<u64>>,
}

impl CallGraph {
    /// Reads the executable sections. Data between the instructions is left out by the mapping
    /// symbols `$t` and `$d` that the Arm ABI asks for.
    pub fn read(elf: &object::File<'_>) -> anyhow::Result<Self> {
        let mut functions = BTreeMap::new();
        let mut marks = BTreeMap::new();
        for symbol in elf.symbols() {
            let name = symbol.name().unwrap_or_default();
            let start = symbol.address() & !1;
            if name.starts_with("$t") || name.starts_with("$d") {
                marks.insert(start, name.starts_with("$t"));
            } else if symbol.kind() == SymbolKind::Text && symbol.size() > 0 {
                let (name, end) = (name.to_owned(), start + symbol.size());
                functions.insert(start, Function { name, end });
            }
        }
        let section = elf.section_by_name(".text").context("no .text")?;
        let (base, code) = (section.address(), section.data()?);
        let at = |address: u64| -> Option<u16> {
            let offset = usize::try_from(address.checked_sub(base)?).ok()?;
            let bytes = code.get(offset..offset + 2)?;
            Some(u16::from_le_bytes([bytes[0], bytes[1]]))
        };
        // Start of the function that an address lies in.
        let containing = |address: u64| {
            let (start, function) = functions.range(..=address).next_back()?;
            (address < function.end).then_some(*start)
        };
        let mut calls = BTreeMap::new();
        for (&start, function) in &functions {
            let called = targets(start, function.end, &marks, at).into_iter();
            calls.insert(start, called.filter_map(containing).collect());
        }
        Ok(Self { functions, calls })
    }

    /// Starts of the functions whose name `is` picks.
    pub fn starts(&self, is: impl Fn(&str) -> bool) -> BTreeSet<u64> {
        let picked = self.functions.iter().filter(|(_, f)| is(&f.name));
        picked.map(|(start, _)| *start).collect()
    }

    /// A way from one of `roots` to one of `bad`, by their names, empty where there is none; and how many functions were
    /// looked at.
    pub fn path(&self, roots: BTreeSet<u64>, bad: &BTreeSet<u64>) -> (Vec<&str>, usize) {
        let mut from: BTreeMap<_, _> = roots.iter().map(|&root| (root, None)).collect();
        let mut queue = VecDeque::from_iter(roots);
        while let Some(at) = queue.pop_front() {
            if bad.contains(&at) {
                let back = successors(Some(at), |function| from[function]);
                let mut way: Vec<_> = back.map(|f| self.functions[&f].name.as_str()).collect();
                way.reverse();
                return (way, from.len());
            }
            for &next in &self.calls[&at] {
                from.entry(next).or_insert_with(|| {
                    queue.push_back(next);
                    Some(at)
                });
            }
        }
        (Vec::new(), from.len())
    }
}

/// Where the branches of a function lead that leave it or call: BL, and B in its four encodings.
fn targets(
    start: u64,
    end: u64,
    marks: &BTreeMap<u64, bool>,
    at: impl Fn(u64) -> Option<u16>,
) -> Vec<u64> {
    // Without its start: a branch there is a call of itself.
    let inside = start + 1..end;
    let mut found = Vec::new();
    let mut address = start;
    while address < end {
        let is_code = marks.range(..=address).next_back().is_none_or(|(_, t)| *t);
        // Data is stepped over as an instruction that does not branch.
        let first = at(address).filter(|_| is_code).unwrap_or(0);
        // 11101, 11110 and 11111 begin an instruction of two halves (Armv7-M, A5.1).
        let wide = first >> 11 >= 0b11101;
        let second = at(address + 2).filter(|_| wide).unwrap_or(0);
        if let Some(offset) = branch(first, second) {
            let target = address.wrapping_add(4).wrapping_add_signed(offset);
            found.extend((!inside.contains(&target)).then_some(target));
        }
        address += if wide { 4 } else { 2 };
    }
    found
}

/// Offset of a branch from its own address plus 4 (Armv7-M, A7.7.12 and A7.7.18).
fn branch(first: u16, second: u16) -> Option<i64> {
    let sign = |value: u32, bits: u32| i64::from((value << (32 - bits)) as i32 >> (32 - bits));
    let (first, second) = (u32::from(first), u32::from(second));
    if first >> 11 == 0b11100 {
        return Some(sign((first & 0x7FF) << 1, 12));
    }
    // A condition of 14 or 15 is another instruction.
    if first >> 12 == 0b1101 && (first >> 8) & 0xF < 0xE {
        return Some(sign((first & 0xFF) << 1, 9));
    }
    if first >> 11 != 0b11110 || second >> 15 == 0 {
        return None;
    }
    let s = (first >> 10) & 1;
    let (j1, j2) = ((second >> 13) & 1, (second >> 11) & 1);
    if second & 0x1000 != 0 {
        // BL and B.W: I = not (J xor S).
        let (i1, i2) = (1 ^ j1 ^ s, 1 ^ j2 ^ s);
        let offset = s << 24 | i1 << 23 | i2 << 22 | (first & 0x3FF) << 12 | (second & 0x7FF) << 1;
        return Some(sign(offset, 25));
    }
    // B<c>.W; 0b1110 and 0b1111 are system instructions.
    if second & 0x4000 == 0 && (first >> 6) & 0xF < 0xE {
        let offset = s << 20 | j2 << 19 | j1 << 18 | (first & 0x3F) << 12 | (second & 0x7FF) << 1;
        return Some(sign(offset, 21));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodings as llvm-mc gives them.
    #[test]
    fn branches_are_decoded() {
        assert_eq!(branch(0xE7FE, 0), Some(-4), "b .");
        assert_eq!(branch(0xF7FF, 0xFFFE), Some(-4), "bl .");
        assert_eq!(branch(0xF000, 0xF802), Some(4), "bl .+8");
        assert_eq!(branch(0xF000, 0xB802), Some(4), "b.w .+8");
        assert_eq!(branch(0xF43F, 0xAFFE), Some(-4), "beq.w .");
        assert_eq!(branch(0xD0FE, 0), Some(-4), "beq .");
        assert_eq!(branch(0xDF00, 0), None, "svc");
        assert_eq!(branch(0xF3BF, 0x8F4F), None, "dsb");
        assert_eq!(branch(0x4770, 0), None, "bx lr");
    }
}
