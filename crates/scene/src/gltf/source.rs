//! The bytes behind a document: GLB chunks, buffer files, data URIs and buffer views.

use super::document::Document;
use super::meshopt;
use crate::SceneError;
use crate::input::{Budget, leaves_folder, read_file};
use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};

const RE_EXPORT: &str = "export the file again";

/// A document with its bytes at hand.
#[derive(Debug)]
pub(super) struct Source {
    pub path: PathBuf,
    pub document: Document,
    file: Vec<u8>,
    /// The document in `file`.
    json: Range<usize>,
    /// The BIN chunk in `file`.
    bin: Range<usize>,
    buffers: Vec<BufferBytes>,
    /// Views that were stored compressed.
    decoded: Vec<Option<Vec<u8>>>,
}

#[derive(Debug)]
enum BufferBytes {
    Bin,
    Own(Vec<u8>),
    /// No URI and no BIN chunk: a placeholder for compressed views.
    Absent,
}

/// A checked buffer view.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    pub bytes: &'a [u8],
    pub stride: Option<usize>,
}

impl Source {
    /// Reads the file and every buffer that it refers to.
    pub fn open(path: &Path, budget: &mut Budget) -> Result<Self, SceneError> {
        let file = read_file(path, budget)?;
        let (json, bin) = chunks(path, &file)?;
        let text = &file[json.clone()];
        let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
        // A parsed document takes a small multiple of its text.
        budget.reserve(text.len() as u64 * 4)?;
        let document: Document = serde_json::from_slice(text).map_err(|e| {
            SceneError::invalid(
                path,
                "",
                &format!("not a glTF 2.0 document ({e})"),
                RE_EXPORT,
            )
        })?;
        let mut source = Self {
            path: path.to_path_buf(),
            document,
            file,
            json,
            bin: bin.unwrap_or(0..0),
            buffers: Vec::new(),
            decoded: Vec::new(),
        };
        source.check_version()?;
        source.open_buffers(budget)?;
        Ok(source)
    }

    /// The whole document, with what this loader does not read.
    pub fn json(&self) -> Result<serde_json::Value, SceneError> {
        let text = &self.file[self.json.clone()];
        let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
        serde_json::from_slice(text)
            .map_err(|e| self.fault("", &format!("not a glTF 2.0 document ({e})"), RE_EXPORT))
    }

    fn check_version(&self) -> Result<(), SceneError> {
        let asset = &self.document.asset;
        let wanted = asset.min_version.as_ref().unwrap_or(&asset.version);
        let major = wanted.split('.').next().unwrap_or_default();
        let newer_minor = asset.min_version.as_ref().is_some_and(|v| v != "2.0");
        if major != "2" || newer_minor {
            let what = format!("glTF version {wanted} is not supported");
            return Err(self.fault("asset", &what, "export as glTF 2.0"));
        }
        Ok(())
    }

    fn open_buffers(&mut self, budget: &mut Budget) -> Result<(), SceneError> {
        let mut buffers = Vec::with_capacity(self.document.buffers.len());
        for (i, buffer) in self.document.buffers.iter().enumerate() {
            let place = format!("buffer {i}");
            let bytes = match &buffer.uri {
                Some(uri) => match self.read_uri(uri, &place, budget)? {
                    Cow::Owned(bytes) => BufferBytes::Own(bytes),
                    Cow::Borrowed(bytes) => BufferBytes::Own(bytes.to_vec()),
                },
                None if i == 0 && !self.bin.is_empty() => BufferBytes::Bin,
                None => BufferBytes::Absent,
            };
            let length = match &bytes {
                BufferBytes::Bin => self.bin.len(),
                BufferBytes::Own(bytes) => bytes.len(),
                BufferBytes::Absent => usize::MAX,
            };
            if (length as u64) < buffer.byte_length {
                let what = format!("has {length} of {} bytes", buffer.byte_length);
                return Err(self.fault(
                    &place,
                    &what,
                    "the file is cut off: copy or export it again",
                ));
            }
            buffers.push(bytes);
        }
        self.buffers = buffers;
        Ok(())
    }

