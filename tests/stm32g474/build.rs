//! Generates Rust from svd/registers.txt: a module for each peripheral, in it a module for each register, in that a constant for
//! each field; and one table of all registers.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::{env, fs};

fn main() {
    println!("cargo:rerun-if-changed=svd/registers.txt");
    let text = fs::read_to_string("svd/registers.txt").expect("svd/registers.txt is committed");
    let (mut code, mut table) = (String::new(), String::new());
    let (mut peripheral, mut register) = (None::<(String, u32)>, None::<Register>);
    for line in text.lines() {
        let words: Vec<_> = line.split(' ').collect();
        match words[..] {
            ["P", name, base] => {
                close(&mut register, &peripheral, &mut code, &mut table);
                if peripheral.is_some() {
                    code += "}\n";
                }
                let base = hexadecimal(base);
                let module = name.to_lowercase();
                writeln!(
                    code,
                    "pub mod {module} {{ use super::Field; pub const BASE: u32 = {base:#x};"
                )
                .unwrap();
                peripheral = Some((name.to_owned(), base));
            }
            ["R", name, offset, reset] => {
                close(&mut register, &peripheral, &mut code, &mut table);
                let (offset, reset) = (hexadecimal(offset), hexadecimal(reset));
                register = Some(Register {
                    name: name.to_owned(),
                    offset,
                    reset,
                    fields: Vec::new(),
                });
            }
            ["F", name, bit, width, access] => {
                let (bit, width) = (bit.parse().unwrap(), width.parse().unwrap());
                let writable = access != "read-only";
                register
                    .as_mut()
                    .unwrap()
                    .fields
                    .push((name.to_owned(), bit, width, writable));
            }
            _ => panic!("svd/registers.txt: {line}"),
        }
    }
    close(&mut register, &peripheral, &mut code, &mut table);
    code += "}\n";
    writeln!(code, "pub static REGISTERS: &[Register] = &[\n{table}];").unwrap();
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap()).join("registers.rs");
    fs::write(out, code).unwrap();
}

struct Register {
    name: String,
    offset: u32,
    reset: u32,
    fields: Vec<(String, u32, u32, bool)>,
}

fn hexadecimal(text: &str) -> u32 {
    u32::from_str_radix(text, 16).unwrap()
}

fn close(
    register: &mut Option<Register>,
    peripheral: &Option<(String, u32)>,
    code: &mut String,
    table: &mut String,
) {
    let (
        Some(Register {
            name,
            offset,
            reset,
            fields,
        }),
        Some((of, base)),
    ) = (register.take(), peripheral)
    else {
        return;
    };
    let address = base + offset;
    writeln!(
        code,
        "pub mod {} {{ use super::Field; pub const ADDRESS: u32 = {address:#x};",
        name.to_lowercase()
    )
    .unwrap();
    let (mut bits, mut writable) = (0u32, 0u32);
    for (field, bit, width, writes) in fields {
        let ones = (((1u64 << width) - 1) << bit) as u32;
        bits |= ones;
        writable |= if writes { ones } else { 0 };
        writeln!(
            code,
            "pub const {}: Field = Field::new({address:#x}, {bit}, {width});",
            field.to_uppercase()
        )
        .unwrap();
    }
    code.push_str("}\n");
    writeln!(
        table,
        "Register {{ peripheral: \"{of}\", name: \"{name}\", address: {address:#x}, reset: {reset:#x}, bits: {bits:#x}, writable: {writable:#x} }},"
    )
    .unwrap();
}
