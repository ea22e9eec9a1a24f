//! The example of the documentation runs, and embedding stays short.

#[path = "../examples/embed.rs"]
mod embed;

#[test]
fn example_runs_and_is_short() {
    embed::main();
    let body = include_str!("../examples/embed.rs").lines();
    let body = body.skip_while(|line| !line.starts_with("pub fn main"));
    assert!(body.count() < 30);
}

#[path = "../examples/remember.rs"]
mod remember;

#[test]
fn remembering_saves_rays_and_stays_short() {
    remember::main();
    let text = include_str!("../examples/remember.rs").lines();
    assert!(text.filter(|line| !line.is_empty()).count() < 40);
}

#[path = "../examples/views.rs"]
mod views;

#[test]
fn views_are_drawn() {
    let folder = std::env::temp_dir().join(format!("occlude-views-{}", std::process::id()));
    let [patches, refined, traced] = views::draw(&folder).expect("a writable folder");
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 3);
    std::fs::remove_dir_all(&folder).unwrap();
    // Patches everywhere; refinement and rays at few places, but at some.
    assert!(patches > 60.0);
    assert!(refined > 0.5 && refined < 64.0, "{refined}");
    assert!(traced > 0.5 && traced < 64.0, "{traced}");
}