    /// Decodes every view that is stored compressed.
    pub fn decompress(&mut self, budget: &mut Budget) -> Result<(), SceneError> {
        let views = &self.document.buffer_views;
        if views.iter().all(|v| v.extensions.meshopt.is_none()) {
            return Ok(());
        }
        for view in views {
            if let Some(m) = &view.extensions.meshopt {
                let size = m.count.checked_mul(m.byte_stride);
                budget.reserve(size.unwrap_or(u64::MAX))?;
            }
        }
        let this = &*self;
        self.decoded = (0..views.len())
            .into_par_iter()
            .map(|i| this.decompress_view(i))
            .collect::<Result<_, _>>()?;
        Ok(())
    }

    fn decompress_view(&self, index: usize) -> Result<Option<Vec<u8>>, SceneError> {
        let Some(m) = &self.document.buffer_views[index].extensions.meshopt else {
            return Ok(None);
        };
        let place = format!("buffer view {index}, EXT_meshopt_compression");
        let bytes = self.buffer_range(m.buffer, m.byte_offset, m.byte_length, &place)?;
        meshopt::decode(bytes, m.count, m.byte_stride, &m.mode, &m.filter)
            .map(Some)
            .map_err(|what| self.fault(&place, what, RE_EXPORT))
    }

    /// The bytes of a view, bounds checked.
    pub fn view(&self, index: u32, place: &str) -> Result<View<'_>, SceneError> {
        let Some(view) = self.document.buffer_views.get(index as usize) else {
            let what = format!("refers to buffer view {index}, which does not exist");
            return Err(self.fault(place, &what, RE_EXPORT));
        };
        let stride = match view.byte_stride {
            Some(stride) if stride == 0 || stride > 65_536 => {
                let what = format!("buffer view {index} has a byte stride of {stride}");
                return Err(self.fault(place, &what, RE_EXPORT));
            }
            stride => stride.map(|s| s as usize),
        };
        if let Some(Some(bytes)) = self.decoded.get(index as usize) {
            let length = usize::try_from(view.byte_length).unwrap_or(usize::MAX);
            return Ok(View {
                bytes: &bytes[..length.min(bytes.len())],
                stride,
            });
        }
        let place = format!("{place}, buffer view {index}");
        let bytes = self.buffer_range(view.buffer, view.byte_offset, view.byte_length, &place)?;
        Ok(View { bytes, stride })
    }

    fn buffer_range(
        &self,
        buffer: u32,
        offset: u64,
        length: u64,
        place: &str,
    ) -> Result<&[u8], SceneError> {
        let bytes = match self.buffers.get(buffer as usize) {
            Some(BufferBytes::Bin) => &self.file[self.bin.clone()],
            Some(BufferBytes::Own(bytes)) => bytes.as_slice(),
            Some(BufferBytes::Absent) => {
                let what = format!("buffer {buffer} has no data");
                return Err(self.fault(place, &what, RE_EXPORT));
            }
            None => {
                let what = format!("refers to buffer {buffer}, which does not exist");
                return Err(self.fault(place, &what, RE_EXPORT));
            }
        };
        let end = offset
            .checked_add(length)
            .filter(|&end| end <= bytes.len() as u64);
        match end {
            // Both fit in memory, for `end` is at most a slice's length.
            Some(end) => Ok(&bytes[offset as usize..end as usize]),
            None => {
                let what = format!(
                    "needs {length} bytes at {offset}, buffer {buffer} has {}",
                    bytes.len()
                );
                Err(self.fault(place, &what, RE_EXPORT))
            }
        }
    }

    /// All bytes that the file's buffers hold: what a claimed element count is measured against.
    pub fn total_bytes(&self) -> u64 {
        let own = |b: &BufferBytes| match b {
            BufferBytes::Own(bytes) => bytes.len() as u64,
            _ => 0,
        };
        self.file.len() as u64 + self.buffers.iter().map(own).sum::<u64>()
    }

    /// The bytes of a data URI or of a file beside this one.
    pub fn read_uri(
        &self,
        uri: &str,
        place: &str,
        budget: &mut Budget,
    ) -> Result<Cow<'_, [u8]>, SceneError> {
        if let Some(rest) = uri.strip_prefix("data:") {
            budget.reserve(rest.len() as u64)?;
            let Some((kind, data)) = rest.split_once(',') else {
                return Err(self.fault(place, "data URI without data", RE_EXPORT));
            };
            if !kind.ends_with(";base64") {
                return Ok(Cow::Owned(percent_decoded(data)));
            }
            let config = GeneralPurposeConfig::new()
                .with_decode_padding_mode(DecodePaddingMode::Indifferent);
            let engine = GeneralPurpose::new(&base64::alphabet::STANDARD, config);
            return engine.decode(data).map(Cow::Owned).map_err(|e| {
                let what = format!("data URI that is not base64 ({e})");
                self.fault(place, &what, "the file is cut off: copy or export it again")
            });
        }
        let decoded = percent_decoded(uri);
        let decoded = String::from_utf8_lossy(&decoded);
        let file = self.beside(&decoded, place)?;
        match read_file(&file, budget) {
            // Some exporters write names that hold a percent sign without escaping it.
            Err(SceneError::Read { .. }) if *decoded != *uri => match self.beside(uri, place) {
                Ok(plain) if plain.is_file() => read_file(&plain, budget).map(Cow::Owned),
                _ => read_file(&file, budget).map(Cow::Owned),
            },
            other => other.map(Cow::Owned),
        }
    }

    /// The path of a relative URI, which must not leave the folder of the document.
    fn beside(&self, uri: &str, place: &str) -> Result<PathBuf, SceneError> {
        let uri = uri.replace('\\', "/");
        let refuse = |why: &str| {
            let cure = "put the file beside the scene and name it by a relative path";
            Err(self.fault(place, &format!("refused to read {uri:?}: {why}"), cure))
        };
        if uri.contains("://") {
            return refuse("it is not a local file");
        }
        if uri.starts_with('/') || uri.get(1..2) == Some(":") {
            return refuse("the path is absolute");
        }
        if uri.is_empty() || uri.contains('\0') {
            return refuse("it is not a file name");
        }
        if leaves_folder(&uri) {
            return refuse("it leaves the folder of the scene");
        }
        Ok(self.path.parent().unwrap_or(Path::new("")).join(uri))
    }

    /// An error in this file.
    pub fn fault(&self, place: &str, what: &str, cure: &str) -> SceneError {
        SceneError::invalid(&self.path, place, what, cure)
    }
}

