//! Profile, topics and layouts of the file, with all their names. docs/captures.md explains them.

use schemars::{JsonSchema, SchemaGenerator};
use serde::{Deserialize, Serialize};

/// Profile of the MCAP header: kind and version. The version rises if a reader of the old one would misunderstand the file; new
/// topics and fields do not raise it.
pub const PROFILE: &str = "ihd-capture 1";

/// Name of the MCAP metadata record that describes the whole capture: its name and full scales.
pub const META_CAPTURE: &str = "ihd-capture";

/// Name of the MCAP metadata record of free text.
pub const META_FREE: &str = "notes";

/// Kind of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Pairs as codes or as f32.
    Samples,
    /// Pairs before noise and quantising, from a simulation.
    CleanSamples,
    /// Truth of one switching period.
    Truth,
    /// [`FSw`].
    FSw,
    /// [`MainsCrossing`].
    Mains,
    /// [`Telemetry`].
    Telemetry,
    /// [`WindowNote`].
    Window,
    /// [`FaultNote`].
    Fault,
    /// [`LookupRecord`].
    Lookup,
    /// [`LinkCounters`].
    LinkCounters,
    /// Bytes from a device, in order.
    FromDevice,
    /// Bytes from a host, in order.
    ToDevice,
}

/// Description of a topic's messages.
pub enum MessageLayout {
    /// CDR, with the names and texts of its possible `ros2msg` schemas.
    Cdr(&'static [(&'static str, &'static str)]),
    /// JSON, with name and text of its schema.
    Json(&'static str, fn() -> String),
    /// Raw bytes of the link.
    Link,
}

/// Name of the schema of samples as 16-bit codes.
pub const SAMPLES_I16: &str = "ihd/msg/Samples";

/// Name of the schema of samples as f32.
pub const SAMPLES_F32: &str = "ihd/msg/SamplesF32";

const SAMPLES_I16_TEXT: &str = "\
# Coil voltage and current, sampled together. Time counts from the beginning of the capture.
float64 t0_s            # time of the first pair, s
float64 dt_s            # time from one pair to the next, s; 0 where t_s gives each
float64 volt_per_code
float64 ampere_per_code
int16[] vi              # codes: v, i, v, i, ...
float64[] t_s           # empty, or the time of each pair, s
";

const SAMPLES_F32_TEXT: &str = "\
# Coil voltage and current, sampled together. Time counts from the beginning of the capture.
float64 t0_s            # time of the first pair, s
float64 dt_s            # time from one pair to the next, s; 0 where t_s gives each
float32[] vi            # v in V, i in A: v, i, v, i, ...
float64[] t_s           # empty, or the time of each pair, s
";

const TRUTH_TEXT: &str = "\
# Truth of one switching period, from the noiseless waveform.
float64 t_s             # middle of the period, s
float64 f_sw_hz
float64[4] r_ohm        # at harmonics 1, 3, 5, 7
float64[4] l_h          # likewise
float64 i_a             # amplitude of the current's fundamental
float64 r_power_ohm     # P / I_rms^2
float64 p_w
";

const SAMPLES: &[(&str, &str)] = &[
    (SAMPLES_I16, SAMPLES_I16_TEXT),
    (SAMPLES_F32, SAMPLES_F32_TEXT),
];

fn schema_of<T: JsonSchema>() -> String {
    let schema = SchemaGenerator::default().into_root_schema_for::<T>();
    schema.as_value().to_string()
}

impl Topic {
    /// All topics.
    pub const ALL: [Self; 12] = [
        Self::Samples,
        Self::CleanSamples,
        Self::Truth,
        Self::FSw,
        Self::Mains,
        Self::Telemetry,
        Self::Window,
        Self::Fault,
        Self::Lookup,
        Self::LinkCounters,
        Self::FromDevice,
        Self::ToDevice,
    ];

    /// Name of the topic in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Samples => "/samples",
            Self::CleanSamples => "/samples/clean",
            Self::Truth => "/truth",
            Self::FSw => "/f_sw",
            Self::Mains => "/mains",
            Self::Telemetry => "/telemetry",
            Self::Window => "/window",
            Self::Fault => "/fault",
            Self::Lookup => "/lookup",
            Self::LinkCounters => "/link/counters",
            Self::FromDevice => "/link/from_device",
            Self::ToDevice => "/link/to_device",
        }
    }

    /// Topic of a name; `None` for one that this version does not know.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }

    /// Layout of its messages.
    pub fn layout(self) -> MessageLayout {
        match self {
            Self::Samples | Self::CleanSamples => MessageLayout::Cdr(SAMPLES),
            Self::Truth => MessageLayout::Cdr(&[("ihd/msg/PeriodTruth", TRUTH_TEXT)]),
            Self::FSw => MessageLayout::Json("ihd.FSw", schema_of::<FSw>),
            Self::Mains => MessageLayout::Json("ihd.Mains", schema_of::<MainsCrossing>),
            Self::Telemetry => MessageLayout::Json("ihd.Telemetry", schema_of::<Telemetry>),
            Self::Window => MessageLayout::Json("ihd.Window", schema_of::<WindowNote>),
            Self::Fault => MessageLayout::Json("ihd.Fault", schema_of::<FaultNote>),
            Self::Lookup => MessageLayout::Json("ihd.Lookup", schema_of::<LookupRecord>),
            Self::LinkCounters => {
                MessageLayout::Json("ihd.LinkCounters", schema_of::<LinkCounters>)
            }
            Self::FromDevice | Self::ToDevice => MessageLayout::Link,
        }
    }
}

