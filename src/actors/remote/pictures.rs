//! Pictures of the cameras of a node for the operator at MP's node.
//!
//! They are for people: a picture that is late, too large or damaged is left out, and the run goes
//! on. Their files are made and read on a thread of their own, so that no actor waits for them.
//!
//! - in: the latest pictures of the node's VSPs, with the results of vision in them
//! - out: at most one picture of each camera every [`APART`], as a JPEG file; at MP's node its
//!   pixels for the page and the recording
//!
//! | fault of a picture that arrives | reaction |
//! |---|---|
//! | more than [`LARGEST`] bytes, or another size than the camera's | refused, and told once |
//! | damaged, or of a camera of another node | the same |
//! | less than [`SOONEST`] after the one before | left out |
//! | the thread is behind by [`WAITING`] | left out |

use super::line::Sender;
use super::message::{JpegFile, Shown, ToHome};
use super::offset::Offset;
use crate::actors::latest::{Found, LatestValues, Sight};
use crate::actors::notice::Notice;
use crate::actors::trace::Trace;
use crate::hw::driver::step_back;
use crate::hw::image_file::decode_frame;
use crate::motion::PERIOD;
use crate::operator::Class;
use crate::record::merge::name_of;
use crate::record::recorder::Entry;
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior};

/// Time between two pictures of a camera.
pub(super) const APART: Duration = Duration::from_millis(200);
/// Shortest time between two pictures of a camera that arrive: jitter of the network is allowed.
const SOONEST: Duration = Duration::from_millis(100);
/// Largest file of a picture (bytes).
const LARGEST: usize = 256 << 10;
/// Number of pictures that wait for their thread.
const WAITING: usize = 4;
/// Quality of the files, 0 to 100.
const QUALITY: u8 = 80;

/// Sends the pictures of a node while `wanted` is set, until the actors' runtime ends.
///
/// # Errors
/// If the system gives no thread.
pub(crate) fn send(
    latest: LatestValues,
    sender: Sender<ToHome>,
    offset: Offset,
    wanted: Arc<AtomicBool>,
) -> std::io::Result<()> {
    let (to, taken) = sync_channel(WAITING);
    std::thread::Builder::new().name("pictures".to_owned()).spawn(move || {
        step_back();
        encode(&taken, &sender);
    })?;
    tokio::spawn(async move {
        let mut next = tokio::time::interval(APART);
        next.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            next.tick().await;
            let mut latest = latest.lock();
            for (camera, sight) in latest.sights.iter_mut().enumerate() {
                let Some(Sight { period, image, found }) = sight else { continue };
                // Taken also if no one wants it: a picture of long ago is not sent later.
                let Some(image) = image.take() else { continue };
                if wanted.load(Ordering::Relaxed) {
                    let _ = to.try_send((camera, offset.at_home(*period), found.clone(), image));
                }
            }
        }
    });
    Ok(())
}

/// Picture of a node's camera before its file is made: camera, period of MP's node, result.
type Taken = (usize, u64, Found, RgbImage);

/// Makes the files of pictures and sends them, until no more come.
fn encode(taken: &Receiver<Taken>, sender: &Sender<ToHome>) {
    while let Ok((camera, period, found, image)) = taken.recv() {
        let mut jpeg = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut jpeg, QUALITY);
        if image.write_with_encoder(encoder).is_ok() && jpeg.len() <= LARGEST {
            sender.send(&ToHome::Picture(Shown { camera, period, found, file: JpegFile(jpeg) }));
        } else {
            tracing::debug!("a picture of camera {camera} is left out: {} bytes", jpeg.len());
        }
    }
}

/// Album of the pictures of a node at MP's node.
#[derive(Debug)]
pub(super) struct Album {
    /// Sizes of the node's cameras (px), by index.
    cameras: BTreeMap<usize, (u32, u32)>,
    /// Time of the last picture of each camera.
    last: BTreeMap<usize, Instant>,
    to: SyncSender<Shown>,
    fault: Fault,
}

