//! Tests of a webcam with a device that plays pictures.

use super::nodes::tests::{Folder, add, nodes};
use super::testing::{Event, Fake, Played, offer};
use super::*;
use image::Rgb;
use std::collections::VecDeque;
use std::sync::MutexGuard;

const SIZE: (u32, u32) = (64, 48);
const WISH: Wish = Wish { size: SIZE, exact: true, shared: false, only: None };

/// Returns a picture of one grey level.
fn grey(level: u8) -> RgbImage {
    RgbImage::from_pixel(SIZE.0, SIZE.1, Rgb([level; 3]))
}

/// Returns an event of a grey picture that is `age` (ms) old.
fn at(level: u8, age: u64) -> Event {
    Event::Picture(grey(level), age)
}

/// Returns events that a start or a change drops: no picture of this level waits with a later one.
fn dropped(count: usize, level: u8) -> impl Iterator<Item = Event> {
    (0..count).map(move |i| if i % 2 == 0 { at(level, 0) } else { Event::Nothing })
}

/// A webcam with the device that it plays. `/dev/null` stands for its node.
struct Rig {
    camera: Webcam,
    fake: Fake,
}

impl Rig {
    /// Opens a webcam whose device plays these events after the ones that a start drops.
    fn new(encoding: Encoding, settings: &WebcamDevice, events: Vec<Event>) -> Self {
        let fake = Fake::playing(encoding, SIZE, Vec::new());
        fake.played.lock().unwrap().events = vec![Event::Nothing; SETTLING].into();
        let camera =
            Webcam::open("desk", settings, WISH, (Nodes::default(), fake.opener())).unwrap();
        let rig = Self { camera, fake };
        rig.played().events = events.into();
        rig
    }

    fn played(&self) -> MutexGuard<'_, Played> {
        self.fake.played.lock().unwrap()
    }

    /// Returns the period and the level of the next frame.
    fn level(&mut self, period: u64) -> (u64, u8) {
        let frame = self.camera.grab(period, 1.0).unwrap();
        (frame.period, frame.image[(20, 20)].0[1])
    }

    fn why(&mut self) -> String {
        self.camera.grab(0, 1.0).unwrap_err().to_string()
    }
}

/// Returns a webcam without fixed controls.
fn plain() -> WebcamDevice {
    WebcamDevice::named("/dev/null")
}

/// Opens a webcam; returns the reason why it is refused.
fn refused(fake: &Fake, nodes: Nodes, device: &str) -> String {
    let opened = Webcam::open("desk", &WebcamDevice::named(device), WISH, (nodes, fake.opener()));
    opened.err().unwrap().to_string()
}

#[test]
fn frame_is_newest_picture_with_its_period() {
    for encoding in Encoding::ALL {
        let mut rig =
            Rig::new(encoding, &plain(), vec![at(10, 90), at(60, 50), at(200, 20), Event::Nothing]);

        let (period, level) = rig.level(1000);

        // 20 ms are ten periods; a slow test may come later.
        assert!(level.abs_diff(200) < 3, "{level}");
        assert!((990..1000).contains(&period), "{period}");
    }
}

/// The driver keeps four buffers of before a pause.
#[test]
fn pictures_of_before_a_pause_are_dropped() {
    let old = [at(1, 9_000), at(2, 8_960), at(3, 8_930), at(4, 8_900), Event::Nothing];
    let mut rig = Rig::new(Encoding::Yuyv, &plain(), [&old[..], &[at(90, 10)]].concat());

    assert_eq!(rig.level(5000).1, 90);
}

#[test]
fn first_pictures_are_dropped_while_camera_adapts() {
    let events = dropped(SETTLING, 0).chain([at(120, 0)]).collect();
    let fake = Fake::playing(Encoding::Yuyv, SIZE, events);
    let camera = Webcam::open("desk", &plain(), WISH, (Nodes::default(), fake.opener()));

    let frame = camera.unwrap().grab(0, 1.0).unwrap();

    assert_eq!(frame.image[(0, 0)].0, [120; 3]);
}

#[test]
fn damaged_pictures_are_skipped_up_to_limit() {
    let damaged = |events: &[Event]| -> VecDeque<Event> {
        events.iter().flat_map(|e| [e.clone(), Event::Nothing]).collect()
    };
    let events =
        damaged(&[Event::Damaged(grey(9)), Event::Noise, Event::Damaged(grey(9)), at(70, 0)]);
    let mut rig = Rig::new(Encoding::Mjpeg, &plain(), events.into());
    assert!(rig.level(0).1.abs_diff(70) < 3);

    rig.played().events = damaged(&[const { Event::Noise }; MOST_DAMAGED]);
    let why = rig.why();
    assert!(why.starts_with("camera desk: /dev/null: all pictures are damaged: "), "{why}");
}

#[test]
fn unplugged_camera_is_reported_and_comes_back() {
    let mut rig = Rig::new(Encoding::Yuyv, &plain(), vec![Event::Error(19)]);
    let why = rig.why();
    assert!(why.starts_with("camera desk: /dev/null: the camera is gone: plug it in"), "{why}");

    rig.played().refuses = 19;
    assert_eq!(rig.why(), why, "it is still gone");
    rig.played().refuses = 0;
    rig.played().events = dropped(SETTLING, 0).chain([at(33, 0)]).collect();
    assert_eq!(rig.level(0).1, 33);
    assert_eq!(rig.played().opened.len(), 3);
}

