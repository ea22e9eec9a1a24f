//! Colour spaces of FLIP: linear Rec. 709, YCxCz (linearised L\*a\*b\*) and Hunt-adjusted L\*a\*b\*.

/// XYZ of linear Rec. 709 with D65, rows; the rational numbers that IEC 61966-2-1's chromaticities give.
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [
        10_135_552.0 / 24_577_794.0,
        8_788_810.0 / 24_577_794.0,
        4_435_075.0 / 24_577_794.0,
    ],
    [
        2_613_072.0 / 12_288_897.0,
        8_788_810.0 / 12_288_897.0,
        887_015.0 / 12_288_897.0,
    ],
    [
        1_425_312.0 / 73_733_382.0,
        8_788_810.0 / 73_733_382.0,
        70_074_185.0 / 73_733_382.0,
    ],
];

/// XYZ relative to white of linear Rec. 709: every row sums to 1.
const RELATIVE_FROM_RGB: [[f32; 3]; 3] = {
    let mut m = [[0.0; 3]; 3];
    let mut row = 0;
    while row < 3 {
        let r = XYZ_FROM_RGB[row];
        let white = r[0] + r[1] + r[2];
        m[row] = [
            (r[0] / white) as f32,
            (r[1] / white) as f32,
            (r[2] / white) as f32,
        ];
        row += 1;
    }
    m
};

/// The inverse, by cofactors.
const RGB_FROM_RELATIVE: [[f32; 3]; 3] = {
    let mut m = [[0.0f64; 3]; 3];
    let mut row = 0;
    while row < 3 {
        let r = XYZ_FROM_RGB[row];
        let white = r[0] + r[1] + r[2];
        m[row] = [r[0] / white, r[1] / white, r[2] / white];
        row += 1;
    }
    let mut inverse = [[0.0f32; 3]; 3];
    let det = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
    let mut i = 0;
    while i < 3 {
        let mut j = 0;
        while j < 3 {
            let (a, b) = ((j + 1) % 3, (j + 2) % 3);
            let (c, d) = ((i + 1) % 3, (i + 2) % 3);
            inverse[i][j] = ((m[a][c] * m[b][d] - m[a][d] * m[b][c]) / det) as f32;
            j += 1;
        }
        i += 1;
    }
    inverse
};

fn product(m: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Linear opponent colours: luminance, red-green, blue-yellow (section 4.1.1).
pub(super) fn ycxcz_from_linear(c: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = product(&RELATIVE_FROM_RGB, c);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// The inverse of [`ycxcz_from_linear`].
pub(super) fn linear_from_ycxcz([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (y + 16.0) / 116.0;
    product(&RGB_FROM_RELATIVE, [y + cx / 500.0, y, y - cz / 200.0])
}

/// CIE L\*a\*b\* with the Hunt effect: chroma in proportion to lightness (eq. 8).
pub(super) fn hunt_lab_from_linear(c: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| {
        if t > DELTA * DELTA * DELTA {
            t.cbrt()
        } else {
            t / (3.0 * DELTA * DELTA) + 4.0 / 29.0
        }
    };
    let [x, y, z] = product(&RELATIVE_FROM_RGB, c).map(f);
    let lightness = 116.0 * y - 16.0;
    [
        lightness,
        0.01 * lightness * 500.0 * (x - y),
        0.01 * lightness * 200.0 * (y - z),
    ]
}

/// The HyAB distance for large differences (eq. 9): city block between lightness and chroma.
pub(super) fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spaces_round_trip_and_know_white() {
        for c in [[1.0, 1.0, 1.0], [0.2, 0.7, 0.1], [0.0, 0.0, 1.0], [0.0; 3]] {
            let back = linear_from_ycxcz(ycxcz_from_linear(c));
            for i in 0..3 {
                assert!((back[i] - c[i]).abs() < 1e-5, "{c:?} became {back:?}");
            }
        }
        let white = hunt_lab_from_linear([1.0; 3]);
        assert!((white[0] - 100.0).abs() < 1e-3 && white[1].abs() < 1e-3 && white[2].abs() < 1e-3);
        // L* of 18 % grey: 116 * 0.18^(1/3) - 16.
        assert!((hunt_lab_from_linear([0.18; 3])[0] - 49.496).abs() < 1e-2);
    }
}
