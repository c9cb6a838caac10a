//! The report of a campaign: one HTML page without scripts or other files, for a light or dark
//! screen and for paper.
//!
//! - in: a [`Tally`], whose header holds the text of the `--vary` file
//! - out: HTML

use super::result::{Figures, RunResult, Verdict};
use super::statistics::Spread;
use super::tally::{Tally, figure, phase};
use super::vary::{Choice, Distribution, Variations};
use crate::record::report::{HEAD, STYLE, escaped, number, step};
use std::fmt::Write;

/// Style of a campaign's report, in addition to that of a run's report.
const MORE: &str = include_str!("style.css");
/// Width of every picture (px).
const WIDTH: f64 = 960.0;
/// Margin to the left and right of the interval and the strips (px).
const SIDE: f64 = 40.0;
/// Largest number of bars in a histogram of whole numbers.
const BARS: usize = 48;
/// Number of failures that a page lists one by one.
const LISTED: usize = 500;
/// Number of runs above which a strip shows only a part of the solved ones.
const DOTS: usize = 2000;

/// Returns the report of a campaign as an HTML page. `aim` is the required share of solved runs
/// (`--at-least`).
#[must_use]
pub fn page(tally: &Tally, aim: Option<f64>) -> String {
    let name = std::path::Path::new(&tally.header.scenario);
    let name = name.file_stem().map_or("campaign".into(), |s| s.to_string_lossy().into_owned());
    let title = format!("{name}, {} runs", grouped(tally.runs()));
    let mut html = String::with_capacity(1 << 18);
    let _ = write!(
        html,
        "{HEAD}<title>{}</title>\n<style>\n{STYLE}{MORE}</style></head>\n<body><main>\n",
        escaped(&title)
    );
    head(&mut html, tally, &title, aim);
    failures(&mut html, tally);
    spreads(&mut html, tally);
    mishaps(&mut html, tally);
    drawn(&mut html, tally);
    origin(&mut html, tally);
    html.push_str("</main></body></html>\n");
    html
}

