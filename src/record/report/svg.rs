//! Charts of a report as SVG: curves, histograms, a timeline, the net of a cube. Lengths are in px.
//! The style sheet of the page gives the colours.

use super::html::escaped;
use std::fmt::Write;

/// Width of each chart (px).
const WIDTH: f64 = 960.0;
/// Margin at the left, for numbers (px).
const LEFT: f64 = 56.0;
/// Margin at the right (px).
const RIGHT: f64 = 12.0;
/// Largest number of points of a curve: about one for each pixel.
const COLUMNS: usize = 900;

/// Curve over time, with or without a limit.
pub(super) struct Curve<'a> {
    /// Quantity with its unit.
    pub title: &'a str,
    /// Largest value in each bin.
    pub values: &'a [f32],
    /// Length of a bin (s).
    pub bin: f64,
    /// Limit, drawn as a dashed line: value and label.
    pub limit: Option<(f64, String)>,
    /// CSS class of the line.
    pub class: &'a str,
}

/// Returns the x coordinate of a time in a chart (px). `end` is the time at the right end of the
/// scale.
fn x(time: f64, end: f64) -> f64 {
    LEFT + (WIDTH - LEFT - RIGHT) * if end > 0.0 { (time / end).clamp(0.0, 1.0) } else { 0.0 }
}

/// Returns the distance between two marks of a scale: 1, 2 or 5 times a power of ten, so that
/// `range` has at most `most` such steps.
pub(crate) fn step(range: f64, most: f64) -> f64 {
    // The bound keeps the logarithm finite for an empty range.
    let least = (range / most).max(1e-9);
    let ten = 10_f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * ten).find(|s| *s >= least).unwrap_or(10.0 * ten)
}

