//! Makes a change of the page's files rebuild the program that embeds them.

fn main() {
    println!("cargo:rerun-if-changed=page");
}
