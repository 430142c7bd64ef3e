//! Devices on the screen: a row for each, and the chosen one in full.

use ihd_model::{DeviceReport, DeviceState, Live};
use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::{Row, Table};

use super::dashboard::{Dashboard, Grade};
use crate::cli::device::{of_pot, one_line};

/// Draws the list of devices.
pub(super) fn device_list(frame: &mut Frame<'_>, area: Rect, dashboard: &Dashboard, stale: bool) {
    let head = [
        "  device",
        "state",
        "W",
        "of W",
        "kHz",
        "R Ω",
        "L µH",
        "pot, fault",
    ];
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let chosen = dashboard.place();
    // The list scrolls so that the chosen device is visible.
    let shown = usize::from(area.height.saturating_sub(1)).max(1);
    let first = chosen.map_or(0, |place| (place + 1).saturating_sub(shown));
    let listed = dashboard.devices.iter().enumerate().skip(first).take(shown);
    let rows = listed.map(|(k, device)| device_row(k, device, chosen == Some(k), stale));
    let widths = [
        Constraint::Length(16),
        Constraint::Length(15),
        Constraint::Length(5),
        Constraint::Length(5),
        Constraint::Length(6),
        Constraint::Length(6),
        Constraint::Length(6),
        Constraint::Min(0),
    ];
    let table = Table::new(rows, widths).header(Row::new(head).style(bold));
    frame.render_widget(table, area);
}

fn device_row(place: usize, device: &DeviceReport, chosen: bool, stale: bool) -> Row<'static> {
    let mark = if chosen { '>' } else { ' ' };
    let number = if place < 9 {
        (place + 1).to_string()
    } else {
        " ".into()
    };
    let name = format!("{mark}{number} {}", one_line(&device.name));
    let known = device.live.as_ref().filter(|_| device.state.is_heard());
    let of = |text: &dyn Fn(&Live) -> String| known.map_or("–".to_owned(), text);
    let heats = known.filter(|live| live.f_sw_hz > 0);
    let heating = |text: &dyn Fn(&Live) -> String| heats.map_or("–".to_owned(), text);
    let finite = |x: f64, text: String| if x.is_finite() { text } else { "–".into() };
    let last = match known {
        Some(live) if live.fault != 0 => {
            format!("fault {}: {}", live.fault, one_line(&live.fault_text))
        }
        Some(live) => one_line(&live.pot),
        None => one_line(&device.detail),
    };
    let row = Row::new([
        name,
        device.state.as_str().to_owned(),
        of(&|l| format!("{:.0}", l.power_w)),
        of(&|l| l.asked_w.to_string()),
        heating(&|l| format!("{:.2}", f64::from(l.f_sw_hz) * 1e-3)),
        heating(&|l| finite(l.r_ohm, format!("{:.3}", l.r_ohm))),
        heating(&|l| finite(l.l_h, format!("{:.2}", l.l_h * 1e6))),
        last,
    ]);
    let mut style = state_style(device, known);
    if chosen {
        style = style.add_modifier(Modifier::BOLD);
    }
    if stale {
        style = Style::new().add_modifier(Modifier::DIM);
    }
    row.style(style)
}

/// The colour supplements the text and never replaces it.
fn state_style(device: &DeviceReport, known: Option<&Live>) -> Style {
    let faulted = known.is_some_and(|live| live.fault != 0);
    match device.state {
        DeviceState::Faulted => Style::new().fg(Color::Red),
        _ if faulted => Style::new().fg(Color::Red),
        DeviceState::Learning => Style::new().fg(Color::Green),
        DeviceState::WaitingForPot | DeviceState::Incompatible => Style::new().fg(Color::Yellow),
        DeviceState::Searching | DeviceState::Suspended => Style::new().add_modifier(Modifier::DIM),
        DeviceState::Connected | DeviceState::Idle => Style::new(),
    }
}

