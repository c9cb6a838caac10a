//! HTML page of a report: a function for each section, in the order of the page.
//!
//! All texts of the recording are escaped, since a recording may come from anywhere.

use super::classes::{classes, count, quantile};
use super::figures::figures;
use super::html::{HEAD, STYLE, escaped};
use super::story::{ArmStory, BIN, Shot, Story};
use super::svg::{self, Curve, Row};
use crate::operator::Class;
use crate::record::reading::End;
use crate::record::summary::{Outcome, Summary, figure_label, figure_text};
use std::fmt::Write;

/// Returns the report of a run as an HTML page.
pub(super) fn page(story: &Story) -> String {
    let title = title(story);
    let mut html = String::with_capacity(1 << 20);
    // Writing to a string cannot fail, here and below.
    let _ = write!(
        html,
        "{HEAD}<title>{}</title>\n<style>\n{STYLE}</style></head>\n<body><main>\n",
        escaped(&title)
    );
    head(&mut html, story, &title);
    if concerns_cube(story) {
        table(&mut html, story);
    }
    timeline(&mut html, story);
    forces(&mut html, story);
    timing(&mut html, story);
    pictures(&mut html, story);
    drawings(&mut html, story);
    plan(&mut html, story);
    messages(&mut html, story);
    origin(&mut html, story);
    html.push_str("</main></body></html>\n");
    html
}

/// Returns whether the run handled a cube, as far as the recording tells.
fn concerns_cube(story: &Story) -> bool {
    story.summary.as_ref().is_none_or(Summary::concerns_cube)
}

/// Returns the title of the report: the name of the scenario and the seed.
fn title(story: &Story) -> String {
    let path = story.label.fact("scenario");
    let name = std::path::Path::new(path).file_stem().map(|s| s.to_string_lossy().into_owned());
    format!("{}, seed {}", name.unwrap_or_else(|| "run".to_owned()), story.label.fact("seed"))
}

/// Writes verdict, warnings about the recording, cubes and main figures.
fn head(html: &mut String, story: &Story, title: &str) {
    let (class, word, reason) = verdict(story);
    let _ = write!(
        html,
        "<header><p class=over>{} &middot; report of a run</p><h1>{}</h1>\n\
         <p class=\"verdict {class}\"><b>{word}</b> {}</p>",
        escaped(story.label.program()),
        escaped(title),
        escaped(&capital(&reason))
    );
    if let Some(flaw) = story.file_end.as_ref().and_then(End::flaw) {
        let how = format!("{:#}", flaw.after(story.end));
        let _ = write!(
            html,
            "<p class=warn>The recording is {}. This page shows all that could be read.</p>",
            escaped(&how)
        );
    }
    // Gaps come before the figures that they affect.
    for why in incomplete(story) {
        let _ = write!(html, "<p class=warn>{}</p>", escaped(&why));
    }
    if concerns_cube(story) {
        cubes(html, story);
    }
    if let Some(summary) = &story.summary {
        facts(html, summary);
    }
    html.push_str("</header>\n");
}

/// Returns the CSS class of the verdict, its word, and the reason.
fn verdict(story: &Story) -> (&'static str, &'static str, String) {
    // The summary is recorded at the end of a run. Without it the end of the run is unknown.
    let Some(summary) = &story.summary else {
        let damaged = matches!(story.file_end, Some(End::Damaged(_)));
        let word = if damaged { "Damaged" } else { "Cut off" };
        return ("bad", word, "the recording ends before the run does".to_owned());
    };
    let word = match (summary.exit_code(), summary.task.as_str()) {
        (0, "solve") => "Solved",
        (0, _) => "Done",
        _ if summary.outcome == Outcome::Failed => "Failed",
        _ => "Aborted",
    };
    let class = if summary.exit_code() == 0 { "good" } else { "bad" };
    (class, word, summary.reason.clone())
}

