//! Page of a camera: its picture with the face that was found, and the faces taken so far.
//!
//! - in: the views of a reading
//! - out: stage, pictures and snapshots at a desk, which the page of runs shows; its inputs

use super::super::output::refuse;
use super::super::ui::{Ui, UiArgs, UiKind};
use super::view::View;
use crate::desk::{Desk, Inputs, Picture, Pixels, RunEnd};
use crate::operator::{
    CameraStage, CameraView, Class, ControlView, Input, Mark, Message, Net, OutcomeView, Reading,
    Snapshot, Stage,
};
use crate::vision::FaceSighting;
use std::sync::Arc;

/// Task of the stage, by which the page leaves out what only a cell has.
const TASK: &str = "scan";

/// An open page, or none.
pub(super) struct Page {
    ui: Ui,
    run_end: RunEnd,
    _desk: Desk,
    name: String,
    snapshot: Snapshot,
    messages: Vec<Message>,
    /// Number of the last picture.
    frame: u64,
}

impl Page {
    /// Opens the page of the camera `name` if the options ask for one.
    pub(super) fn open(name: &str, args: &UiArgs, json: bool) -> anyhow::Result<Self> {
        let desk = Desk::default();
        let ui = match args.kind(json) {
            UiKind::None => Ui::None,
            kind => args.open(kind, desk.ui_end()).map_err(|why| refuse(format!("{why:#}")))?,
        };
        let run_end = desk.run_end();
        Ok(Self {
            ui,
            run_end,
            _desk: desk,
            name: name.to_owned(),
            snapshot: Snapshot::default(),
            messages: Vec::new(),
            frame: 0,
        })
    }

    /// Returns the inputs of the page.
    pub(super) fn take_inputs(&self) -> Option<Inputs> {
        self.run_end.take_inputs()
    }

    /// Shows a picture on the page.
    pub(super) fn show(&mut self, view: &View<'_>) {
        if !self.ui.has_page() {
            return;
        }
        let size = view.image.dimensions();
        if self.frame == 0 {
            self.run_end.stage.send_replace(Arc::new(stage(&self.name, size)));
        }
        self.frame += 1;
        // The picture comes first: the snapshot names it.
        let picture = Picture { frame: self.frame, pixels: Pixels::Raw(view.image.clone()) };
        self.run_end.pictures.send_replace(vec![Some(Arc::new(picture))]);
        if let Some(line) = view.line {
            self.say(view.time, line);
        }
        self.snapshot.time = view.time;
        self.snapshot.factor = 1.0;
        self.snapshot.control = ControlView::Running;
        view.wanted.clone_into(&mut self.snapshot.phase);
        self.snapshot.net = net(view.taken);
        self.snapshot.cameras = vec![camera(&self.name, self.frame, view)];
        self.publish();
    }

    /// Shows the end.
    pub(super) fn end(&mut self, line: &str, good: bool) {
        self.say(self.snapshot.time, line);
        self.snapshot.control = ControlView::Ended;
        self.snapshot.outcome = Some(OutcomeView {
            verdict: if good { "read" } else { "not read" }.to_owned(),
            good,
            reason: line.to_owned(),
            time: Some(self.snapshot.time),
            figures: Vec::new(),
        });
        self.publish();
    }

    /// Keeps the page open until the operator leaves it.
    pub(super) fn linger(self) -> anyhow::Result<()> {
        self.ui.linger(&self.run_end)
    }

    /// Adds a message.
    fn say(&mut self, time: f64, text: &str) {
        self.messages.push(Message {
            number: self.messages.len() as u64 + 1,
            time,
            class: Class::Info,
            source: TASK.to_owned(),
            text: text.to_owned(),
        });
        self.snapshot.messages = Arc::new(self.messages.clone());
    }

    /// Publishes the snapshot.
    fn publish(&mut self) {
        self.snapshot.number += 1;
        self.run_end.publish(self.snapshot.clone());
    }
}

/// Returns whether the operator has left a reading by the page.
pub(super) fn is_left(inputs: Option<&mut Inputs>) -> bool {
    let Some(inputs) = inputs else { return false };
    // Other inputs have no meaning without arms.
    std::iter::from_fn(|| inputs.try_recv().ok())
        .any(|input| matches!(input, Input::Terminate | Input::Quit))
}

