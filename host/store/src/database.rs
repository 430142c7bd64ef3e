//! Opening of one database: pragmas, migrations, integrity check.

use std::fs;
use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

use rusqlite::{Connection, ErrorCode, OpenFlags, TransactionBehavior};

use super::StoreError;
use super::error::is_damage;
use super::folder;
use super::schema::Schema;

/// Longest wait for another connection that writes.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest wait for another connection in a trial: longer than any write takes.
const BUSY_IN_TRIAL: Duration = Duration::from_secs(1);

/// Faults that a check lists before it stops.
const MAX_FAULTS: u32 = 20;

/// Result of a database's integrity check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum IntegrityCheck {
    /// No fault.
    Ok,
    /// The time ran out before the end.
    TimedOut,
    /// Faults, as text.
    Corrupt(String),
}

/// Opens a database for writing, creates it if it does not exist, and migrates its tables.
///
/// # Errors
/// [`StoreError::Damaged`] if it is not a database of ours or corrupt; [`StoreError::Newer`]; or an error of
/// SQLite.
pub fn open(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    check_is_file(path)?;
    if !path.exists() {
        make(path, schema)?;
    }
    connect(path, schema, OpenFlags::SQLITE_OPEN_READ_WRITE)
}

/// Creates a database under another name and renames it when it is complete, so that a file without tables is never a half-made one.
fn make(path: &Path, schema: &Schema) -> Result<(), StoreError> {
    let mut name = path.as_os_str().to_owned();
    name.push(folder::MAKING);
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
        // Otherwise the next start removes it.
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

/// Opens a database for reading; another process may write meanwhile.
///
/// # Errors
/// The same as for [`open`].
pub fn open_to_read(path: &Path, schema: &Schema) -> Result<Connection, StoreError> {
    check_is_file(path)?;
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags).map_err(as_error(path, "opening"))?;
    connection
        .busy_timeout(BUSY_TIMEOUT)
        .map_err(as_error(path, "opening"))?;
    let version = version(&connection, path, schema)?;
    if version == 0 {
        return Err(damaged(path, "it has no tables".to_owned()));
    }
    tables(&connection, path, schema, version)?;
    Ok(connection)
}

/// Runs a statement that fails at once, where others wait, if another connection is in its way.
///
/// # Errors
/// Errors of SQLite.
pub fn without_waiting<T>(
    connection: &Connection,
    run: impl FnOnce() -> rusqlite::Result<T>,
) -> rusqlite::Result<T> {
    connection.busy_timeout(Duration::ZERO)?;
    let done = run();
    connection.busy_timeout(BUSY_TIMEOUT)?;
    done
}

/// Opens a database, checks its pages up to the time limit, and begins and rolls back a write.
///
/// # Errors
/// The same as for [`open_to_read`]; also if it may not be written or is locked.
pub fn try_writing(
    path: &Path,
    schema: &Schema,
    within: Duration,
) -> Result<IntegrityCheck, StoreError> {
    let connection = open_to_read(path, schema)?;
    let integrity = quick_check(&connection, path, within)?;
    if let IntegrityCheck::Corrupt(why) = integrity {
        return Err(damaged(path, why));
    }
    drop(connection);
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let begun = Connection::open_with_flags(path, flags).and_then(|connection| {
        connection.busy_timeout(BUSY_IN_TRIAL)?;
        connection.execute_batch("BEGIN IMMEDIATE; ROLLBACK")
    });
    begun.map_err(as_error(path, "a trial of writing"))?;
    Ok(integrity)
}

fn prepare(connection: &mut Connection, path: &Path, schema: &Schema) -> Result<(), StoreError> {
    let opening = || as_error(path, "opening");
    connection.busy_timeout(BUSY_TIMEOUT).map_err(opening())?;
    let version = version(connection, path, schema)?;
    if version == 0 && schema.shrinks {
        // Before the first page is written.
        connection
            .pragma_update(None, "auto_vacuum", "INCREMENTAL")
            .map_err(opening())?;
    }
    // First access to the file: fails here if it is not a database.
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
    // Length to which a checkpoint cuts the log; its pages are reused.
    connection
        .pragma_update_and_check(None, "journal_size_limit", 8 << 20, |_| Ok(()))
        .map_err(opening())?;
    migrate(connection, path, schema, version)?;
    tables(connection, path, schema, schema.steps.len() as i64)
}