/// Draws the nets of the cube at the start, as it was read, and at the end. A net is left out if
/// the recording does not have its colours.
fn cubes(html: &mut String, story: &Story) {
    html.push_str("<div class=cubes>");
    let start = story.label.fact("cube_start");
    let [read, believed, truth] = &story.letters;
    // On hardware there is no true cube, only the believed one.
    let end = if truth.is_empty() { believed } else { truth };
    // The reading in the summary has precedence. A recording that is cut off has no summary.
    let summary_read = story.summary.as_ref().and_then(|s| s.identified.clone());
    let read = summary_read.as_ref().unwrap_or(read);
    for (words, letters) in
        [("at the start", start), ("as it was read", read.as_str()), ("at the end", end.as_str())]
    {
        if letters.len() == 54 {
            let _ = write!(
                html,
                "<figure>{}<figcaption>The cube {words}</figcaption></figure>",
                svg::net(letters)
            );
        }
    }
    html.push_str("</div>");
}

/// Writes the main figures of the run. Those that only a plant knows are missing on hardware.
fn facts(html: &mut String, summary: &Summary) {
    html.push_str("<dl class=facts>");
    let mut fact = |name: &str, value: String| {
        let _ = write!(html, "<div><dt>{}</dt><dd>{}</dd></div>", escaped(name), escaped(&value));
    };
    fact("time", format!("{:.1} s", summary.sim_time_s));
    if summary.turns > 0 {
        fact("turns", summary.turns.to_string());
        fact("grasps", summary.grasps.to_string());
    }
    let of_cube = |value: Option<f64>| value.filter(|_| summary.concerns_cube());
    if let Some((force, torque)) = of_cube(summary.peak_force_n).zip(summary.peak_torque_nm) {
        fact("peak while both hold", format!("{force:.1} N, {torque:.2} Nm"));
    }
    let counts = (summary.jams, summary.slips, summary.drops);
    if let ((Some(jams), Some(slips), Some(drops)), true) = (counts, summary.concerns_cube()) {
        fact("jams, slips, drops", format!("{jams}, {slips}, {drops}"));
    }
    if summary.recoveries > 0 {
        fact("recoveries", summary.recoveries.to_string());
    }
    if let Some(angle) = summary.turned_deg {
        fact("layer turned by", format!("{angle:.1}\u{b0}"));
    }
    for (name, figure) in &summary.figures {
        fact(&figure_label(name), figure_text(figure));
    }
    html.push_str("</dl>");
}

/// Returns a sentence for each gap in the recording.
fn incomplete(story: &Story) -> Vec<String> {
    let mut whys = Vec::new();
    let lost = story.label.of("recording", "lost");
    if !matches!(lost, "" | "0") {
        whys.push(format!(
            "The recorder did not keep up: {lost} messages of this run are missing, and curves and \
             pictures have gaps."
        ));
    }
    for arm in story.arms.iter().filter(|arm| arm.missing > 0) {
        let (name, missing) = (&arm.name, arm.missing);
        let all = arm.ticks.saturating_add(missing);
        whys.push(format!("{missing} of {all} servo periods of {name} are missing."));
    }
    whys
}

/// Writes the table that compares the run with the paper of 2007.
fn table(html: &mut String, story: &Story) {
    html.push_str(
        "<section><h2>Compared with the paper</h2><table class=paper><thead>\
         <tr><th>figure<th>paper, 2007<th>this run<th class=how>how</tr></thead><tbody>",
    );
    for figure in figures(story) {
        let _ = write!(
            html,
            "<tr><th>{}<td class=n>{}<td class=n><b>{}</b><td class=how>{}</tr>",
            escaped(figure.what),
            escaped(figure.paper),
            escaped(&figure.here),
            escaped(&figure.remark)
        );
    }
    html.push_str("</tbody></table></section>\n");
}

/// Returns the beginning (s) and the name of each phase, without the last one, which is "end".
fn phases(story: &Story) -> Vec<(f64, String)> {
    story.phases.iter().filter(|(_, name)| name != "end").cloned().collect()
}

