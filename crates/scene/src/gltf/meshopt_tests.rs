//! Against the encoder and the filters of another implementation.

use super::decode;
use meshopt_rs::index::{IndexEncodingVersion, buffer, sequence};
use meshopt_rs::vertex::{VertexEncodingVersion, buffer as vertex_buffer, filter};

/// A mixture of smooth and wild bytes, so that all group codes occur.
fn noise(count: usize, seed: u32) -> Vec<u8> {
    let mut state = seed;
    (0..count)
        .map(|i| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let wild = (state >> 24) as u8;
            match i / 997 % 4 {
                0 => 7,
                1 => (i / 64) as u8,
                2 => (i / 3) as u8 ^ (wild & 3),
                _ => wild,
            }
        })
        .collect()
}

fn attributes_of<const N: usize>(count: usize) {
    let bytes = noise(N * count, N as u32);
    let vertices: &[[u8; N]] = bytes.as_chunks().0;
    let mut coded = vec![0; vertex_buffer::encode_vertex_buffer_bound(count, N)];
    let length =
        vertex_buffer::encode_vertex_buffer(&mut coded, vertices, VertexEncodingVersion::V0)
            .unwrap();
    let decoded = decode(
        &coded[..length],
        count as u64,
        N as u64,
        "ATTRIBUTES",
        "NONE",
    );
    assert!(
        decoded.as_deref() == Ok(&bytes),
        "stride {N}, {count} vertices"
    );
    // Cut anywhere: an error or other bytes, no panic.
    for cut in 0..length.min(300) {
        let _ = decode(&coded[..cut], count as u64, N as u64, "ATTRIBUTES", "");
    }
}

#[test]
fn attributes_come_back() {
    for count in [1, 15, 16, 17, 255, 256, 257, 2000] {
        attributes_of::<4>(count);
        attributes_of::<12>(count);
        attributes_of::<16>(count);
        attributes_of::<64>(count);
        attributes_of::<256>(count);
    }
}

/// Triangles of a grid, some of them turned, some of them far apart.
fn triangles() -> Vec<u32> {
    let wild = noise(4 * 3000, 5);
    let words: Vec<u32> = wild
        .as_chunks::<4>()
        .0
        .iter()
        .map(|b| u32::from_le_bytes(*b) >> 8)
        .collect();
    (0..900u32)
        .flat_map(|i| match i % 9 {
            0..6 => [i, i + 1, i + 30],
            6 => [i + 30, i + 31, i + 1],
            7 => [words[i as usize] % 5000, i, i / 2],
            _ => [
                words[i as usize],
                words[i as usize + 1],
                words[i as usize + 2],
            ],
        })
        .collect()
}

/// Rotates each triangle's smallest index to the front: the codec keeps winding, not the first corner.
fn canonical(indices: &[u32]) -> Vec<[u32; 3]> {
    let rotate = |t: &[u32; 3]| {
        let first = (0..3).min_by_key(|&k| t[k]).unwrap_or(0);
        [t[first], t[(first + 1) % 3], t[(first + 2) % 3]]
    };
    indices.as_chunks::<3>().0.iter().map(rotate).collect()
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes
        .as_chunks::<4>()
        .0
        .iter()
        .map(|b| u32::from_le_bytes(*b))
        .collect()
}

#[test]
fn triangles_come_back() {
    let indices = triangles();
    let mut coded = vec![0; indices.len() * 6 + 100];
    let length =
        buffer::encode_index_buffer(&mut coded, &indices, IndexEncodingVersion::V1).unwrap();
    let decoded = decode(&coded[..length], indices.len() as u64, 4, "TRIANGLES", "").unwrap();
    assert_eq!(canonical(&words(&decoded)), canonical(&indices));
    for cut in 0..length {
        let _ = decode(&coded[..cut], indices.len() as u64, 4, "TRIANGLES", "");
    }
}

#[test]
fn index_sequences_come_back() {
    let indices = triangles();
    let mut coded = vec![0; indices.len() * 6 + 100];
    let length = sequence::encode_index_sequence(&mut coded, &indices, IndexEncodingVersion::V1);
    let decoded = decode(&coded[..length], indices.len() as u64, 4, "INDICES", "").unwrap();
    assert_eq!(words(&decoded), indices);
}

