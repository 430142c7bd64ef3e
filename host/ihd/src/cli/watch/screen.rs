//! Frame: devices, the chosen one in full, its last minutes, events. If the terminal is too small, parts are omitted from below.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Paragraph};

use super::dashboard::{Dashboard, Grade};
use super::device_panes::{details, device_list};
use super::trend_charts::draw_trends;
use crate::cli::device::one_line;

/// Limit of devices in the list; of more, those around the chosen one are shown.
const LISTED: usize = 9;

/// Draws everything.
pub(super) fn draw(frame: &mut Frame<'_>, dashboard: &Dashboard, now_ms: i64) {
    let [title, list, detail, trends, events, footer] = places(frame.area(), dashboard);
    frame.render_widget(title_line(dashboard, now_ms), title);
    frame.render_widget(footer_line(dashboard), footer);
    let stale = dashboard.stale_ms(now_ms).is_some();
    device_list(frame, list, dashboard, stale);
    if let Some(device) = dashboard.chosen() {
        frame.render_widget(Paragraph::new(details(device, stale)), detail);
        if let Some(trend) = dashboard.trends.get(&device.name) {
            draw_trends(frame, trends, trend, now_ms);
        }
    } else if dashboard.devices.is_empty() {
        let text = "the daemon has no device: plug one in, or name one in its configuration";
        frame.render_widget(Paragraph::new(text), detail);
    }
    draw_events(frame, events, dashboard);
}

/// Areas of title, list, details, trends, events and footer, in order of priority.
fn places(area: Rect, dashboard: &Dashboard) -> [Rect; 6] {
    let mut left = area.height;
    let mut take = |height: u16| {
        let rows = height.min(left);
        left -= rows;
        rows
    };
    let title = take(1);
    let footer = take(1);
    let list = take(1 + dashboard.devices.len().clamp(1, LISTED) as u16);
    let detail = take(5);
    let rest = take(u16::MAX);
    let events = if rest >= 6 {
        (rest / 3).clamp(3, 12)
    } else {
        0
    };
    let heights = [title, list, detail, rest - events, events, footer];
    Layout::vertical(heights.map(Constraint::Length)).areas(area)
}

fn title_line(dashboard: &Dashboard, now_ms: i64) -> Line<'static> {
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let mut spans = vec![Span::styled(
        format!("ihd watch  {}  ", clock(now_ms)),
        bold,
    )];
    let alarm = Style::new()
        .fg(Color::Red)
        .add_modifier(Modifier::BOLD | Modifier::REVERSED);
    if dashboard.paused() {
        let style = Style::new().add_modifier(Modifier::REVERSED);
        spans.push(Span::styled(" PAUSED ", style));
        spans.push(" ".into());
    }
    if let Some(silent_ms) = dashboard.stale_ms(now_ms) {
        let text = match &dashboard.gone {
            Some(why) => format!(" NO DAEMON for {} s: {why} ", silent_ms / 1000),
            None => format!(" STALE: nothing heard for {} s ", silent_ms / 1000),
        };
        spans.push(Span::styled(text, alarm));
    } else {
        spans.push(dashboard.url.clone().into());
        if dashboard.missed > 0 {
            spans.push(format!("  {} events missed", dashboard.missed).into());
        }
    }
    Line::from(spans)
}

fn footer_line(dashboard: &Dashboard) -> Line<'static> {
    if let Some((text, ok)) = &dashboard.answer {
        let style = if *ok {
            Style::new().add_modifier(Modifier::BOLD)
        } else {
            Grade::Alarm.style()
        };
        let keys = Span::styled("  q ends, o off", Style::new().add_modifier(Modifier::DIM));
        return Line::from(vec![Span::styled(text.clone(), style), keys]);
    }
    let chosen = dashboard
        .chosen()
        .map_or("it".into(), |d| one_line(&d.name));
    Line::styled(
        format!("o or Esc: {chosen} off   arrows, 1-9: choose   p: pause   q: end"),
        Style::new().add_modifier(Modifier::DIM),
    )
}

fn draw_events(frame: &mut Frame<'_>, area: Rect, dashboard: &Dashboard) {
    if area.height == 0 {
        return;
    }
    let rows = usize::from(area.height.saturating_sub(1));
    let skipped = dashboard.events.len().saturating_sub(rows);
    let lines = dashboard.events.iter().skip(skipped).map(|event| {
        let who = if event.device.is_empty() {
            "daemon"
        } else {
            &event.device
        };
        let text = format!("{} {who}: {}", clock(event.at_ms), event.text);
        Line::styled(text, event.grade.style())
    });
    let block = Block::new().borders(Borders::TOP).title("events");
    frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()).block(block), area);
}

