//! The example of embedding runs, and stays short.

#[path = "../examples/remember_meshes.rs"]
mod remember_meshes;

#[test]
fn remembering_saves_rays_and_stays_short() {
    remember_meshes::main();
    let text = include_str!("../examples/remember_meshes.rs").lines();
    assert!(text.filter(|line| !line.is_empty()).count() <= 40);
}
