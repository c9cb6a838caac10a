//! `rubik-robot vision`: declares its subcommands, with their helps, and calls the one of the call.

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
  rubik-robot vision colours measured.json            # the cube of 54 RGB triples
  rubik-robot vision locate photo.jpg --fx 600        # the pose of the cube
  rubik-robot vision eval photographs/manifest.jsonl  # shares found and read, time of a picture
  rubik-robot vision stages photo.jpg -o stages       # figure 4 of the paper for a picture

Exit codes: 0 done, 1 a picture has no face or no pose, or colours make no cube, 2 wrong usage, or
a file cannot be read.")]
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

Exit codes: 0 every picture shows a face, 1 a picture shows none, 2 a picture cannot be read.")]
    Face {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// Print one line of JSON for each picture
        #[arg(long)]
        json: bool,
    },
    /// Read a cube from pictures of its six faces
    #[command(after_help = "\
Examples:
  rubik-robot vision scan u.jpg r.jpg f.jpg d.jpg l.jpg b.jpg
  rubik-robot vision scan u.jpg r.jpg f.jpg d.jpg l.jpg b.jpg --json

Each face is upright as in the usual net: U above F, D below F. Pictures that were turned, exchanged
or mirrored are recognised and put right where exactly one cube fits; the line says which (\"put
right:\", in JSON \"correction\").
Exit codes: 0 the cube is read, 1 a picture shows no face, or no cube fits all stickers, 2 a
picture cannot be read.")]
    Scan {
        /// Pictures of the faces U, R, F, D, L and B, in this order (PNG, JPEG)
        #[arg(required = true, num_args = 6, value_names = ["U", "R", "F", "D", "L", "B"])]
        images: Vec<PathBuf>,
        /// Print one line of JSON
        #[arg(long)]
        json: bool,
    },
    /// Read cubes from 54 measured colours each
    #[command(after_help = "\
A file of measured colours is {\"1\": [r, g, b], ... \"54\": [r, g, b]}, with values from 0 to 255.
Squares are numbered face by face in reading order; the faces are U, L, F, R, B, D. The answer has
the order U, R, F, D, L, B.

Examples:
  rubik-robot vision colours measured.json
  rubik-robot vision colours measured/*.json --json

Faces that were turned, exchanged or mirrored are put right as by `vision scan`.
Exit codes: 0 all cubes are read, 1 no cube fits the colours of a file, 2 a file cannot be read.")]
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
with one or more boxes of pixels: x y width height, then those of the next box.

Examples:
  rubik-robot vision rig new.png --boxes rig.txt
  rubik-robot vision rig new.png --boxes rig.txt --table rig.json --json

Exit codes: 0 all cubes are read, 1 a cube is not, 2 a picture, the boxes or the table cannot be
read.")]
    Rig {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// File with the boxes of pixels that belong to each facelet (px)
        #[arg(long, value_name = "FILE")]
        boxes: PathBuf,
        /// Table of the rig's colours, written by `vision learn` [default: none]
        #[arg(long, value_name = "FILE")]
        table: Option<PathBuf>,
        /// Print one line of JSON for each picture
        #[arg(long)]
        json: bool,
    },
    /// Learn the colours of a rig from pictures of known cubes, and print the table
    #[command(after_help = "\
A file of boxes has a line for each of the 54 facelets (faces U R F D L B, each in reading order),
with one or more boxes of pixels: x y width height. A line of a file of states is the file name of a
picture and the 54 letters of its cube, in the same order.

Examples:
  rubik-robot vision learn known/*.png --boxes rig.txt > rig.json
  rubik-robot vision learn a.png b.png --boxes rig.txt --states states.txt > rig.json

Exit codes: 0 learnt, 2 a picture, the boxes or a state cannot be used.")]
    Learn {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// File with the boxes of pixels that belong to each facelet (px)
        #[arg(long, value_name = "FILE")]
        boxes: PathBuf,
        /// File with the state of each picture's cube [default: the picture's name is the state]
        #[arg(long, value_name = "FILE")]
        states: Option<PathBuf>,
    },
    /// Measure which share of known faces is found and read
    #[command(after_help = "\
A manifest has one JSON object a line for each face: image (path from the manifest's folder), face
(nine letters of WYROGB in reading order), all_centres (nine pixels), and optionally tier and source
to group by. A face is found if all nine centres are within a quarter of the tile pitch.

Examples:
  rubik-robot vision eval photographs/manifest.jsonl
  rubik-robot vision eval photographs/manifest.jsonl --misses
  rubik-robot vision eval photographs/manifest.jsonl --plot confidence.svg

Exit codes: 0 measured, 2 the manifest or a picture cannot be used.")]
    Eval {
        /// Manifest file (JSON lines)
        manifest: PathBuf,
        /// Print one object of JSON instead of a table
        #[arg(long)]
        json: bool,
        /// Print each face that was missed or misread, and each report of a face where none is
        #[arg(long)]
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
With -o each stage becomes a picture: regions, area, boundary, circularity, quadrilaterals, once
(one region at a place), neighbours. The picture of the result has the paper's square in magenta,
and the faces of the default detector in yellow with the colours read. With --fx the pose of the
face is computed from its four corner tiles, as in the paper.

Examples:
  rubik-robot vision stages photo.jpg
  rubik-robot vision stages photo.jpg -o stages --fx 600

Exit codes: 0 done, 1 the optics are not those of a picture, 2 a picture cannot be read, or the
folder cannot be written.")]
    Stages(stages::StagesArgs),
}

/// Calls the subcommand and prints its text; returns the exit code.
pub(super) fn vision(args: &VisionArgs, output: &mut Output) -> anyhow::Result<u8> {
    let done = match &args.what {
        What::Face { images, json } => Ok(faces::face(images, *json)),
        What::Scan { images, json } => Ok(cubes::scan(images, *json)),
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