/// Formats a share in percent, with at most two decimals.
fn percent(share: f64) -> String {
    let text = format!("{:.2}", 100.0 * share);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Formats a number with a thin space between groups of three digits.
fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

/// Appends the head of the page: the share of solved runs with its 95 % interval, and the most
/// important figures. `aim` is the required share (`--at-least`).
fn head(html: &mut String, tally: &Tally, title: &str, aim: Option<f64>) {
    let failed = tally.runs() - tally.solved;
    let [low, high] = tally.interval;
    // Without a required share any failure colours the verdict red.
    let reached = aim.map_or(failed == 0, |aim| tally.success() >= aim);
    let class = if reached && tally.runs() > 0 && tally.is_complete() { "good" } else { "bad" };
    let _ = write!(
        html,
        "<header><p class=over>{} &middot; report of a campaign</p><h1>{}</h1>\n\
         <p class=\"verdict {class}\"><b>{} %</b> {} of {} runs solved; the true share lies \
         between {} and {} % (95 % interval, Wilson){}</p>",
        escaped(tally.header.program_name()),
        escaped(title),
        percent(tally.success()),
        grouped(tally.solved),
        grouped(tally.runs()),
        percent(low),
        percent(high),
        aim.map_or_else(String::new, |aim| format!("; at least {} % are required", percent(aim))),
    );
    if !tally.is_complete() {
        let _ = write!(
            html,
            "<p class=warn>Not all runs are done: {} of {}.</p>",
            grouped(tally.runs()),
            grouped(tally.asked)
        );
    }
    html.push_str(&interval(tally, aim));
    html.push_str("<dl class=facts>");
    let mut fact = |name: &str, value: String| {
        let _ = write!(html, "<div><dt>{name}</dt><dd>{value}</dd></div>");
    };
    fact("failures", grouped(failed));
    fact("runs without a verdict", grouped(tally.without_verdict()));
    // Runs that all died have no figures, and runs of earlier builds have no contact.
    let most = tally.spread(|f| Some(f.peak_force_n));
    if !most.is_empty() {
        fact("largest force", format!("{} N", figure(most.max, 1)));
        let contact = tally.spread(|f| f.peak_contact_n);
        if !contact.is_empty() {
            fact("largest contact", format!("{} N", figure(contact.max, 1)));
            let above = format!("runs above {}", tally.limit());
            fact(&above, grouped(tally.above_limit()));
            if tally.concerns_cube() {
                fact("runs with an unnoticed drop", grouped(tally.unnoticed()));
            }
        }
        if tally.contact_unknown() > 0 {
            fact("runs with unknown contact", grouped(tally.contact_unknown()));
        }
        if tally.concerns_cube() {
            let turns: f64 = figures(tally).map(|(_, f)| f64::from(f.turns)).sum();
            fact("face turns in total", grouped(turns as u64));
        }
        // A time that is not finite is stored as `f64::MAX` and would hide the others in the sum.
        let hours: f64 = figures(tally).map(|(_, f)| f.sim_time_s.min(1e9)).sum::<f64>() / 3600.0;
        fact("simulated time in total", format!("{hours:.1} h"));
        if tally.concerns_cube() {
            fact("drops", grouped(u64::from(tally.mishaps.drops)));
        }
        fact("hash of the plant", tally.plants().join(", "));
    }
    fact("recoveries", grouped(tally.recoveries));
    html.push_str("</dl></header>\n");
}

/// Returns the runs whose summary gave figures (forces, turns, times), each with these figures.
fn figures(tally: &Tally) -> impl Iterator<Item = (&RunResult, &Figures)> {
    tally.results.iter().filter_map(|r| Some((r, r.figures.as_ref()?)))
}

/// Draws the share of solved runs with its 95 % interval; returns the SVG. The scale reaches from a
/// little below the interval, or below `aim` (the share of `--at-least`), up to 100 %.
fn interval(tally: &Tally, aim: Option<f64>) -> String {
    let [low, high] = tally.interval;
    let least = aim.map_or(low, |aim| low.min(aim));
    // The scale begins at a round value, at least one step below the lowest mark.
    let by = step((1.0 - least).max(1e-4) * 100.0, 6.0);
    let from = ((100.0 * least / by).floor() - 1.0).max(0.0) * by;
    let x = |percent: f64| SIDE + (WIDTH - 2.0 * SIDE) * (percent - from) / (100.0 - from);
    let mut svg = open(74.0, "interval", "success and its interval");
    let mut tick = from;
    // The steps add up with rounding errors; the last tick must not be lost by them.
    while tick <= 100.0 + 1e-9 {
        let _ = write!(
            svg,
            "<line class=grid x1={0:.1} x2={0:.1} y1=14 y2=48 />\
             <text class=tick x={0:.1} y=64 text-anchor=middle>{1} %</text>",
            x(tick),
            number(tick)
        );
        tick += by;
    }
    let (a, b, at) = (x(100.0 * low), x(100.0 * high), x(100.0 * tally.success()));
    let _ = write!(
        svg,
        "<rect class=span x={a:.1} y=22 width={:.1} height=18 rx=3 />\
         <circle class=share cx={at:.1} cy=31 r=7 />",
        (b - a).max(1.0)
    );
    if let Some(aim) = aim {
        let at = x(100.0 * aim);
        let _ = write!(
            svg,
            "<line class=limit x1={at:.1} x2={at:.1} y1=10 y2=52 />\
             <text class=limitname x={:.1} y=10 text-anchor=end>required</text>",
            at - 4.0
        );
    }
    svg.push_str("</svg>");
    svg
}

/// Appends the failures: a bar for each phase, then a table with their commands.
fn failures(html: &mut String, tally: &Tally) {
    html.push_str("<section><h2>Failures</h2>");
    let phases = tally.by_phase();
    if phases.is_empty() {
        html.push_str("<p>None.</p></section>\n");
        return;
    }
    html.push_str(
        "<p class=lead>Grouped by the phase in which the run ended. The command repeats the run to \
         the bit, unless the time limit ended it.</p>",
    );
    let most = phases.values().map(Vec::len).max().unwrap_or(1) as f64;
    html.push_str("<div class=bars>");
    for (name, runs) in &phases {
        let _ = write!(
            html,
            "<div><span class=name>{}</span><i style=\"width:{:.1}%\"></i>\
             <span class=n>{} ({} %)</span></div>",
            escaped(name),
            // The longest bar leaves room for the name and the number beside it.
            60.0 * runs.len() as f64 / most,
            runs.len(),
            percent(runs.len() as f64 / tally.runs().max(1) as f64)
        );
    }
    html.push_str("</div>");
    html.push_str(
        "<table class=failures><thead><tr><th>seed<th>phase<th>verdict<th>reason</tr></thead>\
         <tbody>",
    );
    for run in tally.failures().take(LISTED) {
        let _ = write!(
            html,
            "<tr><td class=n>{}<td>{}<td>{}<td>{}<br><code>{}</code></tr>",
            run.seed,
            escaped(phase(run)),
            run.verdict.word(),
            escaped(&run.reason),
            escaped(&tally.command(run))
        );
    }
    html.push_str("</tbody></table>");
    let more = tally.failures().count().saturating_sub(LISTED);
    if more > 0 {
        let _ = write!(html, "<p class=note>And {} more.</p>", grouped(more as u64));
    }
    html.push_str("</section>\n");
}

/// Appends a table of the distributions and a histogram of each quantity.
fn spreads(html: &mut String, tally: &Tally) {
    if figures(tally).next().is_none() {
        return;
    }
    html.push_str(
        "<section><h2>Distribution of the figures</h2><p class=lead>All runs that ended with a \
         verdict, solved or not. Runs that were not solved are red.</p><table class=spread><thead>\
         <tr><th>",
    );
    for name in Spread::COLUMNS {
        let _ = write!(html, "<th class=n>{name}");
    }
    html.push_str("</tr></thead><tbody>");
    let mut columns = tally.columns();
    for column in &columns {
        let _ = write!(html, "<tr><th>{}", escaped(&capital(&column.words)));
        for value in column.spread().values() {
            let _ = write!(html, "<td class=n>{}", figure(value, column.decimals));
        }
        html.push_str("</tr>");
    }
    html.push_str("</tbody></table><div class=pair>");
    for column in &mut columns {
        // A value of 1e12 or more replaces an infinite one, and would leave all others in the
        // first bar.
        column.values.retain(|(value, _)| value.abs() < 1e12);
        let (title, whole) = (escaped(&capital(&column.words)), column.decimals == 0);
        let _ = write!(html, "<figure>{}</figure>", histogram(&title, &column.values, whole));
    }
    html.push_str("</div></section>\n");
}

/// Width of a histogram, its margins to the left, right and top, and the height of its panel (px).
const WIDE: f64 = 470.0;
const LEFT: f64 = 34.0;
const RIGHT: f64 = 10.0;
const TOP: f64 = 24.0;
const PANEL: f64 = 130.0;
/// Vertical position of the axis (px).
const BOTTOM: f64 = TOP + PANEL;

/// Draws the histogram of `values`, each with whether its run was solved; returns the SVG. The
/// failed runs are the red bottom of a bar. `whole` says that the values are whole numbers.
fn histogram(title: &str, values: &[(f64, bool)], whole: bool) -> String {
    let mut svg = format!(
        "<svg class=\"wide histogram\" viewBox=\"0 0 {WIDE} {:.0}\" role=img><title>{title}</title>\
         <text class=name x={LEFT} y={:.0}>{title}</text>",
        BOTTOM + 24.0,
        TOP - 9.0
    );
    if !values.is_empty() {
        let bars = Bars::of(values, whole);
        bars.draw_grid(&mut svg);
        bars.draw(&mut svg);
        bars.draw_marks(&mut svg, whole);
        let _ = write!(
            svg,
            "<line class=axis x1={LEFT} x2={:.0} y1={BOTTOM} y2={BOTTOM} />",
            WIDE - RIGHT
        );
    }
    svg.push_str("</svg>");
    svg
}

/// Bars of a histogram.
struct Bars {
    /// Value at the left end, and width of a bar, in units of the quantity.
    from: f64,
    by: f64,
    /// Number of solved and of failed runs of each bar.
    counts: Vec<(usize, usize)>,
    /// Number of runs of the highest bar.
    most: f64,
    /// Width of a bar in the drawing (px).
    width: f64,
}

impl Bars {
    /// Counts `values`, each with whether its run was solved, in bars whose width is a round
    /// number. If the values are whole numbers (`whole`), each has its own bar where there is room.
    fn of(values: &[(f64, bool)], whole: bool) -> Self {
        let low = values.iter().fold(f64::INFINITY, |m, v| m.min(v.0));
        let high = values.iter().fold(f64::NEG_INFINITY, |m, v| m.max(v.0));
        let by = if whole {
            step(high - low + 1.0, BARS as f64).max(1.0).ceil()
        } else {
            // Equal values have no range; their bar still needs a width that survives rounding.
            step((high - low).max(1e-6 * high.abs()).max(1e-9), 30.0)
        };
        let from = (low / by).floor() * by;
        // The step allows about 30 bars, or BARS of whole numbers; the cap bounds
        // the page for any values that a state file may hold.
        let count = (((high - from) / by).floor() as usize + 1).min(4 * BARS);
        let mut counts = vec![(0_usize, 0_usize); count];
        for (value, solved) in values {
            let at = (((value - from) / by).floor().max(0.0) as usize).min(count - 1);
            if *solved {
                counts[at].0 += 1;
            } else {
                counts[at].1 += 1;
            }
        }
        let most = counts.iter().map(|(a, b)| a + b).max().unwrap_or(1).max(1) as f64;
        let width = (WIDE - LEFT - RIGHT) / count as f64;
        Self { from, by, counts, most, width }
    }

    /// Draws the horizontal lines, each labelled with the number of runs at its height.
    fn draw_grid(&self, svg: &mut String) {
        let lines = step(self.most, 3.0).max(1.0);
        let mut line = 0.0;
        while line <= self.most {
            let y = BOTTOM - PANEL * line / self.most;
            let _ = write!(
                svg,
                "<line class=grid x1={LEFT} x2={:.0} y1={y:.1} y2={y:.1} />\
                 <text class=tick x={:.0} y={:.1} text-anchor=end>{}</text>",
                WIDE - RIGHT,
                LEFT - 5.0,
                y + 4.0,
                number(line)
            );
            line += lines;
        }
    }

    /// Draws the bars, each with its smallest value and its number of runs as a tooltip.
    fn draw(&self, svg: &mut String) {
        let inner = (self.width - 1.0).clamp(0.6, 60.0);
        for (index, (solved, failed)) in
            self.counts.iter().enumerate().filter(|(_, b)| b.0 + b.1 > 0)
        {
            let x = LEFT + index as f64 * self.width + (self.width - inner) / 2.0;
            // One failure among thousands would be thinner than a pixel.
            let least = if *failed > 0 { 3.0 } else { 0.0 };
            let bad = (PANEL * *failed as f64 / self.most).max(least);
            let good = (PANEL * *solved as f64 / self.most).min(PANEL - bad);
            let _ = write!(
                svg,
                "<g><title>{}: {} runs</title><rect class=bar x={x:.1} y={:.1} width={inner:.1} \
                 height={good:.1} /><rect class=\"bar red\" x={x:.1} y={:.1} width={inner:.1} \
                 height={bad:.1} /></g>",
                number(self.from + self.by * index as f64),
                solved + failed,
                BOTTOM - bad - good,
                BOTTOM - bad
            );
        }
    }

    /// Draws round values below the axis. If each whole number has its own bar, the value is
    /// centred below the bar.
    fn draw_marks(&self, svg: &mut String, whole: bool) {
        let (from, by, count) = (self.from, self.by, self.counts.len() as f64);
        let marks = step(by * count, 6.0).max(if whole { 1.0 } else { 0.0 });
        let middle = if whole && by == 1.0 { 0.5 } else { 0.0 };
        let mut mark = (from / marks).ceil() * marks;
        while mark <= from + by * count + 1e-9 {
            let x = LEFT + ((mark - from) / by + middle) * self.width;
            // The centring may move the last mark beyond the panel.
            if x <= WIDE - RIGHT + 1.0 {
                let _ = write!(
                    svg,
                    "<text class=tick x={x:.1} y={:.1} text-anchor=middle>{}</text>",
                    BOTTOM + 16.0,
                    number(mark)
                );
            }
            mark += marks;
        }
    }
}

/// Appends the mishaps that the plant counted.
fn mishaps(html: &mut String, tally: &Tally) {
    let (with, solved) = tally.mishaps_and_solved;
    html.push_str(
        "<section><h2>Mishaps</h2><p class=lead>Counted by the plant; the controller does not see \
         these numbers.</p><dl class=facts>",
    );
    for (name, count) in tally.mishaps.named() {
        let _ = write!(html, "<div><dt>{name}</dt><dd>{}</dd></div>", grouped(u64::from(count)));
    }
    html.push_str("</dl>");
    if with > 0 {
        let _ = write!(
            html,
            "<p>{} runs had one or more mishaps; {} of these were solved nevertheless.</p>",
            grouped(with),
            grouped(solved)
        );
    }
    html.push_str("</section>\n");
}

/// Appends the keys that `--vary` draws, each with a strip of dots, one for each run.
fn drawn(html: &mut String, tally: &Tally) {
    if tally.header.vary.is_empty() {
        return;
    }
    // The campaign read this text before it began. A state file may hold any other; then the
    // section is left out.
    let path = std::path::Path::new("vary");
    let Ok(vary) = Variations::read(path, &tally.header.vary) else { return };
    html.push_str(
        "<section><h2>Values drawn for each run</h2><p class=lead>Each dot is a run at its drawn \
         value. Runs that were not solved are red and drawn above the others.</p>",
    );
    for (key, distribution) in vary.keys() {
        let _ = write!(
            html,
            "<h3 class=key><code>{}</code> <span>{}</span></h3>",
            escaped(key),
            escaped(&distribution.words())
        );
        html.push_str(&strip(tally, key, distribution));
    }
    html.push_str("</section>\n");
}

/// Returns the value that `--vary` drew for the key in this run.
fn value<'a>(run: &'a RunResult, key: &str) -> Option<&'a str> {
    run.set.iter().find_map(|option| option.strip_prefix(key)?.strip_prefix('='))
}

