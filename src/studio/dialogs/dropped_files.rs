//! Files that are dropped on the window.
//!
//! A drop opens one design, one object set or one PSF. All images of a folder are one object set; a message names unused
//! files.

use std::path::{Path, PathBuf};

use crate::formats::{image_files, path_text};
use crate::objects::ObjectSource;
use crate::plural::counted;
use crate::studio::state::messages::Severity;
use crate::studio::state::request::Request;
use crate::studio::state::transition::Transition;
use crate::studio::widgets::file_preview::Preview;
use crate::studio::widgets::format::file_name;
use crate::studio::widgets::modal;
use crate::workbench::FileUse;

/// Maximal number of file names in a message.
const NAMED: usize = 5;

/// Images or arrays that may be a PSF or objects.
#[derive(Debug, PartialEq)]
struct Images {
    first: PathBuf,
    others: Vec<PathBuf>,
    /// The folder, if these are all its images.
    folder: Option<PathBuf>,
}

/// The question about dropped images.
#[derive(Default)]
pub struct Dropped {
    images: Option<Images>,
    /// Path of the first image, with the chosen options.
    text: String,
    preview: Preview,
}

impl Dropped {
    /// Whether a question is open.
    pub fn is_open(&self) -> bool {
        self.images.is_some()
    }

    /// Takes files that were dropped in this frame.
    pub fn take(&mut self, ctx: &egui::Context, requests: &mut Vec<Request>) {
        let files: Vec<PathBuf> =
            ctx.input(|input| input.raw.dropped_files.iter().map(|file| file.path().to_path_buf()).collect());
        match chosen(files) {
            Some((Chosen::Design(path), unused)) => {
                requests.extend(unused_notice(&path, &unused));
                requests.push(Request::Transition(Transition::OpenFile(path)));
            }
            Some((Chosen::Objects(path), unused)) => {
                requests.extend(unused_notice(&path, &unused));
                requests.push(Request::OpenObjects(ObjectSource::guess(&path)));
            }
            Some((Chosen::Images(images), _)) => {
                self.text = path_text(&images.first);
                self.images = Some(images);
            }
            None => {}
        }
    }

    /// Asks whether images are objects or a PSF.
    pub fn ask(&mut self, ctx: &egui::Context, requests: &mut Vec<Request>) {
        let Some(Images { first, others, folder }) = &self.images else { return };
        let mut answered = false;
        modal::show(ctx, "dropped file", 420.0, |ui| {
            let all = 1 + others.len();
            if others.is_empty() {
                ui.heading(format!("Use {}", file_name(Some(first))));
            } else {
                ui.heading(format!("Use {}", counted(all, "image")));
                let text = match folder {
                    Some(folder) => format!("These are all images of {}.", folder.display()),
                    None => format!(
                        "Only {} can be used. To use several images as one object set, put them into a folder of their own.",
                        file_name(Some(first))
                    ),
                };
                ui.label(text);
            }
            ui.add_space(4.0);
            self.preview.show_in_place(ui, &mut self.text, FileUse::Measurements);
            ui.add_space(8.0);
            ui.horizontal(|ui| {
                if ui.button("As objects").clicked() {
                    if folder.is_none() {
                        requests.extend(unused_notice(first, others));
                    }
                    // The chosen options hold for all images of the folder.
                    let meaning = self.text.strip_prefix(&path_text(first)).unwrap_or_default();
                    let source = folder.as_ref().map_or(self.text.clone(), |folder| path_text(folder) + meaning);
                    requests.push(Request::OpenObjects(ObjectSource::guess(Path::new(&source))));
                    answered = true;
                }
                let text =
                    if others.is_empty() { "As PSF".to_owned() } else { format!("{} as PSF", file_name(Some(first))) };
                if ui.button(text).clicked() {
                    requests.extend(unused_notice(first, others));
                    requests.push(Request::OpenPsf(self.text.clone()));
                    answered = true;
                }
                answered |= ui.button("Cancel").clicked() || ui.input(|input| input.key_pressed(egui::Key::Escape));
            });
        });
        if answered {
            self.images = None;
        }
    }
}

/// What one drop opens.
#[derive(Debug, PartialEq)]
enum Chosen {
    Design(PathBuf),
    Objects(PathBuf),
    Images(Images),
}

