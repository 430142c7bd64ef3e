//! Opening one database: pragmas, migrations, and whether it is whole.

use std::fs;
use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

use rusqlite::{Connection, ErrorCode, OpenFlags, TransactionBehavior};

use super::StoreError;
use super::error::is_damage;
use super::folder;
use super::schema::Schema;

/// How long a connection waits for another one that writes.
const BUSY: Duration = Duration::from_secs(5);

/// The same in a trial: nobody writes for so long.
const BUSY_IN_TRIAL: Duration = Duration::from_secs(1);

/// Faults that a check lists before it stops.
const MAX_FAULTS: u32 = 20;

/// What a check found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Found {
    /// Nothing wrong.
    Whole,
    /// Time ran out before it was through.
    Unfinished,
    /// What is wrong.
    Broken(String),
}

/// Opens a database to write, makes it where it is not, and brings its tables up to date.
///
/// # Errors
/// [`StoreError::Damaged`] where it is no database of ours, or broken; [`StoreError::Newer`]; else what
/// SQLite reports.
pub fn open(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    in_the_way(path)?;
    if !path.exists() {
        make(path, schema)?;
    }
    connect(path, schema, OpenFlags::SQLITE_OPEN_READ_WRITE)
}

/// Ending of the name that a database has until its tables are on disk.
pub const MAKING: &str = ".new";

/// Makes a database under another name, and renames it when it is whole: a file without tables is none that was left half-made.
fn make(path: &Path, schema: &Schema) -> Result<(), StoreError> {
    let mut name = path.as_os_str().to_owned();
    name.push(MAKING);
    let unfinished = Path::new(&name);
    if unfinished.exists() {
        folder::delete(unfinished)?;
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE;
    let made = connect(unfinished, schema, flags).and_then(|connection| {
        let closed = connection.close();
        closed.map_err(|(_, error)| as_error(path, "making its tables")(error))
    });
    let named = made.and_then(|()| {
        ihd_signal::atomic::rename(unfinished, path).map_err(StoreError::files(path, "renaming"))
    });
    if named.is_err() && unfinished.exists() {
        // It is removed at the next start otherwise.
        let _ = folder::delete(unfinished);
    }
    named
}

fn connect(path: &Path, schema: &Schema, flags: OpenFlags) -> Result<Connection, StoreError> {
    let flags = flags | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let mut connection =
        Connection::open_with_flags(path, flags).map_err(as_error(path, "opening"))?;
    prepare(&mut connection, path, schema)?;
    Ok(connection)
}

/// Opens a database to read, beside whoever writes it.
///
/// # Errors
/// As [`open`].
pub fn open_to_read(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    in_the_way(path)?;
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags).map_err(as_error(path, "opening"))?;
    connection
        .busy_timeout(BUSY)
        .map_err(as_error(path, "opening"))?;
    let version = version(&connection, path, schema)?;
    if version == 0 {
        return Err(damaged(path, "it has no tables".to_owned()));
    }
    tables(&connection, path, schema, version)?;
    Ok(connection)
}

/// Opens a database as it is, looks at its pages for as long as there is time, and begins to write, no more.
///
/// # Errors
/// As [`open_to_read`], and where it may not be written or is locked.
pub fn try_writing(path: &Path, schema: &Schema, within: Duration) -> Result<Found, StoreError> {
    let connection = open_to_read(path, schema)?;
    let found = quick_check(&connection, path, within)?;
    if let Found::Broken(why) = found {
        return Err(damaged(path, why));
    }
    drop(connection);
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let begun = Connection::open_with_flags(path, flags).and_then(|connection| {
        connection.busy_timeout(BUSY_IN_TRIAL)?;
        connection.execute_batch("BEGIN IMMEDIATE; ROLLBACK")
    });
    begun.map_err(as_error(path, "a trial of writing"))?;
    Ok(found)
}

fn prepare(connection: &mut Connection, path: &Path, schema: &Schema) -> Result<(), StoreError> {
    let opening = || as_error(path, "opening");
    connection.busy_timeout(BUSY).map_err(opening())?;
    let version = version(connection, path, schema)?;
    if version == 0 && schema.shrinks {
        // Before the first page is written.
        connection
            .pragma_update(None, "auto_vacuum", "INCREMENTAL")
            .map_err(opening())?;
    }
    // The first that reads the file: what is no database shows here.
    connection
        .pragma_update_and_check(None, "journal_mode", "WAL", |row| row.get::<_, String>(0))
        .map_err(opening())?;
    for (pragma, value) in [
        ("synchronous", schema.synchronous),
        ("foreign_keys", "ON"),
        ("trusted_schema", "OFF"),
        ("cell_size_check", "ON"),
    ] {
        connection
            .pragma_update(None, pragma, value)
            .map_err(opening())?;
    }
    // What a checkpoint leaves of the log's length: its pages are used again.
    connection
        .pragma_update_and_check(None, "journal_size_limit", 8 << 20, |_| Ok(()))
        .map_err(opening())?;
    migrate(connection, path, schema, version)?;
    tables(connection, path, schema, schema.steps.len() as i64)
}

