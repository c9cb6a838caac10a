//! `rubik-robot vision`: declares its subcommands, with their helps, and calls the one of the call.

use super::live::{CameraArgs, live};
use super::output::{Output, WRONG, complain};
use super::{cubes, evaluate, faces, frames, locate, rig, stages};
use clap::{Args, Subcommand};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot vision face photo.jpg                   # faces, corners, colours
  rubik-robot vision scan u.jpg r.jpg f.jpg d.jpg l.jpg b.jpg
                                                      # the cube of six pictures
  rubik-robot vision scan --camera /dev/video0        # the cube held before a webcam
  rubik-robot vision colours measured.json            # the cube of 54 RGB triples
  rubik-robot vision locate photo.jpg --fx 600        # the pose of the cube
  rubik-robot vision eval photographs/manifest.jsonl  # shares found and read, time of a picture
  rubik-robot vision stages photo.jpg -o stages       # the stages of the detector of 2007

Colours are the letters W R G Y O B: white, red, green, yellow, orange, blue. Reading order is row
by row from the top, each row from the left. Places in a picture are [x, y] in px, x to the right
and y down; the centre of the top left pixel is [0, 0].
Exit codes: 0 done, 1 a picture has no face or no pose, or colours make no cube, 2 wrong usage, or
a file cannot be read, 4 system error.")]
pub(super) struct VisionArgs {
    #[command(subcommand)]
    what: What,
}

/// Subcommand of `vision`.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Subcommand)]
enum What {
    /// Find the faces of a cube in pictures and read their colours
    #[command(after_help = "\
Examples:
  rubik-robot vision face photo.jpg
  rubik-robot vision face *.png --json

Each face gets a line, the most certain face of a picture first: nine letters (W R G Y O B: white,
red, green, yellow, orange, blue) in reading order, row by row from the top left; centre and width
(longest side) in px; confidence that it is a face; confidence in its least certain colour, 0 to 1.
A picture without a face gets a line with the reason.

Keys of a line of --json:
  image             name of the picture
  faces             for each face:
    outline           its four corners, clockwise from the top left
    corners           centres of its four corner tiles, likewise
    centres           centres of its nine tiles in reading order
    colours           its nine letters in reading order
    confidence        certainty that it is a face, 0 to 1
    tile_confidence   certainty of each of the nine colours, 0 to 1
  reason            only if there is no face, or if the picture is black and white
Places are [x, y] in px; the centre of the top left pixel is [0, 0].
Exit codes: 0 every picture shows a face, 1 a picture shows none, 2 wrong usage, or a picture cannot
be read.")]
    Face {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// Print one line of JSON for each picture
        #[arg(long)]
        json: bool,
    },
    /// Read a cube from pictures of its six faces, or before a camera
    #[command(after_help = "\
Examples:
  rubik-robot vision scan u.jpg r.jpg f.jpg d.jpg l.jpg b.jpg
  rubik-robot vision scan u.jpg r.jpg f.jpg d.jpg l.jpg b.jpg --json
  rubik-robot vision scan --camera /dev/video0 --ui web

Each face is upright as in the usual net: U above F, D below F. Pictures that were turned, exchanged
or mirrored are recognised and put right where exactly one cube fits; the line says which.
The line has the cube as 54 letters, nine for each of the faces U R F D L B in this order, each in
reading order; a letter names the face whose centre has the colour. Then come the least margin of a
facelet (sticker) and the doubtful facelets, if any. A margin is the confidence in a facelet over
the best cube in which it has another colour, 0 to 1. Facelets are named U1 to B9.

Keys of the object of --json:
  file         names of the pictures
  facelets     the 54 letters
  colours      54 letters W R G Y O B: white, red, green, yellow, orange, blue
  margins      the 54 margins
  doubtful     names of the facelets with a small margin, the least certain first
  correction   only if pictures were put right: which, in words
If the cube is not read: file, reason, refusal (the reason as one word) and, if all colours were
read, read (54 letters as facelets) and doubtful (facelets to check).

With --camera each face is held still before the camera until it is taken; stderr says which one is
next. Faces may be shown in another order or turned, as pictures may. If the faces make no cube, all
are shown again. A fixed exposure and white balance make colours comparable from face to face. The
page of --ui web shows the camera's picture with the face that was found. A camera that is unplugged
may come back within 30 s. V4L2 cameras need a program that was built with --features v4l2.
Exit codes: 0 the cube is read, 1 a picture shows no face, no cube fits all stickers, or the
camera's pictures ended before the cube was read, 2 wrong usage, or a picture or the camera cannot
be read, 130 interrupted.")]
    Scan {
        /// Pictures of the faces U, R, F, D, L and B, in this order (PNG, JPEG)
        #[arg(required_unless_present = "camera", conflicts_with = "camera", num_args = 6,
            value_names = ["U", "R", "F", "D", "L", "B"])]
        images: Vec<PathBuf>,
        #[command(flatten)]
        camera: CameraArgs,
        /// Print one line of JSON
        #[arg(long)]
        json: bool,
    },
    /// Read cubes from 54 measured colours each
    #[command(after_help = "\