/// Returns the version of the tables; 0 for a file without tables.
fn version(connection: &Connection, path: &Path, schema: &Schema) -> Result<i64, StoreError> {
    let pragma = |name: &str| {
        connection
            .pragma_query_value(None, name, |row| row.get::<_, i64>(0))
            .map_err(as_error(path, "opening"))
    };
    let (application, version) = (pragma("application_id")?, pragma("user_version")?);
    let known = schema.steps.len() as i64;
    let any: i64 = connection
        .query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))
        .map_err(as_error(path, "opening"))?;
    if any > 0 && application != i64::from(schema.application_id) {
        return Err(damaged(path, "it is another program's database".to_owned()));
    }
    if version > known {
        let file = path.to_owned();
        return Err(StoreError::Newer {
            file,
            version,
            known,
        });
    }
    if version < 0 || (version == 0) != (any == 0) {
        let why = format!("its tables are of version {version}, and there are {any} of them");
        return Err(damaged(path, why));
    }
    Ok(version)
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

/// Checks that the tables of a version exist.
fn tables(
    connection: &Connection,
    path: &Path,
    schema: &Schema,
    version: i64,
) -> Result<(), StoreError> {
    let made = usize::try_from(version).unwrap_or(0);
    for table in schema.tables.iter().take(made).copied().flatten() {
        let count: i64 = connection
            .query_row(
                "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = ?1",
                [table],
                |row| row.get(0),
            )
            .map_err(as_error(path, "opening"))?;
        if count == 0 {
            return Err(damaged(path, format!("a table is missing: {table}")));
        }
    }
    Ok(())
}

/// Checks the structure of every page, for `within` at most.
///
/// # Errors
/// Errors of SQLite other than damage.
pub fn quick_check(
    connection: &Connection,
    path: &Path,
    within: Duration,
) -> Result<IntegrityCheck, StoreError> {
    run_check(
        connection,
        path,
        &format!("PRAGMA quick_check({MAX_FAULTS})"),
        within,
    )
}

/// Checks the structure of every page, and that the indices agree with the tables.
///
/// # Errors
/// Errors of SQLite other than damage.
pub fn integrity_check(connection: &Connection, path: &Path) -> Result<IntegrityCheck, StoreError> {
    let pragma = format!("PRAGMA integrity_check({MAX_FAULTS})");
    run_check(connection, path, &pragma, Duration::from_secs(24 * 3600))
}

fn run_check(
    connection: &Connection,
    path: &Path,
    pragma: &str,
    within: Duration,
) -> Result<IntegrityCheck, StoreError> {
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
        Ok(faults) if faults.iter().all(|fault| fault == "ok") => Ok(IntegrityCheck::Ok),
        Ok(faults) => Ok(IntegrityCheck::Corrupt(faults.join("; "))),
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::OperationInterrupted) => {
            Ok(IntegrityCheck::TimedOut)
        }
        Err(error) if is_damage(&error) => Ok(IntegrityCheck::Corrupt(error.to_string())),
        Err(error) => Err(as_error(path, "checking")(error)),
    }
}

/// Refuses a path that is not a file, and an empty file.
fn check_is_file(path: &Path) -> Result<(), StoreError> {
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

/// Turns an error of SQLite into [`StoreError::Damaged`] if it is damage.
fn as_error(path: &Path, doing: &'static str) -> impl FnOnce(rusqlite::Error) -> StoreError {
    move |error| {
        if is_damage(&error) {
            damaged(path, error.to_string())
        } else {
            StoreError::database(path, doing)(error)
        }
    }
}
