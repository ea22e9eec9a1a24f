//! `EXT_meshopt_compression`: compressed vertex and index streams.
//!
//! The three bitstreams (attributes version 0, triangles and indices version 1) and the three filters, as written down in
//! the appendices of the extension's specification. Decoding is bounds checked throughout; what a stream may expand to is
//! bounded by what its encoding can reach, so a lying count allocates nothing.

type Fault = &'static str;

const CUT_OFF: Fault = "the compressed stream is cut off";

/// Decodes `count` elements of `stride` bytes.
pub(super) fn decode(
    bytes: &[u8],
    count: u64,
    stride: u64,
    mode: &str,
    filter: &str,
) -> Result<Vec<u8>, Fault> {
    // The densest code is 2 bits for 16 bytes of an attribute, 1 byte for three 4-byte indices.
    let reachable = (bytes.len() as u64).saturating_mul(64);
    let size = count
        .checked_mul(stride)
        .filter(|&s| s <= reachable)
        .ok_or(CUT_OFF)?;
    let (count, stride, size) = (count as usize, stride as usize, size as usize);
    let mut out = match mode {
        "ATTRIBUTES" => attributes(bytes, count, stride, size)?,
        "TRIANGLES" => packed(&triangles(bytes, count)?, stride)?,
        "INDICES" => packed(&indices(bytes, count)?, stride)?,
        _ => return Err("unknown compression mode"),
    };
    match filter {
        "" | "NONE" => {}
        "OCTAHEDRAL" if stride == 4 => octahedral_8(&mut out),
        "OCTAHEDRAL" if stride == 8 => octahedral_16(&mut out),
        "QUATERNION" if stride == 8 => quaternion(&mut out),
        "EXPONENTIAL" if stride.is_multiple_of(4) => exponential(&mut out),
        _ => return Err("unknown compression filter"),
    }
    Ok(out)
}

fn packed(indices: &[u32], stride: usize) -> Result<Vec<u8>, Fault> {
    match stride {
        2 => Ok(indices
            .iter()
            .flat_map(|&i| (i as u16).to_le_bytes())
            .collect()),
        4 => Ok(indices.iter().flat_map(|&i| i.to_le_bytes()).collect()),
        _ => Err("compressed indices must take 2 or 4 bytes"),
    }
}

/// Reads bytes front to back.
struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], Fault> {
        let (head, tail) = self.bytes.split_at_checked(count).ok_or(CUT_OFF)?;
        self.bytes = tail;
        Ok(head)
    }

    fn byte(&mut self) -> Result<u8, Fault> {
        Ok(self.take(1)?[0])
    }

    /// A number in groups of 7 bits, lowest first.
    fn varint(&mut self) -> Result<u32, Fault> {
        let mut value = 0u32;
        for shift in (0..35).step_by(7) {
            let byte = self.byte()?;
            value |= u32::from(byte & 127).wrapping_shl(shift);
            if byte < 128 {
                break;
            }
        }
        Ok(value)
    }
}

fn zigzag(v: u32) -> u32 {
    (v >> 1) ^ (v & 1).wrapping_neg()
}

fn attributes(bytes: &[u8], count: usize, stride: usize, size: usize) -> Result<Vec<u8>, Fault> {
    if stride == 0 || stride > 256 || !stride.is_multiple_of(4) {
        return Err("compressed attributes need a stride of 4, 8, .. 256 bytes");
    }
    let mut reader = Reader { bytes };
    if reader.byte()? != 0xa0 {
        return Err("not an attribute stream of version 0");
    }
    let body = reader
        .bytes
        .len()
        .checked_sub(stride.max(32))
        .ok_or(CUT_OFF)?;
    let baseline = &bytes[bytes.len() - stride..];
    reader.bytes = &reader.bytes[..body];

    let mut out = vec![0; size];
    let mut last = [0u8; 256];
    last[..stride].copy_from_slice(baseline);
    let block = ((8192 / stride) & !15).min(256);
    let mut column = [0u8; 256];
    for first in (0..count).step_by(block) {
        let rows = block.min(count - first);
        let groups = rows.div_ceil(16);
        for k in 0..stride {
            let header = reader.take(groups.div_ceil(4))?;
            for (g, group) in column.chunks_exact_mut(16).take(groups).enumerate() {
                attribute_group(&mut reader, header[g / 4] >> (g % 4 * 2) & 3, group)?;
            }
            let mut value = last[k];
            for (row, &delta) in column[..rows].iter().enumerate() {
                value = value.wrapping_add((delta >> 1) ^ (delta & 1).wrapping_neg());
                out[(first + row) * stride + k] = value;
            }
            last[k] = value;
        }
    }
    Ok(out)
}