/// What a drop opens, and its unused files. A design precedes objects, objects precede images.
fn chosen(files: Vec<PathBuf>) -> Option<(Chosen, Vec<PathBuf>)> {
    let kinds: Vec<FileKind> = files.iter().map(|path| kind_of(path)).collect();
    let place = |kind| kinds.iter().position(|&found| found == kind);
    let one = |place: usize| {
        let mut others = files.clone();
        let first = others.remove(place);
        (first, others)
    };
    if let Some(place) = place(FileKind::Design) {
        let (design, others) = one(place);
        return Some((Chosen::Design(design), others));
    }
    if let Some(place) = place(FileKind::Objects) {
        let (objects, others) = one(place);
        return Some((Chosen::Objects(objects), others));
    }
    let folder = whole_folder(&files);
    let (first, others) = one(place(FileKind::Image)?);
    Some((Chosen::Images(Images { first, others, folder }), Vec::new()))
}

/// The folder, if these are several files and all its images.
fn whole_folder(files: &[PathBuf]) -> Option<PathBuf> {
    let folder = files.first().filter(|_| files.len() > 1)?.parent()?;
    let mut dropped = files.to_vec();
    dropped.sort();
    (image_files(folder).ok()?.into_iter().map(|file| file.path).collect::<Vec<_>>() == dropped)
        .then(|| folder.to_owned())
}

/// Notice about the unused files of a drop.
fn unused_notice(used: &Path, unused: &[PathBuf]) -> Option<Request> {
    if unused.is_empty() {
        return None;
    }
    let names: Vec<String> = unused.iter().take(NAMED).map(|path| file_name(Some(path))).collect();
    let more = match unused.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let text = format!("{} is used; not used: {}{more}", file_name(Some(used)), names.join(", "));
    Some(Request::Notify(Severity::Notice, text))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FileKind {
    Design,
    Objects,
    Image,
}

/// Likely kind of a dropped file or folder. Images and arrays may be a PSF or objects.
fn kind_of(path: &Path) -> FileKind {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default();
    match extension.as_str() {
        "json" => FileKind::Design,
        "npy" | "npz" | "tif" | "tiff" | "png" | "jpg" | "jpeg" | "bmp" if path.is_file() => FileKind::Image,
        _ => FileKind::Objects,
    }
}

/// Shows a hint while files are dragged over the window.
pub fn show_hint(ctx: &egui::Context) {
    if ctx.input(|input| input.raw.hovered_files.is_empty()) {
        return;
    }
    let painter = ctx.layer_painter(egui::LayerId::new(egui::Order::Foreground, egui::Id::unique("drop hint")));
    let rect = ctx.content_rect();
    painter.rect_filled(rect, 0.0, egui::Color32::from_black_alpha(160));
    painter.text(
        rect.center(),
        egui::Align2::CENTER_CENTER,
        "Drop a design, objects or a PSF",
        egui::FontId::proportional(24.0),
        egui::Color32::WHITE,
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropped_files_are_classified() {
        assert_eq!(kind_of(Path::new("a/Design.JSON")), FileKind::Design);
        assert_eq!(kind_of(Path::new("t10k-images-idx3-ubyte.gz")), FileKind::Objects);
        assert_eq!(kind_of(Path::new("test_batch.bin")), FileKind::Objects);
    }

    #[test]
    fn all_images_of_a_folder_are_one_set() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, b"").unwrap();
            path
        };
        let images: Vec<PathBuf> = (0..8).map(|number| file(&format!("{number}.png"))).collect();
        let mut turned = images.clone();
        turned.reverse();
        let Some((Chosen::Images(found), unused)) = chosen(turned) else { panic!("no images") };
        assert_eq!((found.folder.as_deref(), found.others.len(), unused.len()), (Some(folder.path()), 7, 0));
        // Some images of a folder, or a single one, are not a set.
        for count in [7, 1] {
            let Some((Chosen::Images(found), _)) = chosen(images[..count].to_vec()) else { panic!("no images") };
            assert_eq!((found.folder, found.others.len()), (None, count - 1));
        }
        let (one, other) = (file("one.json"), file("other.json"));
        let dropped = vec![images[0].clone(), one.clone(), other.clone()];
        assert_eq!(chosen(dropped), Some((Chosen::Design(one), vec![images[0].clone(), other])));
        let objects = file("train-images-idx3-ubyte");
        let dropped = vec![images[0].clone(), objects.clone()];
        assert_eq!(chosen(dropped), Some((Chosen::Objects(objects), vec![images[0].clone()])));
        assert_eq!(chosen(Vec::new()), None);
    }
}
