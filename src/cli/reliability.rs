//! Reliability of the confidences that the detector reports for tiles: how often the colour of a
//! tile with a given confidence is right.
//!
//! - in: confidence of each tile that was read, and whether its colour is right, by source (for
//!   example a camera or a set of photographs)
//! - out: a table of classes of confidence, and a plot (SVG)
//!
//! Sources are never pooled: photographs of one camera say nothing about those of another.

use crate::campaign::statistics::wilson;
use crate::record::report::escaped;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Least confidence of each class; the last class ends at 1.
const CLASSES: [f64; 7] = [0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98];

/// Least confidence of a tile that counts as certain.
const CERTAIN: f64 = 0.9;

/// Counts of the tiles in one class of confidence.
#[derive(Debug, Clone, Copy, Default)]
struct Class {
    tiles: u64,
    /// Tiles with the right colour.
    right: u64,
    /// Sum of the confidences of the tiles.
    confidence: f64,
}

impl Class {
    /// Returns the counts of both classes together.
    fn and(self, other: Self) -> Self {
        Self {
            tiles: self.tiles + other.tiles,
            right: self.right + other.right,
            confidence: self.confidence + other.confidence,
        }
    }
}

/// Classes of confidence of each source.
#[derive(Debug, Default)]
pub(super) struct Reliability(BTreeMap<String, [Class; CLASSES.len()]>);

impl Reliability {
    /// Counts a tile of a source, which was read with this confidence; `right` says whether its
    /// colour is right.
    pub(super) fn add(&mut self, source: &str, confidence: f64, right: bool) {
        let class = CLASSES.iter().rposition(|least| confidence >= *least).unwrap_or(0);
        let classes = self.0.entry(source.to_owned()).or_default();
        let tile = Class { tiles: 1, right: u64::from(right), confidence };
        classes[class] = classes[class].and(tile);
    }

    /// Returns the counts of the certain tiles of a source: those with the confidence [`CERTAIN`]
    /// or more.
    fn certain(classes: &[Class]) -> Class {
        let certain = classes.iter().zip(CLASSES).filter(|(_, least)| *least >= CERTAIN);
        certain.fold(Class::default(), |sum, (class, _)| sum.and(*class))
    }

    /// Returns the classes as a table. Below those of each source is the share of wrong tiles among
    /// the certain ones, as an upper bound (end of the 95 % interval).
    pub(super) fn text(&self) -> String {
        let mut out = String::from("source             confidence    tiles  wrong  share right\n");
        for (source, classes) in &self.0 {
            for (index, class) in classes.iter().enumerate().filter(|(_, class)| class.tiles > 0) {
                let end = CLASSES.get(index + 1).copied().unwrap_or(1.0);
                let _ = writeln!(
                    out,
                    "{source:<18} {:.2} .. {end:.2} {:7} {:6}  {:10.3}",
                    CLASSES[index],
                    class.tiles,
                    class.tiles - class.right,
                    class.right as f64 / class.tiles as f64
                );
            }
            let certain = Self::certain(classes);
            let [_, most] = wilson(certain.tiles - certain.right, certain.tiles);
            let _ = writeln!(
                out,
                "{source:<18} certain ({CERTAIN} or more): {} of {} wrong, at most {:.2} % (95 %)",
                certain.tiles - certain.right,
                certain.tiles,
                100.0 * most
            );
        }
        out
    }

    /// Returns the classes of each source as JSON.
    pub(super) fn json(&self) -> Value {
        let sources = self.0.iter().map(|(source, all)| {
            let classes: Vec<Value> = all
                .iter()
                .zip(CLASSES)
                .map(|(class, least)| {
                    json!({ "from": least, "tiles": class.tiles, "right": class.right })
                })
                .collect();
            let certain = Self::certain(all);
            json!({ "source": source, "classes": classes, "certain": certain.tiles,
                "certain_wrong": certain.tiles - certain.right,
                "wrong_at_most": wilson(certain.tiles - certain.right, certain.tiles)[1] })
        });
        sources.collect()
    }