/// Draws phases, holders of the cube, the operator's inputs and messages over time, with a legend
/// of the phases.
fn timeline(html: &mut String, story: &Story) {
    let mut rows = vec![phase_row(story)];
    rows.extend(holder_rows(story));
    if !story.operator.is_empty() {
        let pieces =
            story.operator.iter().map(|(t, word)| (*t, *t, escaped(word), "op".to_owned()));
        rows.push(Row { name: "operator".to_owned(), pieces: pieces.collect() });
    }
    rows.extend(message_rows(story));
    let drawn = svg::timeline(&rows, story.end);
    let _ = write!(html, "<section><h2>What happened when</h2>{drawn}");
    // Short phases have no room for their names in the chart, so a legend repeats them.
    if let Some(summary) = story.summary.as_ref().filter(|s| !s.phases.is_empty()) {
        html.push_str("<ol class=legend>");
        for (i, phase) in summary.phases.iter().enumerate() {
            // The style sheet has eight colours for phases.
            let _ = write!(
                html,
                "<li><i class=p{}></i>{} <span>{:.1} s</span></li>",
                i % 8,
                escaped(&phase.name),
                phase.sim_time_s
            );
        }
        html.push_str("</ol>");
    }
    html.push_str("</section>\n");
}

/// Returns the timeline's row of phases. Each phase lasts until the next one begins.
fn phase_row(story: &Story) -> Row {
    let phases = phases(story);
    let until = |index: usize| phases.get(index + 1).map_or(story.end, |p| p.0);
    let piece = |(i, (begin, name)): (usize, &(f64, String))| {
        (*begin, until(i), escaped(name), format!("p{}", i % 8))
    };
    Row { name: "phase".to_owned(), pieces: phases.iter().enumerate().map(piece).collect() }
}

/// Returns the timeline's rows of the cube's holders: one for each hand and one for neither hand;
/// none if no hand ever held the cube.
fn holder_rows(story: &Story) -> Vec<Row> {
    if story.holders.iter().all(|(_, holders)| holders.is_empty()) {
        return Vec::new();
    }
    let mut lanes: Vec<String> = story.arms.iter().map(|arm| arm.name.clone()).collect();
    lanes.push("neither hand".to_owned());
    let last = lanes.len() - 1;
    let until = |index: usize| story.holders.get(index + 1).map_or(story.end, |h| h.0);
    let row = |(lane, name): (usize, &String)| {
        let mut pieces: Vec<(f64, f64, String, String)> = Vec::new();
        for (i, (begin, holders)) in story.holders.iter().enumerate() {
            if !(holders.contains(name) || holders.is_empty() && lane == last) {
                continue;
            }
            // If only the other hand has changed, the piece continues.
            match pieces.last_mut() {
                Some(before) if (before.1 - begin).abs() < 1e-9 => before.1 = until(i),
                _ => pieces.push((*begin, until(i), escaped(name), format!("h{lane}"))),
            }
        }
        let words = if lane == last {
            "held by neither hand, as the controller believed".to_owned()
        } else {
            format!("held by {name}, as the controller believed")
        };
        Row { name: escaped(&words), pieces }
    };
    lanes.iter().enumerate().map(row).collect()
}

/// Returns the timeline's rows of log messages: injected faults, notes, warnings, errors. A row
/// without a message is left out.
fn message_rows(story: &Story) -> Vec<Row> {
    /// Row of the injected faults.
    const TRUTH: &str = "injected faults: the truth, which the controller does not know";
    // Faults that the scenario injects are logged by the plant.
    let rank = |class: Class, who: &str| match (who, class) {
        // That of another node has the name of its node as well.
        (who, _) if who == "plant" || who.starts_with("plant on ") => TRUTH,
        (_, Class::Info) => "notes",
        (_, Class::Warning) => "warnings",
        (_, Class::NonFatal | Class::Fatal | Class::System) => "errors",
    };
    let row = |name: &'static str| {
        let group = story.messages.iter().filter(|(_, class, who, _)| rank(*class, who) == name);
        let class = if matches!(name, "notes" | "warnings") { "wa" } else { "er" };
        let piece = |(t, _, who, what): &(f64, Class, String, String)| {
            (*t, *t, escaped(&format!("{who}: {what}")), class.to_owned())
        };
        let pieces: Vec<_> = group.map(piece).collect();
        (!pieces.is_empty()).then(|| Row { name: name.to_owned(), pieces })
    };
    [TRUTH, "notes", "warnings", "errors"].into_iter().filter_map(row).collect()
}

