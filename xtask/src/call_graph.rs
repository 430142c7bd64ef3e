//! Who calls whom in a linked image, read from its Thumb code: enough to show that a function never
//! reaches another one.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use anyhow::Context;
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

/// A function of the image.
#[derive(Debug)]
struct Function {
    name: String,
    start: u64,
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
                let end = start + symbol.size();
                let name = name.to_owned();
                functions.insert(start, Function { name, start, end });
            }
        }
        let section = elf.section_by_name(".text").context("no .text")?;
        let (base, code) = (section.address(), section.data()?);
        let mut graph = Self {
            functions,
            calls: BTreeMap::new(),
        };
        let at = |address: u64| -> Option<u16> {
            let offset = usize::try_from(address.checked_sub(base)?).ok()?;
            let bytes = code.get(offset..offset + 2)?;
            Some(u16::from_le_bytes([bytes[0], bytes[1]]))
        };
        let mut calls = BTreeMap::new();
        for function in graph.functions.values() {
            let targets = targets(function, &marks, at);
            let called = targets.filter_map(|target| graph.containing(target));
            calls.insert(function.start, called.collect());
        }
        graph.calls = calls;
        Ok(graph)
    }

    /// Start of the function that an address lies in.
    fn containing(&self, address: u64) -> Option<u64> {
        let (_, function) = self.functions.range(..=address).next_back()?;
        (address < function.end).then_some(function.start)
    }

    /// Functions whose name holds `part`.
    pub fn named<'a>(&'a self, part: &'a str) -> impl Iterator<Item = &'a str> {
        let names = self.functions.values().map(|f| f.name.as_str());
        names.filter(move |name| name.contains(part))
    }

    /// Functions that call one of those named.
    pub fn callers<'a>(&'a self, named: &'a [&str]) -> impl Iterator<Item = &'a str> {
        let calls = self.calls.iter().filter(move |(_, called)| {
            let mut called = called
                .iter()
                .map(|start| self.functions[start].name.as_str());
            called.any(|name| named.contains(&name))
        });
        calls.map(|(caller, _)| self.functions[caller].name.as_str())
    }

    /// A way from one of the functions named to one that `bad` picks, by their names; and how many
    /// functions were looked at.
    pub fn path(&self, named: &[&str], bad: impl Fn(&str) -> bool) -> (Option<Vec<String>>, usize) {
        let roots = self.functions.values();
        let roots = roots.filter(|f| named.contains(&f.name.as_str()));
        let mut queue: VecDeque<u64> = roots.map(|f| f.start).collect();
        let mut from: BTreeMap<u64, Option<u64>> = queue.iter().map(|&f| (f, None)).collect();
        while let Some(at) = queue.pop_front() {
            if bad(&self.functions[&at].name) {
                let mut way = Vec::new();
                let mut step = Some(at);
                while let Some(function) = step {
                    way.push(self.functions[&function].name.clone());
                    step = from[&function];
                }
                way.reverse();
                return (Some(way), from.len());
            }
            for &next in self.calls.get(&at).into_iter().flatten() {
                if let std::collections::btree_map::Entry::Vacant(new) = from.entry(next) {
                    new.insert(Some(at));
                    queue.push_back(next);
                }
            }
        }
        (None, from.len())
    }
}

/// Where the branches of a function lead that leave it or call: BL, and B in its four encodings.
fn targets(
    function: &Function,
    marks: &BTreeMap<u64, bool>,
    at: impl Fn(u64) -> Option<u16>,
) -> impl Iterator<Item = u64> {
    let (start, end) = (function.start, function.end);
    let mut found = Vec::new();
    let mut address = start;
    while address < end {
        let is_code = marks.range(..=address).next_back().is_none_or(|(_, t)| *t);
        let Some(first) = at(address).filter(|_| is_code) else {
            address += 2;
            continue;
        };
        // 11101, 11110 and 11111 begin an instruction of two halves (Armv7-M, A5.1).
        let wide = first >> 11 >= 0b11101;
        let second = if wide {
            at(address + 2).unwrap_or(0)
        } else {
            0
        };
        if let Some(offset) = branch(first, second) {
            let target = address.wrapping_add(4).wrapping_add_signed(offset);
            if !(start..end).contains(&target) || target == start {
                found.push(target);
            }
        }
        address += if wide { 4 } else { 2 };
    }
    found.into_iter()
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
