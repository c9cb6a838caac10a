//! `rubik-robot vision`: dispatches its subcommands.

use super::output::{Output, WRONG, complain};
use super::{cubes, evaluate, faces, frames, locate, rig, stages};
use clap::{Args, Subcommand};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot vision face photo.jpg                        faces, corners, colours
  rubik-robot vision face *.png --json                     one line of JSON a picture
  rubik-robot vision scan u.jpg r.jpg f.jpg d.jpg l.jpg b.jpg
                                                           six pictures -> the cube's facelets
  rubik-robot vision colours measured.json                 54 RGB triples -> the cube's facelets
  rubik-robot vision learn known/*.png --boxes rig.txt > rig.json
  rubik-robot vision rig new.png --boxes rig.txt --table rig.json
  rubik-robot vision locate photo.jpg --fx 600             where the cube is
  rubik-robot vision eval photographs/manifest.jsonl       found right, read right, ms a picture
  rubik-robot vision stages photo.jpg -o stages            the paper's figure 4 of a picture
Exit code 1 when a picture shows no face, or colours make no cube.")]
pub(super) struct VisionArgs {
    #[command(subcommand)]
    what: What,
}

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Subcommand)]
enum What {
    /// Find the faces of a cube in pictures and read their colours
    Face {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// One line of JSON a picture
        #[arg(long)]
        json: bool,
    },
    /// Read a cube from six pictures: U R F D L B, each upright as in the usual net (U over F, D under F)
    Scan {
        /// Picture files (PNG, JPEG) in this order
        #[arg(required = true, num_args = 6, value_names = ["U", "R", "F", "D", "L", "B"])]
        images: Vec<PathBuf>,
        /// One line of JSON
        #[arg(long)]
        json: bool,
    },
    /// Decide whole cubes from 54 measured colours each: {"1": [r, g, b], ... "54": [r, g, b]}
    ///
    /// Squares are numbered face by face in reading order; the faces are U, L, F, R, B, D. The answer is in the
    /// order U, R, F, D, L, B.
    #[command(verbatim_doc_comment)]
    Colours {
        /// Files of measured colours (JSON)
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// One line of JSON a file
        #[arg(long)]
        json: bool,
    },
    /// Read cubes in a rig whose cameras never move, at known places of the picture
    Rig {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// 54 lines (URFDLB), each with one or more boxes: x y width height
        #[arg(long)]
        boxes: PathBuf,
        /// Colours of this rig, from `vision learn`
        #[arg(long)]
        table: Option<PathBuf>,
        /// One line of JSON a picture
        #[arg(long)]
        json: bool,
    },
    /// Learn the colours of a rig from pictures of cubes of known state; prints the table
    Learn {
        /// Picture files (PNG, JPEG)
        #[arg(required = true)]
        images: Vec<PathBuf>,
        /// 54 lines (URFDLB), each with one or more boxes: x y width height
        #[arg(long)]
        boxes: PathBuf,
        /// Lines of a picture's file name and its 54 facelets; without it a picture's name is its state
        #[arg(long)]
        states: Option<PathBuf>,
    },
    /// Compare with the truth of a manifest: which share of the faces is found right and read right
    ///
    /// A manifest has a JSON object a line, a face each: image (path from the manifest's folder), face (nine letters
    /// of WYROGB in reading order), all_centres (nine pixels), and optionally tier and source to group by. Found
    /// right: all nine centres within a quarter of the tile pitch.
    #[command(verbatim_doc_comment)]
    Eval {
        /// File of JSON lines
        manifest: PathBuf,
        /// One object instead of a table
        #[arg(long)]
        json: bool,
        /// Name each face that was missed or misread, and each wrong report
        #[arg(long)]
        misses: bool,
    },
    /// Say where the cube is, from pictures and their optics
    Locate(locate::LocateArgs),
    /// Compare poses with the truth of frames that `vision render` wrote
    Accuracy(locate::AccuracyArgs),
    /// Write frames of the plant's renderer with exact truth
    Render(frames::RenderArgs),
    /// Show what each stage of the paper's method leaves of a picture: its regions, and the square they make
    ///
    /// With -o, a picture of each stage (regions, area, boundary, circularity, quadrilaterals, once: of several colour
    /// ranges, neighbours) and one of the result: the paper's square in magenta, the default detector's faces in yellow
    /// with the colours read. With --fx, the pose of the face by its four corner tiles, as the paper takes it.
    #[command(verbatim_doc_comment)]
    Stages(stages::StagesArgs),
}

/// Runs a subcommand of `vision` and returns the exit code.
pub(super) fn vision(args: &VisionArgs, output: &mut Output) -> anyhow::Result<u8> {
    let done = match &args.what {
        What::Face { images, json } => Ok(faces::face(images, *json)),
        What::Scan { images, json } => Ok(cubes::scan(images, *json)),
        What::Colours { files, json } => Ok(cubes::colours(files, *json)),
        What::Rig { images, boxes, table, json } => {
            rig::rig(images, boxes, table.as_deref(), *json)
        }
        What::Learn { images, boxes, states } => {
            rig::learn(images, boxes, states.as_deref()).map(|text| (text, true))
        }
        What::Eval { manifest, json, misses } => {
            evaluate::evaluate(manifest, *json, *misses).map(|text| (text, true))
        }
        What::Stages(args) => stages::stages(args),
        What::Locate(args) => Ok(locate::locate(args)),
        What::Accuracy(args) => locate::accuracy(args),
        What::Render(args) => {
            let (text, code) = frames::render(args)?;
            output.text(&text)?;
            return Ok(code);
        }
    };
    match done {
        Ok((text, all)) => {
            output.text(&text)?;
            Ok(u8::from(!all))
        }
        Err(error) => {
            complain(&format!("{error:#}"));
            Ok(WRONG)
        }
    }
}
