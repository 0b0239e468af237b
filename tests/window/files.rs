//! Files of images: their interpretation is shown before use, and can be corrected there. Files that are dropped on the window.

use super::psf_import::{import_typed, type_psf_path, wait_for_image};
use super::waiting::wait_for;
use super::*;

/// An array whose lower rows are brighter.
fn array(path: &Path, shape: (usize, usize, usize)) {
    let values = ndarray::Array3::from_shape_fn(shape, |(row, ..)| 1.0 + row as f32);
    lenslet_studio::formats::write_array(path, values.view()).unwrap();
}

fn type_path(window: &mut Window, path: &Path) {
    window.get_by_label("Path").type_text(&path.display().to_string());
    window.run_steps(2);
}

fn is_shown(window: &Window, part: &str) -> bool {
    window.query_all_by_label_contains(part).next().is_some()
}

#[test]
fn file_preview_offers_other_readings() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.npy");
    array(&path, (40, 36, 20));
    let mut window = open(Design::default());
    click(&mut window, "Open objects...");
    type_path(&mut window, &path);
    wait_for(&mut window, "the preview", |window| {
        is_shown(window, "40 images of 36 x 20 px, axis 1 counts them, 32-bit floats, range 1 to 40")
    });
    click(&mut window, "axis=last");
    wait_for(&mut window, "the other meaning", |window| {
        is_shown(window, "20 images of 40 x 36 px, axis 3 counts them")
    });
    click(&mut window, "Open");
    settle(&mut window);
    let named = format!("{}?axis=last", path.display());
    assert_eq!(studio(&window).session().design().objects, ObjectSource::Stack(named.into()));
    assert_eq!(studio(&window).session().live().scene.unwrap().value.set.base_images(), Some(20));
    assert!(is_shown(&window, "File: 20 images of 40 x 36 px"), "beside the objects, too");
}

#[test]
fn invalid_file_is_named_in_preview() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("psf.npy");
    std::fs::write(&path, "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n").unwrap();
    let mut window = open(Design::default());
    menu(&mut window, &["File", "Import PSF..."]);
    type_psf_path(&mut window, &path);
    wait_for(&mut window, "the name of the file's kind", |window| is_shown(window, "found a Git LFS pointer"));
    assert!(is_shown(&window, "run git lfs pull"));
}

#[test]
fn psf_path_takes_resampling_option() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.npy");
    array(&path, (1, 64, 64));
    let mut window = open(Design::default());
    menu(&mut window, &["File", "Import PSF..."]);
    type_psf_path(&mut window, Path::new(&format!("{}@32", path.display())));
    wait_for(&mut window, "the preview", |window| is_shown(window, "1 image of 64 x 64 px"));
    window.get_by_label("PSF of 32 x 32 px");
    click(&mut window, "Import");
    wait_for_image(&mut window);
    assert_eq!(studio(&window).session().live().optics.unwrap().value.image.dim(), (32, 32));
}

#[test]
fn scene_panel_reports_scaling_of_large_images() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.npy");
    array(&path, (1, 240, 320));
    // A single array opened as images is scaled to the field.
    let design = Design { objects: ObjectSource::Images(path), ..Design::default() };
    let mut window = open(design);
    settle(&mut window);
    assert!(is_shown(&window, "objects are the middle 240 x 240 of 240 x 320 px, scaled to 96 x 96 px"));
    assert!(is_shown(&window, "1 whole image, 96 x 96 px"));
}

/// A file as passed by the window system.
#[derive(Debug)]
struct Dropped(std::path::PathBuf);

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        std::fs::read(&self.0).map_err(|error| error.to_string())
    }
}

#[test]
fn dropped_files_are_opened() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    let drop = |window: &mut Window, path: std::path::PathBuf| {
        window.input_mut().dropped_files.push(std::sync::Arc::new(Dropped(path)));
        window.step();
        window.run_steps(3);
    };
    let design = Design { seed: 77, ..Design::default() };
    design.save(&folder.path().join("seventy-seven.json")).unwrap();
    drop(&mut window, folder.path().join("seventy-seven.json"));
    settle(&mut window);
    assert_eq!(**studio(&window).session().design(), design);

    // An image may be a PSF or an object: the window asks.
    let image = folder.path().join("spot.npy");
    let spot = ndarray::Array2::from_shape_fn((16, 16), |(row, col)| ((row * col) % 7) as f32);
    lenslet_studio::formats::write_array(&image, spot.view()).unwrap();
    drop(&mut window, image);
    click(&mut window, "As PSF");
    import_typed(&mut window);
    wait_for_image(&mut window);
    assert_eq!(studio(&window).session().live().optics.unwrap().value.image.dim(), (16, 16));
}

#[test]
fn unused_dropped_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut window = open(Design::default());
    let drop = |window: &mut Window, paths: &[std::path::PathBuf]| {
        for path in paths {
            window.input_mut().dropped_files.push(std::sync::Arc::new(Dropped(path.clone())));
        }
        window.step();
        window.run_steps(3);
    };
    // All images of a folder are one set of objects.
    let images: Vec<_> = (0..8).map(|number| folder.path().join(format!("{number}.npy"))).collect();
    for (number, path) in images.iter().enumerate() {
        let image = ndarray::Array2::from_elem((32, 32), 1.0 + number as f32);
        lenslet_studio::formats::write_array(path, image.view()).unwrap();
    }
    drop(&mut window, &images);
    window.get_by_label("Use 8 images");
    click(&mut window, "As objects");
    settle(&mut window);
    assert_eq!(studio(&window).session().design().objects, ObjectSource::Images(folder.path().to_path_buf()));
    // Some images of a folder are not a set. Unused files are named.
    drop(&mut window, &images[2..5]);
    window.get_by_label_contains("Only 2.npy can be used");
    click(&mut window, "2.npy as PSF");
    import_typed(&mut window);
    wait_for_image(&mut window);
    menu(&mut window, &["View", "Messages"]);
    assert!(window.query_all_by_label("2.npy is used; not used: 3.npy, 4.npy").next().is_some());
    // A window holds one design.
    let designs: Vec<_> = (1..9).map(|seed| folder.path().join(format!("{seed}.json"))).collect();
    for (seed, path) in designs.iter().enumerate() {
        Design { seed: seed as u64, ..Design::default() }.save(path).unwrap();
    }
    let mut window = open(Design::default());
    menu(&mut window, &["View", "Messages"]);
    drop(&mut window, &designs);
    settle(&mut window);
    assert_eq!(studio(&window).session().path(), Some(designs[0].as_path()));
    let named = "1.json is used; not used: 2.json, 3.json, 4.json, 5.json, 6.json and 2 more";
    assert!(window.query_all_by_label(named).next().is_some());
}
