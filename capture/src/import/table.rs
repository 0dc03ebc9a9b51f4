//! CSV tables whose columns are found by name.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::archive::{is_gzip, read};
use super::{ImportError, io};

/// A table with a header, in memory: about what the file has.
#[derive(Debug)]
pub struct Table {
    path: PathBuf,
    columns: Vec<String>,
    /// The fields of all rows behind each other, ...
    text: String,
    /// ... where each ends, ...
    ends: Vec<u32>,
    /// ... and the line of each row, from 1.
    lines: Vec<u32>,
    /// Whether the last row was cut short.
    is_cut: bool,
}

/// Instants after this are taken for damage, ns: the year 2096. What is computed with stamps up to here does not overflow.
pub(super) const LAST_INSTANT: i64 = 4_000_000_000_000_000_000;

/// Rows of a table that may come out of an archive: half an hour of poses at 1 kHz.
const MOST_ROWS: usize = 2_000_000;

/// A column of a [`Table`].
#[derive(Clone, Copy, Debug)]
pub struct Column(usize);

impl Table {
    /// Reads a file, also one that is packed with gzip.
    ///
    /// # Errors
    /// It cannot be read, is no table, has more than 4 GiB of fields, or its rows differ in length. A last row that was cut short is left
    /// out.
    pub fn open(path: &Path) -> Result<Self, ImportError> {
        let mut file =
            BufReader::with_capacity(1 << 16, File::open(path).map_err(io("open", path))?);
        if is_gzip(file.fill_buf().map_err(io("read", path))?) {
            return Self::from_bytes(&read(path)?, path);
        }
        Self::from_reader(file, path, usize::MAX)
    }

