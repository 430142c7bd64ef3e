//! Tables, as migration steps. A released step is never changed: a later change
//! is a step of its own.

/// Kind of a database: its tables and pragmas.
pub struct Schema {
    /// SQLite's `application_id`, by which the command `file` identifies it.
    pub application_id: i32,
    /// SQL of each step, from version `n - 1` of the tables to version `n`, from 1.
    pub steps: &'static [&'static str],
    /// Tables that each step creates: they must exist from its version on.
    pub tables: &'static [&'static [&'static str]],
    /// `true` if freed pages go back to the disk on demand: SQLite's `auto_vacuum = INCREMENTAL`.
    pub shrinks: bool,
    /// SQLite's `synchronous`: FULL lasts when the power fails, NORMAL when the process does.
    pub synchronous: &'static str,
}

/// "IHDr" and "IHDw".
const RECORDS_ID: i32 = i32::from_be_bytes(*b"IHDr");
const WINDOWS_ID: i32 = i32::from_be_bytes(*b"IHDw");

/// `ihd.db`.
pub static RECORDS: Schema = Schema {
    application_id: RECORDS_ID,
    steps: &[
        RECORDS_1, RECORDS_2, RECORDS_3, RECORDS_4, RECORDS_5, RECORDS_6, RECORDS_7,
    ],
    tables: &[
        &[
            "devices", "sessions", "results", "lookups", "learned", "events", "audit",
        ],
        &[],
        &["fleet"],
        &["used"],
        &[],
        &["alloys"],
        &[],
    ],
    shrinks: false,
    synchronous: "FULL",
};

/// `windows-YYYY-MM-DD.db`.
pub static WINDOWS: Schema = Schema {
    application_id: WINDOWS_ID,
    steps: &[WINDOWS_1, WINDOWS_2, WINDOWS_3, WINDOWS_4, WINDOWS_5],
    tables: &[&["windows"], &["telemetry", "trajectories"], &[], &[], &[]],
    shrinks: true,
    synchronous: "NORMAL",
};

const RECORDS_1: &str = "
CREATE TABLE devices (
    id            INTEGER PRIMARY KEY,
    name          TEXT NOT NULL UNIQUE,   -- in the configuration
    address       TEXT NOT NULL,          -- where it was last
    first_seen_ms INTEGER NOT NULL        -- milliseconds since 1970, UTC, here and below
) STRICT;

-- One connection each; several may be of one boot.
CREATE TABLE sessions (
    id                 INTEGER PRIMARY KEY,
    device             INTEGER NOT NULL REFERENCES devices (id),
    boot               INTEGER NOT NULL,
    began_ms           INTEGER NOT NULL,
    ended_ms           INTEGER,
    why                TEXT,               -- why it ended
    build              TEXT NOT NULL,
    board              TEXT NOT NULL,
    protocol_major     INTEGER NOT NULL,
    protocol_minor     INTEGER NOT NULL,
    capabilities       INTEGER NOT NULL,
    reset_reason       INTEGER NOT NULL,
    fault_before_reset INTEGER NOT NULL,
    v_full_scale_mv    INTEGER NOT NULL,
    i_full_scale_ma    INTEGER NOT NULL,
    bus_full_scale_mv  INTEGER NOT NULL,
    mains_full_scale_mv INTEGER NOT NULL,
    bits               INTEGER NOT NULL
) STRICT;
CREATE INDEX sessions_of_device ON sessions (device, began_ms);
CREATE INDEX sessions_open ON sessions (ended_ms) WHERE ended_ms IS NULL;

-- What was learned of a window. Numbers that are not finite are NULL.
CREATE TABLE results (
    id             INTEGER PRIMARY KEY,
    session        INTEGER NOT NULL REFERENCES sessions (id),
    device         INTEGER NOT NULL REFERENCES devices (id),
    boot           INTEGER NOT NULL,
    seq            INTEGER NOT NULL,       -- of the window, since the boot
    half_cycle     INTEGER NOT NULL,       -- since the boot
    at_ms          INTEGER NOT NULL,
    f_sw_hz        INTEGER NOT NULL,
    i_crest_a      REAL,
    power_w        REAL,
    r_ohm          REAL,
    l_h            REAL,
    sigma_r_pct    REAL,
    sigma_l_pct    REAL,
    pass           INTEGER NOT NULL CHECK (pass IN (0, 1)),
    why            TEXT NOT NULL,          -- why the gate refused it
    changed_lookup INTEGER NOT NULL CHECK (changed_lookup IN (0, 1)),
    iterations     INTEGER NOT NULL,
    UNIQUE (device, boot, seq)
) STRICT;
CREATE INDEX results_in_time ON results (at_ms);
CREATE INDEX results_of_device ON results (device, at_ms);

