//! Export of a recording to NumPy's NPZ: arrays of samples, windows, half-cycles and faults.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Seek};
use std::path::Path;

use ihd_shared::fault::Fault;

use super::super::npz::Archive;
use super::{ByteBudget, ExportLimits, RecordingExportError, Row, nothing, rows};
use crate::mcap::FileLosses;
use crate::mcap::topics::{Telemetry, WholeWindow};

/// Room for a text: the name of a state or of a fault.
const WORD: usize = 24;

const _: () = {
    let mut k = 0;
    while k < Fault::TABLE.len() {
        assert!(Fault::TABLE[k].name.len() <= WORD, "a fault's name is cut");
        k += 1;
    }
};

/// NumPy's type of a text of [`WORD`] characters.
const WORDS: &str = "<U24";

/// Name of the note that says what of a recording was lost.
const LOSSES: &str = "losses";

/// Creates a temporary file for an array whose length is not known yet.
pub type Spool<'a> = &'a dyn Fn() -> io::Result<File>;

/// Writes a recording as arrays, and what of it was lost as a note. Returns the losses.
///
/// # Errors
/// [`RecordingExportError`]; what was written until then is no archive.
pub fn recording_npz(
    path: &Path,
    out: File,
    spool: Spool<'_>,
    limits: &ExportLimits<'_>,
) -> Result<FileLosses, RecordingExportError> {
    let mut arrays = Arrays {
        spool,
        columns: Vec::new(),
        budget: ByteBudget::from_limits(limits),
        notes: BTreeMap::new(),
    };
    let losses = rows(path, limits, &mut |row| arrays.take(row))?;
    if arrays.columns.is_empty() {
        return Err(nothing(
            path,
            "half-cycle",
            "the MCAP file has what it holds",
        ));
    }
    if !losses.is_none() {
        arrays.notes.insert(LOSSES.into(), losses.to_string());
    }
    arrays.pack(out)?;
    Ok(losses)
}

/// Column of numbers of one type, whose length is not known yet.
struct Column {
    name: &'static str,
    descr: &'static str,
    count: usize,
    file: BufWriter<File>,
}

struct Arrays<'a> {
    spool: Spool<'a>,
    columns: Vec<Column>,
    budget: ByteBudget,
    notes: BTreeMap<String, String>,
}

impl Arrays<'_> {
    fn take(&mut self, row: Row<'_>) -> Result<(), RecordingExportError> {
        match row {
            Row::Notes(notes) => {
                self.notes.clone_from(notes);
                Ok(())
            }
            Row::HalfCycle(t_s, t) => self.half_cycle(t_s, &t),
            Row::Fault(t_s, fault) => {
                self.double("fault_t_s", t_s)?;
                self.put("fault_number", "<u2", &fault.number.to_le_bytes())?;
                self.text("fault_name", &fault.fault)
            }
            Row::Window(number, begins_s, window, pairs) => {
                self.window(number, begins_s, &window)?;
                for (t_s, v_v, i_a) in pairs {
                    self.double("time_s", *t_s)?;
                    self.put("v_V", "<f4", &v_v.to_le_bytes())?;
                    self.put("i_A", "<f4", &i_a.to_le_bytes())?;
                    self.put("window", "<u4", &number.to_le_bytes())?;
                }
                Ok(())
            }
        }
    }

    fn window(
        &mut self,
        number: u32,
        begins_s: f64,
        w: &WholeWindow,
    ) -> Result<(), RecordingExportError> {
        self.put("windows_number", "<u4", &number.to_le_bytes())?;
        self.double("windows_t_s", begins_s)?;
        self.put("windows_half_cycle", "<u4", &w.half_cycle.to_le_bytes())?;
        self.double("windows_f_sw_hz", f64::from(w.f_sw_hz))?;
        let saturated = w.saturated.to_le_bytes();
        self.put("windows_saturated", "<u2", &saturated)
    }

    fn half_cycle(&mut self, t_s: f64, t: &Telemetry) -> Result<(), RecordingExportError> {
        let off = t.f_sw_hz == 0;
        let or_none = |x: f64| if off { f64::NAN } else { x };
        for (name, x) in [
            ("half_cycle_t_s", t_s),
            ("half_cycle_power_w", t.power_w),
            ("half_cycle_asked_w", f64::from(t.asked_w)),
            ("half_cycle_f_sw_hz", f64::from(t.f_sw_hz)),
            ("half_cycle_i_crest_a", t.i_crest_a),
            ("half_cycle_r_ohm", or_none(t.r_ohm)),
            ("half_cycle_l_h", or_none(t.l_h)),
            ("half_cycle_phase_deg", t.phase_rad.to_degrees()),
            ("half_cycle_bus_peak_v", t.bus_peak_v),
            ("half_cycle_v_coil_peak_v", t.v_coil_peak_v),
            ("half_cycle_i_turn_off_min_a", t.i_turn_off_min_a),
        ] {
            self.double(name, x)?;
        }
        let [number, version] = [t.half_cycle, t.lookup_version].map(u32::to_le_bytes);
        self.put("half_cycle_number", "<u4", &number)?;
        self.put("half_cycle_lookup_version", "<u4", &version)?;
        self.text("half_cycle_state", &t.state)?;
        self.text("half_cycle_pot", &t.pot)?;
        self.text("half_cycle_fault", &t.fault)?;
        self.text("half_cycle_limit", &t.limit)
    }

    fn double(&mut self, name: &'static str, x: f64) -> Result<(), RecordingExportError> {
        self.put(name, "<f8", &x.to_le_bytes())
    }

    fn text(&mut self, name: &'static str, text: &str) -> Result<(), RecordingExportError> {
        let mut bytes = [0; 4 * WORD];
        for (to, c) in bytes.chunks_exact_mut(4).zip(text.chars()) {
            to.copy_from_slice(&u32::from(c).to_le_bytes());
        }
        self.put(name, WORDS, &bytes)
    }

    fn put(
        &mut self,
        name: &'static str,
        descr: &'static str,
        bytes: &[u8],
    ) -> Result<(), RecordingExportError> {
        // Some thirty names; those of a sample are asked for in the same order again and again.
        let column = match self
            .columns
            .iter_mut()
            .position(|c| std::ptr::eq(c.name, name))
        {
            Some(k) => &mut self.columns[k],
            None => {
                self.columns.push(Column {
                    name,
                    descr,
                    count: 0,
                    file: BufWriter::new((self.spool)()?),
                });
                let last = self.columns.len() - 1;
                &mut self.columns[last]
            }
        };
        column.count += 1;
        self.budget.write(&mut column.file, bytes)
    }

    fn pack(self, out: File) -> io::Result<()> {
        let mut archive = Archive::new(out);
        for column in self.columns {
            let mut file = column.file.into_inner().map_err(|e| e.into_error())?;
            file.rewind()?;
            let shape = format!("({},)", column.count);
            archive.copied(column.name, column.descr, &shape, BufReader::new(file))?;
        }
        archive.finish(&self.notes)
    }
}
