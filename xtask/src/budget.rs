//! `cargo xtask test --only budget`: memory of the board's image, module by module, and a check that the sampling path cannot panic.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, bail};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};
use serde::Deserialize;

use crate::call_graph::CallGraph;
use crate::workspace::Workspace;

/// Sections in flash, and those in RAM; sections in both are copied at start.
const FLASH: &str = ".vector_table .text .rodata .ccm .data .tables .flash_filler .image_crc";
const RAM: &str = ".data .tables .bss .uninit .crash_record";
/// RAM of the STM32G474 in bytes: SRAM1, SRAM2, CCM SRAM (RM0440, section 2.4).
const CHIP_RAM: u64 = 128 * 1024;
/// Sections in the CCM SRAM.
const CCM: &str = ".ccm_vectors .ccm";

/// Interrupt of the sampling path, and the task that it runs. The executor calls the task through a pointer, so the path is
/// followed from both.
const INTERRUPT: &str = "DMA1_CHANNEL1";
const TASK: &str = "SamplingTask";
const WAKE: &str = "embassy_executor::raw::waker::wake";

/// Parts of symbols that belong to a panic.
const PANIC: [&str; 4] = ["panicking", "rust_begin_unwind", "_fail", "panic_"];

/// Limits of firmware/budget.toml.
#[derive(Debug, Deserialize)]
pub struct BudgetLimits {
    /// Bytes: `flash`, `ram`, `static_ram`, `ccm`, `stack`.
    pub memory: BTreeMap<String, f64>,
    /// Instructions by subject.
    pub instructions: BTreeMap<String, f64>,
}

impl BudgetLimits {
    /// Reads the file.
    pub fn read(workspace: &Workspace) -> anyhow::Result<Self> {
        let path = workspace.root.join("firmware/budget.toml");
        let text = fs::read_to_string(&path).with_context(|| format!("{}", path.display()))?;
        toml::from_str(&text).with_context(|| format!("{}", path.display()))
    }
}

/// Defect of a figure, if any: above its limit, or so far below that the limit has no meaning any more.
pub fn verdict(what: &str, figure: f64, ceiling: Option<&f64>) -> Option<String> {
    let file = "firmware/budget.toml";
    match ceiling {
        None => Some(format!("{file} has no ceiling for {what}")),
        Some(most) if figure > *most => {
            Some(format!("{what}: {figure}, more than the {most} of {file}"))
        }
        Some(most) if figure < most / 2.0 => Some(format!(
            "{what}: {figure}, less than half of {most}: lower the ceiling in {file}"
        )),
        Some(_) => None,
    }
}

/// Bytes of one module.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ModuleBytes {
    flash: u64,
    ram: u64,
    ccm: u64,
}

impl ModuleBytes {
    /// Counts `size` bytes of a section where that section lies.
    fn add(&mut self, section: &str, size: u64) {
        let within = |sections: &str| size * u64::from(sections.split(' ').any(|s| s == section));
        self.flash += within(FLASH);
        self.ram += within(RAM);
        self.ccm += within(CCM);
    }
}

/// Prints the table; returns the defects.
pub fn check(image: &Path, limits: &BudgetLimits) -> anyhow::Result<Vec<String>> {
    let data = fs::read(image).with_context(|| format!("{}", image.display()))?;
    let elf = object::File::parse(&*data)?;
    let mut total = ModuleBytes::default();
    for section in elf.sections() {
        total.add(section.name()?, section.size());
    }
    print!("{}", table(&by_module(&elf)?, total));
    let memory = |what, bytes, key| verdict(what, bytes as f64, limits.memory.get(key));
    let flash = memory("bytes of flash", total.flash, "flash");
    let ram = memory("bytes of static RAM", total.ram, "static_ram");
    let ccm = memory("bytes of CCM SRAM", total.ccm, "ccm");
    let stack = place_of(&elf, "_stack_start")?.saturating_sub(place_of(&elf, "_stack_end")?);
    let all = total.ram + total.ccm + stack;
    let percent = 100.0 * all as f64 / CHIP_RAM as f64;
    println!("RAM, CCM and a stack of {stack}: {all} of {CHIP_RAM} bytes, {percent:.1} %\n");
    let all = memory("bytes of all RAM", all, "ram");
    let graph = CallGraph::read(&elf)?;
    let (panics, slow) = (panic_path(&graph)?, in_flash(&graph)?);
    Ok([flash, all, ram, ccm, panics, slow]
        .into_iter()
        .flatten()
        .collect())
}

/// Checks that no call from the sampling path leads to a panic; returns the calls that do.
fn panic_path(graph: &CallGraph) -> anyhow::Result<Option<String>> {
    let holds = |part: &'static str| move |name: &str| name.contains(part);
    // Without these the search below would find nothing in any case.
    let handler = graph.starts(holds("rust_begin_unwind"));
    if handler.is_empty() {
        bail!("the image has no panic handler by name; are its symbols stripped?");
    }
    let roots = sampling_path(graph)?;
    let panics = graph.starts(|name| PANIC.iter().any(|part| name.contains(part)));
    let (way, functions) = graph.path(&roots, &panics);
    if way.is_empty() {
        println!("no panic in the {functions} functions of the sampling path\n");
        return Ok(None);
    }
    let way: Vec<_> = way.into_iter().map(readable).collect();
    let way = way.join(" -> ");
    Ok(Some(format!("the sampling path can panic: {way}")))
}