/// The version of its tables; 0 for a file without.
fn version(connection: &Connection, path: &Path, schema: &Schema) -> Result<i64, StoreError> {
    let pragma = |name: &str| {
        connection
            .pragma_query_value(None, name, |row| row.get::<_, i64>(0))
            .map_err(as_error(path, "opening"))
    };
    let (application, found) = (pragma("application_id")?, pragma("user_version")?);
    let known = schema.steps.len() as i64;
    let any: i64 = connection
        .query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))
        .map_err(as_error(path, "opening"))?;
    if any > 0 && application != i64::from(schema.application_id) {
        return Err(damaged(path, "it is another program's database".to_owned()));
    }
    if found > known {
        let file = path.to_owned();
        return Err(StoreError::Newer { file, found, known });
    }
    if found < 0 || (found == 0) != (any == 0) {
        let why = format!("its tables are of version {found}, and there are {any} of them");
        return Err(damaged(path, why));
    }
    Ok(found)
}

fn migrate(
    connection: &mut Connection,
    path: &Path,
    schema: &Schema,
    from: i64,
) -> Result<(), StoreError> {
    for (k, step) in schema.steps.iter().enumerate().skip(from as usize) {
        let migrated = || -> rusqlite::Result<()> {
            let transaction =
                connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            transaction.execute_batch(step)?;
            transaction.pragma_update(None, "user_version", k as i64 + 1)?;
            transaction.pragma_update(None, "application_id", schema.application_id)?;
            transaction.commit()
        };
        let mut migrated = migrated;
        migrated().map_err(as_error(path, "making its tables"))?;
    }
    Ok(())
}

/// Whether the tables of a version are there.
fn tables(
    connection: &Connection,
    path: &Path,
    schema: &Schema,
    version: i64,
) -> Result<(), StoreError> {
    let made = usize::try_from(version).unwrap_or(0);
    for table in schema.tables.iter().take(made).copied().flatten() {
        let found: i64 = connection
            .query_row(
                "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = ?1",
                [table],
                |row| row.get(0),
            )
            .map_err(as_error(path, "opening"))?;
        if found == 0 {
            return Err(damaged(path, format!("a table is missing: {table}")));
        }
    }
    Ok(())
}

/// Whether every page is where it belongs; gives up after `within`.
///
/// # Errors
/// What SQLite reports other than damage.
pub fn quick_check(
    connection: &Connection,
    path: &Path,
    within: Duration,
) -> Result<Found, StoreError> {
    run_check(
        connection,
        path,
        &format!("PRAGMA quick_check({MAX_FAULTS})"),
        within,
    )
}

/// As [`quick_check`], and whether the indices hold what the tables do.
///
/// # Errors
/// What SQLite reports other than damage.
pub fn integrity_check(connection: &Connection, path: &Path) -> Result<Found, StoreError> {
    let pragma = format!("PRAGMA integrity_check({MAX_FAULTS})");
    run_check(connection, path, &pragma, Duration::from_secs(24 * 3600))
}

fn run_check(
    connection: &Connection,
    path: &Path,
    pragma: &str,
    within: Duration,
) -> Result<Found, StoreError> {
    let interrupt = connection.get_interrupt_handle();
    let (through, deadline) = mpsc::channel::<()>();
    let faults = std::thread::scope(|scope| {
        scope.spawn(move || {
            if deadline.recv_timeout(within) == Err(mpsc::RecvTimeoutError::Timeout) {
                interrupt.interrupt();
            }
        });
        let faults = connection.prepare(pragma).and_then(|mut statement| {
            let rows = statement.query_map([], |row| row.get::<_, String>(0))?;
            rows.collect::<rusqlite::Result<Vec<String>>>()
        });
        drop(through);
        faults
    });
    match faults {
        Ok(faults) if faults.iter().all(|fault| fault == "ok") => Ok(Found::Whole),
        Ok(faults) => Ok(Found::Broken(faults.join("; "))),
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::OperationInterrupted) => {
            Ok(Found::Unfinished)
        }
        Err(error) if is_damage(&error) => Ok(Found::Broken(error.to_string())),
        Err(error) => Err(as_error(path, "checking")(error)),
    }
}

/// Refuses a path that is no file, or a file without a byte.
fn in_the_way(path: &Path) -> Result<(), StoreError> {
    for ending in ["", "-wal", "-shm"] {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        let path = Path::new(&name);
        match fs::metadata(path) {
            Ok(about) if !about.is_file() => {
                return Err(damaged(path, "it is no file".to_owned()));
            }
            Ok(about) if about.len() == 0 && ending.is_empty() => {
                return Err(damaged(path, "it is empty: 0 bytes".to_owned()));
            }
            _ => {}
        }
    }
    Ok(())
}

fn damaged(path: &Path, why: String) -> StoreError {
    let file = path.to_owned();
    StoreError::Damaged { file, why }
}

/// Damage as such, anything else as what SQLite reports.
fn as_error(path: &Path, doing: &'static str) -> impl FnOnce(rusqlite::Error) -> StoreError {
    move |error| {
        if is_damage(&error) {
            damaged(path, error.to_string())
        } else {
            StoreError::database(path, doing)(error)
        }
    }
}