/// Draws the force, the torque and the grip of each arm as curves over time.
fn forces(html: &mut String, story: &Story) {
    let label = &story.label;
    // No line is drawn for a limit that the recording does not have or that is no number.
    let limit = |name: &str, unit: &str| {
        let value = label.fact(name).parse::<f64>().ok()?;
        Some((value, format!("limit {value} {unit}")))
    };
    html.push_str(
        "<section><h2>At the wrists</h2><p class=lead>The largest value in each 20 ms, over all \
         servo periods: the wrench that the tool exerts on its surroundings, without its own \
         weight. The bands are the phases.</p>",
    );
    let phases = phases(story);
    for arm in story.arms.iter().filter(|arm| !arm.force.is_empty()) {
        let ArmStory { force, torque, grip, .. } = arm;
        let curve = |title: &'static str, values, limit, class| Curve {
            title,
            values,
            bin: BIN,
            limit,
            class,
        };
        let panels = [
            curve("force [N]", force, limit("force_limit_n", "N"), "force"),
            curve("torque [Nm]", torque, limit("torque_limit_nm", "Nm"), "torque"),
            curve("grip [N]", grip, None, "grip"),
        ];
        let _ = write!(
            html,
            "<h3>{}</h3>{}",
            escaped(&arm.name),
            svg::curves(&panels, &phases, story.end)
        );
    }
    html.push_str(
        "<p class=note>A motion with contact stops at these limits. A free motion stops when the \
         force has changed by more than the limit of the force.</p></section>\n",
    );
}

/// Writes the timing of the servo: histograms for a run on the wall clock, the computing time of a
/// servo period for a run on the virtual clock.
fn timing(html: &mut String, story: &Story) {
    html.push_str("<section><h2>Timing of the servo</h2>");
    let label = &story.label;
    if label.fact("pace") != "real-time" {
        html.push_str(
            "<p>This run was on the virtual clock: each servo period is exact, and the run repeats \
             to the bit. <code>run --pace real-time --record</code> gives a histogram here.</p>",
        );
        if let Some(summary) = &story.summary {
            let periods = story.arms.iter().map(|arm| arm.ticks).max().unwrap_or(0);
            let _ = write!(
                html,
                "<p>{periods} periods of all arms, plant, cameras and recording took {:.1} s on \
                 this machine: {:.0} us a period.</p>",
                summary.wall_time_s,
                summary.wall_time_s / periods.max(1) as f64 * 1e6
            );
        }
    } else if !label.metadata.contains_key("timing") {
        // The timing is recorded at the end of the run. So the file is cut off, or the recorder
        // failed.
        html.push_str("<p>The recording ends before the servo reported its timing.</p>");
    } else {
        for (name, words) in [
            ("wake_up_ns", "from the set time to the beginning of a period"),
            (
                "jitter_ns",
                "difference between a period and the time from one beginning to the next",
            ),
            ("work_ns", "work of a period"),
        ] {
            let classes = classes(label.of("timing", name));
            let us = |q: f64| quantile(&classes, q) as f64 * 1e-3;
            let total = count(&classes);
            let title = format!(
                "{words}: median {:.1} us, 99 % {:.1} us, longest {:.1} us, {total} periods",
                us(0.5),
                us(0.99),
                us(1.0)
            );
            html.push_str(&svg::histogram(&title, &classes));
        }
        let _ = write!(
            html,
            "<p>Missed: {} periods, {} in a row; late readings: {}.</p>",
            escaped(label.of("timing", "missed")),
            escaped(label.of("timing", "missed_in_a_row")),
            escaped(label.of("timing", "late_readings"))
        );
    }
    html.push_str("</section>\n");
}

