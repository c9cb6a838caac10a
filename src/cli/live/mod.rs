//! `rubik-robot vision scan --camera`: reads a cube that is held before a camera, face by face.
//!
//! - in: a webcam, a topic of ROS 2; or a folder of pictures or a local socket, as the cameras of
//!   runs have
//! - out: what the camera sees, on the terminal and on a page; at the end the line of `vision scan`

mod page;
mod reader;
mod view;

use super::cubes::{Refused, report};
use super::faces::letters;
use super::output::{Output, inform, refuse};
use super::ui::{UiArgs, UiKind};
use crate::hw::camera::{FrameSource, NoFrame};
use crate::hw::console;
use crate::hw::folder::FolderCamera;
use crate::hw::socket_camera::SocketCamera;
use crate::hw::webcam::device::{Encoding, Size};
use crate::hw::webcam::negotiation::Wish;
use crate::hw::webcam::{self, WebcamDevice};
use crate::motion::PERIOD;
use crate::net::{RosPlace, domain_of_environment};
use crate::ros::RosCamera;
use crate::run::ending_signals;
use crate::vision::FaceSighting;
use crate::vision::colours::face_letter;
use anyhow::anyhow;
use clap::{Args, ValueEnum};
use image::RgbImage;
use page::Page;
use reader::{Decided, Reader, Seen, is_cube};

use std::os::unix::fs::FileTypeExt as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use view::View;

/// Longest time without a picture: a cable that was pulled out is put back within it.
const PATIENCE: Duration = Duration::from_secs(30);
/// Pause before a camera without a picture is asked again.
const AGAIN: Duration = Duration::from_millis(200);
/// Exit code of an interrupted command.
const INTERRUPTED: u8 = 130;

/// Options of a camera.
#[derive(Debug, Args)]
pub(super) struct CameraArgs {
    /// Camera before which the cube is held, face by face, instead of six pictures: a
    /// V4L2 device (/dev/video0, a link in /dev/v4l/by-id, or a serial number), a
    /// folder of pictures, the socket of another program, or ros:TOPIC for a topic
    /// of ROS 2
    #[arg(long, value_name = "DEVICE", verbatim_doc_comment)]
    pub(super) camera: Option<String>,
    /// Size of the camera's pictures (px); without such a size the nearest one
    #[arg(long, value_name = "WxH", default_value = "640x480", value_parser = size)]
    size: Size,
    /// Encoding of the camera's pictures [default: the better one that works]
    #[arg(long, value_enum, requires = "camera")]
    format: Option<EncodingWord>,
    /// Exposure time (ms) [default: chosen by the camera]
    #[arg(long, requires = "camera", value_parser = exposure)]
    exposure_ms: Option<f64>,
    /// Temperature of white light (K) [default: chosen by the camera]
    #[arg(long, requires = "camera", value_parser = white)]
    white_balance_k: Option<u32>,
    /// Router of `rmw_zenoh` for ros:TOPIC; the domain is that of `ROS_DOMAIN_ID`, or 0
    #[arg(
        long,
        value_name = "ENDPOINT",
        requires = "camera",
        default_value = "tcp/127.0.0.1:7447",
        verbatim_doc_comment
    )]
    router: String,
    #[command(flatten)]
    ui: UiArgs,
}

/// Encoding, as a word of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum EncodingWord {
    /// Uncompressed pictures
    Yuyv,
    /// Compressed pictures, which need less of the bus
    Mjpeg,
}

/// Parses a size such as `640x480`.
fn size(text: &str) -> Result<Size, String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides
        .filter(|&(w, h)| (16..=16_384).contains(&w) && (16..=16_384).contains(&h))
        .ok_or_else(|| "must be WIDTHxHEIGHT from 16 to 16384 px, as in 640x480".to_owned())
}

/// Parses an exposure time (ms).
fn exposure(text: &str) -> Result<f64, String> {
    let time = text.parse().map_err(|_| "must be a number".to_owned())?;
    WebcamDevice::refuses_exposure(time).map_or(Ok(time), Err)
}