A file of measured colours is {\"1\": [r, g, b], ... \"54\": [r, g, b]}, with values from 0 to 255.
The 54 facelets are numbered face by face in reading order; here the faces are in the order U, L, F,
R, B, D. The answer has the order U, R, F, D, L, B.

Examples:
  rubik-robot vision colours measured.json
  rubik-robot vision colours measured/*.json --json

Each file gets a line, with the content and the keys of --json as of `vision scan`. Faces that were
turned, exchanged or mirrored are put right as well.
Exit codes: 0 all cubes are read, 1 no cube fits the colours of a file, or its content is wrong, 2
wrong usage, or a file cannot be read.")]
    Colours {
        /// Files of measured colours (JSON)
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// Print one line of JSON for each file
        #[arg(long)]
        json: bool,
    },
    /// Read cubes in a rig with fixed cameras, at known places of the picture
    #[command(after_help = "\
A rig is a set of fixed cameras whose joint picture shows all faces, always at the same places.
A file of boxes has a line for each of the 54 facelets (faces U R F D L B, each in reading order),
with one or more boxes of pixels: x y width height, then those of the next box. x y is the top left
pixel of the box; that of the picture is 0 0. All numbers are whole.

Examples:
  rubik-robot vision rig new.png --boxes rig.txt
  rubik-robot vision rig new.png --boxes rig.txt --table rig.json --json

Each picture gets a line, with the content and the keys of --json as of `vision scan`.
Exit codes: 0 all cubes are read, 1 a cube is not, or a box is outside of its picture, 2 wrong
usage, or a picture, the boxes or the table cannot be read.")]
    Rig {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// File with the boxes of pixels that belong to each facelet (px)
        #[arg(long, value_name = "FILE")]
        boxes: PathBuf,
        /// Table of the rig's colours, which `vision learn` prints [default: none]
        #[arg(long, value_name = "FILE")]
        table: Option<PathBuf>,
        /// Print one line of JSON for each picture
        #[arg(long)]
        json: bool,
    },
    /// Learn the colours of a rig from pictures of known cubes, and print the table
    #[command(after_help = "\
The file of boxes is that of `vision rig`. A line of a file of states is the file name of a picture
(without its folder), a blank and the 54 letters of its cube: faces U R F D L B, each in reading
order. The table on stdout is one line of JSON for `vision rig --table`.

Examples:
  rubik-robot vision learn known/*.png --boxes rig.txt > rig.json
  rubik-robot vision learn a.png b.png --boxes rig.txt --states states.txt > rig.json

Exit codes: 0 learnt, 2 wrong usage, or a picture, the boxes or a state cannot be used.")]
    Learn {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// File with the boxes of pixels that belong to each facelet (px)
        #[arg(long, value_name = "FILE")]
        boxes: PathBuf,
        /// File with the state of each picture's cube
        /// [default: the name of each picture is the state: 54 letters and .png or .jpg]
        #[arg(long, value_name = "FILE", verbatim_doc_comment)]
        states: Option<PathBuf>,
    },
    /// Measure which share of known faces is found and read
    #[command(after_help = "\
A manifest has a line for each face, a JSON object; `vision render` writes one. For example, broken
here into two lines:
  {\"image\":\"a/1.jpg\", \"face\":\"WYROGBWYR\", \"tier\":\"A\", \"all_centres\":[[120.5,80],
   [160,81],[199.5,82],[119,120],[159,121],[198,122],[118,160],[157,161],[197,162.5]]}
Its keys:
  image         path of the picture from the manifest's folder
  face          nine letters W R G Y O B (white, red, green, yellow, orange, blue) in reading order
  all_centres   centres of the nine tiles, each [x, y] in px, in reading order; the centre of the
                top left pixel of the picture is [0, 0]
  tier, source  texts to group by, optional [default: none; first folder of image]
A face is found if all nine centres are within a quarter of the smallest tile pitch (the smallest
distance of two neighbouring centres) of those of the manifest. It is read if its nine colours are
right as well. All four reading orders of a detected face count.

Examples:
  rubik-robot vision eval photographs/manifest.jsonl
  rubik-robot vision eval photographs/manifest.jsonl --misses
  rubik-robot vision eval photographs/manifest.jsonl --plot confidence.svg

The first table has the shares of faces found and read and of tiles read, by tier and source, the
number of reported faces that the manifest lacks, and the detection time of a picture by the wall
clock (ms). The second one has the share of right tiles in each class of confidence, by source.

Keys of the object of --json:
  images, reports     numbers of pictures, and of faces that the detector reports
  all, groups         faces, found, read, tiles, tiles_right: of all, and in count by tier, source
  wrong_reports, wrong_reports_confident, confident_from    reports that the manifest lacks; those
                      with the confidence confident_from or more
  median_ms, p95_ms, slowest_ms    detection time of a picture
  misses              the lines of --misses
  confidences         for each source: classes (from, tiles, right), certain (tiles with 0.9 or
                      more), certain_wrong, wrong_at_most (end of the 95 % interval of their share)
Exit codes: 0 measured, 2 wrong usage, or the manifest, a picture or the plot cannot be used.")]
    Eval {
        /// Manifest file (JSON lines)
        manifest: PathBuf,
        /// Print one object of JSON instead of a table
        #[arg(long)]
        json: bool,
        /// Print each face that was missed or misread as well, and each report of a face
        /// where none is (with --json they are printed in any case)
        #[arg(long, verbatim_doc_comment)]
        misses: bool,
        /// Draw the share of right tiles over their confidence into FILE (SVG)
        #[arg(long, value_name = "FILE")]
        plot: Option<PathBuf>,
    },
    /// Locate the cube in pictures of a camera with known optics
    Locate(locate::LocateArgs),
    /// Measure the errors of poses in frames of `vision render`
    Accuracy(locate::AccuracyArgs),
    /// Render frames of a cube with their exact ground truth
    Render(frames::RenderArgs),
    /// Show the stages of the detector of the 2007 paper for pictures
    #[command(after_help = "\
The paper is Zieliński et al., Industrial Robot 34/5 (2007), about the robot that this program
builds on. Its detector splits the picture into regions of one colour, and filters leave fewer and
fewer of them: regions (all), area, boundary, circularity, quadrilaterals, once (one region at a
place), neighbours. The largest square of nine of the remaining regions is its face. The default
detector of this program is another one.

The command prints for each picture the number of regions after each stage; the centroids of the
four corner tiles of the face (px), or the reason why there is none; with --fx the pose of the face
from these four points, as in the paper; the number of faces that the default detector finds; and
the files of -o. These are FOLDER/NAME-NUMBER-STAGE.png, with the regions that the stage leaves, and
a last one, result: the face in magenta, those of the default detector in yellow with their colours.

Examples:
  rubik-robot vision stages photo.jpg
  rubik-robot vision stages photo.jpg -o stages --fx 600

Keys of a line of --json:
  image      name of the picture
  stages     stage (its name) and regions (their number), for each stage
  square     the face: corners, the centroids of its corner tiles, [x, y] in px, clockwise; or
             reason; with --fx also camera_from_face (three rows of four, m: origin in its centre,
             x to the next column, y to the next row, z into the cube), residual_px (error of the
             four points), other and other_residual_px (the second pose that fits)
  detector   number of faces that the default detector finds; or the reason why none
  files      names of the files of -o
  reason     only with image: why the picture has no result
Exit codes: 0 done, also without a face; 1 the principal point (--cx, --cy) is outside of a picture;
2 wrong usage, a picture cannot be read, or the folder cannot be written.")]
    Stages(stages::StagesArgs),
}

/// Calls the subcommand and prints its text; returns the exit code.
pub(super) fn vision(args: &VisionArgs, output: &mut Output) -> anyhow::Result<u8> {
    let done = match &args.what {
        What::Face { images, json } => Ok(faces::face(images, *json)),
        What::Scan { images, camera, json } => {
            camera.check()?;
            if let Some(name) = &camera.camera {
                return live(name, camera, *json, output);
            }
            Ok(cubes::scan(images, *json))
        }
        What::Colours { files, json } => Ok(cubes::colours(files, *json)),
        What::Rig { images, boxes, table, json } => {
            rig::rig(images, boxes, table.as_deref(), *json)
        }
        What::Learn { images, boxes, states } => {
            rig::learn(images, boxes, states.as_deref()).map(|text| (text, 0))
        }
        What::Eval { manifest, json, misses, plot } => {
            let plot = plot.as_deref();
            evaluate::evaluate(manifest, *json, *misses, plot).map(|text| (text, 0))
        }
        What::Stages(args) => stages::stages(args),
        What::Locate(args) => Ok(locate::locate(args)),
        What::Accuracy(args) => locate::accuracy(args),
        // Rendering has exit codes of its own: it reads a scenario.
        What::Render(args) => {
            let (text, code) = frames::render(args)?;
            output.text(&text)?;
            return Ok(code);
        }
    };
    match done {
        Ok((text, code)) => {
            output.text(&text)?;
            // The text has a line for each picture, also for those that failed.
            Ok(code)
        }
        Err(error) => {
            complain(&format!("{error:#}"));
            Ok(WRONG)
        }
    }
}