    /// Reads `bytes` that `path` is said to hold; they may come out of an archive.
    ///
    /// # Errors
    /// As [`Table::open`], and more than two million rows: little may be unpacked to very many.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, ImportError> {
        Self::from_reader(bytes, path, MOST_ROWS)
    }

    fn from_reader(source: impl Read, path: &Path, most: usize) -> Result<Self, ImportError> {
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .flexible(true)
            // A stray quote would swallow the rest of the file.
            .quoting(false)
            .from_reader(source);
        let wrong = |error: csv::Error| {
            let line = error.position().map_or(0, csv::Position::line);
            match error.into_kind() {
                csv::ErrorKind::Io(source) => io("read", path)(source),
                csv::ErrorKind::Utf8 { .. } => ImportError::Table {
                    path: path.to_owned(),
                    line,
                    reason: "it is no text (UTF-8): give a CSV table".to_owned(),
                },
                kind => ImportError::Table {
                    path: path.to_owned(),
                    line,
                    reason: format!("{kind:?}"),
                },
            }
        };
        let header = reader.headers().map_err(wrong)?;
        let columns: Vec<_> = header
            .iter()
            .map(|name| unquoted(name.trim_start_matches('\u{feff}')).to_owned())
            .collect();
        if columns.iter().all(String::is_empty) {
            return Err(ImportError::Content {
                path: path.to_owned(),
                reason: "it is empty: not even a line with the names of columns".to_owned(),
            });
        }
        if let ([header], Some(separator)) = (columns.as_slice(), other_separator(&columns)) {
            return Err(ImportError::Content {
                path: path.to_owned(),
                reason: format!(
                    "its columns are separated by {separator} ({}): write it with commas between them and points in numbers",
                    shortened(header)
                ),
            });
        }
        let mut table = Self {
            path: path.to_owned(),
            columns,
            text: String::new(),
            ends: Vec::new(),
            lines: Vec::new(),
            is_cut: false,
        };
        // The last row may be cut short, because the file is still being written or was.
        let mut short: Option<ImportError> = None;
        let mut row = csv::StringRecord::new();
        while reader.read_record(&mut row).map_err(wrong)? {
            if let Some(error) = short.take() {
                return Err(error);
            }
            let line = row.position().map_or(0, csv::Position::line);
            if table.len() == most {
                return Err(table.refusal(
                    line,
                    format!("more than {most} rows in a packed table: unpack it first"),
                ));
            }
            if row.len() == table.columns.len() {
                table.push(&row, line)?;
                continue;
            }
            let error = table.refusal(
                line,
                format!(
                    "{} fields, the header has {}",
                    row.len(),
                    table.columns.len()
                ),
            );
            if row.len() > table.columns.len() {
                return Err(error);
            }
            short = Some(error);
        }
        table.is_cut = short.is_some();
        Ok(table)
    }

    fn push(&mut self, row: &csv::StringRecord, line: u64) -> Result<(), ImportError> {
        for field in row {
            self.text.push_str(unquoted(field));
            let end = u32::try_from(self.text.len());
            self.ends.push(end.map_err(|_| {
                self.refusal(
                    line,
                    "more than 4 GiB of fields; cut the table into parts".to_owned(),
                )
            })?);
        }
        self.lines.push(u32::try_from(line).unwrap_or(u32::MAX));
        Ok(())
    }

    fn refusal(&self, line: u64, reason: String) -> ImportError {
        ImportError::Table {
            path: self.path.clone(),
            line,
            reason,
        }
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Rows without the header.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.lines.len()
    }

    /// Rows that are left out because they were cut short: the last one, or none.
    #[must_use]
    pub fn cut_rows(&self) -> u64 {
        self.is_cut.into()
    }

    /// Whether there is no row.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    /// The column of this name, if there is one.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<Column> {
        self.columns
            .iter()
            .position(|column| column == name)
            .map(Column)
    }

    /// The column of this name.
    ///
    /// # Errors
    /// There is none, or more than one.
    pub fn column(&self, name: &str) -> Result<Column, ImportError> {
        let count = self.columns.iter().filter(|column| *column == name).count();
        if count > 1 {
            return Err(ImportError::Content {
                path: self.path.clone(),
                reason: format!("{count} columns are called {name}: give each its own name"),
            });
        }
        self.find(name).ok_or_else(|| ImportError::Column {
            path: self.path.clone(),
            column: name.to_owned(),
            there: shortened(&self.columns.join(", ")),
        })
    }

    /// Several columns, in the order of `names`.
    ///
    /// # Errors
    /// One is not there.
    pub fn columns<const N: usize>(&self, names: [&str; N]) -> Result<[Column; N], ImportError> {
        let mut found = [Column(0); N];
        for (column, name) in found.iter_mut().zip(names) {
            *column = self.column(name)?;
        }
        Ok(found)
    }

    /// A field as it stands; empty where there is none.
    #[must_use]
    pub fn text(&self, row: usize, column: Column) -> &str {
        let field = row * self.columns.len() + column.0;
        let end = |field: usize| self.ends.get(field).map(|end| *end as usize);
        let begin = field.checked_sub(1).map_or(Some(0), end);
        let place = begin
            .zip(end(field))
            .filter(|_| column.0 < self.columns.len());
        place
            .and_then(|(begin, end)| self.text.get(begin..end))
            .unwrap_or_default()
    }

    /// A number; NaN where the field is empty or says that there is none (`null`, `none`, `n/a`, `-`).
    ///
    /// # Errors
    /// The field is another text.
    pub fn float(&self, row: usize, column: Column) -> Result<f64, ImportError> {
        if is_nothing(self.text(row, column)) {
            return Ok(f64::NAN);
        }
        self.number(row, column)
    }

    /// A number.
    ///
    /// # Errors
    /// The field is none of that kind.
    pub fn number<T: FromStr>(&self, row: usize, column: Column) -> Result<T, ImportError> {
        let text = self.text(row, column);
        text.parse().map_err(|_| ImportError::Field {
            path: self.path.clone(),
            line: self.lines.get(row).copied().map_or(0, u64::from),
            column: self.columns.get(column.0).cloned().unwrap_or_default(),
            got: text.chars().take(40).collect(),
            expected: kind_of::<T>(),
        })
    }

    /// A whole number, also one that is written with a point or an exponent (exact up to 2^53); `None` where the field is empty, says
    /// that there is none, or is not finite.
    ///
    /// # Errors
    /// The field is another text.
    pub fn integer(&self, row: usize, column: Column) -> Result<Option<i64>, ImportError> {
        let error = match self.number::<i64>(row, column) {
            Ok(number) => return Ok(Some(number)),
            Err(error) => error,
        };
        let number = self.float(row, column).map_err(|_| error)?;
        #[allow(
            clippy::cast_possible_truncation,
            reason = "a float to integer `as` saturates"
        )]
        let whole = number.round() as i64;
        Ok(number.is_finite().then_some(whole))
    }

    /// An instant in a column whose unit is `unit_ns`; `None` where there is none, or one before 0 or after the year 2096.
    ///
    /// # Errors
    /// As [`Table::integer`].
    pub fn instant(
        &self,
        row: usize,
        column: Column,
        unit_ns: i64,
    ) -> Result<Option<i64>, ImportError> {
        let number = self.integer(row, column)?;
        let nanos = number.and_then(|number| number.checked_mul(unit_ns));
        Ok(nanos.filter(|nanos| (0..=LAST_INSTANT).contains(nanos)))
    }

    /// Numbers of several columns, as [`Table::float`].
    ///
    /// # Errors
    /// A field is another text.
    pub fn numbers<const N: usize>(
        &self,
        row: usize,
        columns: [Column; N],
    ) -> Result<[f64; N], ImportError> {
        let mut found = [0.0; N];
        for (number, column) in found.iter_mut().zip(columns) {
            *number = self.float(row, column)?;
        }
        Ok(found)
    }
}

