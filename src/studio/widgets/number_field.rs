//! The number field of the window.
//!
//! A typed number is committed by Enter, Tab or focus loss, and parsed by [`number`](crate::studio::widgets::number). A
//! rejected text leaves the old value, and a message says why. Escape cancels. A drag changes the value continuously,
//! within the range of the field.

use std::cell::{Cell, RefCell};
use std::ops::RangeInclusive;

use egui::{DragValue, Event, Id, Key, Response, Ui};

use crate::plural::one_or_many;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::format::format_significant;
use crate::studio::widgets::number::{Rejection, parse};

/// Maximal number of characters of a rejected text in its message.
const REPEATED: usize = 24;
/// Bounds beyond this size are not displayed.
const BOUNDLESS: f64 = 1e30;

/// A numeric field.
pub struct NumberField<'a> {
    name: &'a str,
    range: RangeInclusive<f64>,
    speed: f64,
    decimals: usize,
    prefix: &'a str,
    unit: Unit<'a>,
    is_whole: bool,
    expected: Option<String>,
    format: Option<fn(f64) -> String>,
}

/// Unit behind the number.
enum Unit<'a> {
    Symbol(&'a str),
    /// Counted noun: singular and plural.
    Counted(&'a str, &'a str),
}

/// A change of a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edit {
    /// The new value.
    pub value: f64,
    /// Whether it was typed; a typed value is one undo step.
    pub is_typed: bool,
}

impl<'a> NumberField<'a> {
    /// A field called `name` for numbers in `range`, bounds included.
    pub fn new(name: &'a str, range: RangeInclusive<f64>) -> Self {
        Self {
            name,
            range,
            speed: 1.0,
            decimals: 6,
            prefix: "",
            unit: Unit::Symbol(""),
            is_whole: false,
            expected: None,
            format: None,
        }
    }

    /// A field for whole numbers in `range`, bounds included.
    pub fn whole(name: &'a str, range: RangeInclusive<usize>) -> Self {
        let range = *range.start() as f64..=*range.end() as f64;
        Self { is_whole: true, decimals: 0, speed: 0.25, ..Self::new(name, range) }
    }

    /// A field for a seed, limited to integers that f64 holds exactly.
    pub fn seed(name: &'a str) -> Self {
        Self::whole(name, 0..=9_000_000_000_000_000).speed(0.1)
    }

    /// Change of the value per point of a drag.
    pub fn speed(self, speed: f64) -> Self {
        Self { speed, ..self }
    }

    /// Maximal number of decimals.
    pub fn decimals(self, decimals: usize) -> Self {
        Self { decimals, ..self }
    }

    /// Text before the number.
    pub fn prefix(self, prefix: &'a str) -> Self {
        Self { prefix, ..self }
    }

    /// Unit symbol behind the number, with its leading blank.
    pub fn unit(self, symbol: &'a str) -> Self {
        Self { unit: Unit::Symbol(symbol), ..self }
    }

    /// Counted noun in singular and plural, each with its leading blank.
    pub fn counting(self, one: &'a str, many: &'a str) -> Self {
        Self { unit: Unit::Counted(one, many), ..self }
    }

    /// Expectation in the message of a rejected number, instead of the range.
    pub fn expecting(self, expected: String) -> Self {
        Self { expected: Some(expected), ..self }
    }

    /// Formatter of the number.
    pub fn shown_as(self, format: fn(f64) -> String) -> Self {
        Self { format: Some(format), ..self }
    }

    /// Shows the field with this value and returns a change. An unchanged value keeps decimals that are not displayed.
    pub fn show(&self, ui: &mut Ui, value: f64) -> (Response, Option<Edit>) {
        let (mut edited, typed, refused) = (value, Cell::new(None), Cell::new(None));
        let (formatter, shown) = (ui.style().number_formatter.clone(), RefCell::new(String::new()));
        let (unit, units) = match &self.unit {
            Unit::Symbol(symbol) => (*symbol, vec![*symbol]),
            Unit::Counted(one, many) => (one_or_many((value == 1.0).into(), one, many), vec![*one, *many]),
        };
        let is_cancelled = is_cancelled(ui.ctx());
        let read = |text: &str| {
            let shown = shown.borrow();
            if is_cancelled {
                return None;
            }
            match self.read(text, &units) {
                // Without a change egui commits the displayed text, which may lack decimals.
                Ok(number) if parse(&shown, "", &[]) == Ok(number) => None,
                Ok(number) => {
                    typed.set(Some(number));
                    Some(number)
                }
                Err(refusal) => {
                    refused.set(Some(self.sentence(text, refusal, &format!("{}{shown}{unit}", self.prefix))));
                    None
                }
            }
        };
        let field = DragValue::new(&mut edited)
            .range(self.range.clone())
            .clamp_existing_to_range(false)
            .update_while_editing(false)
            .speed(self.speed)
            .max_decimals(self.decimals)
            .prefix(self.prefix)
            .suffix(unit)
            .custom_parser(read)
            .custom_formatter(|value, decimals| {
                let text = self.format.map_or_else(|| formatter.format(value, decimals), |format| format(value));
                shown.borrow_mut().clone_from(&text);
                text
            });
        let response = ui.add(field);
        name_widget(&response, self.name);
        if let Some(sentence) = refused.take() {
            report(ui.ctx(), sentence);
        }
        // Arrow keys and assistive technology may leave the range.
        let (least, most) = (*self.range.start(), *self.range.end());
        let edited = if self.is_whole { edited.round() } else { edited };
        let changed = response.changed() && edited != value && edited.is_finite();
        let edit = changed.then(|| Edit { value: edited.clamp(least, most), is_typed: typed.get().is_some() });
        (response, edit.filter(|edit| edit.value != value))
    }