/// Parses a white balance (K).
fn white(text: &str) -> Result<u32, String> {
    let kelvin = text.parse().map_err(|_| "must be a whole number".to_owned())?;
    WebcamDevice::refuses_white(kelvin).map_or(Ok(kelvin), Err)
}

impl CameraArgs {
    /// Checks that the options of the page are given only with a camera.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        let ui = &self.ui;
        if self.camera.is_none() && (ui.ui.is_some() || ui.listen.is_some() || !ui.host.is_empty())
        {
            return Err(refuse("--ui, --listen and --host: only with --camera"));
        }
        if ui.ui == Some(UiKind::Tui) {
            return Err(refuse("--ui tui: a camera has no text UI: use web or none"));
        }
        ui.check().map_err(refuse)
    }

    /// Opens the camera; returns it with the longest time without a picture.
    fn open(&self, name: &str) -> Result<(Box<dyn FrameSource>, Duration), NoFrame> {
        if let Some(topic) = name.strip_prefix("ros:") {
            let refuse = |reason| NoFrame { camera: name.to_owned(), reason };
            let domain = domain_of_environment().map_err(refuse)?.unwrap_or(0);
            let place = RosPlace { router: self.router.clone(), domain };
            let camera = RosCamera::open("of the scan", &place, topic, None)?;
            return Ok((Box::new(camera), PATIENCE));
        }
        let path = Path::new(name);
        if path.is_dir() {
            // A folder without a further picture has none later.
            return Ok((Box::new(FolderCamera::open(name, path)?), Duration::ZERO));
        }
        if path.metadata().is_ok_and(|found| found.file_type().is_socket()) {
            return Ok((Box::new(SocketCamera::connect(name, path)?), PATIENCE));
        }
        let settings = WebcamDevice {
            format: self.format.map(|word| match word {
                EncodingWord::Yuyv => Encoding::Yuyv,
                EncodingWord::Mjpeg => Encoding::Mjpeg,
            }),
            exposure_ms: self.exposure_ms,
            white_balance_k: self.white_balance_k,
            ..WebcamDevice::named(name)
        };
        let wish = Wish { size: self.size, exact: false, shared: false, only: None };
        Ok((webcam::open("of the scan", &settings, wish)?, PATIENCE))
    }
}

/// End of a reading.
#[derive(Debug)]
enum End {
    /// The cube was read.
    Cube(Box<Decided>),
    /// No picture came, with the reason, and the last reading that was no cube.
    Lost(NoFrame, Option<Box<Decided>>),
    /// The operator or a signal has ended it.
    Interrupted,
}

/// Reads a cube that is held before the camera `name`, and prints its line; returns the exit code.
pub(super) fn live(
    name: &str,
    args: &CameraArgs,
    json: bool,
    output: &mut Output,
) -> anyhow::Result<u8> {
    let (mut source, patience) = args.open(name).map_err(|why| refuse(why.to_string()))?;
    let ended = Arc::new(AtomicBool::new(false));
    for signal in ending_signals() {
        signal_hook::flag::register(signal, Arc::clone(&ended))?;
    }
    let mut page = Page::open(name, &args.ui, json)?;
    let mut status = Status::new();
    status.say(Reader::default().wanted().as_str());
    let end = {
        let mut inputs = page.take_inputs();
        let ends = || ended.load(Ordering::Acquire) || page::is_left(inputs.as_mut());
        read_cube(source.as_mut(), patience, ends, &mut |view| {
            status.show(view);
            page.show(view);
        })
    };
    status.clear();
    let decided = match end {
        End::Interrupted => {
            inform("interrupted");
            return Ok(INTERRUPTED);
        }
        End::Cube(decided) | End::Lost(_, Some(decided)) => decided.map_err(Refused::from),
        End::Lost(why, None) => Err(Refused::Input(anyhow!(why))),
    };
    let (line, code) = report(name, &decided, json);
    output.text(&line)?;
    // The page may stay for long: the line must not wait for its end.
    output.flush()?;
    page.end(line.trim_end(), code == 0);
    if !json {
        page.linger()?;
    }
    Ok(code)
}