    /// Draws the share of right tiles over the confidence, a curve for each source. The diagonal is
    /// perfect calibration; bars are intervals of 95 %.
    pub(super) fn plot(&self) -> String {
        const COLOURS: [&str; 6] =
            ["#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf"];
        let (x, y) = (|v: f64| 60.0 + 400.0 * v, |v: f64| 440.0 - 400.0 * v);
        let mut svg = String::from(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"720\" height=\"500\" \
             font-family=\"sans-serif\" font-size=\"12\">\
             <rect width=\"720\" height=\"500\" fill=\"white\"/>",
        );
        for tenth in (0..=10).step_by(2) {
            let at = f64::from(tenth) / 10.0;
            let _ = write!(
                svg,
                "<text x=\"{:.0}\" y=\"458\" text-anchor=\"middle\">{at}</text>\
                 <text x=\"52\" y=\"{:.0}\" text-anchor=\"end\">{at}</text>",
                x(at),
                y(at) + 4.0
            );
        }
        let _ = write!(
            svg,
            "<rect x=\"60\" y=\"40\" width=\"400\" height=\"400\" fill=\"none\" stroke=\"#888\"/>\
             <line x1=\"60\" y1=\"440\" x2=\"460\" y2=\"40\" stroke=\"#bbb\"/>\
             <text x=\"260\" y=\"485\" text-anchor=\"middle\">confidence</text>\
             <text x=\"60\" y=\"28\">share of right tiles</text>"
        );
        for (index, (source, classes)) in self.0.iter().enumerate() {
            let colour = COLOURS[index % COLOURS.len()];
            let mut line = String::new();
            for class in classes.iter().filter(|class| class.tiles > 0) {
                let at = x(class.confidence / class.tiles as f64);
                let [low, high] = wilson(class.right, class.tiles);
                let share = y(class.right as f64 / class.tiles as f64);
                let _ = write!(
                    svg,
                    "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{:.1}\" y2=\"{:.1}\" \
                     stroke=\"{colour}\"/>\
                     <circle cx=\"{at:.1}\" cy=\"{share:.1}\" r=\"3\" fill=\"{colour}\"/>",
                    y(low),
                    y(high)
                );
                let _ = write!(line, "{at:.1},{share:.1} ");
            }
            let _ = write!(
                svg,
                "<polyline points=\"{line}\" fill=\"none\" stroke=\"{colour}\"/>\
                 <text x=\"475\" y=\"{}\" fill=\"{colour}\">{}</text>",
                56 + 18 * index,
                escaped(source)
            );
        }
        svg + "</svg>\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_bounds_wrong_tiles_by_source() {
        let mut reliability = Reliability::default();
        (0..500).for_each(|i| reliability.add("camera", 0.99, i != 0));
        reliability.add("camera", 0.6, false);
        reliability.add("other", 0.9, true);

        let text = reliability.text();

        assert!(text.contains("camera             0.98 .. 1.00     500      1"), "{text}");
        assert!(text.contains("camera             0.50 .. 0.70       1      1"), "{text}");
        assert!(text.contains("1 of 500 wrong, at most 1.12 %"), "{text}");
        assert!(text.contains("other              certain (0.9 or more): 0 of 1 wrong"), "{text}");
        assert_eq!(reliability.json()[0]["certain_wrong"], 1);
    }

    #[test]
    fn plot_has_one_curve_for_each_source() {
        let mut reliability = Reliability::default();
        reliability.add("a<b", 0.95, true);
        reliability.add("c", 0.3, false);

        let plot = reliability.plot();

        assert_eq!(plot.matches("<polyline").count(), 2);
        // The plot begins at (60, 440) px, and a share of 1 is 400 px long.
        for at in ["cx=\"440.0\" cy=\"40.0\"", "cx=\"180.0\" cy=\"440.0\""] {
            assert_eq!(plot.matches(at).count(), 1, "{at} in {plot}");
        }
        assert!(plot.contains("a&lt;b") && plot.ends_with("</svg>\n"));
    }
}
