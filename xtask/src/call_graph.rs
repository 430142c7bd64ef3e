//! Call graph of a linked image, read from its Thumb code; enough to show that a function never reaches another one.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::iter::successors;

use anyhow::ensure;
use object::{Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind};

struct Function {
    name: String,
    end: u64,
}

/// Functions and the calls between them.
pub struct CallGraph {
    functions: BTreeMap<u64, Function>,
    calls: BTreeMap<u64, BTreeSet<u64>>,
    /// Addresses and other large constants in the code of each function.
    literals: BTreeMap<u64, BTreeSet<u64>>,
}

/// Executable sections: flash, and code copied from there by the start-up code.
struct Code<'a>(Vec<(u64, &'a [u8])>);

impl<'a> Code<'a> {
    fn read(elf: &object::File<'a>) -> anyhow::Result<Self> {
        let text = elf.sections().filter(|s| s.kind() == SectionKind::Text);
        let text = text.map(|s| Ok((s.address(), s.data()?)));
        let text: Vec<_> = text.collect::<anyhow::Result<_>>()?;
        ensure!(!text.is_empty(), "no executable section");
        Ok(Self(text))
    }

    /// The half-word at an address.
    fn at(&self, address: u64) -> Option<u16> {
        self.0.iter().find_map(|(base, bytes)| {
            let offset = usize::try_from(address.checked_sub(*base)?).ok()?;
            let bytes = bytes.get(offset..offset + 2)?;
            Some(u16::from_le_bytes([bytes[0], bytes[1]]))
        })
    }
}

impl CallGraph {
    /// Reads the executable sections. Data between the instructions are skipped by the mapping symbols `$t` and `$d` that the Arm
    /// ABI requires.
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
        let code = Code::read(elf)?;
        let at = |address: u64| code.at(address);
        // Start of the function that an address lies in.
        let containing = |address: u64| {
            let (start, function) = functions.range(..=address).next_back()?;
            (address < function.end).then_some(*start)
        };
        let (mut calls, mut literals) = (BTreeMap::new(), BTreeMap::new());
        for (&start, function) in &functions {
            let mut scanned = scan(start, function.end, &marks, at);
            // The linker's thunk between two memories loads its target's address.
            if function.name.contains("LongThunk") {
                let jumps = scanned.literals.iter().map(|address| address & !1);
                scanned.targets.extend(jumps);
            }
            let called = scanned.targets.into_iter().filter_map(containing);
            calls.insert(start, called.collect());
            literals.insert(start, scanned.literals);
        }
        Ok(Self {
            functions,
            calls,
            literals,
        })
    }

    /// Starts of the functions whose name `is` picks.
    pub fn starts(&self, is: impl Fn(&str) -> bool) -> BTreeSet<u64> {
        let picked = self.functions.iter().filter(|(_, f)| is(&f.name));
        picked.map(|(start, _)| *start).collect()
    }

    /// Functions that `roots` reach, those included, each with its caller on a shortest path.
    fn callers(&self, roots: &BTreeSet<u64>) -> BTreeMap<u64, Option<u64>> {
        let mut from: BTreeMap<_, _> = roots.iter().map(|&root| (root, None)).collect();
        let mut queue = VecDeque::from_iter(roots.iter().copied());
        while let Some(at) = queue.pop_front() {
            for &next in &self.calls[&at] {
                from.entry(next).or_insert_with(|| {
                    queue.push_back(next);
                    Some(at)
                });
            }
        }
        from
    }

    /// All functions reachable from one of `roots`, those included: name, address, and the constants of 32 bits in their code.
    pub fn reached(&self, roots: &BTreeSet<u64>) -> Vec<(&str, u64, &BTreeSet<u64>)> {
        let each = self.callers(roots).into_keys();
        each.map(|at| (self.functions[&at].name.as_str(), at, &self.literals[&at]))
            .collect()
    }

    /// Names on a path from one of `roots` to one of `bad`, empty if there is none; and the number of functions examined.
    pub fn path(&self, roots: &BTreeSet<u64>, bad: &BTreeSet<u64>) -> (Vec<&str>, usize) {
        let from = self.callers(roots);
        let end = bad.iter().copied().find(|bad| from.contains_key(bad));
        let back = successors(end, |function| from[function]);
        let mut way: Vec<_> = back.map(|f| self.functions[&f].name.as_str()).collect();
        way.reverse();
        (way, from.len())
    }
}