/// Stores elements uncompressed-looking but legal, so that a filter can be run on them.
fn filtered<const N: usize>(elements: &[[u8; N]], name: &str) -> Vec<u8> {
    let mut coded = vec![0; vertex_buffer::encode_vertex_buffer_bound(elements.len(), N)];
    let length =
        vertex_buffer::encode_vertex_buffer(&mut coded, elements, VertexEncodingVersion::V0)
            .unwrap();
    decode(
        &coded[..length],
        elements.len() as u64,
        N as u64,
        "ATTRIBUTES",
        name,
    )
    .unwrap()
}

#[test]
fn filters_agree_with_the_other_implementation() {
    // x and y within the diamond of the 1 that stands in z.
    let small: Vec<[u8; 4]> = (0..200i32)
        .map(|i| {
            [
                (i % 61 - 30) as i8 as u8,
                (i % 67 - 33) as i8 as u8,
                64,
                i as u8,
            ]
        })
        .collect();
    let mut wanted = small.clone();
    filter::decode_filter_oct_8(&mut wanted);
    assert_eq!(filtered(&small, "OCTAHEDRAL"), wanted.as_flattened());

    let bytes =
        |w: &[u16; 4]| -> [u8; 8] { std::array::from_fn(|i| w[i / 2].to_le_bytes()[i % 2]) };
    let large: Vec<[u16; 4]> = (0..500i32)
        .map(|i| {
            [
                (i * 7 % 1001 - 500) as i16 as u16,
                (i * 11 % 1003 - 501) as i16 as u16,
                1023,
                i as u16,
            ]
        })
        .collect();
    let mut wanted = large.clone();
    filter::decode_filter_oct_16(&mut wanted);
    let stored: Vec<[u8; 8]> = large.iter().map(bytes).collect();
    let wanted: Vec<u8> = wanted.iter().flat_map(bytes).collect();
    assert_eq!(filtered(&stored, "OCTAHEDRAL"), wanted);

    let turns: Vec<[u16; 4]> = (0..500i32)
        .map(|i| {
            // The other implementation takes stored words for unsigned.
            let v = |k: i32| (i * k % 501) as u16;
            [v(7), v(11), v(13), (1020 + i % 4) as u16]
        })
        .collect();
    let mut wanted = turns.clone();
    filter::decode_filter_quat(&mut wanted);
    let stored: Vec<[u8; 8]> = turns.iter().map(bytes).collect();
    let wanted: Vec<u8> = wanted.iter().flat_map(bytes).collect();
    assert_eq!(filtered(&stored, "QUATERNION"), wanted);

    let numbers: Vec<u32> = (0..400u32)
        .map(|i| ((i % 40).wrapping_sub(20) << 24) | ((i * 41_943) & 0xff_ffff))
        .collect();
    let mut wanted = numbers.clone();
    filter::decode_filter_exp(&mut wanted);
    let stored: Vec<[u8; 4]> = numbers.iter().map(|n| n.to_le_bytes()).collect();
    assert_eq!(words(&filtered(&stored, "EXPONENTIAL")), wanted);
}

#[test]
fn negative_quaternion_components_stay_negative() {
    // (-1/2, -1/2, -1/2) of a scale of 1023 / sqrt(2), w left out: it is 1/2. Then x left out.
    let half = (0.5 * 1023.0 * std::f32::consts::SQRT_2) as i16;
    for (left_out, wanted) in [
        (0usize, [0.5, -0.5, -0.5, -0.5]),
        (3, [-0.5, -0.5, -0.5, 0.5]),
    ] {
        let words = [-half, -half, -half, 1020 + left_out as i16];
        let bytes: [u8; 8] = std::array::from_fn(|i| words[i / 2].to_le_bytes()[i % 2]);
        let out = filtered(&[bytes], "QUATERNION");
        for (found, wanted) in out.as_chunks::<2>().0.iter().zip(wanted) {
            let found = f32::from(i16::from_le_bytes(*found)) / 32767.0;
            assert!((found - wanted).abs() < 2e-3, "{found} is not {wanted}");
        }
    }
}

#[test]
fn absurd_counts_are_refused() {
    for mode in ["ATTRIBUTES", "TRIANGLES", "INDICES", "OTHER"] {
        for (count, stride) in [
            (u64::MAX, 4),
            (u64::MAX, u64::MAX),
            (3 << 40, 4),
            (3, 0),
            (3, 3),
        ] {
            assert!(
                decode(&[0xa0; 64], count, stride, mode, "").is_err(),
                "{mode} {count} {stride}"
            );
        }
    }
}