/// 16 deltas: none, 2 bits, 4 bits or 8 bits each; the largest short code means that a whole byte follows.
fn attribute_group(reader: &mut Reader, code: u8, out: &mut [u8]) -> Result<(), Fault> {
    let bits = match code {
        0 => {
            out.fill(0);
            return Ok(());
        }
        3 => {
            out.copy_from_slice(reader.take(16)?);
            return Ok(());
        }
        code => usize::from(code) * 2,
    };
    let short = reader.take(2 * bits)?;
    let escape = (1u8 << bits) - 1;
    for (i, to) in out.iter_mut().enumerate() {
        let at = i * bits;
        let value = short[at / 8] >> (8 - bits - at % 8) & escape;
        *to = if value == escape {
            reader.byte()?
        } else {
            value
        };
    }
    Ok(())
}

/// The last 16 of something; `ago` 1 is the latest.
struct Recent<T> {
    items: [T; 16],
    next: usize,
}

impl<T: Copy> Recent<T> {
    fn push(&mut self, item: T) {
        self.items[self.next] = item;
        self.next = (self.next + 1) % 16;
    }

    fn get(&self, ago: u8) -> T {
        self.items[(self.next + 16 - usize::from(ago)) % 16]
    }
}

fn triangles(bytes: &[u8], count: usize) -> Result<Vec<u32>, Fault> {
    if !count.is_multiple_of(3) {
        return Err("the number of compressed indices is not a multiple of 3");
    }
    let mut reader = Reader { bytes };
    if reader.byte()? != 0xe1 {
        return Err("not a triangle stream of version 1");
    }
    let codes = reader.take(count / 3)?;
    let data = reader.bytes.len().checked_sub(16).ok_or(CUT_OFF)?;
    let (data, table) = reader.bytes.split_at(data);
    reader.bytes = data;

    let mut out = Vec::with_capacity(count);
    let mut edges = Recent {
        items: [(0u32, 0u32); 16],
        next: 0,
    };
    let mut vertices = Recent {
        items: [0u32; 16],
        next: 0,
    };
    let (mut next, mut last) = (0u32, 0u32);
    let fresh = |next: &mut u32| {
        let v = *next;
        *next = v.wrapping_add(1);
        v
    };
    for &code in codes {
        if code < 0xf0 {
            let (a, b) = edges.get((code >> 4) + 1);
            let c = match code & 15 {
                0 => fresh(&mut next),
                known @ 1..13 => vertices.get(known + 1),
                explicit => {
                    last = match explicit {
                        13 => last.wrapping_sub(1),
                        14 => last.wrapping_add(1),
                        _ => last.wrapping_add(zigzag(reader.varint()?)),
                    };
                    last
                }
            };
            if !(1..13).contains(&(code & 15)) {
                vertices.push(c);
            }
            edges.push((c, b));
            edges.push((a, c));
            out.extend([a, b, c]);
            continue;
        }
        let explicit = code >= 0xfe;
        let corners = if explicit {
            reader.byte()?
        } else {
            table[usize::from(code & 15)]
        };
        if explicit && corners == 0 {
            next = 0;
        }
        let codes = [
            if code == 0xff { 15 } else { 0 },
            corners >> 4,
            corners & 15,
        ];
        let mut corner = [0u32; 3];
        for (to, code) in corner.iter_mut().zip(codes) {
            // In a table entry 15 is a place in the history like 1 to 14.
            *to = match code {
                0 => fresh(&mut next),
                15 if explicit => 0,
                ago => vertices.get(ago),
            };
        }
        for (to, code) in corner.iter_mut().zip(codes) {
            if explicit && code == 15 {
                last = last.wrapping_add(zigzag(reader.varint()?));
                *to = last;
            }
        }
        let [a, b, c] = corner;
        for (v, code) in corner.into_iter().zip(codes) {
            if code == 0 || explicit && code == 15 {
                vertices.push(v);
            }
        }
        edges.push((b, a));
        edges.push((c, b));
        edges.push((a, c));
        out.extend([a, b, c]);
    }
    Ok(out)
}

