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
    let body = include_str!("../examples/remember.rs").lines();
    let body = body.skip_while(|line| !line.starts_with("/// Every eye asks"));
    assert!(body.filter(|line| !line.is_empty()).count() < 60);
}