/// The flash of the STM32G474, which has wait states (RM0440, section 2.4).
const SLOW: Range<u64> = 0x0800_0000..0x0808_0000;

/// Checks that the sampling path runs, and reads its constants, without wait states; returns the exceptions.
fn in_flash(graph: &CallGraph) -> anyhow::Result<Option<String>> {
    let reached = graph.reached(&sampling_path(graph)?);
    let mut slow = Vec::new();
    for (name, at, literals) in &reached {
        if SLOW.contains(at) {
            slow.push(format!("{name} runs from flash"));
        }
        let named = literals.iter().filter(|literal| SLOW.contains(literal));
        slow.extend(named.map(|literal| format!("{name} names {literal:#x} in flash")));
    }
    if slow.is_empty() {
        println!(
            "none of the {} functions of the sampling path is in flash\n",
            reached.len()
        );
        return Ok(None);
    }
    let why = "place it in firmware/ccm.x";
    Ok(Some(format!(
        "the sampling path, {why}: {}",
        slow.join(", ")
    )))
}

/// Beginnings of the sampling path: interrupt, task, and the waker of the thread's tasks, all called through pointers.
fn sampling_path(graph: &CallGraph) -> anyhow::Result<BTreeSet<u64>> {
    let polls = graph.starts(|name| name.contains(TASK) && readable(name).ends_with("::poll"));
    let interrupt = graph.starts(|name| name == INTERRUPT);
    let wakes = graph.starts(|name| readable(name) == WAKE);
    if interrupt.is_empty() || polls.is_empty() || wakes.is_empty() {
        bail!("the image has no {INTERRUPT}, no {TASK} or no {WAKE}");
    }
    Ok(&(&interrupt | &polls) | &wakes)
}

/// Address of a symbol of memory.x.
fn place_of(elf: &object::File<'_>, name: &str) -> anyhow::Result<u64> {
    let symbol = elf.symbol_by_name(name);
    Ok(symbol
        .with_context(|| format!("the image has no {name}"))?
        .address())
}

fn by_module(elf: &object::File<'_>) -> anyhow::Result<BTreeMap<String, ModuleBytes>> {
    let mut modules = BTreeMap::<_, ModuleBytes>::new();
    for symbol in elf.symbols() {
        let sized = symbol.size() > 0;
        let counted = sized && matches!(symbol.kind(), SymbolKind::Text | SymbolKind::Data);
        if let Some(index) = symbol.section_index().filter(|_| counted) {
            let bytes = modules.entry(module(symbol.name()?)).or_default();
            bytes.add(elf.section_by_index(index)?.name()?, symbol.size());
        }
    }
    Ok(modules)
}

fn readable(symbol: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(symbol))
}

/// Crate of a symbol, with the module if it is ours: `ihd_firmware::ekf`.
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

fn table(modules: &BTreeMap<String, ModuleBytes>, total: ModuleBytes) -> String {
    let mut rows: Vec<_> = modules.iter().collect();
    rows.sort_by_key(|(name, bytes)| (std::cmp::Reverse(bytes.flash + bytes.ram), *name));
    let mut text = format!(
        "{:<36} {:>8} {:>8} {:>8}\n",
        "module", "flash", "RAM", "CCM"
    );
    let mut line = |name: &str, bytes: ModuleBytes| {
        let ModuleBytes { flash, ram, ccm } = bytes;
        text += &format!("{name:<36} {flash:>8} {ram:>8} {ccm:>8}\n");
    };
    let mut rest = total;
    for (name, bytes) in rows {
        rest.flash = rest.flash.saturating_sub(bytes.flash);
        rest.ram = rest.ram.saturating_sub(bytes.ram);
        rest.ccm = rest.ccm.saturating_sub(bytes.ccm);
        line(name, *bytes);
    }
    line("(constants without a name, padding)", rest);
    line("total", total);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ceilings_are_two_sided() {
        let broken = |figure| verdict("x", figure, Some(&100.0)).unwrap_or_default();
        assert_eq!((broken(100.0), broken(50.0)), Default::default());
        assert!(broken(100.1).contains("more than"));
        assert!(broken(49.0).contains("lower the ceiling"));
        assert!(verdict("x", 1.0, None).is_some());
    }

    #[test]
    fn symbols_belong_to_their_module() {
        let ekf = "_ZN12ihd_firmware3ekf3Ekf4step17h227e24941cab6cc4E";
        assert_eq!(module(ekf), "ihd_firmware::ekf");
        let in_impl = "_ZN12ihd_firmware3ekf6update40_$LT$impl$u20$ihd_firmware..ekf..Ekf$GT$16\
                       update_component17h9b69f08c63572c3cE";
        assert_eq!(module(in_impl), "ihd_firmware::ekf");
        let foreign = "_ZN8cortex_m10peripheral3scb4gone17h126bd0e12633cd5dE";
        assert_eq!(module(foreign), "cortex_m");
        assert_eq!(module("__aeabi_memcpy"), "(start-up, vectors, compiler)");
    }

    #[test]
    fn what_has_no_name_is_still_counted() {
        let bytes = |flash, ram, ccm| ModuleBytes { flash, ram, ccm };
        let modules = BTreeMap::from([("a".to_owned(), bytes(10, 1, 0))]);
        let text = table(&modules, bytes(25, 1, 2));
        let rest = "(constants without a name, padding)        15        0        2\n";
        assert!(text.contains(rest), "{text}");
    }
}
