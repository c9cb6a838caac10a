//! `rubik-robot film`: makes an animated GIF of a recorded mission, for a README or a web page.
//!
//! - in: a recording; arms and cube are drawn as the controller believed them to be
//! - out: an animated GIF of four scenes: the cube is taken, read, turned (seen close) and handed
//!   back
//!
//! Each scene has one [`View`], so most pixels of a picture are equal to those before. They are
//! written as transparent, and all pictures share one palette: that keeps the file small.

use super::output::{Output, clash, refuse, save};
use super::{picture, replay};
use crate::cube::Keeper;
use crate::hw::plant::render::Setting;
use crate::hw::plant::render::picture::{View, seen};
use crate::hw::scene::Scene;
use crate::operator::Snapshot;
use crate::run::show::Show;
use crate::scenario::ControllerConfig;
use crate::spatial::Pose;
use crate::tables;
use clap::Args;
use color_quant::NeuQuant;
use gif::{DisposalMethod, Encoder, Frame, Repeat};
use image::RgbImage;
use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::Arc;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot run scenarios/solve.toml --record run.mcap
  rubik-robot film run.mcap -o mission.gif
  rubik-robot film run.mcap -o large.gif --width 800

The film shows four scenes: the cube is taken, read, turned and handed back. All cores draw it; a
wider film takes longer. The line on stdout has the number of pictures, their size (px) and that of
the file (MB).
Exit codes: 0 written, 2 wrong usage, the recording cannot be used or lacks a part of a mission, or
the file cannot be written.")]
pub(super) struct FilmArgs {
    /// Recording of `run --record` (MCAP) with a whole mission
    recording: PathBuf,
    /// Write the film to FILE, whose name ends in .gif
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Width of the film (px, 64 to 1280); its height is 5/8 of it
    #[arg(long, default_value_t = 480, value_parser = clap::value_parser!(u32).range(64..=1280))]
    width: u32,
}

/// Number of pictures of a shot.
const PICTURES: usize = 30;
/// Time between two pictures (1/100 s).
const DELAY: u16 = 10;
/// Time for which the last picture of a shot stays (1/100 s).
const LAST_DELAY: u16 = 80;
/// Simulated time before the cube is held, and before the end of the run, that is shown (s).
const LEAD: f64 = 9.0;
/// Simulated time between two snapshots, where a turn is searched for (s).
const STEP: f64 = 0.1;
/// Simulated time that is shown before and after a turn (s).
const AROUND_TURN: f64 = 1.2;
/// Height of a close picture, in edges of the cube.
const CLOSE: f64 = 6.0;
/// Colours of the palette; its last one is transparent.
const COLOURS: usize = 128;

/// Writes the film of a recording; returns the exit code.
pub(super) fn run(args: &FilmArgs, output: &mut Output) -> anyhow::Result<u8> {
    clash(&[("the recording", Some(&args.recording))], &[("-o", Some(&args.output))])?;
    if !args.output.extension().is_some_and(|end| end.eq_ignore_ascii_case("gif")) {
        let path = args.output.display();
        return Err(refuse(format!("-o {path}: the film is a GIF: name a file that ends in .gif")));
    }
    // The label of the recording has the scenario with the cell that is drawn.
    let (_, scenario) = replay::load(&args.recording).map_err(refuse)?;
    let show = replay::read(&args.recording, &scenario).map_err(refuse)?;
    let size = (args.width, args.width * 5 / 8);
    let shots = shots(&show, &scenario.controller, size)
        .map_err(|why| refuse(format!("{}: {why}", args.recording.display())))?;
    let pictures: Vec<Vec<RgbImage>> =
        shots.iter().map(|shot| shot.drawn(&scenario.controller, size)).collect();
    let film = encoded(&pictures, size)?;
    save(&args.output, &film).map_err(|error| refuse(format!("{error:#}")))?;
    output.line(&format!(
        "{}: {} pictures of {} x {}, {:.1} MB",
        args.output.display(),
        pictures.iter().map(Vec::len).sum::<usize>(),
        size.0,
        size.1,
        film.len() as f64 * 1e-6
    ))?;
    Ok(0)
}

/// Part of the film that is drawn from one view.
struct Shot {
    scenes: Vec<Scene>,
    view: View,
}