/// From `t_s` on the hob switches at `f_sw_hz`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FSw {
    /// When, in seconds after the beginning of the capture.
    pub t_s: f64,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
}

/// A zero crossing of the mains.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MainsCrossing {
    /// When, in seconds after the beginning of the capture.
    pub zero_crossing_s: Option<f64>,
    /// Mains frequency in hertz.
    pub mains_hz: Option<f64>,
}

/// One half-cycle in numbers, as the device reported it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Telemetry {
    /// Counts every telemetry that was due.
    pub seq: u32,
    /// Dropped by the device since boot.
    pub dropped: u32,
    /// Half-cycle since boot.
    pub half_cycle: u32,
    /// State of the controller.
    pub state: String,
    /// Active fault.
    pub fault: String,
    /// Class of the pot on the coil.
    pub pot: String,
    /// Switching frequency in hertz; 0 with the inverter off.
    pub f_sw_hz: u32,
    /// Estimated R at the crest of the current, in ohm.
    pub r_ohm: f64,
    /// Estimated L at the crest of the current, in henry.
    pub l_h: f64,
    /// Largest amplitude of the current's fundamental, in ampere.
    pub i_crest_a: f64,
    /// Mean power of the half-cycle, in watt.
    pub power_w: f64,
    /// Lag of the current behind the inverter's voltage at the crest, in radian.
    pub phase_rad: f64,
    /// Version of the active lookup.
    pub lookup_version: u32,
    /// Power asked for, in watt; since protocol 2.0, like what follows.
    #[serde(default)]
    pub asked_w: u16,
    /// Limit that holds the power below the request.
    #[serde(default)]
    pub limit: String,
    /// Highest bus voltage of the half-cycle, in volt.
    #[serde(default)]
    pub bus_peak_v: f64,
    /// Largest coil voltage of the half-cycle, in volt.
    #[serde(default)]
    pub v_coil_peak_v: f64,
    /// Smallest current at a turn-off, in ampere; negative where it flows the wrong way.
    #[serde(default)]
    pub i_turn_off_min_a: f64,
    /// Reason for which the hob has switched itself off; since protocol 4.0, like what follows.
    #[serde(default)]
    pub off_reason: String,
    /// `true` while the glass is hot enough to burn.
    #[serde(default)]
    pub glass_hot: bool,
}

/// A window that arrived whole, or why it was rejected. Its pairs are in `/samples`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WindowNote {
    /// Counts every window that was due.
    pub seq: u32,
    /// Reason for its rejection; absent for a whole one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rejected: Option<String>,
    /// The rest, for a whole one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub whole: Option<WholeWindow>,
}

/// The header of a whole window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WholeWindow {
    /// Half-cycle since boot.
    pub half_cycle: u32,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Duration of the half-cycle in seconds.
    pub half_cycle_s: f64,
    /// Time of its zero crossing in seconds after the beginning of the capture.
    pub zero_crossing_s: f64,
    /// Pairs in the window.
    pub pairs: usize,
    /// Pairs at the end of the ADC's range.
    pub saturated: u16,
    /// Version of the active lookup.
    pub lookup_version: u32,
    /// Time of the first estimate, in seconds after the beginning of the capture.
    pub track_t0_s: f64,
    /// Time from one estimate to the next, in seconds.
    pub track_dt_s: f64,
    /// The device's own R, in ohm.
    pub track_r_ohm: Vec<f64>,
    /// The device's own L, in henry.
    pub track_l_h: Vec<f64>,
}

/// A fault tripped or was cleared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FaultNote {
    /// Half-cycle since boot.
    pub half_cycle: u32,
    /// Number of the fault; 0 when it was cleared.
    pub number: u16,
    /// Name of the fault.
    pub fault: String,
}

/// A lookup that was pushed to the device, or read from it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LookupRecord {
    /// `pushed` by the host, or `active` on the device.
    pub what: String,
    /// Its version; 0 is the built-in prior.
    pub version: u32,
    /// Cells that rest on observations.
    pub observed_cells: u32,
    /// Frequencies of the rows in hertz.
    pub f_sw_hz: Vec<f64>,
    /// Currents of the columns in ampere.
    pub i_a: Vec<f64>,
    /// Resistance in ohm, by frequency and current.
    pub r_ohm: Vec<Vec<f64>>,
    /// Inductance in henry, by frequency and current.
    pub l_h: Vec<Vec<f64>>,
}

/// Counts of the link so far, of damaged frames too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LinkCounters {
    /// Bytes received.
    pub bytes: u64,
    /// Frames with a correct CRC.
    pub frames_good: u32,
    /// Runs of bytes that were no frame.
    pub frames_bad: u32,
    /// Frames missing from the device's sequence.
    pub frames_lost: u32,
    /// Telemetry received.
    pub telemetry: u32,
    /// Telemetry numbers never seen.
    pub telemetry_missing: u32,
    /// Telemetry dropped by the device since boot.
    pub telemetry_dropped: u32,
    /// Windows received whole.
    pub windows: u32,
    /// Window numbers never seen.
    pub windows_missing: u32,
    /// Windows dropped by the device since boot.
    pub windows_dropped: u32,
    /// Windows rejected.
    pub windows_rejected: u32,
}
