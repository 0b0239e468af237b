//! The layout of the panels.

use std::collections::BTreeSet;

use egui_tiles::{
    Behavior, Container, Linear, LinearDir, SimplificationOptions, Tile, TileId, Tiles, Tree, UiResponse,
};

use crate::studio::app::dispatch;
use crate::studio::app::state::{Parts, State};
use crate::studio::panels::{
    camera, compare, estimates, history, information, information_map, lenslets, mask, mtf, optimize, reconstruction,
    samples, scene, studies,
};
use crate::studio::state::pane::Pane;
use crate::studio::state::request::Request;
use crate::studio::state::window_layout::VisiblePanel;

/// The default layout: mask and lenslets above object, measurement and reconstruction; numbers on the right.
pub fn default_layout() -> Tree<Pane> {
    let mut tiles = Tiles::default();
    let (mask, beside) =
        (tab(&mut tiles, &[Pane::Mask]), tab(&mut tiles, &[Pane::Lenslets, Pane::Studies, Pane::Camera]));
    let above = shared(&mut tiles, LinearDir::Horizontal, &[(mask, 1.0), (beside, 1.07)]);
    let below = row(&mut tiles, &[(Pane::Object, 1.0), (Pane::Measurement, 1.0), (Pane::Reconstruction, 1.0)]);
    let left = shared(&mut tiles, LinearDir::Vertical, &[(above, 1.15), (below, 1.0)]);
    let information = tab(&mut tiles, &[Pane::Information]);
    let others =
        [Pane::Scene, Pane::Optimize, Pane::Estimates, Pane::Compare, Pane::InformationMap, Pane::Mtf, Pane::History];
    let others = tab(&mut tiles, &others);
    let right = shared(&mut tiles, LinearDir::Vertical, &[(information, 1.3), (others, 1.0)]);
    let root = shared(&mut tiles, LinearDir::Horizontal, &[(left, 2.5), (right, 1.15)]);
    Tree::new(egui::Id::unique("rooms"), root, tiles)
}

/// Panels as tabs of one place.
fn tab(tiles: &mut Tiles<Pane>, panes: &[Pane]) -> TileId {
    let panes = panes.iter().map(|&pane| tiles.insert_pane(pane)).collect();
    tiles.insert_tab_tile(panes)
}

/// Panels side by side, with their shares of the width.
fn row(tiles: &mut Tiles<Pane>, panes: &[(Pane, f32)]) -> TileId {
    let tabs: Vec<(TileId, f32)> = panes.iter().map(|&(pane, share)| (tab(tiles, &[pane]), share)).collect();
    shared(tiles, LinearDir::Horizontal, &tabs)
}

/// Tiles along a direction, with their shares.
fn shared(tiles: &mut Tiles<Pane>, dir: LinearDir, children: &[(TileId, f32)]) -> TileId {
    let mut linear = Linear { dir, ..Linear::default() };
    for &(child, share) in children {
        linear.children.push(child);
        linear.shares.set_share(child, share);
    }
    tiles.insert_container(Container::Linear(linear))
}

/// A valid layout from a file. Unknown panels are dropped, missing ones are added beside the scene. `None` if the file
/// holds no layout.
pub fn restored(mut tree: Tree<Pane>) -> Option<Tree<Pane>> {
    if !is_sound(&tree) {
        return None;
    }
    let of = |tree: &Tree<Pane>, wanted: Pane| -> Vec<TileId> {
        let tiles = tree.tiles.iter();
        tiles.filter(|(_, tile)| matches!(tile, Tile::Pane(pane) if *pane == wanted)).map(|(id, _)| *id).collect()
    };
    for unknown in of(&tree, Pane::Unknown) {
        tree.remove_recursively(unknown);
    }
    let scene = of(&tree, Pane::Scene).first().copied()?;
    let beside = tree.tiles.parent_of(scene)?;
    for pane in Pane::ALL {
        match of(&tree, pane).len() {
            0 => {
                let new = tree.tiles.insert_pane(pane);
                match tree.tiles.get_mut(beside) {
                    Some(Tile::Container(container)) => container.add_child(new),
                    _ => return None,
                }
            }
            1 => {}
            _ => return None,
        }
    }
    is_sound(&tree).then_some(tree)
}

/// Whether every tile is reachable from the root in exactly one way.
fn is_sound(tree: &Tree<Pane>) -> bool {
    let mut seen = BTreeSet::new();
    let mut waiting: Vec<TileId> = tree.root.into_iter().collect();
    while let Some(id) = waiting.pop() {
        if !seen.insert(id.0) {
            return false;
        }
        match tree.tiles.get(id) {
            Some(Tile::Container(container)) => waiting.extend(container.children()),
            Some(Tile::Pane(_)) => {}
            None => return false,
        }
    }
    seen.len() == tree.tiles.len()
}

/// Shows one maximized panel, and a button that restores all.
pub fn show_maximised(ui: &mut egui::Ui, state: &mut State, mut pane: Pane) {
    // The window has no colour of its own behind the panels.
    egui::Frame::new().fill(ui.visuals().panel_fill).show(ui, |ui| {
        ui.horizontal(|ui| {
            ui.add_space(8.0);
            ui.strong(pane.title());
            let back = ui.small_button("Show all panels").on_hover_text("Or press Escape");
            // Escape closes an open dialog or menu first.
            let is_in_front =
                ui.memory(|memory| memory.focused().is_none() && memory.allows_interaction(ui.layer_id()));
            let escape = is_in_front
                && !egui::Popup::is_any_open(ui.ctx())
                && ui.input_mut(|input| input.consume_key(egui::Modifiers::NONE, egui::Key::Escape));
            if back.clicked() || escape {
                state.layout.maximised = None;
            }
        });
        // A maximized panel is not dragged.
        let _ = PanelBehavior(state).pane_ui(ui, TileId::from_u64(0), &mut pane);
    });
}

