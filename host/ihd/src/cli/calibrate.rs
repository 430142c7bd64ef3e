//! `ihd calibrate`: skew, gain and offsets of a measuring chain from a capture of a reference.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use ihd_gate::sensors::{MIN_RATE_HZ, is_of_sampling};
use ihd_signal::{Capture, WithSigma};
use ihd_survey::Survey;
use ihd_survey::calibration::{Calibration, ReferenceLoad, blind, estimate};

use super::capture_args::CaptureArgs;
use super::global::Global;
use super::output;
use super::simulate::quantity::quantity;

/// Find skew, gain and offsets of a measuring chain from a capture of a known load.
///
/// Every command that takes a capture applies the file that this writes with --calibration FILE.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd calibrate empty.csv --reference no-pot --out bench.toml\n  \
    ihd calibrate empty.csv --reference no-pot,r=0.1,l=72u --out bench.toml\n  \
    ihd calibrate dummy.csv --reference r=3.3,l=25u --out bench.json --json\n  \
    ihd calibrate any-load.csv --reference blind --out bench.toml\n  \
    ihd identify capture.csv --calibration bench.toml\n\n\
    Exit codes: 0 done, 1 the capture gives no calibration, 2 wrong usage, 7 the file is empty or a\n\
    cut MCAP (what could be read is the result)")]
pub struct CalibrateArgs {
    #[command(flatten)]
    capture: CaptureArgs,
    /// Reference load of the capture: no-pot (the empty coil), no-pot,r=OHM,l=HENRY, a load with r=, l= or both, or blind: any load,
    /// by the plateaus between the bridge's edges
    #[arg(long, value_name = "WHAT", value_parser = against)]
    reference: Against,
    /// Write the calibration to this file: JSON if it ends so, else TOML
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Reference of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Against {
    /// Load with known properties.
    Known(ReferenceLoad),
    /// The plateaus between the bridge's edges, with any load.
    Plateaus,
}

/// Parses `blind` or a reference.
fn against(text: &str) -> Result<Against> {
    match text {
        "blind" => Ok(Against::Plateaus),
        _ => reference(text).map(Against::Known),
    }
}

/// Parses `no-pot`, `no-pot,r=0.1,l=72u`, `r=3.3,l=25u`.
pub(super) fn reference(text: &str) -> Result<ReferenceLoad> {
    let (mut no_pot, mut r_ohm, mut l_h) = (false, None, None);
    for word in text.split(',').map(str::trim) {
        if word == "no-pot" {
            no_pot = true;
            continue;
        }
        let slot = match word.split_once('=') {
            Some(("r", value)) => (&mut r_ohm, value),
            Some(("l", value)) => (&mut l_h, value),
            _ => anyhow::bail!(
                "`{word}` is not known: write no-pot, r=OHM or l=HENRY, as in r=3.3,l=25u"
            ),
        };
        let number = quantity(slot.1)?;
        ensure!(number > 0.0, "`{word}` must be above zero");
        *slot.0 = Some(number);
    }
    Ok(if no_pot {
        ReferenceLoad::NoPot { r_ohm, l_h }
    } else {
        ReferenceLoad::Load { r_ohm, l_h }
    })
}

impl CalibrateArgs {
    /// Opens and surveys the capture, calibrates and writes the result.
    ///
    /// # Errors
    /// Any error of the capture's reader, the survey or the calibration; a file that cannot be written.
    pub fn run(&self, global: &Global) -> Result<()> {
        self.capture.ensure_not_read(self.out.as_deref())?;
        self.refuse_unused()?;
        let loaded = self.capture.open()?;
        loaded.finish(self.calibrate(&loaded.capture, global.json))
    }

    /// Refuses keys of `--input` that this reference has no use for.
    fn refuse_unused(&self) -> Result<()> {
        let input = self.capture.input()?;
        input.refuse(&["mains", "zero-crossing"])?;
        match self.reference {
            Against::Known(_) => input.refuse(&["resonance-capacitance"]),
            Against::Plateaus => Ok(()),
        }
    }

    fn calibrate(&self, capture: &Capture, json: bool) -> Result<()> {
        let input = self.capture.input()?;
        let survey = Survey::from_capture(capture, &input.hints())?;
        let calibration = match self.reference {
            Against::Known(reference) => estimate(capture, &survey, reference)?,
            Against::Plateaus => {
                let calibration = blind::estimate(capture, &survey, input.capacitance_f())?;
                ensure!(
                    !is_of_sampling(&calibration, survey.rate_hz),
                    "{}: a lag of {:.0} ns is no more than the sampling at {:.2} MS/s causes by itself: sample at {:.0} MS/s or \
                     more, or calibrate with a known load (--reference)",
                    self.capture.path().display(),
                    calibration.lag_s.value * 1e9,
                    survey.rate_hz / 1e6,
                    MIN_RATE_HZ / 1e6
                );
                for remark in calibration.remarks(true) {
                    output::complain(format_args!("{remark}"));
                }
                Calibration::from_self_calibration(&calibration, &survey)
            }
        };
        let why = || {
            let capture = self.capture.path().display();
            format!(
                "{capture}: no calibration; look at --reference (25u is 25 µH) and the probes' factors (--input probe)"
            )
        };
        calibration.check().with_context(why)?;
        for doubt in calibration.doubts() {
            output::complain(format_args!("warning: {doubt}"));
        }
        if let Some(path) = &self.out {
            // An existing file may be of another chain or no calibration; the comparison is then skipped.
            if let Ok(before) = Calibration::read(path) {
                for what in calibration.contradicts(&before) {
                    let path = path.display();
                    output::complain(format_args!(
                        "warning: {path}, which this replaces, says otherwise: {what}"
                    ));
                }
            }
            calibration.write(path)?;
        }
        if json {
            return output::json(&calibration);
        }
        output::text(&summary(&calibration))?;
        match &self.out {
            Some(path) => say!("written    {}", path.display()),
            None => Ok(()),
        }
    }
}

/// Describes the calibration.
fn summary(calibration: &Calibration) -> String {
    format!(
        "skew       {} ns (current later)\n{}\
         gain       voltage over current {}\n\
         offsets    {:.4} V, {:.5} A\n\
         assumed    {}\n",
        WithSigma::new(calibration.skew_s * 1e9, calibration.skew_sigma_s * 1e9),
        match calibration.response.is_none() {
            true => String::new(),
            false => format!("response   {}\n", calibration.response),
        },
        match calibration.gain_ratio_sigma > 0.0 {
            true =>
                WithSigma::new(calibration.gain_ratio, calibration.gain_ratio_sigma).to_string(),
            false => format!("{} (assumed)", calibration.gain_ratio),
        },
        calibration.v_offset_v,
        calibration.i_offset_a,
        calibration.assumed.join("; ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_become_references() {
        let empty = ReferenceLoad::NoPot {
            r_ohm: None,
            l_h: None,
        };
        assert_eq!(reference("no-pot").ok(), Some(empty));
        let known = reference("no-pot,r=0.1,l=72u").unwrap();
        assert!(
            matches!(known, ReferenceLoad::NoPot { r_ohm: Some(r), l_h: Some(l) }
            if r == 0.1 && (l / 72e-6 - 1.0).abs() < 1e-9)
        );
        assert_eq!(known.to_string(), "no-pot,r=0.1,l=72.0000u");
        let load = reference("r=3.3").unwrap();
        assert_eq!(load.to_string(), "r=3.3");
        for text in ["", "pot", "r", "r=", "r=-1", "x=3", "r=0", "r=NaN"] {
            assert!(reference(text).is_err(), "{text}");
        }
    }
}
