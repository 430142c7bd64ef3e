//! Text format of Prometheus: <https://prometheus.io/docs/instrumenting/exposition_formats>

use std::fmt::Write;

/// Prefix of every metric name.
const PREFIX: &str = "ihd_";

/// Text for one scrape.
#[derive(Default)]
pub(crate) struct Exposition(String);

impl Exposition {
    /// Writes the head of a family; its samples must follow directly.
    pub(crate) fn family(&mut self, name: &str, help: &str, kind: &str) {
        let help = help.replace('\\', r"\\").replace('\n', r"\n");
        self.line(format_args!("# HELP {PREFIX}{name} {help}"));
        self.line(format_args!("# TYPE {PREFIX}{name} {kind}"));
    }

    /// Writes one sample of the family.
    pub(crate) fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let labels: Vec<String> = labels
            .iter()
            .map(|(label, value)| format!("{label}=\"{}\"", escaped(value)))
            .collect();
        let labels = if labels.is_empty() {
            String::new()
        } else {
            format!("{{{}}}", labels.join(","))
        };
        self.line(format_args!("{PREFIX}{name}{labels} {}", number(value)));
    }

    /// Writes a gauge with one sample.
    pub(crate) fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, help, "gauge");
        self.sample(name, &[], value);
    }

    /// Writes a counter with one sample.
    pub(crate) fn counter(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, help, "counter");
        self.sample(name, &[], value);
    }

    /// Writes a gauge with one sample for each value of a label.
    pub(crate) fn gauges<'a>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        samples: impl IntoIterator<Item = (&'a str, u64)>,
    ) {
        self.family(name, help, "gauge");
        self.labelled(name, label, samples);
    }

    /// Writes a counter with one sample for each value of a label.
    pub(crate) fn counters<'a>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        samples: impl IntoIterator<Item = (&'a str, u64)>,
    ) {
        self.family(name, help, "counter");
        self.labelled(name, label, samples);
    }

    fn labelled<'a>(
        &mut self,
        name: &str,
        label: &str,
        samples: impl IntoIterator<Item = (&'a str, u64)>,
    ) {
        for (value, n) in samples {
            self.sample(name, &[(label, value)], n as f64);
        }
    }

    /// Returns the text.
    pub(crate) fn into_text(self) -> String {
        self.0
    }

    fn line(&mut self, line: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _ = self.0.write_fmt(format_args!("{line}\n"));
    }
}

fn escaped(value: &str) -> String {
    value
        .replace('\\', r"\\")
        .replace('"', "\\\"")
        .replace('\n', r"\n")
}

fn number(value: f64) -> String {
    if value.is_infinite() {
        if value > 0.0 { "+Inf" } else { "-Inf" }.into()
    } else {
        value.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Example of the format's specification.
    #[test]
    fn labels_are_escaped_and_numbers_written_as_the_format_says() {
        let mut text = Exposition::default();
        text.family("x_total", "a\nb", "counter");
        text.sample(
            "x_total",
            &[("path", "C:\\DIR"), ("error", "no \"file\"\n")],
            2.5,
        );
        text.sample("x_total", &[], f64::INFINITY);
        text.sample("x_total", &[], f64::NAN);
        assert_eq!(
            text.into_text(),
            "# HELP ihd_x_total a\\nb\n\
             # TYPE ihd_x_total counter\n\
             ihd_x_total{path=\"C:\\\\DIR\",error=\"no \\\"file\\\"\\n\"} 2.5\n\
             ihd_x_total +Inf\n\
             ihd_x_total NaN\n"
        );
    }
}