/// Code of one function.
#[derive(Default)]
struct ScannedFunction {
    /// Targets of the branches that leave it or call: BL, and B in its four encodings.
    targets: Vec<u64>,
    /// Constants of 32 bits: words between its instructions, and pairs of MOVW and MOVT (Armv7-M, A7.7.76 and
    /// A7.7.79).
    literals: BTreeSet<u64>,
}

/// Decodes a function; `marks` holds the beginnings of code (`true`) and data.
fn scan(
    start: u64,
    end: u64,
    marks: &BTreeMap<u64, bool>,
    at: impl Fn(u64) -> Option<u16>,
) -> ScannedFunction {
    // A branch to its own start is a recursive call.
    let inside = start + 1..end;
    let mut scanned = ScannedFunction::default();
    let word = |high: u16, low: u16| u64::from(high) << 16 | u64::from(low);
    let mut low = [0; 16];
    let mut address = start;
    while address < end {
        let is_code = marks.range(..=address).next_back().is_none_or(|(_, t)| *t);
        let (first, second) = (at(address).unwrap_or(0), at(address + 2).unwrap_or(0));
        if !is_code {
            // Words are aligned; in between are tables of jumps.
            let literal = address.is_multiple_of(4).then(|| word(second, first));
            scanned.literals.extend(literal);
        } else if let Some(offset) = branch(first, second) {
            let target = Some(address.wrapping_add(4).wrapping_add_signed(offset));
            let leaves = target.filter(|target| !inside.contains(target));
            scanned.targets.extend(leaves);
        } else if let Some((top, register, value)) = wide_move(first, second) {
            if top {
                scanned.literals.insert(word(value, low[register]));
            } else {
                low[register] = value;
            }
        }
        // 11101, 11110 and 11111 begin an instruction of two halves (Armv7-M, A5.1).
        let wide = is_code && first >> 11 >= 0b11101;
        address += if wide { 4 } else { 2 };
    }
    scanned
}

/// Returns `true` for MOVT and `false` for MOVW, with register and value; `None` for other instructions.
fn wide_move(first: u16, second: u16) -> Option<(bool, usize, u16)> {
    let top = match first & 0xFBF0 {
        0xF240 => false,
        0xF2C0 => true,
        _ => return None,
    };
    if second >> 15 != 0 {
        return None;
    }
    let value =
        (first & 0xF) << 12 | (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF;
    Some((top, usize::from(second >> 8 & 0xF), value))
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
        let (movw, movt) = (Some((false, 4, 0x5678)), Some((true, 12, 0x0800)));
        assert_eq!(wide_move(0xF245, 0x6478), movw, "movw r4, #0x5678");
        assert_eq!(wide_move(0xF6C0, 0x0C00), movt, "movt r12, #0x800");
        assert_eq!(wide_move(0xF000, 0xF802), None, "bl .+8");
    }

    #[test]
    fn a_function_is_scanned_for_calls_and_constants() {
        // movw r4, #0x5678; movt r4, #0x800; bl .+8; and a word of data.
        let code = [
            0xF245, 0x6478, 0xF6C0, 0x0400, 0xF000, 0xF802, 0x0000, 0x0801,
        ];
        let at = |address: u64| code.get((address - 0x100) as usize / 2).copied();
        let marks = BTreeMap::from([(0x100, true), (0x10C, false)]);
        let scanned = scan(0x100, 0x110, &marks, at);
        assert_eq!(scanned.targets, [0x110]);
        assert_eq!(scanned.literals, BTreeSet::from([0x0800_5678, 0x0801_0000]));
    }

    #[test]
    fn a_way_follows_calls_in_their_direction() {
        let function = |start: u64| {
            let (name, end) = (start.to_string(), start + 1);
            (start, Function { name, end })
        };
        let graph = CallGraph {
            functions: (1..5).map(function).collect(),
            calls: [(1, 2), (2, 3), (3, 1), (4, 1)]
                .map(|(from, to)| (from, BTreeSet::from([to])))
                .into(),
            literals: (1..5).map(|start| (start, BTreeSet::new())).collect(),
        };
        let way = |to| graph.path(&BTreeSet::from([1]), &BTreeSet::from([to]));
        assert_eq!(way(3), (vec!["1", "2", "3"], 3));
        assert_eq!(way(4), (vec![], 3));
        let reached = graph.reached(&BTreeSet::from([2]));
        let names: Vec<&str> = reached.iter().map(|(name, ..)| *name).collect();
        assert_eq!(names, ["1", "2", "3"]);
    }
}
