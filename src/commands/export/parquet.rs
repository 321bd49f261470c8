//! Tables as Parquet: columns without nulls, compressed with Zstandard.

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::Type;
use trifacet::publishing::columns::Value;

use super::{Row, Table};

/// Number of rows in a row group.
const GROUP: usize = 65_536;

/// A Parquet file while it is written. Its columns are those of the first row.
pub(super) struct Parquet<W: Write + Send> {
    to: Option<W>,
    file: Option<SerializedFileWriter<W>>,
    columns: Vec<Column>,
    rows: usize,
}

/// Values of a column that are not written yet.
enum Column {
    Numbers(Vec<f64>),
    /// Also unsigned integers: the schema makes the distinction.
    Integers(Vec<i64>),
    Words(Vec<ByteArray>),
}

impl<W: Write + Send> Parquet<W> {
    pub(super) fn new(to: W) -> Self {
        Self { to: Some(to), file: None, columns: Vec::new(), rows: 0 }
    }

    fn begin(&mut self, row: &Row) -> Result<()> {
        let Some(to) = self.to.take() else { return Ok(()) };
        let fields = row.iter().map(|(name, value)| field(name, value).map(Arc::new));
        let schema =
            Type::group_type_builder("schema").with_fields(fields.collect::<Result<_>>()?).build()?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_dictionary_enabled(false) // measured values do not repeat
            .set_created_by(concat!("trifacet ", env!("CARGO_PKG_VERSION")).to_owned())
            .build();
        self.file = Some(SerializedFileWriter::new(to, Arc::new(schema), Arc::new(properties))?);
        self.columns = row.iter().map(|(_, value)| Column::of(value)).collect();
        Ok(())
    }

    fn put(&mut self, row: Row) -> Result<()> {
        self.begin(&row)?;
        for (column, (_, value)) in self.columns.iter_mut().zip(row) {
            column.push(value);
        }
        self.rows += 1;
        if self.rows == GROUP { self.group() } else { Ok(()) }
    }

    /// Writes the collected rows as a row group.
    fn group(&mut self) -> Result<()> {
        let Some(file) = self.file.as_mut().filter(|_| self.rows > 0) else { return Ok(()) };
        self.rows = 0;
        let mut group = file.next_row_group()?;
        for column in &mut self.columns {
            if let Some(writer) = group.next_column()? {
                column.write(writer)?;
            }
        }
        group.close().map(|_| ())
    }
}

impl<W: Write + Send> Table for Parquet<W> {
    fn row(&mut self, row: Row) -> io::Result<()> {
        self.put(row).map_err(plain)
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        self.group().map_err(plain)?;
        match self.file {
            Some(file) => file.into_inner().map_err(plain)?.flush(),
            None => Ok(()),
        }
    }
}

impl Column {
    fn of(value: &Value) -> Self {
        match value {
            Value::Number(_) => Self::Numbers(Vec::new()),
            Value::Integer(_) | Value::Count(_) => Self::Integers(Vec::new()),
            Value::Text(_) | Value::Names(_) => Self::Words(Vec::new()),
        }
    }

    /// Appends a value. All rows have the columns of the first row; unknown values are NaN.
    fn push(&mut self, value: Value) {
        match (self, value) {
            (Self::Numbers(all), Value::Number(x)) => all.push(x),
            (Self::Integers(all), Value::Integer(x)) => all.push(x),
            (Self::Integers(all), Value::Count(x)) => all.push(x as i64),
            (Self::Words(all), Value::Text(text)) => all.push(text.into_bytes().into()),
            (Self::Words(all), Value::Names(names)) => all.push(names.join(" ").into_bytes().into()),
            (_, value) => unreachable!("{value:?} in a column of another kind"),
        }
    }

    fn write(&mut self, mut writer: SerializedColumnWriter<'_>) -> Result<()> {
        match self {
            Self::Numbers(all) => {
                writer.typed::<DoubleType>().write_batch(all, None, None)?;
                all.clear();
            }
            Self::Integers(all) => {
                writer.typed::<Int64Type>().write_batch(all, None, None)?;
                all.clear();
            }
            Self::Words(all) => {
                writer.typed::<ByteArrayType>().write_batch(all, None, None)?;
                all.clear();
            }
        }
        writer.close()
    }
}

fn field(name: &str, value: &Value) -> Result<Type> {
    let (physical, logical) = match value {
        Value::Number(_) => (Physical::DOUBLE, None),
        Value::Integer(_) => (Physical::INT64, None),
        Value::Count(_) => (Physical::INT64, Some(LogicalType::integer(64, false))),
        Value::Text(_) | Value::Names(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
    };
    Type::primitive_type_builder(name, physical)
        .with_repetition(Repetition::REQUIRED)
        .with_logical_type(logical)
        .build()
}

/// Unwraps I/O errors, so that the exit code fits.
fn plain(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(inner) => match inner.downcast::<io::Error>() {
            Ok(io) => *io,
            Err(other) => io::Error::other(other),
        },
        other => io::Error::other(other),
    }
}
