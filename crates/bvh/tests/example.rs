//! The example of embedding runs, and stays short.

#[path = "../examples/remember.rs"]
mod remember;

#[test]
fn remembering_saves_rays_and_stays_short() {
    remember::main();
    let text = include_str!("../examples/remember.rs").lines();
    assert!(text.filter(|line| !line.is_empty()).count() <= 40);
}