/// Teller of the first refused picture of a node.
#[derive(Debug, Clone)]
struct Fault {
    node: String,
    trace: Trace,
    told: Arc<AtomicBool>,
}

impl Fault {
    /// Tells the operator once that a picture was refused, for the reason `why`.
    fn tell(&self, period: u64, why: &str) {
        if !self.told.swap(true, Ordering::Relaxed) {
            let (class, who) = (Class::Warning, name_of(&self.node, "mp"));
            let text = format!("a picture was refused: {why}");
            self.trace.tell(Notice::Elsewhere(period as f64 * PERIOD, class, who, text));
        }
    }
}

impl Album {
    /// Makes the album of a node with cameras of these sizes (px). Pictures go to the latest values
    /// and the recording of `trace`.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub(super) fn new(
        node: &str,
        cameras: BTreeMap<usize, (u32, u32)>,
        trace: &Trace,
    ) -> std::io::Result<Self> {
        let (to, arrived) = sync_channel(WAITING);
        let fault = Fault { node: node.to_owned(), trace: trace.clone(), told: Arc::default() };
        let (sizes, keeper) = (cameras.clone(), fault.clone());
        std::thread::Builder::new().name(format!("pictures {node}")).spawn(move || {
            step_back();
            decode(&arrived, &sizes, &keeper);
        })?;
        Ok(Self { cameras, last: BTreeMap::new(), to, fault })
    }

    /// Takes a picture that arrives in the period `now` of MP's node.
    pub(super) fn take(&mut self, shown: Shown, now: u64) {
        let (camera, bytes) = (shown.camera, shown.file.0.len());
        if !self.cameras.contains_key(&camera) {
            return self.fault.tell(now, &format!("camera {camera} is not on this node"));
        }
        if bytes > LARGEST {
            return self.fault.tell(now, &format!("{bytes} bytes are more than {LARGEST}"));
        }
        let at = Instant::now();
        if self.last.get(&camera).is_none_or(|last| at.duration_since(*last) >= SOONEST) {
            self.last.insert(camera, at);
            let _ = self.to.try_send(shown);
        }
    }
}

