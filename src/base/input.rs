//! Opens every file written by others: regular files only, after links, and never more bytes than their size.
//!
//! A FIFO blocks its reader, and a device has no end. Both are refused by name, so a dataset received by mail
//! cannot block radcam or fill the memory through a link. All readers use these functions; a test searches
//! the sources for others.

pub use radcam_sim::text::{echo, echo_lines, echo_message};
use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Maximum size of a settings file (manifest, plan, model, map, library), bytes. The largest known is a model
/// with a table of code widths, 2 MB.
pub const MAX_SETTINGS_BYTES: u64 = 1 << 26;

/// Maximum size of a text table (`frames.csv`, EMVA 1288 descriptor, table of statistics), bytes: some 10^7
/// rows.
pub const MAX_TABLE_BYTES: u64 = 1 << 30;

/// Opens a regular file for reading.
///
/// # Errors
///
/// The path cannot be opened, or leads to a FIFO, device, socket or folder.
pub fn open(path: &Path) -> Result<File> {
    // The type is checked before the file is opened: opening a device may move a tape or start a watchdog.
    must_be_regular(&std::fs::metadata(path)?)?;
    let mut options = OpenOptions::new();
    options.read(true);
    // The path may have become a FIFO since. Without this flag, opening one waits for a writer.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(
        &mut options,
        rustix::fs::OFlags::NONBLOCK.bits().cast_signed(),
    );
    let file = options.open(path)?;
    must_be_regular(&file.metadata()?)?;
    Ok(file)
}

/// Reads a whole regular file, no more than its size when it was opened.
///
/// # Errors
///
/// As [`open`], and if there is not enough memory.
pub fn bytes(path: &Path) -> Result<Vec<u8>> {
    whole(path, u64::MAX)
}

/// Reads a settings file: UTF-8, up to [`MAX_SETTINGS_BYTES`].
///
/// # Errors
///
/// As [`bytes`], and if the file is larger or no UTF-8.
pub fn settings(path: &Path) -> Result<String> {
    text(path, MAX_SETTINGS_BYTES)
}

/// Reads a text table: UTF-8, up to [`MAX_TABLE_BYTES`].
///
/// # Errors
///
/// As [`bytes`], and if the file is larger or no UTF-8.
pub fn table(path: &Path) -> Result<String> {
    text(path, MAX_TABLE_BYTES)
}

/// Reads a text that any program wrote, up to [`MAX_SETTINGS_BYTES`]: UTF-8, UTF-16 with a byte order mark,
/// or else Latin 1.
///
/// # Errors
///
/// As [`bytes`], and if the file is larger.
pub fn plain_text(path: &Path) -> Result<String> {
    let wide = |bytes: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]])).collect();
        String::from_utf16_lossy(&units)
    };
    Ok(match String::from_utf8(whole(path, MAX_SETTINGS_BYTES)?) {
        Ok(text) => text,
        Err(error) => match error.into_bytes().as_slice() {
            [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
            [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
            bytes => bytes.iter().map(|byte| char::from(*byte)).collect(),
        },
    })
}

/// Reads the first bytes of a regular file, up to `most`.
///
/// # Errors
///
/// As [`open`].
pub fn start(path: &Path, most: u64) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    open(path)?.take(most).read_to_end(&mut out)?;
    Ok(out)
}

fn text(path: &Path, most: u64) -> Result<String> {
    String::from_utf8(whole(path, most)?).map_err(|_| Error::new(ErrorKind::InvalidData, "is no UTF-8 text"))
}

fn whole(path: &Path, most: u64) -> Result<Vec<u8>> {
    let file = open(path)?;
    let size = file.metadata()?.len();
    if size > most {
        return Err(invalid(&format!("has {size} bytes; such a file has {most} at most")));
    }
    let mut out = Vec::new();
    out.try_reserve_exact(usize::try_from(size).unwrap_or(usize::MAX))
        .map_err(|e| Error::new(ErrorKind::OutOfMemory, e))?;
    file.take(size).read_to_end(&mut out)?;
    Ok(out)
}

fn must_be_regular(found: &Metadata) -> Result<()> {
    if found.is_file() {
        return Ok(());
    }
    Err(invalid(&format!("is {}; a regular file is needed", name_of(found.file_type()))))
}

/// Returns the name of a file type, with its article.
pub(crate) fn name_of(kind: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return "a FIFO";
        }
        if kind.is_socket() {
            return "a socket";
        }
        if kind.is_char_device() || kind.is_block_device() {
            return "a device";
        }
    }
    if kind.is_symlink() {
        "a link"
    } else if kind.is_dir() {
        "a folder"
    } else if kind.is_file() {
        "a file"
    } else {
        "no regular file"
    }
}

fn invalid(message: &str) -> Error {
    Error::new(ErrorKind::InvalidInput, message)
}

/// Returns the maximum size in memory of the image in a packed file of `size` bytes, bytes.
///
/// Deflate packs a constant image a thousand to one, and frames with noise four to one at most. The limit is
/// 256 MiB, enough for a constant image, plus 64 times the size of the file.
pub(crate) fn max_unpacked_bytes(size: u64) -> u64 {
    const SMALL_IMAGE: u64 = 1 << 28;
    const MAX_PACKING_OF_LARGE_IMAGES: u64 = 64;
    size.saturating_mul(MAX_PACKING_OF_LARGE_IMAGES).saturating_add(SMALL_IMAGE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_is_read_than_the_size() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, "12345").unwrap();
        assert_eq!((bytes(&path).unwrap(), start(&path, 2).unwrap()), (b"12345".to_vec(), b"12".to_vec()));
        assert!(bytes(dir.path()).unwrap_err().to_string().contains("a folder"));
        std::fs::File::create(&path).unwrap().set_len(MAX_SETTINGS_BYTES + 1).unwrap();
        assert!(settings(&path).unwrap_err().to_string().contains("67108864 at most"));
    }
}
