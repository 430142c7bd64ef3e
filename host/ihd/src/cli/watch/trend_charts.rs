//! Trends on the screen: a chart each, or a line of bars where there is little room.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style};
use ratatui::symbols::Marker;
use ratatui::widgets::{Axis, Block, Borders, Chart, Dataset, GraphType, Paragraph, Sparkline};

use super::trend::{Quantity, SPAN_S, Trend};

/// Width from which on the three trends are side by side.
const TRENDS_ABREAST_COLUMNS: u16 = 110;

/// Height from which on a trend has axes; below it is a line of bars.
const CHART_ROWS: u16 = 5;

/// Steps of a bar: eight to a row.
const BAR_STEPS: f64 = 64.0;

/// Draws the three quantities beside or below each other.
pub(super) fn draw_trends(frame: &mut Frame<'_>, area: Rect, trend: &Trend, now_ms: i64) {
    if area.height == 0 {
        return;
    }
    let thirds = [Constraint::Ratio(1, 3); 3];
    let panes: [Rect; 3] = if area.width >= TRENDS_ABREAST_COLUMNS {
        Layout::horizontal(thirds).areas(area)
    } else if area.height >= 3 {
        Layout::vertical(thirds).areas(area)
    } else {
        // Power alone.
        Layout::vertical([
            Constraint::Length(1),
            Constraint::Length(0),
            Constraint::Length(0),
        ])
        .areas(area)
    };
    for (quantity, pane) in Quantity::ALL.into_iter().zip(panes) {
        if pane.height >= CHART_ROWS {
            chart(frame, pane, trend, quantity, now_ms);
        } else {
            bars(frame, pane, trend, quantity, now_ms);
        }
    }
}

/// Ends of the axis: power from 0, R and L with some margin.
fn ends(quantity: Quantity, (low, high): (f64, f64)) -> (f64, f64) {
    match quantity {
        Quantity::Power => (0.0, (1.05 * high).max(1.0)),
        Quantity::R | Quantity::L => {
            let air = (0.1 * (high - low)).max(0.002 * high.abs()).max(1e-9);
            (low - air, high + air)
        }
    }
}

fn chart(frame: &mut Frame<'_>, area: Rect, trend: &Trend, quantity: Quantity, now_ms: i64) {
    let title = format!("{} over {} min", quantity.letter(), SPAN_S / 60);
    let block = Block::new().borders(Borders::TOP).title(title);
    let Some(range) = trend.range(quantity, now_ms) else {
        frame.render_widget(Paragraph::new("not known").block(block), area);
        return;
    };
    let (low, high) = ends(quantity, range);
    let runs = trend.runs(quantity, now_ms);
    let sets = runs.iter().map(|run| {
        Dataset::default()
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(Style::new().fg(Color::Cyan))
            .data(run)
    });
    let x = Axis::default()
        .bounds([-(SPAN_S as f64), 0.0])
        .labels([format!("-{} min", SPAN_S / 60), "now".into()]);
    let y = Axis::default()
        .bounds([low, high])
        .labels([quantity.text(low), quantity.text(high)]);
    let chart = Chart::new(sets.collect()).block(block).x_axis(x).y_axis(y);
    frame.render_widget(chart, area);
}

fn bars(frame: &mut Frame<'_>, area: Rect, trend: &Trend, quantity: Quantity, now_ms: i64) {
    let range = trend.range(quantity, now_ms);
    let text = range.map_or(format!("{} not known", quantity.letter()), |(low, high)| {
        let (low, high) = (quantity.text(low), quantity.text(high));
        format!("{} {low} to {high}", quantity.letter())
    });
    let [words, bars] =
        Layout::horizontal([Constraint::Length(25), Constraint::Min(0)]).areas(area);
    frame.render_widget(Paragraph::new(text), words);
    let Some(range) = range else { return };
    let (low, high) = ends(quantity, range);
    let columns = trend.columns(quantity, usize::from(bars.width), now_ms);
    let step = |x: f64| ((x - low) / (high - low) * BAR_STEPS).round().max(1.0) as u64;
    let data: Vec<Option<u64>> = columns.into_iter().map(|x| x.map(step)).collect();
    let line = Sparkline::default()
        .data(data)
        .max(BAR_STEPS as u64)
        .absent_value_symbol(" ")
        .style(Style::new().fg(Color::Cyan));
    frame.render_widget(line, bars);
}