/// Shows a panel with its part of the state.
fn show_panel(ui: &mut egui::Ui, pane: Pane, parts: Parts<'_>, requests: &mut Vec<Request>) {
    let Parts { view, panels, edit_history, .. } = parts;
    match pane {
        Pane::Mask => mask::show(ui, &mut panels.mask, &mut panels.selection, &view, requests),
        Pane::Lenslets => lenslets::show(ui, &mut panels.selection, &view, requests),
        Pane::Object => samples::show_object(ui, &mut panels.samples, &view, requests),
        Pane::Measurement => samples::show_measurement(ui, &mut panels.samples, &view, requests),
        Pane::Reconstruction => reconstruction::show(ui, &mut panels.samples, &view, requests),
        Pane::Scene => scene::show(ui, &view, requests),
        Pane::Information => information::show(ui, &view, requests),
        Pane::Mtf => mtf::show(ui, &mut panels.mtf, &view, requests),
        Pane::History => history::show(ui, edit_history, requests),
        Pane::Estimates => estimates::show(ui, &mut panels.estimates, &view, requests),
        Pane::InformationMap => information_map::show(ui, &mut panels.map, &view, requests),
        Pane::Optimize => optimize::show(ui, &mut panels.optimize, &view, requests),
        Pane::Compare => compare::show(ui, &mut panels.compare, view.palettes, requests),
        Pane::Studies => studies::show(ui, &mut panels.studies, &view, requests),
        Pane::Camera => camera::show(ui, &mut panels.camera, &view, requests),
        Pane::Unknown => {}
    }
}

/// Draws the panels.
pub struct PanelBehavior<'a>(pub &'a mut State);

impl Behavior<Pane> for PanelBehavior<'_> {
    fn pane_ui(&mut self, ui: &mut egui::Ui, _tile: TileId, pane: &mut Pane) -> UiResponse {
        let frame = egui::Frame::new().inner_margin(egui::Margin::symmetric(8, 6)).fill(ui.visuals().panel_fill);
        frame.show(ui, |ui| {
            ui.set_min_size(ui.available_size());
            let rect = ui.max_rect().expand2(egui::vec2(8.0, 6.0));
            self.0.layout.visible.push(VisiblePanel { pane: *pane, rect });
            let mut requests = Vec::new();
            show_panel(ui, *pane, self.0.parts(), &mut requests);
            // At once, so that panels below show the effect in this frame.
            dispatch::serve_all(requests, ui.ctx(), self.0);
        });
        UiResponse::None
    }

    fn on_tab_button(&mut self, tiles: &mut Tiles<Pane>, tile: TileId, response: egui::Response) -> egui::Response {
        let pane = tiles.get(tile).and_then(|tile| if let Tile::Pane(pane) = tile { Some(*pane) } else { None });
        if let Some(pane) = pane
            && response.double_clicked()
        {
            self.0.layout.maximised = Some(pane);
        }
        response.on_hover_text("Drag to move this panel; double-click to maximize it")
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

#[cfg(test)]
mod tests {
    use super::*;

    fn panes(tree: &Tree<Pane>) -> Vec<Pane> {
        tree.tiles.tiles().filter_map(|tile| if let Tile::Pane(pane) = tile { Some(*pane) } else { None }).collect()
    }

    #[test]
    fn unknown_panels_are_dropped_and_missing_ones_added() {
        let text = serde_json::to_string(&default_layout()).unwrap();
        let older = text.replace("\"Optimize\"", "\"Teleport\"");
        let tree = restored(serde_json::from_str(&older).unwrap()).unwrap();
        let found = panes(&tree);
        assert_eq!(found.len(), Pane::ALL.len());
        assert!(Pane::ALL.iter().all(|pane| found.contains(pane)));
        let plain = restored(serde_json::from_str(&text).unwrap()).unwrap();
        assert_eq!(panes(&plain).len(), Pane::ALL.len());
    }

    #[test]
    fn layout_without_a_newer_panel_gets_it_beside_the_scene() {
        let mut tree = default_layout();
        let found = tree.tiles.find_pane(&Pane::Reconstruction).unwrap();
        tree.remove_recursively(found);
        let older = serde_json::to_string(&tree).unwrap();
        assert!(!older.contains("Reconstruction"));
        let tree = restored(serde_json::from_str(&older).unwrap()).unwrap();
        let parent = |pane| tree.tiles.parent_of(tree.tiles.find_pane(&pane).unwrap());
        assert_eq!(parent(Pane::Reconstruction), parent(Pane::Scene));
    }

    #[test]
    fn invalid_layout_is_refused() {
        let mut tree = default_layout();
        tree.root = None;
        assert!(restored(tree).is_none());
        let mut tree = default_layout();
        let _ = tree.tiles.insert_pane(Pane::Mask);
        assert!(restored(tree).is_none(), "a panel that cannot be reached");
        // A container that contains itself.
        let mut tree = default_layout();
        let root = tree.root.unwrap();
        if let Some(Tile::Container(container)) = tree.tiles.get_mut(root) {
            container.add_child(root);
        }
        assert!(restored(tree).is_none());
    }
}