/// Selects pictures that show the course of the run, with captions, in the order of time: of the
/// stand-alone camera, the picture in which it first found the cube, and the last one; of the
/// hands' cameras, the first `FACES.0` and the last `FACES.1` faces that were read. The turns have
/// no pictures, since the cameras look only on request.
fn chosen(story: &Story) -> Vec<(&Shot, String)> {
    /// Number of faces at the beginning and at the end of the run.
    const FACES: (usize, usize) = (6, 3);
    let mut chosen = Vec::new();
    // Picture and result of a look have different times, so the picture nearest in time is taken.
    let standalone: Vec<_> = story.shots.iter().filter(|s| s.camera == "standalone").collect();
    if let Some((found, _)) = story.seen.first()
        && let Some(shot) = standalone
            .iter()
            .min_by(|a, b| (a.time - found).abs().total_cmp(&(b.time - found).abs()))
    {
        chosen.push((*shot, "the cube is found".to_owned()));
    }
    let phase = |time: f64| {
        let begun = story.phases.iter().rev().find(|(begun, _)| *begun <= time);
        begun.map_or("", |(_, name)| name.as_str())
    };
    if let (Some(last), true) = (standalone.last(), standalone.len() > 1) {
        chosen.push((
            *last,
            format!("the last look, in the phase \u{201c}{}\u{201d}", phase(last.time)),
        ));
    }
    // A picture shows a face that was read if the look nearest in time succeeded.
    let read = |shot: &Shot| {
        let near = story
            .faces
            .iter()
            .min_by(|a, b| (a.0 - shot.time).abs().total_cmp(&(b.0 - shot.time).abs()));
        near.is_some_and(|(_, _, why)| why.is_none())
    };
    let faces: Vec<_> =
        story.shots.iter().filter(|s| s.camera != "standalone" && read(s)).collect();
    // With `max`, no face of a short run belongs to both groups.
    let last = faces.len().saturating_sub(FACES.1).max(FACES.0);
    for (index, shot) in faces.iter().enumerate() {
        if index < FACES.0 || index >= last {
            let words =
                format!("a face is read, in the phase \u{201c}{}\u{201d}", phase(shot.time));
            chosen.push((shot, words));
        }
    }
    chosen.sort_by(|a, b| a.0.time.total_cmp(&b.0.time));
    chosen
}

/// Writes the section with the pictures that [`chosen`] selects. The pictures are inside the HTML,
/// so that the page needs no other files.
fn pictures(html: &mut String, story: &Story) {
    let chosen = chosen(story);
    if chosen.is_empty() {
        return;
    }
    html.push_str("<section><h2>What the cameras saw</h2><div class=shots>");
    for (shot, words) in chosen {
        let _ = write!(
            html,
            "<figure><img alt=\"{} at {:.1} s\" src=\"data:image/jpeg;base64,{}\">\
             <figcaption><b>{:.1} s</b> {}: {words}</figcaption></figure>",
            escaped(&shot.camera),
            shot.time,
            base64(&shot.jpeg),
            shot.time,
            escaped(&shot.camera),
            words = escaped(&words)
        );
    }
    html.push_str("</div></section>\n");
}

/// Writes the section with drawings of the arms at work, which no camera sees. The page calls them
/// drawings, so that no reader takes them for photographs.
fn drawings(html: &mut String, story: &Story) {
    if story.drawn.is_empty() {
        return;
    }
    html.push_str(
        "<section><h2>Drawn from the recording</h2><p class=lead>Drawings, not photographs: the \
         arms at their encoders' positions, the cube as the controller believed it, and again, \
         larger, in the corner.</p><div class=shots>",
    );
    for (time, words, jpeg) in &story.drawn {
        let words = escaped(words);
        let _ = write!(
            html,
            "<figure><img alt=\"Drawing: {words}\" src=\"data:image/jpeg;base64,{}\">\
             <figcaption><b>{time:.1} s</b> {words}</figcaption></figure>",
            base64(jpeg)
        );
    }
    html.push_str("</div></section>\n");
}

/// Writes the solution, the turns that were carried out, and each plan.
fn plan(html: &mut String, story: &Story) {
    let summary = story.summary.as_ref();
    if story.plans.is_empty() && summary.is_none_or(|s| s.executed.is_empty()) {
        return;
    }
    html.push_str("<section><h2>The plan</h2>");
    if let Some(summary) = summary {
        if let Some(solution) = summary.solution.as_ref().filter(|s| !s.is_empty()) {
            let _ = write!(html, "<p class=turns><span>solution</span> {}</p>", escaped(solution));
        }
        if !summary.executed.is_empty() {
            let _ = write!(
                html,
                "<p class=turns><span>carried out</span> {}</p>",
                escaped(&summary.executed)
            );
        }
    }
    // A run plans again after a failure. All its plans are shown.
    for (number, (time, steps)) in story.plans.iter().enumerate() {
        let made = if number == 0 { "Made" } else { "Made again" };
        let _ = write!(html, "<h3>{made} at {time:.1} s</h3>");
        html.push_str(
            "<table class=plan><thead><tr><th><th>what<th class=how>why<th class=n>planned</tr>\
             </thead><tbody>",
        );
        for (index, step) in steps.iter().enumerate() {
            let _ = write!(
                html,
                "<tr><td class=n>{}<td>{}<td class=how>{}<td class=n>{:.1} s</tr>",
                index + 1,
                escaped(&step.what),
                escaped(&step.why),
                step.seconds
            );
        }
        html.push_str("</tbody></table>");
    }
    html.push_str("</section>\n");
}