/// Returns the stage of a page with one camera.
fn stage(name: &str, size: (u32, u32)) -> Stage {
    Stage {
        title: name.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        task: TASK.to_owned(),
        pace: "real-time".to_owned(),
        plant: "a camera".to_owned(),
        cameras: vec![CameraStage { name: "camera".to_owned(), size, ..CameraStage::default() }],
        ..Stage::default()
    }
}

/// Returns the camera's part of the snapshot.
fn camera(name: &str, frame: u64, view: &View<'_>) -> CameraView {
    let marks = |face: &FaceSighting| {
        let tiles = face.centres.iter().zip(face.colours.iter().zip(&face.confidences));
        tiles
            .map(|(at, (colour, confidence))| Mark {
                at: *at,
                colour: Some(*colour),
                confidence: *confidence,
            })
            .collect()
    };
    CameraView {
        name: name.to_owned(),
        frame,
        time: view.time,
        size: view.image.dimensions(),
        outlines: view.face.map(|face| face.corners.to_vec()).into_iter().collect(),
        marks: view.face.map(marks).unwrap_or_default(),
        words: view.words.to_owned(),
        found: view.face.is_some(),
    }
}

/// Returns the net of the faces that were taken, in the order of showing.
fn net(taken: &[FaceSighting]) -> Net {
    if taken.is_empty() {
        return Net::default();
    }
    let reading = |facelet: usize| {
        let face = taken.get(facelet / 9)?;
        let tile = facelet % 9;
        Some(Reading { colour: face.colours[tile], confidence: face.confidences[tile] })
    };
    Net { facelets: (0..54).map(reading).collect(), decided: false }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    /// A face with colours in a picture.
    fn face() -> FaceSighting {
        FaceSighting {
            corners: [(1.0, 1.0), (9.0, 1.0), (9.0, 9.0), (1.0, 9.0)],
            centres: [(5.0, 5.0); 9],
            seen: [true; 9],
            sticker: 0.8,
            rgb: [[200.0, 10.0, 10.0]; 9],
            colours: [1; 9],
            confidences: [0.9; 9],
            confidence: 1.0,
        }
    }

    #[test]
    fn page_shows_picture_with_found_face() {
        let listen = Some("127.0.0.1:0".to_owned());
        let args = UiArgs { ui: Some(UiKind::Web), listen, host: Vec::new() };
        let mut page = Page::open("/dev/video0", &args, false).unwrap();
        let ui = page.run_end.ui_end();
        let (image, face) = (RgbImage::new(64, 48), face());
        let taken = [face.clone()];
        let mut view = View {
            time: 1.5,
            image: &image,
            face: Some(&face),
            taken: &taken,
            words: "RRR: taken",
            wanted: "show face R",
            line: Some("face U"),
        };

        page.show(&view);
        view.line = None;
        page.show(&view);

        let stage = ui.stage.borrow().clone();
        assert_eq!((stage.task.as_str(), stage.cameras[0].size), ("scan", (64, 48)));
        let shown = ui.snapshots.borrow().clone();
        assert_eq!((shown.cameras[0].frame, shown.messages.len()), (2, 1));
        assert_eq!(shown.cameras[0].outlines, [face.corners.to_vec()]);
        assert_eq!(shown.cameras[0].marks[8].colour, Some(1));
        assert_eq!(shown.phase, "show face R");
        assert_eq!(shown.net.facelets.iter().flatten().count(), 9);
        let picture = ui.pictures.borrow()[0].clone().unwrap();
        assert_eq!(picture.frame, 2);

        let mut inputs = page.take_inputs();
        assert!(!is_left(inputs.as_mut()));
        assert!(ui.send(Input::Pause) && !is_left(inputs.as_mut()));
        assert!(ui.send(Input::Terminate) && is_left(inputs.as_mut()));
        drop(inputs);
        // The operator has left the page before the end.
        assert!(ui.send(Input::Quit));
        page.end("the cube", true);
        page.linger().unwrap();
        let outcome = ui.snapshots.borrow().outcome.clone().unwrap();
        assert_eq!((outcome.verdict.as_str(), outcome.good), ("read", true));
    }
}