CREATE TABLE lookups (
    id      INTEGER PRIMARY KEY,
    device  INTEGER NOT NULL REFERENCES devices (id),
    version INTEGER NOT NULL,
    state   TEXT NOT NULL CHECK (state IN ('pending', 'active', 'superseded', 'refused')),
    origin  TEXT NOT NULL CHECK (origin IN ('host', 'device')),
    at_ms   INTEGER NOT NULL,              -- of its last change of state
    why     TEXT NOT NULL,
    blob    BLOB NOT NULL                  -- as it is pushed
) STRICT;
CREATE INDEX lookups_of_device ON lookups (device, version);
CREATE UNIQUE INDEX one_active_lookup ON lookups (device) WHERE state = 'active';
CREATE UNIQUE INDEX one_pending_lookup ON lookups (device) WHERE state = 'pending';

-- What a device's learner goes on from.
CREATE TABLE learned (
    device INTEGER PRIMARY KEY REFERENCES devices (id),
    at_ms  INTEGER NOT NULL,
    state  BLOB NOT NULL                   -- JSON of the learner's own
) STRICT;

CREATE TABLE events (
    id     INTEGER PRIMARY KEY,
    at_ms  INTEGER NOT NULL,
    device INTEGER REFERENCES devices (id), -- NULL where the daemon itself speaks
    kind   TEXT NOT NULL,
    text   TEXT NOT NULL
) STRICT;

-- Every command, and what became of it.
CREATE TABLE audit (
    id      INTEGER PRIMARY KEY,
    at_ms   INTEGER NOT NULL,
    device  INTEGER REFERENCES devices (id),
    holder  TEXT NOT NULL,                 -- who asked
    command TEXT NOT NULL,
    outcome TEXT NOT NULL
) STRICT;
";

const WINDOWS_1: &str = "
-- Every window that came whole. The files of a day stand alone: devices have their names.
CREATE TABLE windows (
    id                  INTEGER PRIMARY KEY,
    device              TEXT NOT NULL,
    boot                INTEGER NOT NULL,
    seq                 INTEGER NOT NULL,  -- counts every window that was due since the boot
    at_ms               INTEGER NOT NULL,  -- when it was stored, milliseconds since 1970, UTC
    half_cycle          INTEGER NOT NULL,  -- since the boot
    f_sw_hz             INTEGER NOT NULL,
    half_cycle_ns       INTEGER NOT NULL,
    first_pair_ns       INTEGER NOT NULL,  -- after the mains zero crossing
    first_trajectory_ns INTEGER NOT NULL,  -- after the mains zero crossing
    saturated           INTEGER NOT NULL,  -- pairs at the end of the range
    lookup_version      INTEGER NOT NULL,
    v_full_scale_mv     INTEGER NOT NULL,  -- what code -2048 stands for
    i_full_scale_ma     INTEGER NOT NULL,
    pairs               INTEGER NOT NULL,
    trajectory          INTEGER NOT NULL,
    not_kept            TEXT,              -- why the samples are not here: 'policy', 'tells nothing', 'size'
    pairs_zst           BLOB,              -- pairs of int16 v, int16 i, little-endian, in zstd
    trajectory_zst      BLOB,              -- int32 R in microohm, int32 L in picohenry, likewise
    UNIQUE (device, boot, seq),
    CHECK ((not_kept IS NULL) = (pairs_zst IS NOT NULL)),
    CHECK ((pairs_zst IS NULL) = (trajectory_zst IS NULL))
) STRICT;
CREATE INDEX windows_in_time ON windows (device, at_ms);
";

const RECORDS_2: &str = "
-- How well each cell is founded, [frequency][current], a byte a cell: 255 is 1. NULL where nobody told.
ALTER TABLE lookups ADD COLUMN confidence BLOB;
CREATE INDEX events_in_time ON events (at_ms);
CREATE INDEX audit_in_time ON audit (at_ms);
";

const RECORDS_3: &str = "
-- What an edge of a fleet remembers.
CREATE TABLE fleet (
    what  TEXT PRIMARY KEY,                -- 'events': up to which id they were acknowledged; 'secret 1', 'secret 2'
    value INTEGER NOT NULL
) STRICT;
";

