//! A file that is added to the page has to be in the program too.

fn main() {
    println!("cargo:rerun-if-changed=page");
}