/// Where JSON and BIN are. A file that does not begin as GLB is all JSON.
fn chunks(path: &Path, file: &[u8]) -> Result<(Range<usize>, Option<Range<usize>>), SceneError> {
    const JSON: u32 = 0x4e4f_534a;
    const BIN: u32 = 0x004e_4942;
    let fault = |what: &str| {
        SceneError::invalid(
            path,
            "",
            what,
            "the file is damaged: copy or export it again",
        )
    };
    let word = |at: usize| {
        let bytes = file.get(at..at.checked_add(4)?)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    };
    if !file.starts_with(b"glTF") {
        let binary = path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("glb"));
        if binary && !file.trim_ascii_start().starts_with(b"{") {
            return Err(fault("not a GLB file: it does not begin with \"glTF\""));
        }
        return Ok((0..file.len(), None));
    }
    match word(4) {
        Some(2) => {}
        Some(version) => return Err(fault(&format!("GLB version {version} is not supported"))),
        None => return Err(fault("the GLB header is cut off")),
    }
    let (mut json, mut bin) = (None, None);
    let mut at = 12;
    while let (Some(length), Some(kind)) = (word(at), word(at + 4)) {
        let start = at + 8;
        let end = start + length as usize;
        if end > file.len() {
            let what = format!(
                "a GLB chunk claims {length} bytes, the file has {} left",
                file.len() - start
            );
            return Err(fault(&what));
        }
        match kind {
            JSON if json.is_none() => json = Some(start..end),
            BIN if bin.is_none() => bin = Some(start..end),
            _ => {}
        }
        at = end.next_multiple_of(4);
    }
    match json {
        Some(json) => Ok((json, bin)),
        None => Err(fault("the GLB file has no JSON chunk")),
    }
}

fn percent_decoded(text: &str) -> Vec<u8> {
    let digit = |b: Option<&u8>| (*b? as char).to_digit(16);
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        match (bytes[i], digit(bytes.get(i + 1)), digit(bytes.get(i + 2))) {
            (b'%', Some(high), Some(low)) => {
                out.push((high * 16 + low) as u8);
                i += 3;
            }
            (byte, ..) => {
                out.push(byte);
                i += 1;
            }
        }
    }
    out
}