const WINDOWS_2: &str = "
-- What a device did: a row for each second, and one for each minute, in which it spoke. R, L and the switching
-- frequency are of those half-cycles in which it heated, NULL without one.
CREATE TABLE telemetry (
    device           TEXT NOT NULL,
    span_s           INTEGER NOT NULL CHECK (span_s IN (1, 60)),
    at_s             INTEGER NOT NULL,     -- where it begins, seconds since 1970, UTC
    half_cycles      INTEGER NOT NULL,
    heating          INTEGER NOT NULL,     -- half-cycles in which it heated
    asked_w          INTEGER NOT NULL,     -- at the end, as the two below
    state            INTEGER NOT NULL,     -- number of the protocol's State (docs/protocol.md)
    pot              INTEGER NOT NULL,     -- number of the protocol's Pot
    fault            INTEGER NOT NULL,     -- the last one in it, 0 for none
    power_min_mw     INTEGER NOT NULL,
    power_mean_mw    INTEGER NOT NULL,
    power_max_mw     INTEGER NOT NULL,
    i_crest_min_ma   INTEGER NOT NULL,     -- amplitude of the current's fundamental at the crest
    i_crest_mean_ma  INTEGER NOT NULL,
    i_crest_max_ma   INTEGER NOT NULL,
    r_min_uohm       INTEGER,              -- the device's own R and L at the crest
    r_mean_uohm      INTEGER,
    r_max_uohm       INTEGER,
    l_min_ph         INTEGER,
    l_mean_ph        INTEGER,
    l_max_ph         INTEGER,
    f_sw_min_hz      INTEGER,
    f_sw_mean_hz     INTEGER,
    f_sw_max_hz      INTEGER,
    PRIMARY KEY (device, span_s, at_s)
) STRICT, WITHOUT ROWID;

-- R and L over the half-cycle of windows whose samples are here, thinned. Columns of float32, one after the other,
-- little-endian, in zstd: seconds after the mains zero crossing, ohm, henry, ampere (amplitude of the fundamental);
-- of the network also the standard deviations of R and L, where it told them.
CREATE TABLE trajectories (
    id             INTEGER PRIMARY KEY,
    device         TEXT NOT NULL,
    boot           INTEGER NOT NULL,
    seq            INTEGER NOT NULL,
    network_points INTEGER,                -- of each column
    network_zst    BLOB,
    truth_points   INTEGER,
    truth_zst      BLOB,                   -- where the device was simulated in the daemon
    UNIQUE (device, boot, seq)
) STRICT;
";

const WINDOWS_3: &str = "
-- Whether a fleet has the window: NULL where it need not, 0 where that is due, 1 where it has acknowledged the window, 2 where
-- there is a result here and there.
ALTER TABLE windows ADD COLUMN fleet INTEGER CHECK (fleet IN (0, 1, 2));
CREATE INDEX windows_due ON windows (at_ms) WHERE fleet = 0;
CREATE INDEX windows_unanswered ON windows (at_ms) WHERE fleet = 1;
";

const RECORDS_4: &str = "
-- How long the store was in use, in steps that no clock can stretch: retention tells the age of a day by it.
CREATE TABLE used (
    day     TEXT PRIMARY KEY,              -- when a day's file was seen first; '' is now
    used_ms INTEGER NOT NULL
) STRICT;
";

const RECORDS_5: &str = "
-- Standard deviation of each cell, first of all R, then of all L, [frequency][current]: a little-endian uint16 in 0.01 % of the cell's
-- value, 65535 for that and more. NULL where nobody told.
ALTER TABLE lookups ADD COLUMN sigma BLOB;
";

const RECORDS_6: &str = "
-- Effects of heat on the metals of pots that boiled water on a device's coil.
CREATE TABLE alloys (
    device INTEGER PRIMARY KEY REFERENCES devices (id),
    at_ms  INTEGER NOT NULL,
    state  BLOB NOT NULL                   -- JSON of the thermometer's own
) STRICT;
";

const RECORDS_7: &str = "
-- Number of the chip of the board that was there last, in hexadecimal; NULL where none was told.
ALTER TABLE devices ADD COLUMN chip TEXT;
";

const WINDOWS_4: &str = "
-- Windows with samples in the order in which they came: retention goes through them. Where samples went to make room, not_kept is
-- 'thinned'.
CREATE INDEX windows_with_samples ON windows (id) WHERE not_kept IS NULL;
";

const WINDOWS_5: &str = "
-- Beside fleet = 2: NULL where the fleet has answered, 'learned here', or why the window was given up: 'no samples' (they went before
-- it was sent), 'dead: WHY' (no worker could identify it).
ALTER TABLE windows ADD COLUMN fleet_end TEXT;
-- Since when fleet is what it is, milliseconds since 1970, UTC; NULL: since at_ms.
ALTER TABLE windows ADD COLUMN fleet_ms INTEGER;
DROP INDEX windows_unanswered;
CREATE INDEX windows_at_fleet ON windows (fleet, fleet_end, fleet_ms, at_ms);
";
