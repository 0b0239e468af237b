//! The rooms of the window and how they are arranged.

use egui_tiles::{Behavior, Container, Linear, LinearDir, SimplificationOptions, TileId, Tiles, Tree, UiResponse};

use super::state::State;
use super::{
    estimates_panel, history_panel, information_map_panel, information_panel, lenslet_table, mask_canvas, mtf_panel,
    optimize_panel, sample_panels, scene_panel,
};

/// A room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pane {
    /// The PSF plane with the lenslets.
    Mask,
    /// The lenslets as numbers.
    Lenslets,
    /// One object.
    Object,
    /// One measurement.
    Measurement,
    /// What is imaged and by which sensor.
    Scene,
    /// Information and Tamura coefficient.
    Information,
    /// Modulation transfer function.
    Mtf,
    /// Information of past edits.
    History,
    /// Estimates that take minutes.
    Estimates,
    /// Where in a patch the information comes from.
    InformationMap,
    /// Runs that optimize the mask.
    Optimize,
}

impl Pane {
    fn title(self) -> &'static str {
        match self {
            Self::Mask => "Mask",
            Self::Lenslets => "Lenslets",
            Self::Object => "Object",
            Self::Measurement => "Measurement",
            Self::Scene => "Scene",
            Self::Information => "Information",
            Self::Mtf => "MTF",
            Self::History => "History",
            Self::Estimates => "Estimates",
            Self::InformationMap => "Map",
            Self::Optimize => "Optimize",
        }
    }
}

/// The arrangement that a new window has: mask and lenslets, object and measurement, numbers.
pub fn default_layout() -> Tree<Pane> {
    let mut tiles = Tiles::default();
    let column = |tiles: &mut Tiles<Pane>, panes: [(Pane, f32); 2]| {
        let mut linear = Linear { dir: LinearDir::Vertical, ..Linear::default() };
        for (pane, share) in panes {
            let pane = tiles.insert_pane(pane);
            let tab = tiles.insert_tab_tile(vec![pane]);
            linear.children.push(tab);
            linear.shares.set_share(tab, share);
        }
        tiles.insert_container(Container::Linear(linear))
    };
    let left = column(&mut tiles, [(Pane::Mask, 2.1), (Pane::Lenslets, 1.0)]);
    let middle = column(&mut tiles, [(Pane::Object, 1.0), (Pane::Measurement, 1.0)]);
    let right = {
        let information = tiles.insert_pane(Pane::Information);
        let information = tiles.insert_tab_tile(vec![information]);
        let scene = tiles.insert_pane(Pane::Scene);
        let mtf = tiles.insert_pane(Pane::Mtf);
        let history = tiles.insert_pane(Pane::History);
        let estimates = tiles.insert_pane(Pane::Estimates);
        let map = tiles.insert_pane(Pane::InformationMap);
        let optimize = tiles.insert_pane(Pane::Optimize);
        let below = tiles.insert_tab_tile(vec![scene, optimize, estimates, map, mtf, history]);
        let mut linear = Linear { dir: LinearDir::Vertical, ..Linear::default() };
        linear.children = vec![information, below];
        linear.shares.set_share(information, 1.15);
        linear.shares.set_share(below, 1.0);
        tiles.insert_container(Container::Linear(linear))
    };
    let mut row = Linear { dir: LinearDir::Horizontal, ..Linear::default() };
    row.children = vec![left, middle, right];
    row.shares.set_share(left, 1.45);
    row.shares.set_share(middle, 1.05);
    row.shares.set_share(right, 1.15);
    let root = tiles.insert_container(Container::Linear(row));
    Tree::new(egui::Id::unique("rooms"), root, tiles)
}

/// Draws the rooms.
pub struct Rooms<'a>(pub &'a mut State);

impl Behavior<Pane> for Rooms<'_> {
    fn pane_ui(&mut self, ui: &mut egui::Ui, _tile: TileId, pane: &mut Pane) -> UiResponse {
        let frame = egui::Frame::new().inner_margin(egui::Margin::symmetric(8, 6)).fill(ui.visuals().panel_fill);
        frame.show(ui, |ui| {
            ui.set_min_size(ui.available_size());
            match pane {
                Pane::Mask => mask_canvas::show(ui, self.0),
                Pane::Lenslets => lenslet_table::show(ui, self.0),
                Pane::Object => sample_panels::show_object(ui, self.0),
                Pane::Measurement => sample_panels::show_measurement(ui, self.0),
                Pane::Scene => scene_panel::show(ui, self.0),
                Pane::Information => information_panel::show(ui, self.0),
                Pane::Mtf => mtf_panel::show(ui, self.0),
                Pane::History => history_panel::show(ui, self.0),
                Pane::Estimates => estimates_panel::show(ui, self.0),
                Pane::InformationMap => information_map_panel::show(ui, self.0),
                Pane::Optimize => optimize_panel::show(ui, self.0),
            }
        });
        UiResponse::None
    }

    fn tab_title_for_pane(&mut self, pane: &Pane) -> egui::WidgetText {
        pane.title().into()
    }

    fn simplification_options(&self) -> SimplificationOptions {
        SimplificationOptions { all_panes_must_have_tabs: true, ..SimplificationOptions::default() }
    }

    fn gap_width(&self, _style: &egui::Style) -> f32 {
        3.0
    }
}
