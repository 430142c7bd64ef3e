//! Tables and figures of the commands.

pub mod identified;
pub mod recording;
pub mod scenario;
pub mod survey;
pub mod table;
#[cfg(feature = "pinn")]
pub mod trained;
#[cfg(feature = "pinn")]
pub mod training;
pub mod utilisation;

/// Wraps text at spaces to a width in characters; lines after the first begin with `indent`, which does not count.
pub(crate) fn wrapped(text: &str, width: usize, indent: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    let mut used = 0;
    for word in text.split(' ') {
        let length = word.chars().count();
        match lines.last_mut() {
            Some(line) if used + 1 + length <= width => {
                line.push(' ');
                line.push_str(word);
                used += 1 + length;
            }
            last => {
                let indent = if last.is_some() { indent } else { "" };
                lines.push(format!("{indent}{word}"));
                used = length;
            }
        }
    }
    lines
}