/// Time of day, UTC.
fn clock(at_ms: i64) -> String {
    let s = at_ms.div_euclid(1000).rem_euclid(86_400);
    format!("{:02}:{:02}:{:02} UTC", s / 3600, s / 60 % 60, s % 60)
}

#[cfg(test)]
mod tests {
    use ihd_model::EventKind;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::super::dashboard::tests::{notice, report};
    use super::super::device_panes::duration;
    use super::super::feed::FeedUpdate;
    use super::*;

    const NOW_MS: i64 = 43_200_000;

    /// Five minutes of a bench that heats with 1200 W from the second minute on, and a lab that is gone.
    fn dashboard() -> Dashboard {
        let mut dashboard = Dashboard::new("http://127.0.0.1:8731", None);
        let mut bench = report("bench", "learning");
        bench.detail = "heats with 1200 W".into();
        let mut lab = report("lab", "searching");
        lab.detail = "no answer at tcp:10.0.0.7:4711".into();
        lab.lease = None;
        dashboard.apply(FeedUpdate::Devices(vec![bench.clone(), lab]), NOW_MS);
        let live = bench.live.unwrap();
        for s in 0..=300_i64 {
            let mut live = live.clone();
            let on = s >= 60;
            live.power_w = if on { 1200.0 + (s % 7) as f64 } else { 0.0 };
            live.f_sw_hz = if on { 51_020 } else { 0 };
            live.r_ohm = 3.27 - 0.001 * (s as f64 - 60.0);
            let what = EventKind::Telemetry { live };
            dashboard.apply(notice(NOW_MS - 300_000 + s * 1000, "bench", what), NOW_MS);
        }
        let fault = EventKind::Fault {
            fault: 4,
            text: "current beyond the limit".into(),
        };
        let active = EventKind::LookupActive {
            version: 5,
            observed_cells: 47,
        };
        dashboard.apply(notice(NOW_MS - 90_000, "lab", fault), NOW_MS);
        dashboard.apply(notice(NOW_MS - 2_000, "bench", active), NOW_MS);
        dashboard
    }