/// Formats a number with at most three decimals.
pub(crate) fn number(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Draws curves below each other on one scale of time, from 0 to `end` (s). Behind them each of the
/// `phases` (beginning in s, name) is a coloured band.
pub(super) fn curves(curves: &[Curve<'_>], phases: &[(f64, String)], end: f64) -> String {
    let (panel, gap, top) = (130.0, 34.0, 22.0);
    let height = top + curves.len() as f64 * (panel + gap) + 6.0;
    let mut svg = open(height, "curves");
    for (index, curve) in curves.iter().enumerate() {
        let y0 = top + index as f64 * (panel + gap);
        bands(&mut svg, phases, end, y0, panel);
        let largest = curve.values.iter().fold(0.0_f64, |m, v| m.max(f64::from(*v)));
        let limit = curve.limit.as_ref().map_or(0.0, |(value, _)| 1.08 * value);
        // The limit is always visible. The upper bound keeps the scale finite if a recorded value
        // is not.
        let most = (1.05 * largest).max(limit).clamp(1e-3, 1e12);
        let y = |value: f64| y0 + panel * (1.0 - (value / most).clamp(0.0, 1.0));
        let by = step(most, 4.0);
        let mut tick = 0.0;
        while tick <= most {
            let at = y(tick);
            let _ = write!(
                svg,
                "<line class=grid x1={LEFT} x2={:.0} y1={at:.1} y2={at:.1} />\
                 <text class=tick x={:.0} y={:.1} text-anchor=end>{}</text>",
                WIDTH - RIGHT,
                LEFT - 6.0,
                at + 4.0,
                number(tick)
            );
            tick += by;
        }
        let _ = write!(svg, "<text class=name x={LEFT} y={:.1}>{}</text>", y0 - 7.0, curve.title);
        let _ = write!(
            svg,
            "<text class=tick x={:.0} y={:.1} text-anchor=end>largest {}</text>",
            WIDTH - RIGHT,
            y0 - 7.0,
            number((largest * 100.0).round() / 100.0)
        );
        let _ =
            write!(svg, "<path class=\"line {}\" d=\"{}\" />", curve.class, path(curve, end, y));
        if let Some((value, words)) = &curve.limit {
            let at = y(*value);
            let _ = write!(
                svg,
                "<line class=limit x1={LEFT} x2={:.0} y1={at:.1} y2={at:.1} />\
                 <text class=limitname x={:.0} y={:.1} text-anchor=end>{words}</text>",
                WIDTH - RIGHT,
                WIDTH - RIGHT - 4.0,
                at - 4.0
            );
        }
        // The numbers of the time axis are below the last curve only.
        time_axis(&mut svg, end, y0 + panel, index + 1 == curves.len());
    }
    svg.push_str("</svg>");
    svg
}

/// Returns the path data of a curve on a scale of time from 0 to `end` (s); `y` converts a value to
/// its coordinate (px).
fn path(curve: &Curve<'_>, end: f64, y: impl Fn(f64) -> f64) -> String {
    // A long curve is thinned by maxima, so that a peak of one bin remains visible.
    let per = curve.values.len().div_ceil(COLUMNS).max(1);
    let mut d = String::new();
    for (index, values) in curve.values.chunks(per).enumerate() {
        let most = values.iter().fold(0.0_f64, |m, v| m.max(f64::from(*v)));
        let time = (index * per) as f64 * curve.bin;
        let _ =
            write!(d, "{}{:.1} {:.1}", if index == 0 { 'M' } else { 'L' }, x(time, end), y(most));
    }
    d
}

/// Draws a band for each phase behind a curve whose chart begins at `y` and is `height` high (px).
fn bands(svg: &mut String, phases: &[(f64, String)], end: f64, y: f64, height: f64) {
    for (index, (begin, _)) in phases.iter().enumerate() {
        let until = phases.get(index + 1).map_or(end, |p| p.0);
        let (a, b) = (x(*begin, end), x(until, end));
        let _ = write!(
            svg,
            "<rect class=\"band p{}\" x={a:.1} y={y:.1} width={:.1} height={height:.1} />",
            index % 8,
            (b - a).max(0.0)
        );
    }
}

/// Draws the axis of time, from 0 to `end` (s), at the height `y` (px); with labels if `numbers` is
/// set.
fn time_axis(svg: &mut String, end: f64, y: f64, numbers: bool) {
    let by = step(end, 12.0);
    let mut tick = 0.0;
    while tick <= end {
        let at = x(tick, end);
        let _ =
            write!(svg, "<line class=axis x1={at:.1} x2={at:.1} y1={y:.1} y2={:.1} />", y + 4.0);
        if numbers {
            let unit = if tick == 0.0 { " s" } else { "" };
            let _ = write!(
                svg,
                "<text class=tick x={at:.1} y={:.1} text-anchor=middle>{}{unit}</text>",
                y + 17.0,
                number(tick)
            );
        }
        tick += by;
    }
    let _ =
        write!(svg, "<line class=axis x1={LEFT} x2={:.0} y1={y:.1} y2={y:.1} />", WIDTH - RIGHT);
}

/// Row of a timeline.
pub(super) struct Row {
    /// Name, escaped.
    pub name: String,
    /// Pieces: begin (s), end (s), escaped text, CSS class.
    pub pieces: Vec<(f64, f64, String, String)>,
}

/// Draws a timeline from 0 to `end` (s): in each row a bar for each of its pieces, or a mark for a
/// piece without a duration.
pub(super) fn timeline(rows: &[Row], end: f64) -> String {
    let (row, gap) = (26.0, 20.0);
    let mut svg = open(rows.len() as f64 * (row + gap) + 26.0, "timeline");
    for (index, line) in rows.iter().enumerate() {
        let y = 16.0 + index as f64 * (row + gap);
        let _ = write!(svg, "<text class=name x={LEFT} y={:.1}>{}</text>", y - 4.0, line.name);
        for (begin, until, words, class) in &line.pieces {
            let (a, b) = (x(*begin, end), x(*until, end));
            // The mark of a piece without a duration is 3 px wide; its time has one more decimal.
            let (width, when) = if until > begin {
                ((b - a).max(0.5), format!("{begin:.1} to {until:.1} s"))
            } else {
                (3.0, format!("{begin:.2} s"))
            };
            let _ = write!(
                svg,
                "<g><title>{words}: {when}</title><rect class=\"piece {class}\" x={a:.1} y={y:.1} \
                 width={width:.1} height={row} rx=2 />"
            );
            // The text is inside its piece if it fits, at about 6.3 px per letter.
            if words.len() as f64 * 6.3 < width - 8.0 {
                let _ = write!(
                    svg,
                    "<text class=inside x={:.1} y={:.1}>{words}</text>",
                    a + 5.0,
                    y + 17.0
                );
            }
            svg.push_str("</g>");
        }
    }
    let bottom = rows.len() as f64 * (row + gap) + 4.0;
    time_axis(&mut svg, end, bottom, true);
    svg.push_str("</svg>");
    svg
}

/// Draws a histogram of times on a logarithmic scale. Each of `classes` is a time (ns) and its
/// count, in rising order of the times. Returns an empty text if there is none.
pub(super) fn histogram(title: &str, classes: &[(u64, u64)]) -> String {
    const BARS: usize = 70;
    // The scale of time begins and ends at powers of ten. It begins at 100 ns or later, and ends at
    // 1 us or later.
    let (Some(first), Some(last)) = (classes.first(), classes.last()) else { return String::new() };
    let low = (first.0.max(100) as f64).log10().floor();
    let high = (last.0.max(1000) as f64).log10().ceil();
    let mut bars = [0_u64; BARS];
    for (nanos, count) in classes {
        let share = ((*nanos).max(1) as f64).log10() - low;
        let at = (share / (high - low) * BARS as f64) as usize;
        let bar = &mut bars[at.min(BARS - 1)];
        *bar = bar.saturating_add(*count);
    }
    let (top, panel) = (22.0, 120.0);
    let most = bars.iter().copied().max().unwrap_or(1).max(1) as f64;
    // Heights are logarithmic: a single late period among thousands must be visible.
    let height = |count: u64| panel * (count as f64).ln_1p() / most.ln_1p();
    let mut svg = open(top + panel + 24.0, "histogram");
    let _ = write!(svg, "<text class=name x={LEFT} y={:.0}>{title}</text>", top - 7.0);
    let width = (WIDTH - LEFT - RIGHT) / BARS as f64;
    for (index, count) in bars.iter().enumerate().filter(|(_, c)| **c > 0) {
        let (at, tall) = (LEFT + index as f64 * width, height(*count).max(1.0));
        let _ = write!(
            svg,
            "<rect class=bar x={at:.1} y={:.1} width={:.1} height={tall:.1}>\
             <title>{count}</title></rect>",
            top + panel - tall,
            width - 1.0
        );
    }
    for count in
        [1_u64, 10, 100, 1000, 10_000, 100_000, 1_000_000].into_iter().filter(|c| *c as f64 <= most)
    {
        let y = top + panel - height(count);
        let _ = write!(
            svg,
            "<line class=grid x1={LEFT} x2={:.0} y1={y:.1} y2={y:.1} />\
             <text class=tick x={:.0} y={:.1} text-anchor=end>{count}</text>",
            WIDTH - RIGHT,
            LEFT - 6.0,
            y + 4.0
        );
    }
    log_time_axis(&mut svg, (low, high), top + panel);
    svg.push_str("</svg>");
    svg
}

/// Draws a logarithmic axis of time at the height `bottom` (px), with a label for each power of
/// ten. `low` and `high` are the exponents at its ends: 3 is 10^3 ns.
fn log_time_axis(svg: &mut String, (low, high): (f64, f64), bottom: f64) {
    let mut decade = low;
    while decade <= high {
        let at = LEFT + (WIDTH - LEFT - RIGHT) * (decade - low) / (high - low);
        let nanos = 10_f64.powf(decade);
        let words = match nanos {
            n if n < 1e3 => format!("{n:.0} ns"),
            n if n < 1e6 => format!("{:.0} us", n / 1e3),
            n => format!("{:.0} ms", n / 1e6),
        };
        let _ = write!(
            svg,
            "<text class=tick x={at:.1} y={:.1} text-anchor=middle>{words}</text>",
            bottom + 17.0
        );
        decade += 1.0;
    }
    let _ = write!(
        svg,
        "<line class=axis x1={LEFT} x2={:.0} y1={:.1} y2={:.1} />",
        WIDTH - RIGHT,
        bottom,
        bottom
    );
}

/// Draws the unfolded cube from 54 letters URFDLB. Stickers with other letters are grey.
pub(super) fn net(letters: &str) -> String {
    let size = 15.0;
    // Column and row of each face in the net, in the order URFDLB.
    let places = [(1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (3, 1)];
    let mut svg = format!(
        "<svg class=net viewBox=\"0 0 {:.0} {:.0}\" role=img aria-label=\"cube {}\">",
        12.0 * size + 10.0,
        9.0 * size + 8.0,
        escaped(letters)
    );
    for (index, letter) in letters.chars().take(54).enumerate() {
        let (column, row) = places[index / 9];
        let within = index % 9;
        let left = f64::from(column) * (3.0 * size + 3.0) + (within % 3) as f64 * size;
        let top = f64::from(row) * (3.0 * size + 3.0) + (within / 3) as f64 * size;
        let class = if "URFDLB".contains(letter) { letter } else { 'x' };
        let _ = write!(
            svg,
            "<rect class=\"tile t{class}\" x={:.1} y={:.1} width={:.1} height={:.1} rx=2 />",
            left + 0.5,
            top + 0.5,
            size - 1.0,
            size - 1.0
        );
    }
    svg.push_str("</svg>");
    svg
}

/// Returns the opening `<svg>` tag of a chart with this height (px) and CSS class.
fn open(height: f64, class: &str) -> String {
    format!("<svg class=\"wide {class}\" viewBox=\"0 0 {WIDTH:.0} {height:.0}\" role=img>")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_have_round_steps() {
        assert_eq!(step(100.0, 5.0), 20.0);
        assert_eq!(step(0.9, 4.0), 0.5);
        assert_eq!(step(130.0, 12.0), 20.0);
    }

    /// Thinning a curve keeps a peak of one bin.
    #[test]
    fn thinned_curve_keeps_a_short_peak() {
        let mut values = vec![0.0_f32; 20_000];
        values[12_345] = 7.0;
        let curve = Curve { title: "", values: &values, bin: 0.02, limit: None, class: "a" };

        let d = path(&curve, 400.0, |v| v);

        assert!(d.contains(" 7.0"), "thinned, but not lost");
    }

    #[test]
    fn curve_with_infinite_value_has_finite_scale() {
        let values = [1.0, f32::INFINITY, f32::NAN];
        let curve = Curve { title: "", values: &values, bin: 0.02, limit: None, class: "a" };

        assert!(curves(&[curve], &[], 1.0).len() < 10_000);
    }

    #[test]
    fn histogram_shows_a_single_late_period() {
        let svg = histogram("wake-up", &[(10_000, 50_000), (45_000_000, 1)]);

        assert!(svg.contains("<title>1</title>"));
        assert!(svg.contains(">10 us<") && svg.contains(">100 ms<"));
    }
}