/// Writes a table of all notes, warnings and errors in the log.
fn messages(html: &mut String, story: &Story) {
    html.push_str("<section><h2>Notes, warnings and errors</h2>");
    if story.messages.is_empty() {
        html.push_str("<p>None.</p></section>\n");
        return;
    }
    html.push_str("<table><thead><tr><th class=n>time<th>class<th>who<th>what</tr></thead><tbody>");
    for (time, class, who, what) in &story.messages {
        // The CSS class has four levels for the colour; the text names the exact class.
        let (look, class) = match class {
            Class::Info => ("info", "info"),
            Class::Warning => ("warning", "warning"),
            Class::NonFatal => ("error", "non-fatal error"),
            Class::System => ("error", "system error"),
            Class::Fatal => ("fatal", "fatal error"),
        };
        let _ = write!(
            html,
            "<tr class={look}><td class=n>{time:.2} s<td>{class}<td>{}<td>{}</tr>",
            escaped(who),
            escaped(what)
        );
    }
    html.push_str("</tbody></table></section>\n");
}

/// Writes build, options, hashes and scenario of the run: everything that is needed to repeat it.
fn origin(html: &mut String, story: &Story) {
    let label = &story.label;
    html.push_str("<section class=origin><h2>Origin</h2><table><tbody>");
    let mut row = |name: &str, value: &str| {
        if !value.is_empty() {
            let _ = write!(html, "<tr><th>{name}<td><code>{}</code></tr>", escaped(value));
        }
    };
    row(
        "program",
        &format!(
            "{} {}, build {}, {}",
            label.program(),
            label.program_version(),
            label.fact("build"),
            label.fact("platform")
        ),
    );
    row("scenario", label.fact("scenario"));
    let options = label.options();
    let words: Vec<_> = options.iter().map(|(_, key, value)| format!("{key} = {value}")).collect();
    row("overridden by", &words.join("; "));
    row("seed", label.fact("seed"));
    row("coordination", label.fact("coordination"));
    row("pace", label.fact("pace"));
    row("begun", &utc(label.fact("started_unix_s").parse().unwrap_or(0)));
    if let Some(summary) = &story.summary {
        row("run hash", &summary.hash);
        // Summaries of older builds have no servo hash.
        if !summary.servo_hash.is_empty() {
            row("servo hash", &summary.servo_hash);
        }
    }
    row("recording", &format!("{} messages over {:.1} s", story.count, story.end));
    html.push_str("</tbody></table><h3>The scenario</h3><pre>");
    html.push_str(&escaped(&label.scenario));
    html.push_str("</pre></section>\n");
}

/// Formats Unix time (s) as date and time in UTC. Days count from 0000-03-01: if years begin in
/// March, the leap day is the last day of its year.
fn utc(seconds: u64) -> String {
    // 719,468 days lie between 0000-03-01 and 1970-01-01. An era has 400 years or 146,097 days.
    let (days, rest) = (seconds / 86_400 + 719_468, seconds % 86_400);
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year + year / 4 - year / 100);
    // `shifted` counts months from March. Each five months have 31 + 30 + 31 + 30 + 31 = 153 days.
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year + era * 400 + u64::from(month <= 2);
    format!("{year}-{month:02}-{day:02} {:02}:{:02} UTC", rest / 3600, rest % 3600 / 60)
}

