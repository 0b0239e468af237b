//! Array, image and table files, and atomic writing.
//!
//! Every reader checks the sizes in a header against the length of the file before it reserves memory. It returns a
//! [`FormatError`] of one sentence for a file that it cannot read. Values are those of the file (counts of the camera,
//! NaN included); the caller decides on their meaning.

mod atomic_write;
mod background_writer;
mod bytes;
mod cifar;
mod document;
mod document_folder;
mod drawing_font;
mod error;
mod folder;
mod grey_values;
mod idx;
mod image_file;
mod jpeg;
mod kind;
mod npy;
mod npy_header;
mod npz;
mod orientation;
mod raster;
mod raw_array;
mod samples;
#[cfg(test)]
mod scratch;
mod shell_word;
mod stack;
mod tables;
mod text_form;
mod tiff_directory;
mod tiff_pages;
mod tiff_write;
mod understood;

pub use atomic_write::{
    CompleteFile, NameLock, TEMPORARY_PREFIX, check_writable, complete_file, create_folder, lock_folder, lock_name,
    read_if_there, remove_if_there, write_safely,
};
pub use background_writer::{AfterWrite, FileContent, FileWriter};
pub use bytes::read_bytes;
pub use cifar::read_cifar;
pub use document::{DocumentKind, Listed, Mismatch, content_key, json_of};
pub use document_folder::{DocumentFolder, FoundDocuments};
pub(crate) use drawing_font::{DRAWING_FONT, use_drawing_font};
pub use error::FormatError;
pub use folder::{image_files, no_images};
pub use grey_values::{GreyValues, Saturated, Wrapped};
pub use idx::read_idx;
pub use image_file::{Channel, FrameAxis, ImageFile, Meaning, PathOption, path_text, split_end, split_kind};
pub use npy::{ArrayWriter, read_array, write_array};
pub use npz::{read_npz, read_npz_f64};
pub use orientation::turned;
pub use raster::{complete_png_rgb, complete_png8, complete_png16, write_png_rgb, write_png8, write_png16};
pub(crate) use samples::bits_of;
pub use samples::{GREY_WEIGHTS, PixelStack, Samples};
#[cfg(test)]
pub(crate) use scratch::Scratch;
pub use shell_word::{shell_quoted, shell_word};
pub use stack::{read_grey, read_stack};
pub use tables::{complete_csv, complete_json, read_json, write_csv, write_csv_text, write_json};
pub(crate) use text_form::text_form;
pub use tiff_pages::read_pages;
pub use tiff_write::{PageWriter, write_tiff};
pub use understood::{ImageSummary, Understood};