/// Reads a cube from the pictures of `source` until it is read, no picture comes for `patience`, or
/// `ends` returns true. Each picture goes to `shown`.
fn read_cube(
    source: &mut dyn FrameSource,
    patience: Duration,
    mut ends: impl FnMut() -> bool,
    shown: &mut dyn FnMut(&View<'_>),
) -> End {
    let begun = Instant::now();
    let (mut reader, mut last) = (Reader::default(), None);
    // Time of the last picture, and the last of them for messages without a new one.
    let (mut seen_at, mut image) = (begun, RgbImage::new(4, 3));
    while !ends() {
        let time = begun.elapsed().as_secs_f64();
        let (seen, face) = match source.grab((time / PERIOD) as u64, 1.0) {
            Ok(frame) => {
                (seen_at, image) = (Instant::now(), frame.image);
                reader.see(&image)
            }
            Err(why) if seen_at.elapsed() >= patience => return End::Lost(why, last),
            Err(why) => (Seen::Nothing(why.to_string()), None),
        };
        let lost = seen_at.elapsed() >= AGAIN;
        let wanted = reader.wanted();
        let (words, line) = said(&seen, face.as_ref(), &wanted);
        let (face, taken) = (face.as_ref(), reader.taken());
        let line = line.as_deref();
        let (words, wanted) = (words.as_str(), wanted.as_str());
        shown(&View { time, image: &image, face, taken, words, wanted, line });
        match seen {
            Seen::Cube(decided) if is_cube(&decided) => return End::Cube(decided),
            Seen::Cube(decided) => last = Some(decided),
            // A camera that is gone answers at once.
            Seen::Nothing(_) if lost => std::thread::sleep(AGAIN),
            _ => {}
        }
    }
    End::Interrupted
}

/// Returns the content of a picture in words, and the line that stays, if there is one.
fn said(seen: &Seen, face: Option<&FaceSighting>, wanted: &str) -> (String, Option<String>) {
    let rows = face.map(letters).unwrap_or_default();
    let rows = [rows.get(..3), rows.get(3..6), rows.get(6..)].map(Option::unwrap_or_default);
    let rows = rows.join(" / ");
    match seen {
        Seen::Nothing(why) => (why.clone(), None),
        Seen::Moving => (format!("{rows}: hold it still"), None),
        Seen::Known(number) => (format!("{rows}: face {} is taken", face_letter(*number)), None),
        Seen::Taken(number) => {
            let line = format!("face {}: {rows}; {wanted}", face_letter(*number));
            (format!("{rows}: taken"), Some(line))
        }
        Seen::Cube(decided) if is_cube(decided) => (format!("{rows}: the cube is read"), None),
        Seen::Cube(decided) => {
            let decided = (**decided).clone().map_err(Refused::from);
            let why = report("no cube", &decided, false).0.trim_end().to_owned();
            let line = format!("{why}; once more: {wanted}");
            (format!("{rows}: no cube"), Some(line))
        }
    }
}

/// Status on stderr: on a terminal one line that changes, and lines that stay.
struct Status {
    drawn: Instant,
}

impl Status {
    /// Makes a status that shows nothing yet.
    fn new() -> Self {
        Self { drawn: Instant::now() }
    }

    /// Prints a line that stays.
    fn say(&self, line: &str) {
        self.clear();
        inform(line);
    }

    /// Removes the line that changes.
    #[allow(clippy::unused_self, reason = "only a status has such a line")]
    fn clear(&self) {
        console::show("");
    }

    /// Shows what a picture has. A file gets only the lines that stay.
    fn show(&mut self, view: &View<'_>) {
        if let Some(line) = view.line {
            self.say(line);
        }
        // Ten changes a second can be read.
        if self.drawn.elapsed() > Duration::from_millis(100) {
            console::show(view.words);
            self.drawn = Instant::now();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::reader::STEADY;
    use super::reader::tests::Show;
    use super::*;
    use crate::hw::camera::Frame;
    use crate::hw::webcam::nodes::Nodes;
    use crate::hw::webcam::testing::{Event, Fake};
    use crate::hw::webcam::{SETTLING, Webcam};
    use clap::Parser;

    /// Command line with the options of a camera.
    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: CameraArgs,
    }

    /// Parses and checks options; returns the first line of the error.
    fn parsed(words: &[&str]) -> Result<CameraArgs, String> {
        let line = Line::try_parse_from([&["scan"], words].concat()).map_err(|e| e.to_string())?;
        line.args.check().map_err(|e| e.to_string())?;
        Ok(line.args)
    }

    /// Returns the pictures of all faces, each held still.
    fn pictures(cube: &mut Show) -> Vec<RgbImage> {
        let held = |face| std::iter::repeat_n(face, STEADY);
        (0..6).flat_map(held).map(|face| cube.face(face, 0.0, 0.2, 0.1)).collect()
    }

    /// Camera that plays frames and errors.
    struct Playing(std::vec::IntoIter<Result<RgbImage, &'static str>>);

    impl FrameSource for Playing {
        fn grab(&mut self, period: u64, _: f64) -> Result<Frame, NoFrame> {
            let image = self.0.next().unwrap_or(Err("no more"));
            let refuse = |why: &str| NoFrame { camera: "played".into(), reason: why.into() };
            image.map(|image| Frame { period, image }).map_err(refuse)
        }
    }

    /// Reads a cube; returns the end, the lines that stay, and the words of all views.
    fn read(source: &mut dyn FrameSource, patience: Duration) -> (End, Vec<String>, Vec<String>) {
        let (mut lines, mut words) = (Vec::new(), Vec::new());
        let end = read_cube(source, patience, || false, &mut |view| {
            lines.extend(view.line.map(str::to_owned));
            words.push(view.words.to_owned());
        });
        (end, lines, words)
    }

    /// Returns the facelets of a cube that was read.
    fn facelets(end: End) -> [u8; 54] {
        match end {
            End::Cube(decided) => decided.unwrap().facelets,
            other => panic!("{other:?}"),
        }
    }

    /// The whole way: buffers of a device, pictures, faces, the cube.
    #[test]
    fn cube_before_a_webcam_is_read() {
        for encoding in Encoding::ALL {
            let mut cube = Show::new(4);
            let shown = pictures(&mut cube).into_iter();
            let events = shown.flat_map(|image| [Event::Picture(image, 0), Event::Nothing]);
            let events = vec![Event::Nothing; SETTLING].into_iter().chain(events).collect();
            let fake = Fake::playing(encoding, (640, 480), events);
            let wish = Wish { size: (640, 480), exact: false, shared: false, only: None };
            let system = (Nodes::default(), fake.opener());
            let settings = WebcamDevice::named("/dev/null");
            let mut camera = Webcam::open("webcam", &settings, wish, system).unwrap();

            let (end, lines, words) = read(&mut camera, Duration::ZERO);

            assert_eq!(facelets(end), cube.facelets);
            assert_eq!(lines.len(), 5, "{lines:?}");
            assert!(lines[0].starts_with("face U: "), "{lines:?}");
            assert!(lines[0].ends_with("; show face R, with U above it (2 of 6)"), "{lines:?}");
            assert!(words[0].ends_with(": hold it still"), "{words:?}");
            assert!(words.last().unwrap().ends_with(": the cube is read"), "{words:?}");
        }
    }

    #[test]
    fn lost_camera_is_shown_and_may_return() {
        let mut cube = Show::new(5);
        let mut frames: Vec<_> = pictures(&mut cube).into_iter().map(Ok).collect();
        frames.splice(4..4, [Err("the camera is gone"), Err("the camera is gone")]);

        let mut source = Playing(frames.clone().into_iter());
        let (end, _, words) = read(&mut source, PATIENCE);

        // Two of the three pictures of a face follow each other after the loss: it is held longer.
        assert!(words.contains(&"camera played: the camera is gone".to_owned()), "{words:?}");
        assert!(matches!(end, End::Cube(_) | End::Lost(..)));
        let (end, ..) = read(&mut Playing(frames.into_iter()), Duration::ZERO);
        let End::Lost(why, None) = end else { panic!("{end:?}") };
        assert_eq!(why.reason, "the camera is gone");
    }

    /// A corner is twisted: the faces are read rightly, and no cube has them.
    #[test]
    fn impossible_cube_is_refused_and_shown_again() {
        let mut cube = Show::new(4);
        let truth = cube.facelets;
        let corner = [8, 9, 20];
        for i in 0..3 {
            cube.facelets[corner[i]] = truth[corner[(i + 1) % 3]];
        }
        let mut frames = pictures(&mut cube);
        let (end, lines, _) = read(
            &mut Playing(frames.clone().into_iter().map(Ok).collect::<Vec<_>>().into_iter()),
            Duration::ZERO,
        );
        let End::Lost(_, Some(last)) = end else { panic!("{end:?}") };
        assert!(!is_cube(&last));
        assert!(lines[5].contains("once more: show face U"), "{lines:?}");

        cube.facelets = truth;
        frames.extend(pictures(&mut cube));
        let frames: Vec<_> = frames.into_iter().map(Ok).collect();
        let (end, ..) = read(&mut Playing(frames.into_iter()), Duration::ZERO);
        assert_eq!(facelets(end), truth);
    }

    #[test]
    fn reading_ends_when_operator_leaves() {
        let mut source = Playing(Vec::new().into_iter());
        let mut views = 0;

        let end = read_cube(&mut source, PATIENCE, || true, &mut |_| views += 1);

        assert!(matches!(end, End::Interrupted) && views == 0, "{end:?}");
    }

    #[test]
    fn wrong_camera_options_are_refused() {
        for (words, wanted) in [
            (&["--ui", "web"][..], "only with --camera"),
            (&["--camera", "0", "--ui", "tui"], "has no text UI"),
            (&["--camera", "0", "--size", "640"], "must be WIDTHxHEIGHT"),
            (&["--camera", "0", "--size", "9x9"], "16 to 16384"),
            (&["--camera", "0", "--exposure-ms", "0"], "outside 0.1 to 10000 ms"),
            (&["--camera", "0", "--white-balance-k", "5"], "outside 1000 to 20000 K"),
            (&["--format", "yuyv"], "--camera"),
        ] {
            let why = parsed(words).unwrap_err();
            assert!(why.contains(wanted), "{why}");
        }
        let args = parsed(&["--camera", "0", "--size", "1280x720", "--format", "mjpeg"]).unwrap();
        assert_eq!((args.size, args.format), ((1280, 720), Some(EncodingWord::Mjpeg)));
    }

    #[test]
    fn camera_is_folder_socket_or_device() {
        let folder = crate::tables::testing::Folder::new("live-camera");
        let args = parsed(&[]).unwrap();
        let open = |name: &str| {
            args.open(name).map(|(_, patience)| patience).map_err(|why| why.to_string())
        };
        let name = folder.0.to_str().unwrap();

        assert!(open(name).unwrap_err().ends_with("holds no PNG or JPEG file"));
        RgbImage::new(4, 4).save(folder.0.join("a.png")).unwrap();
        assert_eq!(open(name), Ok(Duration::ZERO));
        let why = open("/dev/nosuch").unwrap_err();
        let wanted = if cfg!(feature = "v4l2") { "no such file" } else { "--features v4l2" };
        assert!(why.starts_with("camera of the scan: /dev/nosuch: ") && why.contains(wanted));
    }
}