/// Returns the text with a capital letter at its beginning.
fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Encodes bytes as base64 with padding (RFC 4648).
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let at = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let word = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let letter = LETTERS[(word >> (18 - 6 * i) & 63) as usize];
            text.push(if i <= three.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::story::Step;
    use super::*;
    use crate::record::summary::EndedBy;

    #[test]
    fn base64_encodes_and_pads() {
        assert_eq!(base64(b""), "");
        assert_eq!(base64(b"M"), "TQ==");
        assert_eq!(base64(b"Ma"), "TWE=");
        assert_eq!(base64(b"Man"), "TWFu");
        assert_eq!(base64(&[0xff, 0xd8, 0xff, 0xe0]), "/9j/4A==");
    }

    #[test]
    fn utc_formats_dates_and_leap_days() {
        assert_eq!(utc(0), "1970-01-01 00:00 UTC");
        assert_eq!(utc(951_782_400), "2000-02-29 00:00 UTC");
        assert_eq!(utc(1_795_291_200), "2026-11-21 20:00 UTC");
    }

    #[test]
    fn text_of_a_recording_never_becomes_markup() {
        let mut story = Story::default();
        story.messages.push((1.0, Class::NonFatal, "<script>".into(), "a < b & c".into()));
        story.label.scenario = "</pre><script>alert(1)</script>".into();
        let evil = "\"><script>alert(1)</script>";
        let letters = format!("{evil:U<54}");
        story.letters = [letters.clone(), letters.clone(), letters.clone()];
        let evils =
            |names: &[&str]| names.iter().map(|n| ((*n).to_owned(), evil.to_owned())).collect();
        let timing = ["missed", "missed_in_a_row", "late_readings", "wake_up_ns", "jitter_ns"];
        story.label.metadata.insert("timing".into(), evils(&timing));
        story.label.metadata.insert("recording".into(), evils(&["lost"]));
        let facts = ["version", "scenario", "seed", "arms", "force_limit_n", "standalone_xyz"];
        story.label.metadata.insert("rubik_robot".into(), evils(&facts));
        if let Some(facts) = story.label.metadata.get_mut("rubik_robot") {
            facts.insert("pace".into(), "real-time".into());
            facts.insert("cube_start".into(), letters);
        }

        let html = page(&story);

        assert!(!html.contains("<script") && html.contains("<p>Missed: &quot;&gt;"), "{html}");
        assert_eq!(html.matches("aria-label=\"cube &quot;&gt;").count(), 3, "{html}");
        assert!(html.contains("a &lt; b &amp; c"));
        assert!(html.contains("<td>non-fatal error<td>&lt;script&gt;"), "{html}");
    }

    /// Also checks that the style sheet does not hide the remarks (`how`) on a narrow screen.
    #[test]
    fn page_lists_each_plan_with_its_time() {
        let step = |what: &str| Step { what: what.into(), why: "so".into(), seconds: 1.0 };
        let plans = vec![(5.0, vec![step("turn R")]), (71.5, vec![step("turn U")])];

        let html = page(&Story { plans, ..Story::default() });

        let [first, second] = ["Made at 5.0 s", "Made again at 71.5 s"].map(|w| html.find(w));
        assert!(first.is_some() && first < second, "{html}");
        assert!(html.contains("<td>turn R") && html.contains("<td>turn U"), "{html}");
        assert!(html.contains("<th class=how>why") && html.contains("<th class=how>how"));
        assert!(!STYLE.contains("}.how{display:none}"));
    }

    #[test]
    fn report_has_figures_of_task_with_units() {
        let mut summary = Summary::not_started("press", 1, None, "why", EndedBy::Task);
        summary.figures.insert("pressed_n".to_owned(), 6.25.into());
        summary.figures.insert("<b>".to_owned(), "<i>".into());
        let mut html = String::new();

        facts(&mut html, &summary);

        assert!(html.contains("<dt>pressed [N]</dt><dd>6.25</dd>"), "{html}");
        assert!(html.contains("<dt>&lt;b&gt;</dt><dd>&lt;i&gt;</dd>"), "{html}");
    }

    #[test]
    fn report_labels_pictures_drawn_from_recording() {
        let drawn = vec![(12.5, "turn R by 90\u{b0}".to_owned(), vec![0xff, 0xd8])];

        let html = page(&Story { drawn, ..Story::default() });

        assert!(html.contains("<h2>Drawn from the recording</h2>"), "{html}");
        assert!(html.contains("<b>12.5 s</b> turn R by 90\u{b0}"), "{html}");
        assert!(!page(&Story::default()).contains("Drawn from"));
    }

    #[test]
    fn page_warns_of_lost_messages_and_periods() {
        let mut story = Story::default();
        assert!(!page(&story).contains("class=warn"));

        story.label.metadata.insert("recording".into(), [("lost".into(), "17".into())].into());
        let arm = ArmStory { name: "track".into(), ticks: 90, missing: 10, ..ArmStory::default() };
        story.arms.push(arm);
        let html = page(&story);

        assert!(html.contains("17 messages of this run are missing"), "{html}");
        assert!(html.contains("10 of 100 servo periods of track are missing"), "{html}");
    }

    /// A recording may hold any number of 64 bits. Sums of them must not overflow.
    #[test]
    fn page_saturates_sums_of_extreme_numbers() {
        let (most, last) = (u64::MAX, u64::MAX);
        let arm = ArmStory { ticks: 3, missing: most, last, ..ArmStory::default() };
        let mut story = Story { arms: vec![arm], looks: vec![0, most], ..Story::default() };
        let classes = format!("{most}:{most} 100:{most} 5:1");
        let timing =
            ["wake_up_ns", "jitter_ns", "work_ns"].map(|n| (n.to_owned(), classes.clone()));
        story.label.metadata.insert("timing".into(), timing.into());
        let pace = [("pace".to_owned(), "real-time".to_owned())];
        story.label.metadata.insert("rubik_robot".into(), pace.into());

        let html = page(&story);

        assert!(html.contains(&format!("{most} of {most} servo periods")), "{html}");
        assert!(html.contains(&format!("{most} periods</text>")), "{html}");
    }

    #[test]
    fn page_warns_of_cut_and_damaged_files() {
        let ends =
            |file_end| page(&Story { file_end: Some(file_end), end: 1.5, ..Story::default() });

        assert!(!ends(End::Whole).contains("class=warn"));
        let cut = ends(End::Cut("no more".into()));
        assert!(cut.contains("<b>Cut off</b>"), "{cut}");
        assert!(cut.contains("The recording is cut off after 1.5 s (no more). This"), "{cut}");
        let damaged = ends(End::Damaged("before byte 7: <b>".into()));
        assert!(damaged.contains("<b>Damaged</b>"), "{damaged}");
        let warning = "The recording is damaged (before byte 7: &lt;b&gt;). This";
        assert!(damaged.contains(warning), "{damaged}");
    }

    /// A cube that no hand holds may have fallen, so the page does not say that the operator has
    /// it.
    #[test]
    fn page_shows_unheld_cube_in_neither_hand() {
        let mut story = Story { end: 9.0, ..Story::default() };
        story.holders = vec![(0.0, vec!["track".into()]), (5.0, vec![])];
        story.arms.push(ArmStory { name: "track".into(), ..ArmStory::default() });

        let html = page(&story);

        assert!(html.contains("held by neither hand, as the controller believed"), "{html}");
        for piece in
            ["<title>track: 0.0 to 5.0 s</title>", "<title>neither hand: 5.0 to 9.0 s</title>"]
        {
            assert_eq!(html.matches(piece).count(), 1, "{piece} in {html}");
        }
        assert!(!html.contains("with the operator"));
    }

    #[test]
    fn chosen_pictures_span_first_to_last_face() {
        let mut story = Story {
            phases: vec![(0.0, "identify".into()), (50.0, "inspect".into())],
            ..Story::default()
        };
        for second in 0..60 {
            let time = f64::from(second);
            story.shots.push(Shot { time, camera: "track_hand".into(), jpeg: vec![] });
            story.faces.push((time, "vsp gs1".into(), None));
        }

        let chosen = chosen(&story);

        let times: Vec<f64> = chosen.iter().map(|(shot, _)| shot.time).collect();
        assert_eq!(times, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 57.0, 58.0, 59.0]);
        assert!(chosen[0].1.contains("identify") && chosen[8].1.contains("inspect"));
    }
}
