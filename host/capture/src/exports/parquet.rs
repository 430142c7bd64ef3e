//! Export to Apache Parquet: columns `time_s`, `v_V`, `i_A`; the capture's metadata become the file's.

use std::fs::File;
use std::sync::Arc;

use ihd_signal::Capture;
use parquet::basic::Compression;
use parquet::data_type::{DataType, DoubleType, FloatType};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;

use super::time_s;

/// Rows of a group, which is buffered in memory.
const GROUP: usize = 1 << 18;

/// Schema of the columns.
const SCHEMA: &str =
    "message capture { required double time_s; required float v_V; required float i_A; }";

/// Writes time, voltage and current; mains, full scales and the steps of the switching frequency (`f_sw`, pairs of s and Hz in JSON)
/// become metadata.
///
/// # Errors
/// What the operating system or the library reports.
pub fn write(
    capture: &Capture,
    file: File,
    progress: &mut dyn FnMut(f64),
) -> Result<(), ParquetError> {
    let mut metadata: Vec<KeyValue> = capture
        .metadata
        .iter()
        .map(|(key, value)| KeyValue::new(key.clone(), value.clone()))
        .collect();
    let numbers = [
        ("mains_hz", capture.mains_hz),
        ("zero_crossing_s", capture.zero_crossing_s),
        ("v_full_scale_v", capture.v_full_scale_v),
        ("i_full_scale_a", capture.i_full_scale_a),
    ];
    for (key, value) in numbers {
        metadata.extend(value.map(|x| KeyValue::new(key.to_owned(), x.to_string())));
    }
    if !capture.f_sw.is_empty() {
        let steps: Vec<_> = capture.f_sw.iter().map(|s| [s.t_s, s.f_sw_hz]).collect();
        let text = serde_json::to_string(&steps).map_err(|e| ParquetError::External(e.into()))?;
        metadata.push(KeyValue::new("f_sw".to_owned(), text));
    }
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_key_value_metadata(Some(metadata))
        .build();
    let schema = Arc::new(parse_message_type(SCHEMA)?);
    let mut writer = SerializedFileWriter::new(file, schema, Arc::new(properties))?;
    for from in (0..capture.len()).step_by(GROUP) {
        let to = (from + GROUP).min(capture.len());
        let times: Vec<f64> = (from..to).map(|k| time_s(&capture.time, k)).collect();
        let mut group = writer.next_row_group()?;
        column::<DoubleType>(&mut group, &times)?;
        column::<FloatType>(&mut group, &capture.v_v[from..to])?;
        column::<FloatType>(&mut group, &capture.i_a[from..to])?;
        group.close()?;
        progress(to as f64 / capture.len() as f64);
    }
    writer.close()?;
    Ok(())
}

/// Writes the next column of a group.
fn column<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: &[T::T],
) -> Result<(), ParquetError> {
    let missing = || ParquetError::General("a column more than the schema has".to_owned());
    let mut column = group.next_column()?.ok_or_else(missing)?;
    column.typed::<T>().write_batch(values, None, None)?;
    column.close()
}