    fn drawn(width: u16, height: u16, dashboard: &Dashboard, now_ms: i64) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal
            .draw(|frame| draw(frame, dashboard, now_ms))
            .unwrap();
        terminal.backend().to_string()
    }

    fn all_of(text: &str, words: &[&str]) {
        for word in words {
            assert!(text.contains(word), "{word:?} is not in\n{text}");
        }
    }

    #[test]
    fn a_device_in_five_lines() {
        let lines = details(&report("bench", "learning"), false);
        let text: Vec<String> = lines.iter().map(ToString::to_string).collect();
        insta::assert_snapshot!(text.join("\n"), @r"
        bench: learning for 1 min 23 s
        1203 W of 1200 W asked at 51.02 kHz, crest 44.8 A, R 3.274 Ω, L 19.10 µH
        controller Heating, pot Ferromagnetic, limit None; no fault
        lookup 5, 47 cells known; windows: 127 stored, 120 learned, 3 unfit, 1 refused, 2 lost
        ada (ihd device, process 7) commands it, 8 s more
        ");
    }

    #[test]
    fn a_bench_and_a_lab_at_80_by_24() {
        let text = drawn(80, 24, &dashboard(), NOW_MS);
        all_of(
            &text,
            &[
                "ihd watch  12:00:00 UTC  http://127.0.0.1:8731",
                ">1 bench         learning        1206  1200  51.02  3.030  19.10  Ferromagnetic",
                " 2 lab           searching       –     –     –      –      –      no answer at",
                "bench: learning for 1 min 23 s: heats with 1200 W",
                "1206 W of 1200 W asked at 51.02 kHz, crest 44.8 A, R 3.030 Ω, L 19.10 µH",
                "P 0 W to 1206 W",
                "R 3.030 Ω to 3.270 Ω",
                "11:58:30 UTC lab: fault 4: current beyond the limit",
                "11:59:58 UTC bench: lookup 5 active, 47 cells known",
                "o or Esc: bench off   arrows, 1-9: choose   p: pause   q: end",
            ],
        );
        // Power was 0 in the first minute, a fifth of the bars, and there was no R.
        let bars = |letter: &str| {
            let rows = text.lines().skip_while(|l| !l.contains(letter)).take(3);
            let full = rows.map(|l| l.matches('█').count());
            full.max().unwrap_or(0)
        };
        let heating = (80 - 25) * 4 / 5;
        assert!(
            (heating - 2..=heating + 2).contains(&bars("P 0 W")),
            "{text}"
        );
        assert!(bars("R 3.030 Ω to") < heating, "{text}");
    }

    #[test]
    fn the_same_with_room_at_160_by_45_has_axes() {
        let text = drawn(160, 45, &dashboard(), NOW_MS);
        let axes = ["-5 min", "now", "1266 W", "0 W", "3.006 Ω", "3.294 Ω"];
        all_of(&text, &axes);
        all_of(&text, &["P over 5 min", "R over 5 min", "L over 5 min"]);
    }

    #[test]
    fn a_daemon_that_is_gone_and_a_faulted_device() {
        let mut dashboard = dashboard();
        let mut bench = report("bench", "faulted");
        let live = bench.live.as_mut().unwrap();
        (live.fault, live.fault_text) = (4, "current beyond the limit".into());
        (live.f_sw_hz, live.power_w, live.r_ohm) = (0, 0.0, f64::NAN);
        bench.lease = None;
        dashboard.apply(FeedUpdate::Devices(vec![bench]), NOW_MS);
        dashboard.apply(
            FeedUpdate::Gone("connection refused".into()),
            NOW_MS + 2_000,
        );
        dashboard.apply(FeedUpdate::Answer("bench: off".into(), true), NOW_MS);
        let text = drawn(80, 24, &dashboard, NOW_MS + 12_000);
        all_of(
            &text,
            &[
                "NO DAEMON for 12 s: connection refused",
                ">1 bench         faulted         0     1200  –      –      –      fault 4",
                "fault 4: current beyond the limit",
                "0 W of 1200 W asked",
                "nobody commands it",
                "12:00:02 UTC daemon: the daemon is gone",
                "bench: off  q ends, o off",
            ],
        );
    }

    #[test]
    fn any_size_is_drawn_without_a_panic_and_the_first_lines_first() {
        let mut all = vec![dashboard(), Dashboard::new("http://127.0.0.1:8731", None)];
        let mut many = Dashboard::new("http://x", None);
        let crowd = (0..40).map(|k| report(&format!("dev-{k}"), "idle"));
        many.apply(FeedUpdate::Devices(crowd.collect()), NOW_MS);
        all.push(many);
        for dashboard in &all {
            for width in [1, 2, 7, 20, 40, 79, 80, 109, 110, 300] {
                for height in [1, 2, 3, 4, 5, 8, 11, 13, 16, 24, 30, 90] {
                    drawn(width, height, dashboard, NOW_MS);
                }
            }
        }
        let small = drawn(70, 4, &all[0], NOW_MS);
        assert!(small.contains("ihd watch") && small.contains("bench"));
        assert!(small.contains("q: end"));
    }

    #[test]
    fn the_chosen_one_of_many_is_in_the_list() {
        let mut dashboard = Dashboard::new("http://x", None);
        let crowd = (0..40).map(|k| report(&format!("dev-{k}"), "idle"));
        dashboard.apply(FeedUpdate::Devices(crowd.collect()), NOW_MS);
        use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
        dashboard.key(KeyEvent::new(KeyCode::Up, KeyModifiers::NONE));
        assert!(drawn(80, 24, &dashboard, NOW_MS).contains("dev-39: idle"));
        assert!(drawn(80, 24, &dashboard, NOW_MS).contains(">  dev-39"));
    }

    /// No text from a device may reach the terminal unescaped.
    #[test]
    fn what_devices_say_is_escaped() {
        let mut dashboard = dashboard();
        let evil = "\u{1b}]0;owned\u{7}\u{202e}";
        let mut device = report("bench", "faulted");
        device.detail = evil.into();
        device.recording = Some(evil.into());
        device.lease.as_mut().unwrap().holder = evil.into();
        let live = device.live.as_mut().unwrap();
        (live.fault, live.fault_text) = (9, evil.into());
        (live.pot, live.state) = (evil.into(), evil.into());
        dashboard.apply(FeedUpdate::Devices(vec![device]), NOW_MS);
        let text = drawn(200, 40, &dashboard, NOW_MS);
        assert!(text.chars().all(|c| c == '\n' || !c.is_control()));
        assert!(!text.contains('\u{202e}'));
    }

    #[test]
    fn times_have_the_units_that_they_need() {
        assert_eq!(clock(43_200_000 + 3_661_000), "13:01:01 UTC");
        assert_eq!(
            [5, 83, 7_320].map(duration),
            ["5 s", "1 min 23 s", "2 h 2 min"]
        );
    }
}