/// Draws the strip of a key: a dot for each run, at the value that was drawn for the key. Returns
/// the SVG. A key with listed values gets a table instead.
fn strip(tally: &Tally, key: &str, distribution: &Distribution) -> String {
    if let Distribution::OneOf(values) = distribution {
        return table_of(tally, key, values);
    }
    // A campaign may have ten million runs. A part of the solved ones is shown, but all failures.
    let every = tally.results.len().div_ceil(DOTS).max(1);
    let points: Vec<(f64, bool, u64)> = tally
        .results
        .iter()
        .enumerate()
        .filter(|(i, run)| i % every == 0 || run.verdict != Verdict::Solved)
        .filter_map(|(_, run)| {
            let value = value(run, key)?.parse::<f64>().ok()?;
            Some((value, run.verdict == Verdict::Solved, run.seed))
        })
        .collect();
    let low = points.iter().fold(f64::INFINITY, |m, p| m.min(p.0));
    let high = points.iter().fold(f64::NEG_INFINITY, |m, p| m.max(p.0));
    if points.is_empty() {
        return String::new();
    }
    // A step that is lost in the rounding of a large value would make the loop over the ticks
    // endless.
    let range = (high - low).max(1e-6 * high.abs().max(low.abs())).max(1e-9);
    let by = step(range, 10.0);
    let from = (low / by).floor() * by;
    let to = ((high / by).ceil() * by).max(from + by);
    let x = |v: f64| SIDE + (WIDTH - 2.0 * SIDE) * (v - from) / (to - from);
    let mut svg = open(66.0, "strip", key);
    let mut tick = from;
    while tick <= to + 1e-9 * by {
        let _ = write!(
            svg,
            "<line class=grid x1={0:.1} x2={0:.1} y1=4 y2=46 />\
             <text class=tick x={0:.1} y=60 text-anchor=middle>{1}</text>",
            x(tick),
            number(tick)
        );
        tick += by;
    }
    // Later elements cover earlier ones, so the failures come last.
    for wanted in [true, false] {
        for (value, _, seed) in points.iter().filter(|p| p.1 == wanted) {
            // The height depends on the seed, so that solved runs of equal values do not cover each
            // other. The factor is 2^64 over the golden ratio: it scatters consecutive seeds
            // evenly.
            let jitter = (seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as f64 / 256.0;
            let (y, class) = if wanted { (24.0 + 20.0 * jitter, "dot") } else { (12.0, "dot red") };
            let _ = write!(
                svg,
                "<circle class=\"{class}\" cx={:.1} cy={y:.1} r=3>\
                 <title>seed {seed}: {value}</title></circle>",
                x(*value)
            );
        }
    }
    svg.push_str("</svg>");
    svg
}

/// Returns the table of a key with listed values: share of solved runs for each value.
fn table_of(tally: &Tally, key: &str, values: &[Choice]) -> String {
    // A value that is listed twice is drawn twice as often; it has one row.
    let mut unique: Vec<&str> = values.iter().map(|v| v.text.as_str()).collect();
    unique.sort_unstable();
    unique.dedup();
    let mut html = String::from(
        "<table><thead><tr><th>value<th class=n>runs<th class=n>solved<th class=n>95 % interval\
         </tr></thead><tbody>",
    );
    for wanted in unique {
        let runs: Vec<_> = tally.results.iter().filter(|r| value(r, key) == Some(wanted)).collect();
        let solved = runs.iter().filter(|r| r.verdict == Verdict::Solved).count() as u64;
        let [low, high] = super::statistics::wilson(solved, runs.len() as u64);
        let _ = write!(
            html,
            "<tr><td><code>{}</code><td class=n>{}<td class=n>{solved}<td class=n>{} .. {} %</tr>",
            escaped(wanted),
            runs.len(),
            percent(low),
            percent(high)
        );
    }
    html.push_str("</tbody></table>");
    html
}

/// Appends the header of the campaign: program, scenario, options, seeds.
fn origin(html: &mut String, tally: &Tally) {
    let header = &tally.header;
    html.push_str("<section class=origin><h2>Origin</h2><table><tbody>");
    let mut row = |name: &str, value: &str| {
        if !value.is_empty() {
            let _ = write!(html, "<tr><th>{name}<td><code>{}</code></tr>", escaped(value));
        }
    };
    row(
        "program",
        &format!("{} {}, build {}", header.program_name(), header.version, header.build),
    );
    row("scenario", &format!("{} (sum {})", header.scenario, header.scenario_sum));
    row("changed by --set", &header.set.join("; "));
    let last = header.seed.saturating_add(header.runs.saturating_sub(1));
    row("seeds", &format!("{} to {last}", header.seed));
    if header.shard.to_string() != "1/1" {
        row("shard", &header.shard.to_string());
    }
    row("time limit of a run", &format!("{} s by the wall clock", header.limit_s));
    let wall: f64 = tally.results.iter().map(|r| r.wall_time_s).sum();
    row("time of all processes", &format!("{wall:.0} s by the wall clock"));
    html.push_str(
        "</tbody></table><p class=note>The verdict of a run depends on the cube in the simulated \
         cell, not on the controller's belief. A run that panics, is killed or exceeds its time \
         limit counts as a failure.</p>",
    );
    if !header.vary.is_empty() {
        let _ = write!(html, "<h3>File of --vary</h3><pre>{}</pre>", escaped(&header.vary));
    }
    html.push_str("</section>\n");
}

/// Returns the opening tags of a picture of the page's width.
fn open(height: f64, class: &str, title: &str) -> String {
    format!(
        "<svg class=\"wide {class}\" viewBox=\"0 0 {WIDTH:.0} {height:.0}\" role=img>\
         <title>{}</title>",
        escaped(title)
    )
}

/// Returns the text with a capital first letter.
fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::super::result::tests::result;
    use super::super::state::State;
    use super::super::state::tests::header;
    use super::*;

    /// Returns the tally of runs with values drawn by the `--vary` text. Each seventh run failed.
    fn tally(runs: u64, vary: &str) -> Tally {
        let mut header = header(runs, "1/1");
        header.vary = vary.into();
        let drawn = Variations::read(std::path::Path::new("v"), vary).unwrap_or_default();
        let outcome = |seed: u64| {
            let verdict = if seed.is_multiple_of(7) { Verdict::Failed } else { Verdict::Solved };
            let mut run = result(seed, verdict, seed as f64);
            run.set = drawn.draw(seed).iter().map(super::super::vary::Drawn::option).collect();
            (seed, run)
        };
        let results = header.seeds().map(outcome).collect();
        Tally::of(&State { header, results, whole: 0, damaged: 0, torn: false })
    }

    #[test]
    fn foreign_text_cannot_become_markup() {
        let mut tally = tally(20, "");
        for run in &mut tally.results {
            run.verdict = Verdict::Failed;
            run.reason = "<script>alert(1)</script>".into();
            run.phase = "\"><script>".into();
        }
        tally.header.scenario = "</title><script>.toml".into();

        let html = page(&tally, Some(0.995));

        assert!(!html.contains("<script"));
    }

    #[test]
    fn page_lists_every_failure_with_its_command() {
        let tally = tally(40, "a.b = { uniform = [1, 2] }\nc = { one_of = [\"x\", \"y\"] }");
        let html = page(&tally, None);

        for run in tally.failures() {
            assert!(html.contains(&escaped(&tally.command(run))));
        }
        assert_eq!(html.matches("<circle class=\"dot red\"").count(), tally.failures().count());
        assert_eq!(html.matches("<circle class=\"dot").count(), 40);
    }

    #[test]
    fn page_renders_few_runs_and_equal_values() {
        for runs in [0, 1, 2] {
            let html = page(&tally(runs, ""), Some(0.9));
            assert!(html.ends_with("</html>\n") && !html.contains("NaN"), "{runs}");
        }
        let mut equal = tally(5, "");
        for run in &mut equal.results {
            run.figures.as_mut().unwrap().sim_time_s = f64::MAX;
            run.figures.as_mut().unwrap().peak_force_n = 0.0;
        }
        assert!(page(&equal, None).contains("not finite"));
    }

    #[test]
    fn strip_plot_renders_large_and_equal_values() {
        for vary in ["a = { uniform = [1e16, 1e16] }", "a = { uniform = [-1e300, 1e300] }"] {
            assert!(page(&tally(9, vary), None).contains("class=\"dot"));
        }
    }

    #[test]
    fn large_numbers_get_thousands_separators() {
        assert_eq!(grouped(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!((grouped(999).as_str(), percent(0.995).as_str()), ("999", "99.5"));
    }
}
