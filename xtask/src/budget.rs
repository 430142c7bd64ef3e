//! `cargo xtask budget`: what the board's image takes, module by module, and whether the sampling
//! path can panic.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, bail};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use crate::call_graph::CallGraph;
use crate::limits::{Limits, verdict};

/// Sections that are in flash, and those that are in RAM; what is in both is copied at start.
const FLASH: [&str; 4] = [".vector_table", ".text", ".rodata", ".data"];
const RAM: [&str; 3] = [".data", ".bss", ".uninit"];

/// The interrupt of the sampling path, and the task it runs. The executor calls the task through a
/// pointer, so the way is followed from both, and from whoever calls the task by its name.
const INTERRUPT: &str = "DMA1_CHANNEL1";
const TASK: &str = "SamplingTask";

/// What a panic looks like in a symbol.
const PANIC: [&str; 4] = ["panicking", "rust_begin_unwind", "_fail", "panic_"];

/// Bytes of one module.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Bytes {
    flash: u64,
    ram: u64,
}

/// Prints the table; returns what is wrong.
pub fn check(image: &Path, limits: &Limits) -> anyhow::Result<Vec<String>> {
    let data = fs::read(image).with_context(|| format!("{}", image.display()))?;
    let elf = object::File::parse(&*data)?;
    let (sections, modules) = (by_section(&elf), by_module(&elf)?);
    let sum = |names: &[&str]| -> u64 { names.iter().filter_map(|n| sections.get(*n)).sum() };
    let total = Bytes {
        flash: sum(&FLASH),
        ram: sum(&RAM),
    };
    print!("{}", table(&modules, total));
    let mut broken = Vec::new();
    for (key, what, figure) in [
        ("flash", "bytes of flash", total.flash),
        ("static_ram", "bytes of static RAM", total.ram),
    ] {
        let ceiling = limits.memory.get(key).copied();
        let ceiling = ceiling.with_context(|| format!("no {key} in firmware/budget.toml"))?;
        broken.extend(verdict(what, figure as f64, ceiling));
    }
    broken.extend(panic_path(&CallGraph::read(&elf)?)?);
    Ok(broken)
}

/// Shows that no call from the sampling path leads to a panic, or the calls that do.
fn panic_path(graph: &CallGraph) -> anyhow::Result<Option<String>> {
    // Without these the search below would find nothing whatever the code does.
    if graph.named("rust_begin_unwind").next().is_none() {
        bail!("the image has no panic handler by name; are its symbols stripped?");
    }
    let is_panic = |name: &str| PANIC.iter().any(|part| name.contains(part));
    // By the readable name: compilers differ in how they write the other.
    let polls = graph
        .named(TASK)
        .filter(|name| readable(name).ends_with("::poll"));
    let polls: Vec<_> = polls.collect();
    let callers: Vec<_> = graph.callers(&polls).collect();
    if graph.named(INTERRUPT).next().is_none() || polls.is_empty() || callers.is_empty() {
        bail!("the image has no {INTERRUPT}, no {TASK}, or nobody who polls it");
    }
    let roots = [&[INTERRUPT], &polls[..], &callers[..]].concat();
    let (way, functions) = graph.path(&roots, is_panic);
    if let Some(way) = way {
        let way: Vec<_> = way.iter().map(|name| readable(name)).collect();
        return Ok(Some(format!(
            "the sampling path can panic: {}",
            way.join(" -> ")
        )));
    }
    println!("no panic in the {functions} functions of the sampling path\n");
    Ok(None)
}

fn by_section(elf: &object::File<'_>) -> BTreeMap<String, u64> {
    elf.sections()
        .filter_map(|section| Some((section.name().ok()?.to_owned(), section.size())))
        .collect()
}

fn by_module(elf: &object::File<'_>) -> anyhow::Result<BTreeMap<String, Bytes>> {
    let mut modules: BTreeMap<String, Bytes> = BTreeMap::new();
    for symbol in elf.symbols() {
        let Some(index) = symbol.section_index().filter(|_| symbol.size() > 0) else {
            continue;
        };
        if !matches!(symbol.kind(), SymbolKind::Text | SymbolKind::Data) {
            continue;
        }
        let section = elf.section_by_index(index)?;
        let name = section.name()?;
        let bytes = modules.entry(module(symbol.name()?)).or_default();
        if FLASH.contains(&name) {
            bytes.flash += symbol.size();
        }
        if RAM.contains(&name) {
            bytes.ram += symbol.size();
        }
    }
    Ok(modules)
}

fn readable(symbol: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(symbol))
}

/// Crate of a symbol, and the module where it is ours: `ihd_firmware::ekf`.
fn module(symbol: &str) -> String {
    let readable = readable(symbol);
    if readable == symbol {
        return "(start-up, vectors, compiler)".into();
    }
    let path = readable.trim_start_matches(['<', '&', '*', '(', '[']);
    let path = path.trim_start_matches("mut ").trim_start_matches("dyn ");
    let end = path.find([' ', '>', '<', '{', ']']).unwrap_or(path.len());
    let mut parts = path[..end].split("::");
    let first = parts.next().unwrap_or_default();
    match (first, parts.next()) {
        ("ihd_firmware" | "ihd_shared", Some(second)) => format!("{first}::{second}"),
        _ => first.to_owned(),
    }
}

fn table(modules: &BTreeMap<String, Bytes>, total: Bytes) -> String {
    let mut rows: Vec<_> = modules.iter().collect();
    rows.sort_by_key(|(name, bytes)| (std::cmp::Reverse(bytes.flash + bytes.ram), *name));
    let mut text = format!("{:<36} {:>8} {:>8}\n", "module", "flash", "RAM");
    let mut line = |name: &str, bytes: Bytes| {
        text += &format!("{name:<36} {:>8} {:>8}\n", bytes.flash, bytes.ram);
    };
    let mut named = Bytes::default();
    for (name, bytes) in rows {
        named.flash += bytes.flash;
        named.ram += bytes.ram;
        line(name, *bytes);
    }
    let rest = Bytes {
        flash: total.flash.saturating_sub(named.flash),
        ram: total.ram.saturating_sub(named.ram),
    };
    line("(constants without a name, padding)", rest);
    line("total", total);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_belong_to_their_module() {
        for (symbol, expected) in [
            (
                "_ZN12ihd_firmware3ekf3Ekf4step17h227e24941cab6cc4E",
                "ihd_firmware::ekf",
            ),
            (
                "_ZN8cortex_m10peripheral3scb4gone17h126bd0e12633cd5dE",
                "cortex_m",
            ),
            ("__aeabi_memcpy", "(start-up, vectors, compiler)"),
        ] {
            assert_eq!(module(symbol), expected);
        }
        let in_impl = "_ZN12ihd_firmware3ekf6update40_$LT$impl$u20$ihd_firmware..ekf..Ekf$GT$16\
                       update_component17h9b69f08c63572c3cE";
        assert_eq!(module(in_impl), "ihd_firmware::ekf");
    }

    #[test]
    fn what_has_no_name_is_still_counted() {
        let modules = BTreeMap::from([("a".to_owned(), Bytes { flash: 10, ram: 1 })]);
        let text = table(&modules, Bytes { flash: 25, ram: 1 });
        let line = text
            .lines()
            .find(|line| line.starts_with("(constants"))
            .unwrap();
        assert!(line.split_whitespace().any(|word| word == "15"), "{text}");
    }
}