/// The kernel gives the camera another number when it comes back.
#[test]
fn replugged_camera_is_found_under_another_number() {
    let folder = Folder::new("webcam-renumbered");
    add(&folder, "video0", "usb1", "A1");
    let fake = Fake::playing(Encoding::Yuyv, SIZE, Vec::new());
    let settings = WebcamDevice::named("A1");
    let mut camera =
        Webcam::open("desk", &settings, WISH, (nodes(&folder), fake.opener())).unwrap();
    std::fs::remove_dir_all(folder.0.join("class/video0")).unwrap();
    assert!(camera.grab(0, 1.0).is_err());

    let why = camera.grab(0, 1.0).unwrap_err().reason;
    assert!(why.starts_with("no camera has the serial number A1"), "{why}");
    add(&folder, "video4", "usb1", "A1");
    let _ = camera.grab(0, 1.0);

    let opened = fake.played.lock().unwrap().opened.clone();
    assert_eq!(opened, [PathBuf::from("/dev/video0"), "/dev/video4".into()]);
}

#[test]
fn silent_camera_is_opened_again() {
    let mut rig = Rig::new(Encoding::Yuyv, &plain(), vec![Event::Nothing, Event::Nothing]);
    assert!(rig.why().contains("no picture in time"));
    assert_eq!(rig.played().opened.len(), 1);

    let _ = rig.camera.grab(0, 1.0);

    assert_eq!(rig.played().opened.len(), 2);
}

#[test]
fn fixed_controls_are_set_and_exposure_scaled() {
    use Control::{AutomaticWhite, Exposure, ExposureMode, White};
    let settings = WebcamDevice { exposure_ms: Some(8.0), white_balance_k: Some(4600), ..plain() };
    let mut rig = Rig::new(Encoding::Yuyv, &settings, vec![at(5, 0), Event::Nothing]);
    let set = [(ExposureMode, 1), (Exposure, 80), (AutomaticWhite, 0), (White, 4600)];
    assert_eq!(rig.played().controls, set);
    rig.level(0);
    assert_eq!(rig.played().controls.len(), 4, "the exposure is the same");

    // The pictures of the old exposure are dropped.
    rig.played().events = dropped(FIXED, 5).chain([at(40, 0)]).collect();
    let frame = rig.camera.grab(0, 2.0).unwrap();

    assert_eq!(rig.played().controls[4..], [(Exposure, 160)]);
    assert_eq!(frame.image[(0, 0)].0, [40; 3]);
}

#[test]
fn automatic_controls_are_left_to_the_camera() {
    let mut rig = Rig::new(Encoding::Yuyv, &plain(), vec![at(5, 0)]);
    let _ = rig.camera.grab(0, 2.0);

    let automatic = [(Control::ExposureMode, 3), (Control::AutomaticWhite, 1)];
    assert_eq!(rig.played().controls, automatic);
}

#[test]
fn control_that_camera_lacks_is_refused() {
    let settings =
        |exposure_ms, white_balance_k| WebcamDevice { exposure_ms, white_balance_k, ..plain() };
    let why = |most, settings: &WebcamDevice| {
        let fake = Fake { most, ..Fake::playing(Encoding::Yuyv, SIZE, Vec::new()) };
        let opened = Webcam::open("desk", settings, WISH, (Nodes::default(), fake.opener()));
        opened.err().map(|why| why.reason).unwrap_or_default()
    };

    assert!(why(0, &settings(Some(8.0), None)).contains("exposure_ms: the camera cannot fix it"));
    assert!(why(0, &settings(None, Some(4600))).contains("white_balance_k: the camera cannot"));
    let clamped = why(50, &settings(Some(8.0), None));
    assert!(clamped.ends_with("exposure_ms: the camera takes 5.0 ms instead of 8.0 ms"));
    assert_eq!(why(0, &plain()), "", "an automatic camera without controls is good");
}

#[test]
fn device_without_pictures_names_the_right_node() {
    let folder = Folder::new("webcam-metadata");
    add(&folder, "video0", "usb1", "A1");
    add(&folder, "video1", "usb1", "A1");
    let fake = Fake { no_pictures: true, ..Fake::with(vec![offer(*b"YUYV", &[SIZE])]) };

    let why = refused(&fake, nodes(&folder), "/dev/null");
    assert_eq!(why, "camera desk: /dev/null delivers metadata, no pictures");
    // A link to the second node, as no such device exists here.
    let stream = nodes(&folder).with_pictures(Path::new("/dev/video1"));
    assert_eq!(stream, Some("/dev/video0".into()));
}

#[test]
fn refused_openings_say_what_helps() {
    let fake = Fake::playing(Encoding::Yuyv, SIZE, Vec::new());
    for (error, wanted) in [
        (13, "this user may not open it: `sudo usermod -aG video"),
        (19, "the camera is gone"),
        (25, "not a video device"),
        (5, "Input/output error"),
    ] {
        fake.played.lock().unwrap().refuses = error;
        let why = refused(&fake, Nodes::default(), "/dev/null");
        assert!(why.starts_with("camera desk: /dev/null: ") && why.contains(wanted), "{why}");
    }
    fake.played.lock().unwrap().refuses = 0;
    let busy = Fake { busy: true, ..fake.clone() };
    let why = refused(&busy, Nodes::default(), "/dev/null");
    assert!(why.ends_with(" uses the camera"), "{why}");
    let full = Fake { room: 100, ..fake };
    let why = refused(&full, Nodes::default(), "/dev/null");
    assert!(why.contains("/dev/null: the USB bus has no room for 64x48 YUYV: "), "{why}");
}

#[cfg(not(feature = "v4l2"))]
#[test]
fn program_without_feature_names_its_build() {
    let why = open("desk", &plain(), WISH).err().unwrap().to_string();

    assert!(why.starts_with("camera desk: /dev/null: this program cannot open V4L2"), "{why}");
    assert!(why.contains("--features v4l2") && why.contains("libclang"), "{why}");
}