/// Reads the files of pictures that have arrived, and shows and records them, until no more come.
fn decode(arrived: &Receiver<Shown>, sizes: &BTreeMap<usize, (u32, u32)>, fault: &Fault) {
    while let Ok(Shown { camera, period, found, file }) = arrived.recv() {
        let image = match decode_frame(&file.0) {
            Ok(image) if sizes.get(&camera) == Some(&image.dimensions()) => image,
            Ok(image) => {
                let (width, height) = image.dimensions();
                fault.tell(period, &format!("{width} x {height} px is not the camera's size"));
                continue;
            }
            Err(why) => {
                fault.tell(period, &why.to_string());
                continue;
            }
        };
        let trace = &fault.trace;
        trace.recorder().record(period, || Entry::Picture(camera, image.clone()));
        if let Some(latest) = trace.latest() {
            latest.saw(camera, Sight { period, image: Some(image), found });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::pair;
    use crate::record::recorder::Recorder;
    use crate::record::run_hash::RunHash;
    use tokio::sync::mpsc;

    const SIZE: (u32, u32) = (40, 30);

    fn sight(period: u64) -> Sight {
        let image = Some(RgbImage::from_pixel(SIZE.0, SIZE.1, image::Rgb([200, 30, 30])));
        Sight { period, image, found: Found::Nothing("no cube".into()) }
    }

    fn jpeg(size: (u32, u32)) -> Vec<u8> {
        let mut jpeg = Vec::new();
        let image = RgbImage::new(size.0, size.1);
        image.write_with_encoder(JpegEncoder::new(&mut jpeg)).unwrap();
        jpeg
    }

    /// Sends the pictures that `show` makes available, for a second or longer. Returns those that
    /// arrive, and this time.
    async fn sent(wanted: bool, show: impl Fn(&LatestValues, u64)) -> (Vec<Shown>, Duration) {
        let begun = Instant::now();
        let [(near, _), (_, parcels)] = pair();
        let (latest, offset) = (LatestValues::default(), Offset::default());
        let sender = Sender::new(near, 5);
        send(latest.clone(), sender, offset, Arc::new(AtomicBool::new(wanted))).unwrap();
        for i in 0..50 {
            show(&latest, i);
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let lasted = begun.elapsed();
        let mut receiver = super::super::Receiver::<ToHome>::new(parcels).of_run(5);
        let mut shown = Vec::new();
        let limit = Duration::from_millis(500);
        while let Ok(Some(Ok(message))) = tokio::time::timeout(limit, receiver.recv()).await {
            let ToHome::Picture(picture) = message else { panic!("{message:?}") };
            shown.push(picture);
        }
        (shown, lasted)
    }

    /// A camera that delivers 50 pictures in a second has 5 of them sent. Waiting for the last one,
    /// and a busy machine, give time for some more.
    #[tokio::test]
    async fn five_pictures_a_second_are_sent() {
        let (shown, lasted) = sent(true, |latest, i| latest.saw(1, sight(i))).await;

        let most = lasted.div_duration_f64(APART) + 2.0;
        assert!(shown.len() >= 3 && shown.len() as f64 <= most, "{} in {lasted:?}", shown.len());
        assert!(shown.iter().all(|shown| shown.camera == 1));
    }

    #[tokio::test]
    async fn unwanted_pictures_are_not_sent() {
        assert_eq!(sent(false, |latest, i| latest.saw(0, sight(i))).await.0, vec![]);
    }

    /// Passes a picture of camera 0 to an album. Returns the latest values and the notices.
    async fn kept(shown: &[Shown]) -> (LatestValues, mpsc::Receiver<Notice>) {
        let latest = LatestValues::default();
        let (recorder, shows) = (Recorder::default(), Some(latest.clone()));
        let (trace, notices) = Trace::new(RunHash::default(), recorder, shows);
        let mut album = Album::new("b", [(0, SIZE)].into(), &trace).unwrap();
        for shown in shown {
            album.take(shown.clone(), 7);
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
        (latest, notices)
    }

    #[tokio::test]
    async fn picture_arrives_with_its_result() {
        let file = JpegFile(jpeg(SIZE));
        let found = Found::Nothing("dark".into());
        let shown = Shown { camera: 0, period: 90, found: found.clone(), file };
        let sooner = Shown { period: 91, ..shown.clone() };

        let (latest, mut notices) = kept(&[shown, sooner]).await;

        let latest = latest.lock();
        let sight = latest.sights[0].as_ref().unwrap();
        assert_eq!((sight.period, &sight.found), (90, &found), "the second one came too soon");
        assert_eq!(sight.image.as_ref().unwrap().dimensions(), SIZE);
        assert!(notices.try_recv().is_err());
    }

    /// Each wrong picture is left out, and the first one is told.
    #[tokio::test]
    async fn wrong_pictures_are_refused() {
        let cases = [
            (0, jpeg((4000, 30)), "4000 x 30 px is not the camera's size"),
            (0, jpeg(SIZE)[..100].to_vec(), "damaged picture"),
            (0, vec![0; LARGEST + 1], "262145 bytes are more than 262144"),
            (3, jpeg(SIZE), "camera 3 is not on this node"),
        ];
        for (camera, file, why) in cases {
            let found = Found::Nothing(String::new());
            let shown = Shown { camera, period: 90, found, file: JpegFile(file) };

            let (latest, mut notices) = kept(&[shown.clone(), shown]).await;

            assert!(latest.lock().sights.is_empty(), "{why}");
            let told = notices.try_recv().unwrap();
            let Notice::Elsewhere(_, Class::Warning, who, text) = &told else { panic!("{told:?}") };
            assert_eq!(who, "on node b");
            assert!(text.contains(why), "{text}");
            assert!(notices.try_recv().is_err(), "{why}: told twice");
        }
    }
}