impl Shot {
    /// Draws the pictures of the shot on all cores, since a picture takes one core half a second.
    /// `size` is width and height (px).
    fn drawn(&self, controller: &ControllerConfig, size: (u32, u32)) -> Vec<RgbImage> {
        let setting = Setting::of(&controller.cell);
        // Each core draws a part of consecutive scenes, which keeps their order.
        let cores = tables::cores();
        let each = self.scenes.len().div_ceil(cores).max(1);
        let draw = |scene: &Scene| seen(scene, &setting, &self.view, size);
        std::thread::scope(|scope| {
            let parts: Vec<_> = self
                .scenes
                .chunks(each)
                .map(|part| scope.spawn(move || part.iter().map(draw).collect::<Vec<_>>()))
                .collect();
            // A panic of a thread becomes one of the command.
            let images = parts
                .into_iter()
                .map(|part| part.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            images.flatten().collect()
        })
    }
}

/// Returns the four shots of a mission. `size` is the width and height of the film (px).
///
/// # Errors
/// A text that names the part of a mission that the recording lacks.
fn shots(
    show: &Show,
    controller: &ControllerConfig,
    size: (u32, u32),
) -> Result<Vec<Shot>, String> {
    let end = show.end();
    let last = show.snapshots(&[end]).pop().ok_or("the recording is empty")?;
    let phase = |name: &str| {
        let at = last.phases.iter().position(|(phase, _)| phase == name);
        let at = at.ok_or(format!("the recording has no phase \"{name}\""))?;
        let next = last.phases.get(at + 1).map_or(end, |(_, begin)| *begin);
        Ok::<_, String>((last.phases[at].1, next))
    };
    let (taking, reading, solving) = (phase("acquire")?, phase("identify")?, phase("solve")?);
    // At the start of the solution the controller has read all colours.
    let colours = show.snapshots(&[solving.0]).pop().map(|s| s.cube.facelets.clone());
    let colours = colours.unwrap_or_default();
    let turn = first_turn(show, solving).ok_or("the recording has no turn of a face")?;
    // The end of taking, the whole reading, one turn, and the end of the run.
    let spans = [
        ((taking.1 - LEAD).max(taking.0), taking.1),
        reading,
        (turn.0 - AROUND_TURN, turn.1 + AROUND_TURN),
        (end - LEAD, end),
    ];
    let aspect = f64::from(size.0) / f64::from(size.1);
    let mut shots = Vec::new();
    for (at, (begin, end)) in spans.into_iter().enumerate() {
        // The scenes take different times; each is shown with the same number of pictures.
        let step = (end - begin) / (PICTURES - 1) as f64;
        let times: Vec<f64> = (0..PICTURES).map(|k| begin + step * k as f64).collect();
        let mut cube = None;
        let snapshots = show.snapshots(&times);
        let scenes = snapshots.iter().filter_map(|s| scene(s, &colours, &mut cube, controller));
        let scenes: Vec<_> = scenes.collect();
        let middle = scenes.get(scenes.len() / 2);
        let middle =
            middle.ok_or(format!("the recording does not show the cube at {begin:.0} s"))?;
        let view =
            // The turn is small, so its view is close. The other scenes show both hands.
            if at == 2 { View::of_cube(middle, CLOSE) } else { View::of_hands(&scenes, aspect) };
        shots.push(Shot { scenes, view });
    }
    Ok(shots)
}

/// Returns when the first turn of a face within a span of time begins and ends (s); `None` if there
/// is none.
fn first_turn(show: &Show, (begin, end): (f64, f64)) -> Option<(f64, f64)> {
    let times: Vec<f64> =
        (0..((end - begin) / STEP) as u32).map(|k| begin + STEP * f64::from(k)).collect();
    let snapshots = show.snapshots(&times);
    let turns = |snapshot: &Arc<Snapshot>| snapshot.cube.turned.is_some();
    // A turn takes several snapshots, during which the belief has a turned layer.
    let first = snapshots.iter().position(turns)?;
    let count = snapshots[first..].iter().take_while(|s| turns(s)).count();
    Some((times[first], times[first + count - 1]))
}

/// Returns the scene of a snapshot; `None` if the controller has not seen the cube so far.
/// `colours` are the cube's facelets at the start of the solution, for the time before the
/// controller has read them. `last` keeps the cube's last known pose, for the time when the person
/// has it back. While no arm holds the cube, it is in the hand of the person, if the cell has one.
fn scene(
    snapshot: &Snapshot,
    colours: &str,
    last: &mut Option<Pose>,
    controller: &ControllerConfig,
) -> Option<Scene> {
    let mut snapshot = snapshot.clone();
    let (cell, cube) = (&controller.cell, &mut snapshot.cube);
    if cube.facelets.is_empty() || cube.facelets.contains('-') {
        colours.clone_into(&mut cube.facelets);
    }
    let seen = snapshot.hand.map(|hand| hand.world_from_cube);
    cube.world_from_cube = cube.world_from_cube.or(seen).or(*last);
    *last = cube.world_from_cube;
    let mut scene = picture::during(&snapshot, controller)?;
    if snapshot.cube.held_by.is_empty() && cell.keeper == Keeper::Person {
        // Vision knows the orientation of the cube only up to its symmetry, so the hand is drawn
        // with the orientation in the scenario.
        let place = scene.cube.world_from_cube.translation;
        scene.hand = Some(Pose::from_parts(place, cell.hand.world_from_cube.rotation));
    }
    Some(scene)
}

/// Returns an animated GIF of the pictures of all shots, one shot after the other.
fn encoded(shots: &[Vec<RgbImage>], (width, height): (u32, u32)) -> anyhow::Result<Vec<u8>> {
    let palette = Palette::of(shots);
    let mut film = Vec::new();
    let (width, height) = (u16::try_from(width)?, u16::try_from(height)?);
    let mut encoder = Encoder::new(&mut film, width, height, &palette.rgb)?;
    encoder.set_repeat(Repeat::Infinite)?;
    for shot in shots {
        let mut shown: Option<Vec<u8>> = None;
        for (number, image) in shot.iter().enumerate() {
            let indices = palette.indices(image);
            // Unchanged pixels are transparent: long runs of one value, which compress well.
            let written = match &shown {
                None => indices.clone(),
                Some(before) => {
                    let changed = |(&now, &then): (&u8, &u8)| {
                        if now == then { Palette::TRANSPARENT } else { now }
                    };
                    indices.iter().zip(before).map(changed).collect()
                }
            };
            encoder.write_frame(&Frame {
                width,
                height,
                delay: if number + 1 == shot.len() { LAST_DELAY } else { DELAY },
                dispose: DisposalMethod::Keep,
                transparent: shown.is_some().then_some(Palette::TRANSPARENT),
                buffer: Cow::Owned(written),
                ..Frame::default()
            })?;
            shown = Some(indices);
        }
    }
    drop(encoder);
    Ok(film)
}

/// Colours that all pictures of the film share.
struct Palette {
    quantiser: NeuQuant,
    /// Red, green and blue of each colour.
    rgb: Vec<u8>,
}

impl Palette {
    /// Index of a transparent pixel, which leaves the pixel below as it is: the last index.
    const TRANSPARENT: u8 = (COLOURS - 1) as u8;

