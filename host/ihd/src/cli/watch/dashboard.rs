//! State of the dashboard: the daemon and its devices, and the effect of keys.

use std::collections::{BTreeMap, VecDeque};

use ihd_model::{DaemonEvent, DeviceReport, EventKind};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::style::{Color, Modifier, Style};

use super::feed::FeedUpdate;
use super::trend::Trend;
use crate::cli::device::{event_text, one_line};

/// Limit of events.
const EVENTS: usize = 200;

/// Silence after which the state is shown as old, in milliseconds: reports come every second.
pub(super) const STALE_MS: i64 = 3_000;

/// Severity of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Grade {
    /// Normal.
    Plain,
    /// Warning.
    Warning,
    /// Alarm.
    Alarm,
}

impl Grade {
    /// Style of the text.
    pub(super) fn style(self) -> Style {
        match self {
            Self::Plain => Style::new(),
            Self::Warning => Style::new().fg(Color::Yellow),
            Self::Alarm => Style::new().fg(Color::Red).add_modifier(Modifier::BOLD),
        }
    }
}

/// Event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Line {
    /// Milliseconds since 1970, UTC.
    pub(super) at_ms: i64,
    /// Name of the device; empty for an event of the daemon itself.
    pub(super) device: String,
    /// Text.
    pub(super) text: String,
    /// Severity.
    pub(super) grade: Grade,
}

/// Action of a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum KeyAction {
    /// None.
    Nothing,
    /// Draw a new frame.
    Draw,
    /// Switch this device off.
    Off(String),
    /// End the dashboard.
    End,
}

/// State of the dashboard.
pub(super) struct Dashboard {
    /// URL of the daemon.
    pub(super) url: String,
    /// Devices shown, in the daemon's order.
    pub(super) devices: Vec<DeviceReport>,
    /// Last minutes of each device.
    pub(super) trends: BTreeMap<String, Trend>,
    /// Last events, newest last.
    pub(super) events: VecDeque<Line>,
    /// Number of events that the daemon dropped for this reader.
    pub(super) missed: u64,
    /// Reason why the daemon does not answer; `None` if it does.
    pub(super) gone: Option<String>,
    /// Result of the last command; `true` if it was carried out.
    pub(super) answer: Option<(String, bool)>,
    /// Time of the last message from the daemon, in milliseconds since 1970.
    pub(super) heard_ms: i64,
    only: Option<String>,
    /// Name of the chosen device: a device that appears must not change which one is switched off.
    chosen: Option<String>,
    paused: bool,
}

impl Dashboard {
    /// Creates the state before any data, of the daemon at `url`; `only` restricts it to one device.
    pub(super) fn new(url: &str, only: Option<String>) -> Self {
        Self {
            url: one_line(url),
            devices: Vec::new(),
            trends: BTreeMap::new(),
            events: VecDeque::new(),
            missed: 0,
            gone: None,
            answer: None,
            heard_ms: 0,
            chosen: only.clone(),
            only,
            paused: false,
        }
    }

    /// Device that keys apply to.
    pub(super) fn chosen(&self) -> Option<&DeviceReport> {
        let name = self.chosen.as_ref()?;
        self.devices.iter().find(|d| d.name == *name)
    }

    /// Its index in the list.
    pub(super) fn place(&self) -> Option<usize> {
        let name = self.chosen.as_ref()?;
        self.devices.iter().position(|d| d.name == *name)
    }

    /// Returns `true` while drawing is stopped.
    pub(super) fn paused(&self) -> bool {
        self.paused
    }

    /// Time since the last message in milliseconds; `None` if it is short.
    pub(super) fn stale_ms(&self, now_ms: i64) -> Option<i64> {
        // A clock that is set back hides no silence.
        let silent = (now_ms - self.heard_ms).abs();
        (self.gone.is_some() || silent > STALE_MS).then_some(silent)
    }

    /// Applies an update.
    pub(super) fn apply(&mut self, updates: FeedUpdate, now_ms: i64) {
        match updates {
            FeedUpdate::Devices(devices) => self.take(devices, now_ms),
            FeedUpdate::DaemonEvent(notice) => {
                self.heard_ms = now_ms;
                self.notice(*notice);
            }
            FeedUpdate::Missed(n) => self.missed = self.missed.saturating_add(n),
            FeedUpdate::History(name, history) => {
                self.trends.entry(name).or_default().fill(&history);
            }
            FeedUpdate::Gone(why) => {
                if self.gone.is_none() {
                    self.push(now_ms, "", "the daemon is gone".into(), Grade::Alarm);
                }
                self.gone = Some(one_line(&why));
            }
            FeedUpdate::Answer(text, ok) => self.answer = Some((one_line(&text), ok)),
        }
    }

    fn take(&mut self, mut devices: Vec<DeviceReport>, now_ms: i64) {
        if let Some(only) = &self.only {
            devices.retain(|d| d.name == *only);
        }
        if self.gone.take().is_some() {
            self.push(now_ms, "", "the daemon is back".into(), Grade::Plain);
        }
        self.heard_ms = now_ms;
        if self.chosen.is_none() {
            self.chosen = devices.first().map(|d| d.name.clone());
        }
        self.trends
            .retain(|name, _| devices.iter().any(|d| d.name == *name));
        self.devices = devices;
    }