fn indices(bytes: &[u8], count: usize) -> Result<Vec<u32>, Fault> {
    let mut reader = Reader { bytes };
    if reader.byte()? != 0xd1 {
        return Err("not an index stream of version 1");
    }
    let data = reader.bytes.len().checked_sub(4).ok_or(CUT_OFF)?;
    reader.bytes = &reader.bytes[..data];
    let mut last = [0u32; 2];
    (0..count)
        .map(|_| {
            let v = reader.varint()?;
            let baseline = &mut last[(v & 1) as usize];
            *baseline = baseline.wrapping_add(zigzag(v >> 1));
            Ok(*baseline)
        })
        .collect()
}

/// A direction from its octahedral coordinates, given the value that stands for 1; scaled to `most`.
fn octahedral([x, y, one]: [f32; 3], most: f32) -> [f32; 3] {
    let z = one - x.abs() - y.abs();
    let fold = z.min(0.0);
    let x = x + if x >= 0.0 { fold } else { -fold };
    let y = y + if y >= 0.0 { fold } else { -fold };
    let scale = most / (x * x + y * y + z * z).sqrt();
    [x * scale, y * scale, z * scale].map(f32::round)
}

fn octahedral_8(bytes: &mut [u8]) {
    for e in bytes.as_chunks_mut::<4>().0 {
        let v = octahedral([e[0], e[1], e[2]].map(|b| f32::from(b as i8)), 127.0);
        for (to, v) in e.iter_mut().zip(v) {
            *to = v as i8 as u8;
        }
    }
}

fn words(e: &[u8; 8]) -> [i16; 4] {
    std::array::from_fn(|i| i16::from_le_bytes([e[2 * i], e[2 * i + 1]]))
}

fn octahedral_16(bytes: &mut [u8]) {
    for e in bytes.as_chunks_mut::<8>().0 {
        let [x, y, one, _] = words(e).map(f32::from);
        let v = octahedral([x, y, one], 32767.0);
        for (to, v) in e.as_chunks_mut::<2>().0.iter_mut().zip(v) {
            *to = (v as i16).to_le_bytes();
        }
    }
}

/// Three components of a quaternion, scaled; the fourth word holds the scale and which component was left out.
fn quaternion(bytes: &mut [u8]) {
    for e in bytes.as_chunks_mut::<8>().0 {
        let [x, y, z, code] = words(e);
        let scale = std::f32::consts::FRAC_1_SQRT_2 / f32::from(code | 3);
        let [x, y, z] = [x, y, z].map(|v| f32::from(v) * scale);
        let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
        let left_out = (code & 3) as usize;
        for (i, v) in [w, x, y, z].into_iter().enumerate() {
            let at = (left_out + i) % 4 * 2;
            e[at..at + 2].copy_from_slice(&((v * 32767.0).round() as i16).to_le_bytes());
        }
    }
}

/// 24 bits of mantissa and 8 of exponent become an f32.
fn exponential(bytes: &mut [u8]) {
    for e in bytes.as_chunks_mut::<4>().0 {
        let word = i32::from_le_bytes(*e);
        let mantissa = word.wrapping_shl(8) >> 8;
        let value = f64::from(mantissa) * f64::from(word >> 24).exp2();
        *e = (value as f32).to_le_bytes();
    }
}

#[cfg(test)]
#[path = "meshopt_tests.rs"]
mod tests;