    /// Shows the field and changes the value in place.
    pub fn edit(&self, ui: &mut Ui, value: &mut f64) -> Response {
        let (response, edit) = self.show(ui, *value);
        if let Some(edit) = edit {
            *value = edit.value;
        }
        response
    }

    /// Shows the field and changes a whole number in place.
    pub fn edit_whole(&self, ui: &mut Ui, value: &mut usize) -> Response {
        let (response, edit) = self.show(ui, *value as f64);
        if let Some(edit) = edit {
            *value = edit.value as usize;
        }
        response
    }

    /// Parses a text by the rules of this field.
    fn read(&self, text: &str, units: &[&str]) -> Result<f64, Rejection> {
        let number = parse(text, self.prefix, units)?;
        if self.is_whole && number.fract() != 0.0 {
            return Err(Rejection::NotWhole);
        }
        if self.range.contains(&number) { Ok(number) } else { Err(Rejection::Outside) }
    }

    /// Message about a rejected text.
    fn sentence(&self, text: &str, refusal: Rejection, old: &str) -> String {
        let text = text.trim();
        let typed = match text.char_indices().nth(REPEATED) {
            Some((end, _)) => format!("\"{}...\"", &text[..end]),
            None => format!("\"{text}\""),
        };
        let reason = match refusal {
            Rejection::Empty => "no number was typed".to_owned(),
            Rejection::Ambiguous => {
                let [decimal, thousands] = [".", ""].map(|separator| text.replacen(',', separator, 1));
                format!("{typed} may mean {decimal} or {thousands}")
            }
            Rejection::NoNumber => format!("{typed} is not a number"),
            Rejection::NotWhole => format!("{typed} is not a whole number"),
            Rejection::Outside => format!("{typed} is not {}", self.expected.clone().unwrap_or_else(|| self.bounds())),
        };
        format!("{}: {reason}; {old} stays", self.name)
    }

    /// The range as text.
    fn bounds(&self) -> String {
        let text = |bound: f64| if self.is_whole { format!("{bound}") } else { plain(bound) };
        match (*self.range.start(), *self.range.end()) {
            (least, most) if most >= BOUNDLESS => format!("at least {}", text(least)),
            (least, most) if least <= -BOUNDLESS => format!("at most {}", text(most)),
            (least, most) => format!("between {} and {}", text(least), text(most)),
        }
    }
}

/// A bound as text, rounded if long.
fn plain(bound: f64) -> String {
    let short = format!("{bound}");
    if short.len() <= 8 { short } else { format_significant(bound) }
}

/// Memory of the messages of this frame.
fn place() -> Id {
    Id::unique("refused numbers")
}

/// Stores a message until it is taken. A field is parsed in two passes when it loses the keyboard; the message counts once.
fn report(ctx: &egui::Context, sentence: String) {
    let (now, last) = (ctx.cumulative_pass_nr(), Id::unique("last refused number"));
    ctx.data_mut(|data| {
        let reported = data.get_temp::<(u64, String)>(last);
        if reported.is_none_or(|(pass, reported)| reported != sentence || pass + 1 < now) {
            data.get_temp_mut_or_default::<Vec<String>>(place()).push(sentence.clone());
        }
        data.insert_temp(last, (now, sentence));
    });
    ctx.request_repaint();
}

/// Whether Escape has just taken the keyboard from a field, in this pass or the one before, in which egui would commit.
fn is_cancelled(ctx: &egui::Context) -> bool {
    // Raw events, since a shortcut may have consumed the key.
    let is_pressed = ctx.input(|input| {
        let is_escape = |event: &Event| matches!(event, Event::Key { key: Key::Escape, pressed: true, .. });
        input.raw.events.iter().any(is_escape)
    });
    let (now, place) = (ctx.cumulative_pass_nr(), Id::unique("pass of Escape"));
    ctx.data_mut(|data| {
        if is_pressed {
            data.insert_temp(place, now);
        }
        data.get_temp::<u64>(place).is_some_and(|pass| now <= pass + 1)
    })
}

/// Takes the messages about rejected texts since the last call.
pub fn take_rejections(ctx: &egui::Context) -> Vec<String> {
    ctx.data_mut(|data| data.remove_temp(place())).unwrap_or_default()
}