    fn notice(&mut self, notice: DaemonEvent) {
        if let EventKind::Telemetry { live } = notice.kind {
            let trend = self.trends.entry(notice.device.clone()).or_default();
            trend.add(&live, notice.at_ms);
            let device = self.devices.iter_mut().find(|d| d.name == notice.device);
            if let Some(device) = device {
                device.live = Some(live);
            }
            return;
        }
        let grade = grade(&notice.kind);
        if let Some(text) = event_text(&notice.kind) {
            self.push(notice.at_ms, &notice.device, one_line(&text), grade);
        }
    }

    fn push(&mut self, at_ms: i64, device: &str, text: String, grade: Grade) {
        self.events.push_back(Line {
            at_ms,
            device: one_line(device),
            text,
            grade,
        });
        while self.events.len() > EVENTS {
            self.events.pop_front();
        }
    }

    /// Returns the action of a key.
    pub(super) fn key(&mut self, key: KeyEvent) -> KeyAction {
        // Some terminals also report the release.
        if key.kind == KeyEventKind::Release {
            return KeyAction::Nothing;
        }
        // The result of a command stays visible until the next key.
        if !matches!(key.code, KeyCode::Esc | KeyCode::Char('o' | 'O')) {
            self.answer = None;
        }
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            KeyCode::Char('c' | 'd') if control => KeyAction::End,
            KeyCode::Char('l') if control => KeyAction::Draw,
            KeyCode::Char(_) if control => KeyAction::Nothing,
            KeyCode::Char('q' | 'Q') => KeyAction::End,
            KeyCode::Char('p' | 'P') => {
                self.paused = !self.paused;
                KeyAction::Draw
            }
            KeyCode::Char('o' | 'O') | KeyCode::Esc => self.off(),
            KeyCode::Up | KeyCode::Left | KeyCode::BackTab => self.step(-1),
            KeyCode::Down | KeyCode::Right | KeyCode::Tab => self.step(1),
            KeyCode::Char(digit @ '1'..='9') => {
                let place = digit as usize - '1' as usize;
                if let Some(device) = self.devices.get(place) {
                    self.chosen = Some(device.name.clone());
                }
                KeyAction::Draw
            }
            _ => KeyAction::Nothing,
        }
    }

    fn off(&mut self) -> KeyAction {
        match &self.chosen {
            Some(name) => {
                let text = format!("{}: switching off …", one_line(name));
                self.answer = Some((text, true));
                KeyAction::Off(name.clone())
            }
            None => KeyAction::Nothing,
        }
    }

    fn step(&mut self, by: isize) -> KeyAction {
        let count = self.devices.len();
        if count > 0 {
            let place = self.place().map_or(0, |place| {
                (place as isize + by).rem_euclid(count as isize) as usize
            });
            self.chosen = Some(self.devices[place].name.clone());
        }
        KeyAction::Draw
    }
}