/// What separates the columns of a header without a comma.
fn other_separator(columns: &[String]) -> Option<&'static str> {
    let [header] = columns else {
        return None;
    };
    let known = [(';', "semicolons"), ('\t', "tabs")];
    let found = known
        .into_iter()
        .find(|(letter, _)| header.contains(*letter));
    found.map(|(_, name)| name)
}

/// A field without the quotes around it. One that has a comma or a line's end in them is not known: numbers and names have none.
fn unquoted(field: &str) -> &str {
    let inner = field.strip_prefix('"');
    let inner = inner.and_then(|field| field.strip_suffix('"'));
    inner.map_or(field, str::trim)
}

/// The first 300 letters: what is no table may have columns of any length.
fn shortened(text: &str) -> String {
    match text.char_indices().nth(300) {
        Some((end, _)) => format!("{}...", text.get(..end).unwrap_or_default()),
        None => text.to_owned(),
    }
}

/// What a number of type `T` is called.
fn kind_of<T>() -> &'static str {
    match std::any::type_name::<T>() {
        "i64" => "a whole number",
        _ => "a number",
    }
}

/// Whether a field says that there is no number.
fn is_nothing(text: &str) -> bool {
    let words = ["", "null", "none", "n/a", "na", "-", "--"];
    words.iter().any(|word| text.eq_ignore_ascii_case(word))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Result<Table, ImportError> {
        Table::from_bytes(text.as_bytes(), Path::new("a.csv"))
    }

    #[test]
    fn columns_are_found_by_name_whatever_their_order() {
        let table = table("\u{feff}b, a\n1,-2\n3,4e-1\n").unwrap();
        let [a, b] = table.columns(["a", "b"]).unwrap();
        assert_eq!(table.numbers(0, [a, b]).unwrap(), [-2.0, 1.0]);
        assert_eq!(table.numbers(1, [a, b]).unwrap(), [0.4, 3.0]);
        let message = table.column("c").unwrap_err().to_string();
        assert_eq!(message, "a.csv has no column c; its columns are b, a");
    }

    #[test]
    fn a_row_cut_short_at_the_end_is_left_out_and_one_before_is_refused() {
        assert_eq!(table("a,b\n1,2\n3").unwrap().len(), 1);
        assert_eq!(table("a,b\n1,2\n3").unwrap().cut_rows(), 1);
        assert_eq!(table("a,b\n1,2\n3,4").unwrap().cut_rows(), 0);
        let message = table("a,b\n1\n2,3\n").unwrap_err().to_string();
        assert_eq!(message, "a.csv line 2: 1 fields, the header has 2");
    }

    #[test]
    fn a_stray_quote_costs_its_own_field_alone() {
        let table = table("\"a\",b\n1,\"2\nx,3\n\"4\", 5\n").unwrap();
        let [a, b] = table.columns(["a", "b"]).unwrap();
        assert_eq!(table.len(), 3);
        assert_eq!(table.numbers(2, [a, b]).unwrap(), [4.0, 5.0]);
        let message = table.float(0, b).unwrap_err().to_string();
        assert_eq!(message, "a.csv line 2: b is \"\\\"2\", expected a number");
    }

    #[test]
    fn other_separators_and_columns_of_one_name_are_named() {
        for (text, wanted) in [
            ("t;Fx;Fy\n1;2,5;3\n", "separated by semicolons (t;Fx;Fy)"),
            ("t\tFx\n1\t2\n", "separated by tabs"),
        ] {
            let message = table(text).unwrap_err().to_string();
            assert!(message.contains(wanted), "{message}");
        }
        let table = table("a,b,a\n1,2,3\n").unwrap();
        let message = table.columns(["b", "a"]).unwrap_err().to_string();
        assert_eq!(
            message,
            "a.csv: 2 columns are called a: give each its own name"
        );
    }

    #[test]
    fn what_is_no_text_and_a_folder_are_named() {
        let bytes = [b"a,b\n1,2\n".as_slice(), &[0xff, 0xfe, 0, 1], b",2\n"].concat();
        let message = Table::from_bytes(&bytes, Path::new("a.csv")).unwrap_err();
        let message = message.to_string();
        assert!(
            message.starts_with("a.csv line 3: it is no text"),
            "{message}"
        );
        let folder = tempfile::tempdir().unwrap();
        let message = Table::open(folder.path()).unwrap_err().to_string();
        assert!(
            message.contains("cannot read") && message.contains("directory"),
            "{message}"
        );
    }

    #[test]
    fn fields_of_any_row_and_column_are_found_again() {
        let table = table("a,b,c\nx,,zz\n,yy,\n\n1,2,3\n").unwrap();
        let [a, b, c] = table.columns(["a", "b", "c"]).unwrap();
        let row = |row| [a, b, c].map(|column| table.text(row, column));
        assert_eq!(
            [row(0), row(1), row(2)],
            [["x", "", "zz"], ["", "yy", ""], ["1", "2", "3"]]
        );
        assert_eq!((row(3), table.len()), (["", "", ""], 3));
        assert!(
            table
                .number::<f64>(1, b)
                .unwrap_err()
                .to_string()
                .contains("line 3: b is \"yy\"")
        );
    }

    #[test]
    fn more_rows_than_memory_should_hold_are_refused() {
        let text = "1\n".repeat(MOST_ROWS);
        assert_eq!(table(&format!("a\n{text}")).unwrap().len(), MOST_ROWS);
        let message = table(&format!("a\n{text}1\n")).unwrap_err().to_string();
        assert_eq!(
            message,
            "a.csv line 2000002: more than 2000000 rows in a packed table: unpack it first"
        );
    }

    #[test]
    fn an_empty_file_is_called_so() {
        for text in ["", "\n", "\u{feff}"] {
            let message = table(text).unwrap_err().to_string();
            assert!(message.contains("it is empty"), "{message}");
        }
    }

    #[test]
    fn instants_are_read_as_integers_however_they_are_written() {
        let table = table("a\n1716200000000000001\n1.7162e18\nx\n").unwrap();
        let column = table.column("a").unwrap();
        let read = |row| table.integer(row, column).unwrap().unwrap();
        assert_eq!(read(0), 1_716_200_000_000_000_001);
        assert_eq!(read(1), 1_716_200_000_000_000_000);
        assert!(
            table
                .integer(2, column)
                .unwrap_err()
                .to_string()
                .contains("expected a whole number")
        );
    }

    #[test]
    fn fields_without_a_number_are_none_and_not_zero() {
        let table = table("a,b\n,1\nnan,1\nNaN,1\ninf,1\nnull,1\nN/A,1\n-,1\n").unwrap();
        let a = table.column("a").unwrap();
        for row in 0..table.len() {
            assert_eq!(table.integer(row, a).unwrap(), None, "{row}");
            assert_eq!(table.instant(row, a, 1).unwrap(), None, "{row}");
            assert!(!table.float(row, a).unwrap().is_finite(), "{row}");
        }
    }

    #[test]
    fn instants_that_cannot_be_are_none() {
        let text = "a\n-1\n9e18\n9223372036854775807\n-9223372036854775808\n-9e18\n1e300\n5\n";
        let table = table(text).unwrap();
        let a = table.column("a").unwrap();
        for unit_ns in [1, 1_000] {
            let read: Vec<_> = (0..7)
                .map(|row| table.instant(row, a, unit_ns).unwrap())
                .collect();
            assert_eq!(
                read,
                [None, None, None, None, None, None, Some(5 * unit_ns)]
            );
        }
    }

    #[test]
    fn a_field_that_is_no_number_is_named_with_its_line() {
        let table = table("a\n1\nx\n").unwrap();
        let column = table.column("a").unwrap();
        let message = table.number::<i64>(1, column).unwrap_err().to_string();
        assert_eq!(message, "a.csv line 3: a is \"x\", expected a whole number");
    }
}
