//! One file per panel of the window, and the parts shared by panels.

pub mod camera;
pub mod compare;
pub mod estimates;
pub mod history;
pub mod information;
pub mod information_map;
pub mod jobs;
pub mod lenslets;
pub mod mask;
pub mod messages;
pub mod mtf;
pub mod optimize;
pub mod parts;
pub mod preview_banner;
pub mod reconstruction;
pub mod samples;
pub mod scene;
pub mod status_bar;
pub mod studies;