    /// Chooses the colours that suit the middle pictures of all shots.
    fn of(shots: &[Vec<RgbImage>]) -> Self {
        let middle = shots.iter().filter_map(|shot| shot.get(shot.len() / 2));
        let pixels: Vec<u8> =
            middle.flat_map(|image| image.pixels()).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
        // The last index is left free for transparency.
        let quantiser = NeuQuant::new(3, COLOURS - 1, &pixels);
        let mut rgb = quantiser.color_map_rgb();
        rgb.resize(3 * COLOURS, 0);
        Self { quantiser, rgb }
    }

    /// Returns the index of the nearest colour for each pixel.
    fn indices(&self, image: &RgbImage) -> Vec<u8> {
        let index = |p: &image::Rgb<u8>| self.quantiser.index_of(&[p[0], p[1], p[2], 255]) as u8;
        image.pixels().map(index).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn film_shows_its_pictures_in_order() {
        let size = (32, 20);
        let square = |left: u32| {
            RgbImage::from_fn(size.0, size.1, |column, row| {
                let within = (left..left + 6).contains(&column) && (4..10).contains(&row);
                if within { Rgb([220, 20, 20]) } else { Rgb([30, 90, 200]) }
            })
        };
        let shots = vec![vec![square(0), square(8), square(16)], vec![square(24)]];

        let film = encoded(&shots, size).unwrap();

        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(&film[..]).unwrap();
        // A reader draws each picture over what the ones before have left.
        let mut canvas = vec![[0_u8; 3]; (size.0 * size.1) as usize];
        let mut delays = Vec::new();
        for expected in shots.iter().flatten() {
            let frame = decoder.read_next_frame().unwrap().unwrap();
            delays.push(frame.delay);
            for (pixel, rgba) in canvas.iter_mut().zip(frame.buffer.chunks(4)) {
                if rgba[3] == 255 {
                    *pixel = [rgba[0], rgba[1], rgba[2]];
                }
            }
            for (shown, wanted) in canvas.iter().zip(expected.pixels()) {
                let off = |c: usize| i32::from(shown[c]).abs_diff(i32::from(wanted[c]));
                assert!((0..3).all(|c| off(c) < 12), "{shown:?} for {wanted:?}");
            }
        }
        assert!(decoder.read_next_frame().unwrap().is_none());
        assert_eq!(delays, [DELAY, DELAY, LAST_DELAY, LAST_DELAY]);
    }
}
