//! The order of questions (Popov 2013, Figs. 3 and 4): asked line by line, shadows shift along the lines; asked in the progressive
//! order they stay where they are, and refinement finds neighbours on all sides.
//!
//! A floor under one point light and a ball: the exact shadow is a disk, so what shifts is known.

use super::fixed;
use crate::common::{Report, Setting};
use glam::Vec3;
use occlude_image::{Look, Picture, ToneMap};
use occlude_visibility::quantized::{
    BoundingSphere, ErrorReach, Quantized, QuantizedSettings, Refine,
};
use occlude_visibility::{EveryLight, EyeSample, Ray, Session, SharedLight, order};

/// Eyes along each side of the floor, and screen pixels of an eye.
const SIDE: u32 = 96;
const ZOOM: u32 = 3;
const ERROR: f32 = 8.0;

const TITLE: &str = "The order of questions (Figs. 3 and 4): a ball's shadow on a floor, C_E 8";
const HEADER: &[&str] = &[
    "order",
    "refined",
    "rays /",
    "wrong, % of the shadow's edge",
    "shift along lines, samples",
    "shift down, samples",
];

pub fn run(setting: &Setting, report: &mut Report) {
    let light = SharedLight::point(Vec3::new(0.1, 4.0, 0.2));
    let blocked = |ray: &Ray| {
        let way = Vec3::new(0.0, 1.0, 0.0) - ray.origin;
        let nearest = way.dot(ray.direction) / ray.direction.length_squared();
        (ray.at(nearest) - ray.origin - way).length() < 0.7
    };
    let place = |x: u32, y: u32| {
        let along = |i: u32| (i as f32 + 0.5) / SIDE as f32 * 4.0 - 2.0;
        Vec3::new(along(x), 0.0, along(y))
    };
    let lines: Vec<[u32; 2]> = (0..SIDE * SIDE).map(|i| [i % SIDE, i / SIDE]).collect();
    let first = (SIDE * SIDE) as f32 / (ERROR * ERROR);
    let orders = [
        ("line by line", lines),
        ("progressive", order::progressive(SIDE, SIDE, first)),
    ];
    let truth: Vec<bool> = (0..SIDE * SIDE)
        .map(|i| !blocked(&light.ray_from(place(i % SIDE, i / SIDE))))
        .collect();
    let mut sheet = Picture::new(4 * (SIDE * ZOOM + ZOOM), SIDE * ZOOM);
    let panels = orders
        .iter()
        .flat_map(|order| [Refine::Levels(1), Refine::Auto].map(|refine| (order, refine)));
    for (panel, ((name, places), refine)) in (0..).zip(panels) {
        let bounds = BoundingSphere {
            centre: Vec3::ZERO,
            radius: 3.0,
        };
        let settings = QuantizedSettings {
            error: ErrorReach::all(ERROR),
            refine,
            ..QuantizedSettings::default()
        };
        let strategy = Quantized::new(settings, bounds).expect("legal settings");
        let mut session = Session::new(&blocked, &strategy);
        let density = (SIDE as f32 / 4.0).powi(2);
        let eyes: Vec<EyeSample> = places
            .iter()
            .map(|&[x, y]| EyeSample::new(place(x, y), Vec3::Y, density))
            .collect();
        let mut visible = vec![false; (SIDE * SIDE) as usize];
        // Line by line means one call a line: within a call the strategy takes its segments.
        let together = if *name == "progressive" {
            eyes.len()
        } else {
            1
        };
        for (eyes, places) in eyes.chunks(together).zip(places.chunks(together)) {
            let take = |eye: usize, _: usize, answer: f32| {
                let [x, y] = places[eye];
                visible[(y * SIDE + x) as usize] = answer > 0.5;
            };
            if together == 1 {
                let mut answers = [0.0];
                session.answer(&[light.query(&eyes[0])], &mut answers);
                let [x, y] = places[0];
                visible[(y * SIDE + x) as usize] = answers[0] > 0.5;
            } else {
                session.answer_many(eyes, &[light], &mut EveryLight(1, take));
            }
        }
        let [wrong, along, down] = compare(&visible, &truth);
        let stats = session.stats();
        report.table(
            TITLE,
            HEADER,
            vec![
                (*name).into(),
                if refine == Refine::Auto { "yes" } else { "no" }.into(),
                fixed(stats.queries as f64 / stats.traced.max(1) as f64),
                fixed(100.0 * wrong),
                format!("{along:+.2}"),
                format!("{down:+.2}"),
            ],
        );
        report.raw(&format!(
            "order,floor,1,{name},{panel},shift,{along:.4},samples"
        ));
        draw(&mut sheet, panel, &visible, &truth);
    }
    let file = setting.out.join("order.png");
    let plain = Look {
        tone_map: ToneMap::None,
        exposure_ev: 0.0,
    };
    match occlude_image::write(&file, &sheet, plain) {
        Ok(()) => report.figure(
            "A ball's shadow: line by line without and with refinement, then in the progressive order without and with it; red: wrong",
            "<img src=\"order.png\" alt=\"the order of questions\">".to_owned(),
        ),
        Err(error) => report.note(format!("{}: {error}", file.display())),
    }
}

/// Wrong answers over the length of the edge, and how far the shadow's centre has moved.
fn compare(visible: &[bool], truth: &[bool]) -> [f64; 3] {
    let centre = |seen: &[bool]| {
        let (mut sum, mut n) = ([0.0f64; 2], 0.0);
        for (i, _) in seen.iter().enumerate().filter(|(_, seen)| !**seen) {
            sum[0] += f64::from(i as u32 % SIDE);
            sum[1] += f64::from(i as u32 / SIDE);
            n += 1.0;
        }
        ([sum[0] / n, sum[1] / n], n)
    };
    let wrong = visible.iter().zip(truth).filter(|(a, b)| a != b).count() as f64;
    let ((found, _), (true_one, area)) = (centre(visible), centre(truth));
    let edge = (4.0 * std::f64::consts::PI * area).sqrt();
    [wrong / edge, found[0] - true_one[0], found[1] - true_one[1]]
}

fn draw(sheet: &mut Picture, panel: u32, visible: &[bool], truth: &[bool]) {
    for y in 0..SIDE * ZOOM {
        for x in 0..SIDE * ZOOM {
            let i = (y / ZOOM * SIDE + x / ZOOM) as usize;
            let at = y * sheet.width + panel * (SIDE * ZOOM + ZOOM) + x;
            let grey = if visible[i] { 0.8 } else { 0.1 };
            sheet.pixels[at as usize] = if visible[i] == truth[i] {
                [grey; 3]
            } else {
                [0.8, 0.5 * grey, 0.5 * grey]
            };
        }
    }
}