/// Details of the chosen device in five lines.
pub(super) fn details(device: &DeviceReport, stale: bool) -> Vec<Line<'static>> {
    let mut state = format!(
        "{}: {} for {}",
        device.name,
        device.state.as_str(),
        duration(device.since_s)
    );
    if !device.detail.is_empty() {
        state += &format!(": {}", device.detail);
    }
    let known = device.live.as_ref().filter(|_| device.state.is_heard());
    let now = match known {
        None => Line::from("not heard now"),
        Some(live) => Line::from(now_words(live)),
    };
    let fault = match known {
        Some(live) if live.fault != 0 => {
            let text = format!("fault {}: {}", live.fault, one_line(&live.fault_text));
            Line::styled(text, Grade::Alarm.style())
        }
        Some(live) => Line::from(format!(
            "controller {}, pot {}, limit {}{}; no fault",
            one_line(&live.state),
            one_line(&live.pot),
            one_line(&live.limit),
            if live.glass_hot { ", glass hot" } else { "" }
        )),
        None => Line::default(),
    };
    let lines = vec![
        Line::from(one_line(&state)),
        now,
        fault,
        Line::from(format!("{}{}", pot_text(device), lookup_text(device))),
        Line::from(one_line(&command_words(device))),
    ];
    if stale {
        let dim = Style::new().add_modifier(Modifier::DIM);
        return lines
            .into_iter()
            .map(|line| line.patch_style(dim))
            .collect();
    }
    lines
}

fn now_words(live: &Live) -> String {
    let mut text = format!("{:.0} W of {} W asked", live.power_w, live.asked_w);
    if live.f_sw_hz > 0 {
        let khz = f64::from(live.f_sw_hz) * 1e-3;
        text += &format!(" at {khz:.2} kHz, crest {:.1} A", live.i_crest_a);
        if live.r_ohm.is_finite() && live.l_h.is_finite() {
            text += &format!(", R {:.3} Ω, L {:.2} µH", live.r_ohm, live.l_h * 1e6);
        }
    }
    text
}

/// Temperature of its pot, before other text.
fn pot_text(device: &DeviceReport) -> String {
    let pot = device.pot_temperature.as_ref();
    pot.map_or(String::new(), |pot| format!("pot {}; ", of_pot(pot)))
}

fn lookup_text(device: &DeviceReport) -> String {
    let lookup = &device.lookup;
    let version = match lookup.on_device {
        None => "lookup not known yet".into(),
        Some(0) => "built-in lookup".into(),
        Some(v) => format!("lookup {v}, {} cells known", lookup.observed_cells),
    };
    let pending = lookup
        .pending
        .map_or(String::new(), |v| format!(" ({v} pending)"));
    let w = &device.windows;
    let mut windows = format!("windows: {} stored, {} learned", w.stored, w.learned);
    let bad = [
        (w.unfit, "unfit"),
        (w.refused, "refused"),
        (w.lost, "lost"),
        (w.dropped_by_device, "dropped"),
        (w.not_stored, "not stored"),
    ];
    for (count, word) in bad.into_iter().filter(|(count, _)| *count > 0) {
        windows += &format!(", {count} {word}");
    }
    format!("{version}{pending}; {windows}")
}

fn command_words(device: &DeviceReport) -> String {
    let mut text = match &device.lease {
        None => "nobody commands it".to_owned(),
        Some(lease) => format!(
            "{} commands it, {} s more",
            lease.holder, lease.expires_in_s
        ),
    };
    if !device.sweep_left_w.is_empty() {
        let left: Vec<String> = device.sweep_left_w.iter().map(u16::to_string).collect();
        text += &format!("; sweep, to come: {} W", left.join(", "));
    }
    if let Some(file) = &device.recording {
        text += &format!("; records {file}");
    }
    text
}

/// Formats a duration with the necessary units.
pub(super) fn duration(s: u64) -> String {
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {} s", s / 60, s % 60),
        _ => format!("{} h {} min", s / 3600, s / 60 % 60),
    }
}