fn grade(what: &EventKind) -> Grade {
    match what {
        EventKind::Fault { fault, .. } if *fault != 0 => Grade::Alarm,
        EventKind::Store { ok: false, .. } => Grade::Alarm,
        EventKind::PotTemperature {
            overheats: true, ..
        } => Grade::Alarm,
        EventKind::Command { ok: false, .. }
        | EventKind::WindowRefused { .. }
        | EventKind::LookupRefused { .. }
        | EventKind::ResultStored { pass: false, .. } => Grade::Warning,
        EventKind::Lease { taken_from, .. } if !taken_from.is_empty() => Grade::Warning,
        _ => Grade::Plain,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Report of a heating device, as the API returns it.
    pub(in crate::cli::watch) fn report(name: &str, state: &str) -> DeviceReport {
        let json = serde_json::json!({
            "name": name, "serial": name, "address": "sim", "state": state, "since_s": 83,
            "detail": "", "identity": null, "updates_needed": "",
            "live": {
                "half_cycle": 12_345, "state": "Heating", "pot": "Ferromagnetic", "fault": 0,
                "fault_text": "", "limit": "None", "asked_w": 1200, "power_w": 1203.4,
                "f_sw_hz": 51_020, "i_crest_a": 44.8, "r_ohm": 3.274, "l_h": 19.1e-6, "glass_hot": false
            },
            "lookup": {"on_device": 5, "active": 5, "pending": null, "observed_cells": 47},
            "windows": {
                "announced": 130, "stored": 127, "refused": 1, "dropped_by_device": 0, "lost": 2,
                "not_stored": 0, "learned": 120, "unfit": 3, "unlearned": 0
            },
            "asked_by_daemon_w": 1200,
            "lease": {"holder": "ada (ihd device, process 7)", "expires_in_s": 8},
            "sweep_left_w": [], "sweep_is_complete": false, "recording": null, "recording_now": null, "connections": 1
        });
        serde_json::from_value(json).expect("a report")
    }

    pub(in crate::cli::watch) fn notice(at_ms: i64, device: &str, kind: EventKind) -> FeedUpdate {
        FeedUpdate::DaemonEvent(Box::new(DaemonEvent {
            at_ms,
            device: device.into(),
            kind,
        }))
    }

    fn press(code: KeyCode) -> KeyEvent {
        KeyEvent::new(code, KeyModifiers::NONE)
    }

    fn two() -> Dashboard {
        let mut dashboard = Dashboard::new("http://127.0.0.1:8731", None);
        let devices = vec![report("bench", "learning"), report("lab", "idle")];
        dashboard.apply(FeedUpdate::Devices(devices), 1_000);
        dashboard
    }

    #[test]
    fn off_is_for_the_device_that_was_chosen_whatever_appears_before_it() {
        let mut dashboard = two();
        assert_eq!(dashboard.key(press(KeyCode::Down)), KeyAction::Draw);
        let mut more = vec![report("annex", "idle")];
        more.extend(dashboard.devices.clone());
        dashboard.apply(FeedUpdate::Devices(more), 2_000);
        assert_eq!(
            dashboard.key(press(KeyCode::Esc)),
            KeyAction::Off("lab".into())
        );
        assert_eq!(dashboard.key(press(KeyCode::Char('1'))), KeyAction::Draw);
        assert_eq!(
            dashboard.key(press(KeyCode::Char('o'))),
            KeyAction::Off("annex".into())
        );
        // Gone from the list, it can still be switched off: the daemon answers for an unknown device.
        dashboard.apply(FeedUpdate::Devices(vec![]), 3_000);
        assert_eq!(
            dashboard.key(press(KeyCode::Char('o'))),
            KeyAction::Off("annex".into())
        );
        assert_eq!(dashboard.key(press(KeyCode::Char('7'))), KeyAction::Draw);
    }

    #[test]
    fn keys_end_pause_and_choose_around() {
        let mut dashboard = two();
        assert_eq!(dashboard.place(), Some(0));
        dashboard.key(press(KeyCode::Up));
        assert_eq!(dashboard.place(), Some(1));
        dashboard.key(press(KeyCode::Down));
        assert_eq!(dashboard.place(), Some(0));
        dashboard.apply(FeedUpdate::Answer("bench: off".into(), true), 2_000);
        assert!(dashboard.answer.is_some());
        dashboard.key(press(KeyCode::Char('p')));
        assert!(dashboard.paused() && dashboard.answer.is_none());
        assert_eq!(dashboard.key(press(KeyCode::Char('q'))), KeyAction::End);
        let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(dashboard.key(control_c), KeyAction::End);
        let mut released = press(KeyCode::Char('q'));
        released.kind = KeyEventKind::Release;
        assert_eq!(dashboard.key(released), KeyAction::Nothing);
    }

    #[test]
    fn a_daemon_that_is_gone_is_told_once_and_so_is_its_return() {
        let mut dashboard = two();
        for at_ms in [2_000, 3_000] {
            dashboard.apply(FeedUpdate::Gone("connection refused".into()), at_ms);
        }
        assert_eq!(dashboard.stale_ms(5_000), Some(4_000));
        dashboard.apply(FeedUpdate::Devices(vec![report("bench", "idle")]), 6_000);
        assert_eq!(dashboard.stale_ms(6_500), None);
        // A stalled connection without an error is reported too.
        assert_eq!(dashboard.stale_ms(6_000 + STALE_MS + 1), Some(STALE_MS + 1));
        let texts: Vec<&str> = dashboard.events.iter().map(|e| e.text.as_str()).collect();
        assert_eq!(texts, ["the daemon is gone", "the daemon is back"]);
    }

    #[test]
    fn telemetry_is_no_event_and_its_numbers_are_shown_at_once() {
        let mut dashboard = two();
        let mut live = dashboard.devices[0].live.clone().unwrap();
        live.power_w = 777.0;
        dashboard.apply(notice(1_500, "bench", EventKind::Telemetry { live }), 1_500);
        assert_eq!(dashboard.devices[0].live.as_ref().unwrap().power_w, 777.0);
        assert!(dashboard.events.is_empty());
        let fault = EventKind::Fault {
            fault: 3,
            text: "evil\u{1b}[2J\nline".into(),
        };
        for _ in 0..2 * EVENTS {
            dashboard.apply(notice(1_600, "bench", fault.clone()), 1_600);
        }
        assert_eq!(dashboard.events.len(), EVENTS);
        assert!(dashboard.events[0].text.chars().all(|c| !c.is_control()));
        assert_eq!(dashboard.events[0].grade, Grade::Alarm);
    }

    #[test]
    fn only_the_named_device_is_shown() {
        let mut dashboard = Dashboard::new("http://x", Some("lab".into()));
        let devices = vec![report("bench", "learning"), report("lab", "idle")];
        dashboard.apply(FeedUpdate::Devices(devices), 0);
        assert_eq!(dashboard.devices.len(), 1);
        assert_eq!(dashboard.chosen().unwrap().name, "lab");
    }
}
